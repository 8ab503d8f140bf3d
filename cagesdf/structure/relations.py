"""Relations between sibling parts: attachments and the symmetries of StructureNet."""

from dataclasses import dataclass, replace

import numpy as np

from cagesdf.frames import Similarity

Vector = tuple[float, float, float]


def _point(point: Vector, similarity: Similarity) -> Vector:
    x, y, z = similarity.to_canonical(np.array([point]))[0].tolist()
    return x, y, z


def _direction(direction: Vector, similarity: Similarity) -> Vector:
    x, y, z = (similarity.rotation @ direction).tolist()
    return x, y, z


@dataclass(frozen=True)
class Adjacency:
    """Two parts that touch."""

    a: str  # part id
    b: str  # part id
    distance: float  # gap between the parts, canonical units

    def transformed(self, similarity: Similarity) -> "Adjacency":
        """The relation taken through a similarity."""
        return replace(self, distance=self.distance * similarity.scale)


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


@dataclass(frozen=True)
class Translation:
    """Part b is part a moved."""

    a: str  # part id
    b: str  # part id
    offset: Vector  # canonical units

    def transformed(self, similarity: Similarity) -> "Translation":
        """The relation taken through a similarity."""
        x, y, z = (similarity.scale * similarity.rotation @ self.offset).tolist()
        return replace(self, offset=(x, y, z))


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


Relation = Adjacency | Reflection | Translation | Rotation
