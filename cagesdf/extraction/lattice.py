"""The grid that a field is asked on, and the part of it that each cuboid has."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Integer
from numpy import ndarray

from cagesdf.cuboid import Cuboid

SLAB = 1 << 20  # points whose depths are found at once


@dataclass(frozen=True)
class Lattice:
    """A box of the canonical lattice: points at whole multiples of `cell`, so that mirrored points are negatives."""

    start: tuple[int, int, int]  # its lowest point, counted in cells from the canonical origin
    shape: tuple[int, int, int]  # points along each axis
    cell: float  # canonical units

    @staticmethod
    def covering(low: Float[ndarray, " 3"], high: Float[ndarray, " 3"], cell: float) -> "Lattice":
        """The box around [low, high] with a layer of points outside it, as far as that reaches."""
        start = np.floor(low / cell).astype(int) - 1
        end = np.ceil(high / cell).astype(int) + 1
        return Lattice(_triple(start), _triple(end - start + 1), cell)

    def points(self, indices: Integer[ndarray, "n 3"] | Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Canonical positions of (possibly fractional) indices into the box."""
        return (indices + np.array(self.start)) * self.cell

    def axis(self, k: int) -> Float[ndarray, " r"]:
        """Canonical coordinates along axis `k`."""
        return (self.start[k] + np.arange(self.shape[k])) * self.cell

    def box_of(self, other: "Lattice") -> tuple[slice, slice, slice]:
        """Where another box, which lies within this one, is in its arrays."""
        first = [b - a for a, b in zip(self.start, other.start)]
        x, y, z = (slice(start, start + length) for start, length in zip(first, other.shape))
        return x, y, z


@dataclass(frozen=True, eq=False)
class Region:
    """The lattice around one cuboid; it depends on the cuboid and the cell alone."""

    cuboid: Cuboid
    lattice: Lattice
    inside: Bool[ndarray, "r s t"]  # the points that the cuboid contains, its surface too

    @staticmethod
    def around(cuboid: Cuboid, cell: float) -> "Region":
        """The lattice with cells of size `cell` around a cuboid."""
        reach = np.abs(cuboid.axes.T) @ (cuboid.size / 2)
        lattice = Lattice.covering(cuboid.centre - reach, cuboid.centre + reach, cell)
        inside = np.empty(lattice.shape, dtype=bool)
        thick = max(1, SLAB // (lattice.shape[1] * lattice.shape[2]))
        for first in range(0, lattice.shape[0], thick):
            rows = slice(first, first + thick)
            x, y, z = (lattice.axis(k) for k in range(3))
            inside[rows] = depth_in(cuboid, *np.ix_(x[rows], y, z)) <= 0
        return Region(cuboid, lattice, inside)

    def among(
        self, places: Integer[ndarray, "n 3"], lattice: Lattice
    ) -> tuple[Int[ndarray, " m"], Int[ndarray, " m"], Float32[ndarray, " m"]]:
        """Which of some places of a larger lattice the cuboid contains, their flat indices here, and their depths."""
        local = places + (np.array(lattice.start) - np.array(self.lattice.start))
        rows = np.flatnonzero(((local >= 0) & (local < np.array(self.lattice.shape))).all(axis=1))
        flat = np.ravel_multi_index(tuple(local[rows].T), self.lattice.shape)
        contained = self.inside.reshape(-1)[flat]
        rows, flat = rows[contained], flat[contained]
        return rows, flat, depth_in(self.cuboid, *lattice.points(places[rows]).T)


def depth_in(
    cuboid: Cuboid, x: Float[ndarray, "*#n"], y: Float[ndarray, "*#n"], z: Float[ndarray, "*#n"]
) -> Float32[ndarray, "*#n"]:
    """Signed distance to a cuboid's nearest face plane, canonical: its depth inside, positive outside.

    The coordinates are broadcast against each other.
    """
    x, y, z = ((part - centre).astype(np.float32) for part, centre in zip((x, y, z), cuboid.centre))
    axes, half = cuboid.axes.astype(np.float32), (cuboid.size / 2).astype(np.float32)
    beyond = [np.abs(a * x + b * y + c * z) - h for (a, b, c), h in zip(axes, half)]
    return np.maximum(np.maximum(beyond[0], beyond[1]), beyond[2])


def _triple(numbers: Int[ndarray, " 3"]) -> tuple[int, int, int]:
    x, y, z = numbers.tolist()
    return x, y, z
