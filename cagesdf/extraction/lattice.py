"""The lattice of one cuboid on which a field is evaluated."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Integer
from numpy import ndarray

from cagesdf.cuboid import Cuboid

WHOLE = 1e-9  # cells: a length that exceeds a number of cells by less has no further one, since rounding explains it


@dataclass(frozen=True, eq=False)
class Lattice:
    """Points along a cuboid's own axes, those on its faces included."""

    cuboid: Cuboid
    cells: Int[ndarray, " 3"]  # along each axis; points are one more

    @staticmethod
    def of(cuboid: Cuboid, cell: float, least: int) -> "Lattice":
        """Cells no larger than `cell` (canonical units), and at least `least` of them along each axis."""
        return Lattice(cuboid, np.maximum(np.ceil(cuboid.size / cell - WHOLE), least).astype(int))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Points along each axis."""
        x, y, z = (self.cells + 1).tolist()
        return x, y, z

    @property
    def steps(self) -> Float[ndarray, " 3"]:
        """Distance of neighbouring points along each axis, canonical units."""
        return self.cuboid.size / self.cells

    def unit_axes(self) -> list[Float[ndarray, " _"]]:
        """Coordinates of the points along each axis, unit frame."""
        return [np.arange(count + 1) / count - 0.5 for count in self.cells.tolist()]

    def points(self, indices: Integer[ndarray, "n 3"] | Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Canonical positions of (possibly fractional) indices; equal ones have equal positions in any batch.

        Along a cuboid whose axes are the frame's own, all points of a face have the very same coordinate.
        """
        x, y, z = ((indices / self.cells - 0.5) * self.cuboid.size).T[:, :, None]
        a, b, c = self.cuboid.axes
        return x * a + y * b + z * c + self.cuboid.centre


def strides_of(shape: tuple[int, ...]) -> Int[ndarray, " 3"]:
    """Differences of the flat indices of neighbours along each axis, in an array of three axes."""
    return np.array([shape[1] * shape[2], shape[2], 1])
