"""From a network's values on a cuboid's lattice to the closed solid that they bound there."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Float32, Int
from manifold3d import Manifold
from numpy import ndarray
from skimage.measure import marching_cubes

from cagesdf.extraction.asking import Method
from cagesdf.extraction.field import CageField
from cagesdf.extraction.lattice import Lattice
from cagesdf.meshes import Mesh, vertex_normals
from cagesdf.solid import as_manifold, from_manifold

# A vertex is no nearer to a lattice point than this, in steps: at a value of 0 faces would have no area.
NUDGE = 1e-3
# A vertex is moved by no more than this towards the zero set, in steps along each axis.
FARTHEST = 0.4
# A vertex on a face counts as clipped where the network would go on beyond it by more, in cells, or where it says half
# of the most that it can.
CLIP_TOLERANCE = 0.25
NOTHING = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))


@dataclass(frozen=True)
class Fineness:
    """Least number of cells of a part, and how much its faces are simplified."""

    least: int  # cells along each axis of its cuboid
    even: float  # faces are made fewer where that moves the surface by no more, in the shortest steps


USUAL = Fineness(16, 0.05)
PREVIEW = Fineness(12, 0.2)  # where a surface is to be there at once


@dataclass(frozen=True, eq=False)
class Part:
    """The closed solid that a network has in one cuboid.

    It depends on the network, the part's code, the cuboid and the cells, not on other cuboids.
    """

    mesh: Mesh  # canonical; closed, manifold, outward, within the cuboid; no faces if the network says outside
    solid: Manifold  # the same, ready to be united
    vertices: int  # of marching cubes
    clipped: int  # of them on the cuboid's faces where the network would go on
    asked: int  # points given to the network


def part_of(field: CageField, cuboid: int, cell: float, fineness: Fineness, method: Method) -> Part:
    """The solid that a field has in one of its cuboids, in cells of at most `cell`, canonical units."""
    lattice = Lattice.of(field.cage[field.cage.part_ids[cuboid]], cell, fineness.least)
    answers = method(field.on_lattice(lattice, cuboid), field.reach(cuboid), lattice)
    asked = answers.asked
    marched = march(answers.values, lattice)
    del answers  # the largest thing in memory at 512 cells
    clipped = int(np.count_nonzero(marched.clipped < -min(CLIP_TOLERANCE * cell, field.reach(cuboid) / 2)))
    mesh, drawn_by = drawn(marched, partial(field.ask, cuboid=cuboid), lattice)
    del marched
    solid = as_manifold(mesh).simplify(fineness.even * float(lattice.steps.min()))
    return Part(from_manifold(solid), solid, len(mesh.vertices), clipped, asked + drawn_by)


@dataclass(frozen=True, eq=False)
class Marched:
    """A surface on a lattice, closed by the faces of the cuboid."""

    places: Float[ndarray, "v 3"]  # in steps from the lattice's first point
    faces: Int[ndarray, "f 3"]  # int32, outward
    slope: Float[ndarray, " v"]  # of the values between the two points that a vertex lies between; 0 on lattice points
    clipped: Float32[ndarray, " c"]  # values at the vertices on lattice points, all of them negative


def march(values: Float32[ndarray, "r s t"], lattice: Lattice) -> Marched:
    """The surface of what is negative, by marching cubes in which all that lies beyond the cuboid is outside.

    Vertices beyond are moved onto the lattice's outermost points: several meet on edges and corners of the cuboid, are
    made one there, and what was between them is gone. So the part of a face that is inside becomes a flat piece of the
    surface with vertices at the lattice's points. `values` have a layer around the lattice.
    """
    negative = values < 0
    if not negative.any():
        return Marched(NOTHING.vertices, NOTHING.faces, np.zeros(0), np.zeros(0, np.float32))
    # Of signs alone, so that vertices come halfway and tell between which points they lie: Lorensen's table reads no
    # more of values. Where exactly is reckoned in float64.
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
    """The surface with its vertices drawn to the zero set, canonical, and how many points that took.

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
