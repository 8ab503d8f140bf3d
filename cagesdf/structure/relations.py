"""Relations between sibling parts: attachments and the symmetries of StructureNet."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.frames import Similarity

Vector = tuple[float, float, float]
MET = 1e-9  # centres nearer than this have no direction between them


def _vector(values: ndarray) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


def _point(point: Vector, similarity: Similarity) -> Vector:
    return _vector(similarity.to_canonical(np.array([point]))[0])


def _direction(direction: Vector, similarity: Similarity) -> Vector:
    return _vector(similarity.rotation @ direction)


@dataclass(frozen=True)
class Adjacency:
    """Two parts that touch."""

    a: str  # part id
    b: str  # part id
    distance: float  # gap between the parts, canonical units

    def transformed(self, similarity: Similarity) -> "Adjacency":
        """The relation taken through a similarity."""
        return replace(self, distance=self.distance * similarity.scale)

    def between(self, a: Float[ndarray, " 3"], b: Float[ndarray, " 3"]) -> "Adjacency":
        """The relation of moved parts: unchanged, since their centres don't say how far they are apart."""
        return self


@dataclass(frozen=True)
class Reflection:
    """Part b is part a mirrored in a plane."""

    a: str  # part id
    b: str  # part id
    point: Vector  # on the plane, canonical
    normal: Vector  # unit, canonical

    def transformed(self, similarity: Similarity) -> "Reflection":
        """The relation taken through a similarity."""
        return replace(self, point=_point(self.point, similarity), normal=_direction(self.normal, similarity))

    def between(self, a: Float[ndarray, " 3"], b: Float[ndarray, " 3"]) -> "Reflection":
        """The relation of moved parts, by their new centres."""
        offset = b - a
        distance = float(np.linalg.norm(offset))
        normal = _vector(offset / distance) if distance > MET else self.normal
        return replace(self, point=_vector((a + b) / 2), normal=normal)


@dataclass(frozen=True)
class Translation:
    """Part b is part a moved."""

    a: str  # part id
    b: str  # part id
    offset: Vector  # canonical units

    def transformed(self, similarity: Similarity) -> "Translation":
        """The relation taken through a similarity."""
        return replace(self, offset=_vector(similarity.scale * similarity.rotation @ self.offset))

    def between(self, a: Float[ndarray, " 3"], b: Float[ndarray, " 3"]) -> "Translation":
        """The relation of moved parts, by their new centres."""
        return replace(self, offset=_vector(b - a))


@dataclass(frozen=True)
class Rotation:
    """Part b is part a turned about an axis."""

    a: str  # part id
    b: str  # part id
    pivot: Vector  # on the axis, canonical
    axis: Vector  # unit, canonical
    angle: float  # radians

    def transformed(self, similarity: Similarity) -> "Rotation":
        """The relation taken through a similarity."""
        return replace(self, pivot=_point(self.pivot, similarity), axis=_direction(self.axis, similarity))

    def between(self, a: Float[ndarray, " 3"], b: Float[ndarray, " 3"]) -> "Rotation":
        """The relation of moved parts, by their new centres, about the same direction by the same angle."""
        arm = np.cross(self.axis, b - a) / (2 * math.tan(self.angle / 2)) if abs(self.angle) > MET else 0
        return replace(self, pivot=_vector((a + b) / 2 + arm))


Relation = Adjacency | Reflection | Translation | Rotation
