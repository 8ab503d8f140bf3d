"""Marching cubes' table: the triangles of a cell for each of the 256 signs of its corners (Lorensen and Cline 1987).

It follows from one rule. On each face of the cell, each run of outside corners is cut off by a line between the two
crossed edges at its ends. Neighbouring cells see the same lines, so surfaces are closed. The lines of a cell form
loops, and each loop is filled with triangles. Where outside and inside corners alternate around a face, the inside is
connected, so that thin sheets stay whole.

Corner number 4x + 2y + z of a cell is (x, y, z), in {0, 1}. An edge is its axis and its lower corner.
"""

from collections.abc import Iterator
from itertools import combinations, product

import numpy as np

Triangle = tuple[int, int, int]  # edges, by their number in EDGES

CORNERS = tuple(product((0, 1), repeat=3))
EDGES = tuple((axis, k) for axis in range(3) for k, corner in enumerate(CORNERS) if corner[axis] == 0)


def _number(corner: tuple[int, ...]) -> int:
    return 4 * corner[0] + 2 * corner[1] + corner[2]


def _upper(edge: int) -> int:
    axis, low = EDGES[edge]
    return low + (4, 2, 1)[axis]


def _faces() -> list[list[int]]:
    """The corners of each face, counter-clockwise seen from outside the cell."""
    faces = []
    for axis, side in product(range(3), (0, 1)):
        ring = [(0, 0), (1, 0), (1, 1), (0, 1)][:: 1 if side else -1]
        corners = [dict(zip(((axis + 1) % 3, (axis + 2) % 3), pair)) | {axis: side} for pair in ring]
        faces.append([_number((corner[0], corner[1], corner[2])) for corner in corners])
    return faces


FACES = _faces()
EDGE_BETWEEN = {frozenset((low, _upper(edge))): edge for edge, (_, low) in enumerate(EDGES)}


def loops(code: int) -> list[list[int]]:
    """The crossed edges in loops, counter-clockwise seen from outside; bit k of `code`: corner k is inside."""
    following: dict[int, int] = {}
    for ring in FACES:
        inside = [bool(code >> corner & 1) for corner in ring]
        edges = [EDGE_BETWEEN[frozenset((ring[i], ring[(i + 1) % 4]))] for i in range(4)]
        for start in (i for i in range(4) if inside[i] and not inside[(i + 1) % 4]):
            end = next(i % 4 for i in range(start + 1, start + 4) if inside[(i + 1) % 4])
            following[edges[end]] = edges[start]
    result = []
    while following:
        loop = [min(following)]
        while (edge := following.pop(loop[-1])) != loop[0]:
            loop.append(edge)
        result.append(loop)
    return result


def share_a_face(one: int, other: int) -> bool:
    """Whether two edges lie on one face of the cell."""
    corners = {EDGES[one][1], _upper(one), EDGES[other][1], _upper(other)}
    return any(corners <= set(ring) for ring in FACES)


def triangulations(loop: list[int]) -> Iterator[list[Triangle]]:
    """All triangulations of a loop."""
    if len(loop) < 3:
        yield []
        return
    for k in range(1, len(loop) - 1):
        for before, after in product(triangulations(loop[: k + 1]), triangulations(loop[k:])):
            yield [(loop[0], loop[k], loop[-1]), *before, *after]


def filled(loop: list[int]) -> list[Triangle]:
    """The first triangulation without a diagonal on a face of the cell, where the next cell could have the same one."""
    sides = {frozenset(side) for side in zip(loop, [*loop[1:], loop[0]])}

    def diagonals_on_faces(triangles: list[Triangle]) -> int:
        pairs = {frozenset(pair) for triangle in triangles for pair in combinations(triangle, 2)}
        return sum(share_a_face(*pair) for pair in pairs - sides)

    return next(triangles for triangles in triangulations(loop) if diagonals_on_faces(triangles) == 0)


TRIANGLES = [[triangle for loop in loops(code) for triangle in filled(loop)] for code in range(256)]

# The same as arrays. Bit k of a code: corner k is inside.
COUNTS = np.array([len(triangles) for triangles in TRIANGLES])  # triangles for each code
STARTS = np.cumsum(COUNTS) - COUNTS  # row in TRIANGLE_EDGES of each code's first
TRIANGLE_EDGES = np.array([triangle for triangles in TRIANGLES for triangle in triangles], np.int8).T.copy()  # 3 rows
EDGE_AXES = np.array([axis for axis, _ in EDGES])
EDGE_CORNERS = np.array([CORNERS[low] for _, low in EDGES])  # lower ends
# Whether the edge from corner 0 along each axis is crossed, for each code.
CROSSED = np.array([[(code & 1) != (code >> (4, 2, 1)[axis] & 1) for axis in range(3)] for code in range(256)])
