"""Area of a surface that a solid leaves out: the check that no step of the repair loses a sheet in silence.

A point of a surface is lost if it lies outside the solid, farther than a given reach from it. Surface inside the
solid isn't: the union of overlapping pieces removes it, and it is no border between inside and outside.
"""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, face_areas

REACH = 0.002  # canonical units: a point of a part's surface farther from its solid is lost
FINE = 2e-4  # share of the area: a cell no wider than this one's square root is judged by its centre
NEEDLE = 1e-8  # share of the area: so is a cell that is smaller
MAX_CELLS = 500_000  # whose distances are computed; beyond, cells of any size are judged by their centres


def lost_areas(mesh: Mesh, solid: Mesh, reach: float) -> Float[ndarray, " f"]:
    """The area of each face whose signed distance to a closed, outward solid is above `reach`.

    Faces that the solid has too aren't lost. All others are cut into cells, halved across their longest
    side, until each cell is settled as a whole: by its centre if the distance there differs from `reach` by
    at least the cell's radius, because distances change no faster than places; or it is near if its
    corners are near to one face of the solid, because the distance to a convex set is a convex function.
    Cells too small to matter are judged by their centres; so an area is wrong by at most the cells on the
    border of what is lost, sqrt(FINE · area) wide.
    """
    surface = SurfaceDistance(solid)
    areas = face_areas(mesh)
    total = areas.sum()
    width = max(reach / 4, np.sqrt(FINE * total))
    lost = np.zeros(len(areas))
    (faces,) = np.nonzero(~_kept(mesh, solid))
    cells, areas, asked = mesh.corners()[faces], areas[faces], 0
    while len(cells):
        asked += len(cells)
        centres = cells.mean(axis=1)
        radii = np.linalg.norm(cells - centres[:, None], axis=2).max(axis=1)
        unsigned, nearest, places = surface.closest(centres)
        near = _farthest(cells, solid.corners()[nearest]) <= reach
        small = (radii <= width) | (areas <= NEEDLE * total)
        settled = near | small | (np.abs(unsigned - reach) >= radii) | (asked > MAX_CELLS)
        (far,) = np.nonzero(settled & ~near & (unsigned > reach))
        far = far[~surface.behind(centres[far], unsigned[far], nearest[far], places[far])]
        np.add.at(lost, faces[far], areas[far])
        faces, areas = np.repeat(faces[~settled], 2), np.repeat(areas[~settled] / 2, 2)
        cells = _halved(cells[~settled])
    return lost


def _kept(mesh: Mesh, solid: Mesh) -> Bool[ndarray, " f"]:
    """Whether each face of a mesh is a face of the solid: the same corners, to the last bit, in any order."""
    keys, corners = _sorted_corners(mesh)
    wanted, present = _sorted_corners(solid)
    order = wanted.argsort(kind="stable")
    twin = order[np.searchsorted(wanted, keys, sorter=order).clip(max=len(order) - 1)]
    return (corners == present[twin]).all(axis=(1, 2))


def _sorted_corners(mesh: Mesh) -> tuple[Float[ndarray, " f"], Float[ndarray, "f 3 3"]]:
    """A number for each face that hardly any two share, and its corners in the order of theirs."""
    x, y, z = mesh.vertices.T
    numbers = (x + np.sqrt(2) * y + np.sqrt(3) * z)[mesh.faces]
    order = numbers.argsort(axis=1)
    low, middle, high = np.take_along_axis(numbers, order, axis=1).T
    return low + np.sqrt(5) * middle + np.sqrt(7) * high, mesh.vertices[np.take_along_axis(mesh.faces, order, axis=1)]


def _halved(cells: Float[ndarray, "n 3 3"]) -> Float[ndarray, "m 3 3"]:
    """Each triangle as two, which follow each other, cut across its longest side."""
    rows = np.arange(len(cells))[:, None]
    longest = np.linalg.norm(np.roll(cells, -1, axis=1) - cells, axis=2).argmax(axis=1)
    a, b, c = cells[rows, (longest[:, None] + np.arange(3)) % 3].transpose(1, 0, 2)
    middle = (a + b) / 2
    return np.stack([a, middle, c, middle, b, c], axis=1).reshape(-1, 3, 3)


def _farthest(cells: Float[ndarray, "n 3 3"], triangles: Float[ndarray, "n 3 3"]) -> Float[ndarray, " n"]:
    """Upper bound of the distance from any point of a cell to the triangle beside it."""
    origin = triangles[:, :1]
    u, v = np.swapaxes(triangles[:, 1:] - origin, 0, 1)
    away = cells - origin
    uu, uv, vv = (np.einsum("nx,nx->n", *pair)[:, None] for pair in ((u, u), (u, v), (v, v)))
    au, av = np.einsum("nkx,nx->nk", away, u), np.einsum("nkx,nx->nk", away, v)
    determinant = np.maximum(uu * vv - uv**2, 1e-60)
    s, t = (vv * au - uv * av) / determinant, (uu * av - uv * au) / determinant
    # Any point of the triangle gives a bound: coordinates that lie outside are clipped.
    weights = np.clip(np.stack([1 - s - t, s, t], axis=2), 0, 1)
    weights /= weights.sum(axis=2, keepdims=True)
    return np.linalg.norm(cells - np.einsum("nkc,ncx->nkx", weights, triangles), axis=2).max(axis=1)
