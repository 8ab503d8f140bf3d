"""The closed solid that a network's values on a cuboid's lattice bound."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy import ndarray

from cagesdf.extraction import table
from cagesdf.extraction.lattice import Lattice, strides_of
from cagesdf.geometry.meshes import Mesh, vertex_normals

# A vertex is no nearer to a lattice point than this, in steps: at a value of 0 faces would have no area.
NUDGE = 1e-3
# Largest movement of a vertex towards the zero set, in steps along each axis.
FARTHEST = 0.4
# For each edge of a cell and each set of crossed edges at its lower end (bit k: along axis k), how many come before it.
CROSSED_BEFORE = np.array(
    [[(bits & ((1 << axis) - 1)).bit_count() for bits in range(8)] for axis in table.EDGE_AXES.tolist()], np.int32
)
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
    cells, codes = crossed_cells(values)
    if len(cells) == 0:
        return Marched(NOTHING.vertices, NOTHING.faces, np.zeros(0), np.zeros(0, np.float32))
    vertices, corners = triangles(cells, codes, values.shape)
    low, axes = vertices
    flat, (x, y, z) = values.reshape(-1), np.unravel_index(low, values.shape)
    high = low + strides_of(values.shape)[axes]
    below, above = flat[low].astype(np.float64), flat[high].astype(np.float64)
    share = (below / (below - above)).clip(NUDGE, 1 - NUDGE)
    places = np.stack([x, y, z], axis=1).astype(np.float64) - 1
    rows = np.arange(len(places))
    start = places[rows, axes]
    places[rows, axes] = start + share
    np.clip(places, 0, lattice.cells, out=places)
    slope = np.abs(above - below) / lattice.steps[axes]

    # Vertices beyond: the first at each point of the lattice stands for all of them.
    beyond = np.flatnonzero((start < 0) | (start >= lattice.cells[axes]))
    slope[beyond] = 0
    points = np.where(start[beyond] < 0, high[beyond], low[beyond])
    vertex_at = np.empty(len(flat), np.int32)
    vertex_at[points[::-1]] = beyond[::-1]
    once = np.arange(len(places), dtype=np.int32)
    once[beyond] = vertex_at[points]
    corners = once[corners]
    a, b, c = corners
    corners = corners[:, (a != b) & (b != c) & (c != a)]

    used = np.zeros(len(places), bool)
    used[corners] = True
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    clipped = np.minimum(below, above)[beyond[once[beyond] == beyond]].astype(np.float32)
    return Marched(places[used], number[corners].T, slope[used], clipped)


def crossed_cells(values: Float32[ndarray, "r s t"]) -> tuple[Int[ndarray, " c"], Int[ndarray, " c"]]:
    """The cells whose corners have two signs, by the flat index of their first corner, and their codes in the table.

    Values in the outermost layer are positive, so that cells from the end of one row to the start of the next have one
    sign.
    """
    code = (values.reshape(-1) < 0).view(np.uint8)
    for stride, bits in zip(strides_of(values.shape)[::-1], (1, 2, 4)):
        code = code[:-stride] | code[stride:] << np.uint8(bits)
    cells = np.flatnonzero(code + np.uint8(1) > 1)  # neither 0 nor 255
    return cells, code[cells].astype(np.intp)


def triangles(
    cells: Int[ndarray, " c"], codes: Int[ndarray, " c"], shape: tuple[int, ...]
) -> tuple[tuple[Int[ndarray, " v"], Int[ndarray, " v"]], Int[ndarray, "3 f"]]:
    """Vertices, each the flat index of the lower end of its edge and the edge's axis, and faces by their corners.

    The cells are all that have two signs, by the flat index of their first corner. The lower end of a crossed edge is
    the first corner of one of them. int32 holds eight times the number of vertices.
    """
    crossed = table.CROSSED[codes]
    rows, axes = np.nonzero(crossed)
    counts = crossed.sum(axis=1)
    # Of each first corner: its first vertex, times 8, and which edges are crossed. Others are never looked up.
    numbers = np.empty(cells[-1] + 1, np.int32)
    numbers[cells] = 8 * (np.cumsum(counts) - counts) + crossed @ [1, 2, 4]

    sizes = table.COUNTS[codes]
    ends = np.cumsum(sizes)
    row = np.arange(ends[-1]) + np.repeat(table.STARTS[codes] - ends + sizes, sizes)
    cell = np.repeat(cells, sizes)
    offsets = table.EDGE_CORNERS @ strides_of(shape)
    corners = np.empty((3, len(row)), np.int32)
    for corner, edges in zip(corners, table.TRIANGLE_EDGES):
        edge = edges[row]
        number = numbers[cell + offsets[edge]]
        corner[:] = (number >> 3) + CROSSED_BEFORE[edge, number & 7]
    return (cells[rows], axes), corners


def drawn(
    marched: Marched, evaluate: Callable[[Float[ndarray, "n 3"]], Float32[ndarray, " n"]], lattice: Lattice
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
    away = evaluate(lattice.points(places[inner])) / np.maximum(marched.slope[inner], 1)
    step = (away[:, None] * normals / lattice.steps).clip(-FARTHEST, FARTHEST)
    places[inner] = (places[inner] - step).clip(NUDGE, lattice.cells - NUDGE)
    return Mesh(lattice.points(places), marched.faces), len(inner)
