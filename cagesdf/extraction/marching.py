"""The closed solid that a network's values on a cuboid's lattice bound."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy import ndarray
from skimage.measure import marching_cubes

from cagesdf.extraction.lattice import Lattice
from cagesdf.geometry.meshes import Mesh, vertex_normals

# A vertex is no nearer to a lattice point than this, in steps: at a value of 0 faces would have no area.
NUDGE = 1e-3
# Largest movement of a vertex towards the zero set, in steps along each axis.
FARTHEST = 0.4
NOTHING = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))


@dataclass(frozen=True, eq=False)
class Marched:
    """A surface on a lattice, closed by the faces of the cuboid."""

    places: Float[ndarray, "v 3"]  # in steps from the lattice's first point
    faces: Int[ndarray, "f 3"]  # int32, outward
    slope: Float[ndarray, " v"]  # of the values between the two points that a vertex lies between; 0 on lattice points
    clipped: Float32[ndarray, " c"]  # values at the vertices on lattice points, all of them negative


def march(values: Float32[ndarray, "r s t"], lattice: Lattice) -> Marched:
    """Boundary of the negative values, by marching cubes in which everything beyond the cuboid is outside.

    Vertices beyond are moved onto the lattice's outermost points: several meet on edges and corners of the cuboid, are
    made one there, and what was between them is gone. So the part of a face that is inside becomes a flat piece of the
    surface with vertices at the lattice's points. `values` have a layer around the lattice.
    """
    negative = values < 0
    if not negative.any():
        return Marched(NOTHING.vertices, NOTHING.faces, np.zeros(0), np.zeros(0, np.float32))
    # From signs alone, so that vertices come halfway and show between which points they lie: Lorensen's table needs
    # no more. Their exact places are computed in float64.
    signs = np.where(negative, np.float32(-1), np.float32(1))
    halfway, faces, _, _ = marching_cubes(signs, level=0.0, gradient_direction="descent", method="lorensen")
    del negative, signs
    low, high = np.floor(halfway).astype(np.int32), np.ceil(halfway).astype(np.int32)
    below, above = (values[tuple(ends.T)].astype(np.float64) for ends in (low, high))
    share = (below / (below - above)).clip(NUDGE, 1 - NUDGE)
    places = (low - 1 + share[:, None] * (high - low)).clip(0, lattice.cells)
    slope = np.abs(above - below) / ((high - low) @ lattice.steps)
    beyond = np.flatnonzero(((low < 1) | (high > lattice.cells + 1)).any(axis=1))
    slope[beyond] = 0
    points = np.ravel_multi_index(tuple(places[beyond].astype(int).T), lattice.shape)
    _, first, of_point = np.unique(points, return_index=True, return_inverse=True)
    once = np.arange(len(places), dtype=np.int32)
    once[beyond] = beyond[first][of_point]
    a, b, c = once[faces].T
    faces = np.stack([a, b, c], axis=1)[(a != b) & (b != c) & (c != a)]
    used = np.zeros(len(places), bool)
    used[faces] = True
    renumbered = np.cumsum(used, dtype=np.int32) - np.int32(1)
    ends = np.minimum(below, above)[beyond[first]].astype(np.float32)
    return Marched(places[used], renumbered[faces], slope[used], ends)


def drawn(
    marched: Marched, ask: Callable[[Float[ndarray, "n 3"]], Float32[ndarray, " n"]], lattice: Lattice
) -> tuple[Mesh, int]:
    """The surface with its vertices drawn to the zero set, canonical, and the number of points evaluated for it.

    One step along the surface's own normals, as long as the value there: that is a distance, or steeper than
    one if the lattice found it so. Newton's step along the field's gradient takes seven times as many points and gives
    no better normals. Vertices on the cuboid's faces stay.
    """
    places = marched.places.copy()
    inner = np.flatnonzero(((places > 0) & (places < lattice.cells)).all(axis=1))
    local = Mesh(places * lattice.steps, marched.faces)
    normals = vertex_normals(local)[inner]
    away = ask(lattice.points(places[inner])) / np.maximum(marched.slope[inner], 1)
    step = (away[:, None] * normals / lattice.steps).clip(-FARTHEST, FARTHEST)
    places[inner] = (places[inner] - step).clip(NUDGE, lattice.cells - NUDGE)
    return Mesh(lattice.points(places), marched.faces), len(inner)
