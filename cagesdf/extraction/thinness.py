"""How many cells go through a part, and the lattice in which enough of them do."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cuboid
from cagesdf.extraction.lattice import Lattice
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.meshes import Mesh, face_normals, signed_volume

HELD = 2.0  # cells that a part must be thick


@dataclass(frozen=True)
class Fineness:
    """The cells of a part, and how far its surface may move as its faces are reduced (see EASE)."""

    least: int  # cells along each axis of its cuboid
    finer: float  # the smallest cells that a part gets so that it is HELD thick, of those asked for; 1: no smaller ones
    sag: float  # of chords between the vertices that `merged` leaves, in steps
    even: float  # largest movement as the closed part is simplified after that, in the shortest steps


USUAL = Fineness(16, 0.25, 0.028, 0.05)
PREVIEW = Fineness(12, 1.0, 0.06, 0.2)  # for surfaces that must appear at once


@dataclass(frozen=True, eq=False)
class Thickness:
    """The thickness of a closed part, in whichever cells it is made."""

    mesh: Mesh  # canonical, closed
    cuboid: Cuboid

    @cached_property
    def _volume(self) -> float:
        return abs(signed_volume(self.mesh)) if len(self.mesh.faces) else 0.0

    @cached_property
    def _areas(self) -> Float[ndarray, "f 3"]:
        """Area of each face as it is seen along each of the cuboid's axes; canonical."""
        return np.abs(face_normals(self.mesh) @ self.cuboid.axes.T) / 2

    def cells(self, lattice: Lattice) -> float:
        """The thickness in the cells of its cuboid's lattice, 0 where nothing has a surface.

        It is `solid.thickness` of the mesh with these cells as units, that of a sheet and half of a rod's: a face's
        area across an axis is then smaller by the other two axes' steps.
        """
        area = float(np.linalg.norm(self._areas * lattice.steps, axis=1).sum())
        return 2 * self._volume / max(area, 1e-300)

    def holding_lattice(self, cell: float, fineness: Fineness) -> Lattice:
        """The lattice that holds the part: HELD cells go through it, each at most `cell`, canonical units.

        A sheet that is bent through a deep cuboid falls between the points of a lattice that does for a thick part. No
        cell is smaller than `fineness.finer` of `cell`, and none so small that the part would have more than the whole
        has in cells of `cell` along [-HALF_EXTENT, HALF_EXTENT].
        """
        size, lattice = cell, Lattice.of(self.cuboid, cell, fineness.least)
        share = float(np.cbrt(self.cuboid.size.prod())) / (2 * HALF_EXTENT)
        smallest = min(max(fineness.finer, share), 1.0) * cell
        while size > smallest and (cells := self.cells(lattice)) < HELD:
            size = max(min(size, float(lattice.steps.max())) * min(cells / HELD, 0.98), smallest)
            lattice = Lattice.of(self.cuboid, size, fineness.least)
        return lattice
