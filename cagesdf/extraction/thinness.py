"""How many cells go through a part, and the lattice in which enough of them do."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cuboid
from cagesdf.extraction.lattice import Lattice
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.meshes import Mesh, face_normals, signed_volume

FINER = 0.25  # of the cells that were asked for: smaller ones thin parts don't get


@dataclass(frozen=True)
class Fineness:
    """Least number of cells of a part, and how far its surface may move as its faces are reduced (see EASE)."""

    least: int  # cells along each axis of its cuboid
    through: float  # cells through its thickness, as far as FINER allows
    sag: float  # of chords between the vertices that `merged` leaves, in steps
    even: float  # largest movement as the closed part is simplified after that, in the shortest steps


USUAL = Fineness(16, 2.0, 0.028, 0.05)
PREVIEW = Fineness(12, 0.0, 0.06, 0.2)  # for surfaces that must appear at once


@dataclass(frozen=True, eq=False)
class Profile:
    """All that the thickness of a part follows from, in whichever cells it is made."""

    volume: float  # canonical
    areas: Float[ndarray, "f 3"]  # of its faces, across each of the cuboid's axes; canonical

    @staticmethod
    def of(mesh: Mesh, cuboid: Cuboid) -> "Profile":
        """The profile of a closed part, canonical."""
        volume = abs(signed_volume(mesh)) if len(mesh.faces) else 0.0
        return Profile(volume, np.abs(face_normals(mesh) @ cuboid.axes.T) / 2)

    def cells(self, lattice: Lattice) -> float:
        """The thickness in the cells of its cuboid's lattice, 0 where nothing has a surface.

        It is `solid.thickness` of the mesh with these cells as units, that of a sheet and half of a rod's: a face's
        area across an axis is then smaller by the other two axes' steps.
        """
        area = float(np.linalg.norm(self.areas * lattice.steps, axis=1).sum())
        return 2 * self.volume / max(area, 1e-300)


def holding_lattice(profile: Profile, cuboid: Cuboid, cell: float, fineness: Fineness) -> Lattice:
    """The lattice that holds a part: `fineness.through` cells go through it, each at most `cell`, canonical units.

    A sheet that is bent through a deep cuboid falls between the points of a lattice that does for a thick part. No cell
    is smaller than FINER of `cell`, and none so small that the part would have more than the whole has in cells of
    `cell` along [-HALF_EXTENT, HALF_EXTENT].
    """
    size, lattice = cell, Lattice.of(cuboid, cell, fineness.least)
    smallest = min(max(FINER, float(np.cbrt(cuboid.size.prod())) / (2 * HALF_EXTENT)), 1.0) * cell
    while (cells := profile.cells(lattice)) < fineness.through and size > smallest:
        size = max(min(size, float(lattice.steps.max())) * min(cells / fineness.through, 0.98), smallest)
        lattice = Lattice.of(cuboid, size, fineness.least)
    return lattice
