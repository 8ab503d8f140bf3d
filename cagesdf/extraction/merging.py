"""Merging of vertices where a surface is nearly flat, before they cost anything: a third remains on a vessel.

Marching cubes has a vertex wherever the surface crosses an edge of the lattice, also where it is flat.
Here the vertices around one point of the lattice, or of every second one, become one vertex where they and their
faces form a nearly flat disc. The surface's topology stays: discs shrink to points.
"""

from math import prod

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from cagesdf.extraction.lattice import Lattice
from cagesdf.extraction.marching import Marched

STRIDES = (2, 1)  # of the points that vertices gather around, in steps


def merged(marched: Marched, lattice: Lattice, sag: float) -> Marched:
    """The surface with the vertices of each nearly flat disc made one, at their mean; vertices on faces stay.

    Chords between merged vertices leave the surface by about `sag` steps at most: that bounds the spread of normals.
    """
    count = len(marched.places)
    if count == 0:
        return marched
    corners = np.ascontiguousarray(marched.faces.T)
    normals = normal_sums(marched.places * lattice.steps, corners)
    free = np.array(((marched.places > 0) & (marched.places < lattice.cells)).all(axis=1))
    owner = np.arange(count, dtype=np.int32)  # for each vertex, the one that stands for it
    for stride in STRIDES:
        members = np.flatnonzero(free)
        nodes = np.floor(marched.places[members] / stride + 0.5).astype(np.int32)
        shape = tuple((lattice.cells // stride + 2).tolist())
        keys = np.ravel_multi_index(tuple(nodes.T), shape)
        first_at = np.empty(prod(shape), np.int32)  # for each point, the first vertex around it
        first_at[keys[::-1]] = members[::-1]
        label = np.full(count, -1, np.int32)
        label[members] = first_at[keys]
        flat = members[flat_discs(label, corners, normals, stride, sag)[label[members]]]
        owner[flat] = label[flat]
        free[flat] = False
    return _joined(marched, corners, owner)


def normal_sums(vertices: Float[ndarray, "v 3"], corners: Int[ndarray, "3 f"]) -> Float[ndarray, "4 v"]:
    """Sums of normal · 2 area, and of 2 area, over the faces with each vertex as their first corner.

    Products are in float32, a coordinate at a time: three times as fast, and 1e-6 of an area doesn't matter here.
    """
    first, second, third = corners.astype(np.intp)
    columns = vertices.T.astype(np.float32, order="C")
    ux, uy, uz = (column.take(second) - column.take(first) for column in columns)
    vx, vy, vz = (column.take(third) - column.take(first) for column in columns)
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    rows = (x, y, z, np.sqrt(x * x + y * y + z * z))
    return np.stack([np.bincount(first, row, len(vertices)) for row in rows])


def flat_discs(
    labels: Int[ndarray, " v"], corners: Int[ndarray, "3 f"], normals: Float[ndarray, "4 v"], stride: int, sag: float
) -> Bool[ndarray, " v"]:
    """Whether each cluster of vertices is a disc (its Euler number is 1) of nearly one normal, by its label.

    The label is the number of one of its vertices; −1: of none. On a cylinder whose chords between clusters sag by
    `sag`, normals of a cluster and the faces around it are spread evenly over an angle; the length of their mean says
    how wide it is.
    """
    count = len(labels)
    a, b, c = labels[corners]
    ab, bc, ca = (a == b) & (a >= 0), (b == c) & (b >= 0), (c == a) & (c >= 0)
    members = np.flatnonzero(labels >= 0)
    cluster = labels[members]
    sizes = np.bincount(cluster, minlength=count)
    edges = np.bincount(np.concatenate([a[ab], b[bc], c[ca]]), minlength=count) // 2
    disc = sizes - edges + np.bincount(a[ab & bc], minlength=count) == 1
    x, y, z, area = (np.bincount(cluster, row[members], count) for row in normals)
    spread = 8 * sag / stride**2 * (stride + 1.5)  # radians
    least = max(0.0, 1 - spread**2 / 24)
    return disc & (sizes > 1) & (x * x + y * y + z * z > (least * area) ** 2)


def _joined(marched: Marched, corners: Int[ndarray, "3 f"], owner: Int[ndarray, " v"]) -> Marched:
    """The surface of the vertices that stand for others, each at the mean of those."""
    count = len(owner)
    while True:
        faces = _between(corners, owner)
        used = np.zeros(count, bool)
        used[faces] = True
        twice = _edges_that_come_twice(faces, count)  # of discs that touch twice
        gone = np.flatnonzero((owner == np.arange(count)) & ~used)  # discs of a piece that two or three of them make up
        if len(twice) + len(gone) == 0:
            break
        apart = np.flatnonzero(np.isin(owner, np.concatenate([twice // count, twice % count, gone])))
        owner[apart] = apart
    sizes = np.bincount(owner, minlength=count)
    several = np.flatnonzero(sizes > 1)
    places, slope = marched.places.copy(), marched.slope.copy()
    for column in (*places.T, slope):
        column[several] = np.bincount(owner, column, count)[several] / sizes[several]
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return Marched(places[used], number[faces.T], slope[used], marched.clipped)


def _between(corners: Int[ndarray, "3 f"], owner: Int[ndarray, " v"]) -> Int[ndarray, "3 g"]:
    a, b, c = owner[corners]
    return np.stack([a, b, c])[:, (a != b) & (b != c) & (c != a)]


def _edges_that_come_twice(faces: Int[ndarray, "3 f"], count: int) -> Int[ndarray, " e"]:
    """Edges of a closed surface with more than two faces, as tail · count + head."""
    a, b, c = faces
    tails_up = ((tail[tail < head], head[tail < head]) for tail, head in ((a, b), (b, c), (c, a)))
    edges = np.sort(np.concatenate([tail.astype(np.int64) * count + head for tail, head in tails_up]))
    return edges[1:][edges[1:] == edges[:-1]]
