"""From a network's values on a cuboid's lattice to the closed solid that they bound there."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy import ndarray
from skimage.measure import marching_cubes

from cagesdf.extraction.asking import Answers, Method
from cagesdf.extraction.field import CageField
from cagesdf.extraction.lattice import Lattice
from cagesdf.meshes import Mesh, compact

# A vertex is no nearer to a lattice point than this, in steps: at a value of 0 faces would have no area.
NUDGE = 1e-3
# A vertex on a face counts as clipped where the network would go on beyond it by more, in cells.
CLIP_TOLERANCE = 0.25
NOTHING = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))


@dataclass(frozen=True, eq=False)
class Part:
    """What a network makes of one cuboid.

    It depends on the network, the part's code, the cuboid and the cells, not on other cuboids.
    """

    solid: Mesh  # canonical; closed, manifold, outward, within the cuboid; no faces if the network says outside
    clipped: int  # vertices on the cuboid's faces where the network would go on
    asked: int  # points given to the network


def part_of(field: CageField, cuboid: int, cell: float, least: int, method: Method) -> Part:
    """The solid that a field has in one of its cuboids, whose lattice is `Lattice.of(…, cell, least)`."""
    lattice = Lattice.of(field.cage[field.cage.part_ids[cuboid]], cell, least)
    answers = method(lambda points: field.ask(points, cuboid), field.reach(cuboid), lattice)
    solid, beyond = march(answers, lattice)
    return Part(solid, int(np.count_nonzero(beyond < -CLIP_TOLERANCE * cell)), answers.asked)


def march(answers: Answers, lattice: Lattice) -> tuple[Mesh, Float32[ndarray, " c"]]:
    """The surface of what is negative, canonical, closed by the cuboid's faces; the values at vertices on these.

    Marching cubes, in which all that lies beyond the faces is outside. Vertices beyond are moved onto
    the lattice's outermost points: several meet on edges and corners of the cuboid, are made one there, and what was
    between them is gone. So the part of a face that is inside becomes a flat piece of the surface with vertices at the
    lattice's points.
    """
    values = answers.values
    negative = values < 0
    if not negative.any():
        return NOTHING, np.zeros(0, np.float32)
    # Of signs alone, so that vertices come halfway and tell between which points they lie: Lorensen's table reads no
    # more of values. Where exactly is reckoned in float64.
    signs = np.where(negative, np.float32(-1), np.float32(1))
    halfway, faces, _, _ = marching_cubes(signs, level=0.0, gradient_direction="descent", method="lorensen")
    low, high = np.floor(halfway).astype(int), np.ceil(halfway).astype(int)
    below, above = (values[tuple(ends.T)].astype(np.float64) for ends in (low, high))
    share = (below / (below - above)).clip(NUDGE, 1 - NUDGE)
    places = low - 1 + share[:, None] * (high - low)
    beyond = np.flatnonzero(((low < 1) | (high > lattice.cells + 1)).any(axis=1))
    places.clip(0, lattice.cells, out=places)
    points = np.ravel_multi_index(tuple(places[beyond].astype(int).T), lattice.shape)
    _, first, of_point = np.unique(points, return_index=True, return_inverse=True)
    once = np.arange(len(places), dtype=np.int32)
    once[beyond] = beyond[first][of_point]
    a, b, c = once[faces].T
    kept = np.stack([a, b, c], axis=1)[(a != b) & (b != c) & (c != a)]
    solid = compact(Mesh(lattice.points(places), kept))
    return solid, np.minimum(below, above)[beyond[first]].astype(np.float32)
