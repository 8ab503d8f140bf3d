"""Cuboids: oriented boxes that bound parts, and cages, all cuboids of a shape.

A cuboid (elsewhere: OBB) has a centre, three unit axes as the rows of a proper rotation, and
full side lengths. Its frames are `frames.py`'s: local and unit.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from cagesdf.frames import Similarity

# Corners of [-½, ½]³ in the order used everywhere: x slowest, z fastest.
CORNER_ORDER = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])

BLOCK = 1024  # points whose distances to all cuboids are found at once

# The 24 proper rotations that permute a cuboid's axes: new axes = PROPER_PERMUTATIONS[k] @ axes.
PROPER_PERMUTATIONS = np.array(
    [
        rotation
        for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [1, 0, 2], [2, 1, 0])
        for signs in np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).T.reshape(-1, 3)
        for rotation in [np.eye(3)[order] * signs[:, None]]
        if np.linalg.det(rotation) > 0
    ]
)


@dataclass(frozen=True, eq=False)
class Cuboid:
    """One oriented box."""

    centre: Float[ndarray, " 3"]  # canonical
    axes: Float[ndarray, "3 3"]  # rows are unit axes, right-handed, canonical
    size: Float[ndarray, " 3"]  # full lengths along the axes, canonical units, > 0

    def permuted(self, permutation: Float[ndarray, "3 3"]) -> "Cuboid":
        """The same box with its axes renamed by one of PROPER_PERMUTATIONS."""
        return Cuboid(self.centre, permutation @ self.axes, np.abs(permutation) @ self.size)

    def transformed(self, similarity: Similarity) -> "Cuboid":
        """The box taken through a similarity."""
        centre = similarity.to_canonical(self.centre[None])[0]
        return Cuboid(centre, self.axes @ similarity.rotation.T, self.size * similarity.scale)

    def nearest_to(self, axes: Float[ndarray, "3 3"]) -> "Cuboid":
        """The same box, its axes renamed to be as near as possible to `axes` (largest trace).

        Used with the canonical axes to name them, and with a source's before interpolation:
        naming by size flips between similar shapes.
        """
        traces = np.einsum("kij,jl,il->k", PROPER_PERMUTATIONS, self.axes, axes)
        return self.permuted(PROPER_PERMUTATIONS[int(np.argmax(traces))])


@dataclass(frozen=True, eq=False)
class Cage:
    """All cuboids of one shape, in the order of its structure's parts."""

    part_ids: tuple[str, ...]  # p ids
    centre: Float[ndarray, "p 3"]  # canonical
    axes: Float[ndarray, "p 3 3"]  # rows are unit axes, right-handed, canonical
    size: Float[ndarray, "p 3"]  # full lengths, canonical units, > 0

    @staticmethod
    def of(cuboids: Mapping[str, Cuboid]) -> "Cage":
        """A cage from cuboids by part id, in the mapping's order."""
        return Cage(
            tuple(cuboids),
            np.array([cuboid.centre for cuboid in cuboids.values()]).reshape(-1, 3),
            np.array([cuboid.axes for cuboid in cuboids.values()]).reshape(-1, 3, 3),
            np.array([cuboid.size for cuboid in cuboids.values()]).reshape(-1, 3),
        )

    @staticmethod
    def from_vectors(part_ids: tuple[str, ...], vectors: Float[ndarray, "p 15"]) -> "Cage":
        """Undo `vectors`."""
        values = np.asarray(vectors, dtype=np.float64)
        return Cage(part_ids, values[:, :3], values[:, 3:12].reshape(-1, 3, 3), values[:, 12:15])

    def transformed(self, similarity: Similarity) -> "Cage":
        """All cuboids taken through a similarity."""
        return Cage.of({part_id: cuboid.transformed(similarity) for part_id, cuboid in self.cuboids().items()})

    def at_origin(self) -> "Cage":
        """Cuboids of the same lengths, each centred at the origin with its axes along the frame's."""
        count = len(self)
        return Cage(self.part_ids, np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1)), self.size)

    def __len__(self) -> int:
        return len(self.part_ids)

    def __getitem__(self, part_id: str) -> Cuboid:
        i = self.part_ids.index(part_id)
        return Cuboid(self.centre[i], self.axes[i], self.size[i])

    def cuboids(self) -> dict[str, Cuboid]:
        """The cuboids by part id."""
        return {part_id: self[part_id] for part_id in self.part_ids}

    def vectors(self) -> Float[ndarray, "p 15"]:
        """The network's input (§3.1): centre (3), axes by rows (9), full lengths (3)."""
        return np.concatenate([self.centre, self.axes.reshape(-1, 9), self.size], axis=1)

    def corners(self) -> Float[ndarray, "p 8 3"]:
        """Canonical corners, ordered as CORNER_ORDER."""
        return self.centre[:, None] + (CORNER_ORDER * self.size[:, None]) @ self.axes

    def to_local(self, points: Float[ndarray, "n 3"], cuboid: int) -> Float[ndarray, "n 3"]:
        """Canonical points in the local frame of cuboid number `cuboid`."""
        return (points - self.centre[cuboid]) @ self.axes[cuboid].T

    def to_unit(self, points: Float[ndarray, "n 3"], cuboid: int) -> Float[ndarray, "n 3"]:
        """Canonical points in the unit frame of cuboid number `cuboid`: [-½, ½]³ is inside."""
        return self.to_local(points, cuboid) / self.size[cuboid]

    def from_unit(self, points: Float[ndarray, "n 3"], cuboid: int) -> Float[ndarray, "n 3"]:
        """Undo `to_unit`."""
        return (points * self.size[cuboid]) @ self.axes[cuboid] + self.centre[cuboid]

    def signed_distance(self, points: Float[ndarray, "n 3"]) -> Float[ndarray, "n p"]:
        """Exact signed distance of each point to each cuboid, canonical units, negative inside."""
        result = np.empty((len(points), len(self)))
        for rows, distance in self._blocks(points):
            result[rows] = distance.T
        return result

    def assign(self, points: Float[ndarray, "n 3"]) -> tuple[Int[ndarray, " n"], Float[ndarray, " n"]]:
        """The cuboid that most contains each point (§3.4), and the signed distance to it.

        Outside all cuboids it is the nearest one. Ties go to the first.
        """
        owner, nearest = np.empty(len(points), np.int64), np.empty(len(points))
        for rows, distance in self._blocks(points):
            owner[rows] = distance.argmin(axis=0)
            nearest[rows] = distance.min(axis=0)
        return owner, nearest

    def holder(self, points: Float[ndarray, "n 3"], depth: float) -> Int[ndarray, " n"]:
        """The first cuboid that holds each point deeper than `depth`, canonical units; −1 where none does."""
        owner = np.full(len(points), -1)
        left = np.arange(len(points))
        for k in range(len(self)):
            held = (np.abs(self.to_local(points[left], k)) < self.size[k] / 2 - depth).all(axis=1)
            owner[left[held]] = k
            left = left[~held]
        return owner

    def _blocks(self, points: Float[ndarray, "n 3"]) -> Iterator[tuple[slice, Float[ndarray, "p k"]]]:
        """Signed distances to all cuboids, for rows of points in turn, few enough for the processor's cache."""
        half = self.size[:, :, None] / 2
        for start in range(0, len(points), BLOCK):
            rows = slice(start, min(start + BLOCK, len(points)))
            beyond = np.abs(self.axes @ (points[rows].T - self.centre[:, :, None])) - half
            x, y, z = beyond.swapaxes(0, 1)
            deepest = np.maximum(np.maximum(x, y), z)
            x, y, z = np.square(np.maximum(beyond, 0)).swapaxes(0, 1)
            yield rows, np.sqrt(x + y + z) + np.minimum(deepest, 0)


@dataclass(frozen=True, eq=False)
class Sequence:
    """One deformation of a source shape towards a target's cage (§3.3)."""

    shape_id: str  # the source
    target_id: str | None  # None: the shape has no sequence, only its rest cage, or was scaled
    t: Float[ndarray, " s"]  # in [0, 1], 0 first: the rest shape
    held_out: tuple[bool, ...]  # s flags: steps kept from training
    cages: tuple[Cage, ...]  # s cages with the same parts
