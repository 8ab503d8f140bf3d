"""Surfaces that are measured, and the distances and normals between two of them, both ways."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from manifold3d import Manifold
from numpy import ndarray
from scipy.spatial import cKDTree

from cagesdf.cuboid import Cage, Sequence
from cagesdf.deformation.sequences import Transfer
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, face_normals, is_closed, sample_surface, topology
from cagesdf.geometry.solid import as_manifold, cage_surface, union
from cagesdf.shape import Shape


class Measured:
    """A surface that is asked for distances, normals and insides more than once."""

    def __init__(self, mesh: Mesh) -> None:
        """`mesh` is canonical and has faces; it is closed and outward where insides matter."""
        self.mesh = mesh
        self.distance = SurfaceDistance(mesh)
        self._shared: dict[Measured, float] = {}

    @cached_property
    def normals(self) -> Float[ndarray, "f 3"]:
        """Unit normals of the faces; zero for a face without area."""
        normals = face_normals(self.mesh)
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)

    @cached_property
    def closed(self) -> bool:
        """Whether the surface has no hole and one orientation."""
        return is_closed(self.mesh)

    @cached_property
    def topology(self) -> tuple[int, int]:
        """How many closed surfaces hang together, and how many handles they have in all."""
        return topology(self.mesh)

    @cached_property
    def _solid(self) -> Manifold:
        return as_manifold(self.mesh)

    def iou(self, other: "Measured") -> float:
        """Volume of the intersection over that of the union, exact; 0 for a surface that isn't closed."""
        if not (self.closed and other.closed):
            return 0.0
        if other is self:  # manifold3d, to whom all faces would lie on others, says up to 1.0025
            return 1.0
        if other not in self._shared:
            self._shared[other] = (self._solid ^ other._solid).volume()
        both = self._shared[other]
        return max(both / (self._solid.volume() + other._solid.volume() - both), 0.0)


class Truth(Measured):
    """The true surface, and which of it is detail: further from the cage's surface than a threshold."""

    def __init__(self, mesh: Mesh, cage: Cage, detail: float) -> None:
        """`mesh` is the union of the true parts, canonical; `detail` a share of its longest side."""
        super().__init__(mesh)
        self.side = float(np.ptp(mesh.vertices, axis=0).max())  # the unit of percentages, canonical
        self.threshold = detail * self.side
        self.cage = SurfaceDistance(cage_surface(cage))

    def drawn(self, count: int, rng: np.random.Generator) -> "Drawn":
        """`count` points of it, uniform by area, to measure several surfaces with."""
        points, normals = _sample(self, count, rng)
        return Drawn(points, normals, self.is_detail(points))

    @staticmethod
    def of(shape: Shape, sequence: Sequence, step: int, detail: float, transfer: Transfer) -> "Truth":
        """The union of a shape's parts after they have followed its sequence to `step`."""
        return Truth(union(transfer.parts(shape, sequence, step)), sequence.cages[step], detail)

    @staticmethod
    def of_own_cuboids(shape: Shape, sequence: Sequence, step: int, detail: float, transfer: Transfer) -> "Truth":
        """The same of parts that have each followed its own cuboid alone."""
        return Truth(union(transfer.own_parts(shape, sequence, step)), sequence.cages[step], detail)

    def is_detail(self, points: Float[ndarray, "n 3"]) -> Bool[ndarray, " n"]:
        """Whether points of the true surface are detail."""
        return self.cage.unsigned(points) > self.threshold


@dataclass(frozen=True, eq=False)
class Drawn:
    """Points of the true surface."""

    points: Float[ndarray, "n 3"]  # canonical
    normals: Float[ndarray, "n 3"]  # unit
    detail: Bool[ndarray, " n"]  # whether they are detail

    @cached_property
    def tree(self) -> cKDTree:
        """Nearest-neighbour search among the points."""
        return _tree(self.points)


@dataclass(frozen=True, eq=False)
class Direction:
    """From points of one surface to the other surface."""

    distance: Float[ndarray, " n"]  # exact, to the surface; canonical
    sample: Float[ndarray, " n"]  # to the nearest of the other surface's sampled points; canonical
    cosine: Float[ndarray, " n"]  # between the point's normal and that of the nearest point of the surface
    aligned: Float[ndarray, " n"]  # its absolute value
    detail: Bool[ndarray, " n"]  # the point on the true surface is detail

    def only(self, where: Bool[ndarray, " n"]) -> "Direction":
        """Some of the points."""
        return Direction(*(field[where] for field in vars(self).values()))


def nowhere(side: float) -> Direction:
    """The worst values, for a surface that isn't there: one longest side away, no normal that agrees."""
    one = np.ones(1)
    return Direction(side * one, side * one, -one, 0 * one, np.ones(1, dtype=bool))


def directions(
    predicted: Measured, truth: Truth, drawn: Drawn, rng: np.random.Generator
) -> tuple[Direction, Direction]:
    """From points of the true surface to the predicted one, and from an equal number of its points back."""
    points, normals = _sample(predicted, len(drawn.points), rng)
    distance, faces, _ = predicted.distance.closest(drawn.points)
    cosine = np.einsum("ij,ij->i", drawn.normals, predicted.normals[faces])
    forth = Direction(distance, _nearest(_tree(points), drawn.points), cosine, np.abs(cosine), drawn.detail)
    distance, faces, nearest = truth.distance.closest(points)
    cosine = np.einsum("ij,ij->i", normals, truth.normals[faces])
    back = Direction(distance, _nearest(drawn.tree, points), cosine, np.abs(cosine), truth.is_detail(nearest))
    return forth, back


def _sample(surface: Measured, count: int, rng: np.random.Generator) -> tuple[ndarray, ndarray]:
    points, faces = sample_surface(surface.mesh, count, rng)
    return points, surface.normals[faces]


def _tree(points: ndarray) -> cKDTree:
    """Quickly built: it is asked only as often as it has points."""
    return cKDTree(points, compact_nodes=False, balanced_tree=False)


def _nearest(tree: cKDTree, points: ndarray) -> ndarray:
    """Distance from each point to the nearest of the tree's."""
    return np.asarray(tree.query(points)[0])
