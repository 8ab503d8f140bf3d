"""Triangulation of the faces of every format, with checks of indices and numbers.

Polygons are triangulated in the plane of two coordinates, whichever two show most of their area. These are
copied, not computed, so the predicates are about the polygon that the file holds. Convex polygons
are fans of triangles, found for all polygons of a size at once: a fan counts only if its orientations are
certain by Shewchuk's error bound (Adaptive Precision Floating-Point Arithmetic, 1997). The others go to
manifold3d's ear clipping, which uses every corner, adds none, and takes outlines that touch themselves, such as
those of a face with a hole and a slit to it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import manifold3d
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.geometry.meshes import Mesh, compact, face_areas

MAX_CORNERS = 10_000  # of a polygon that isn't convex: its triangulation takes time with their square
MAX_COORDINATE = 1e100  # beyond it, squares and products leave the range of float64
STARTS = 4  # corners from which a fan is tried
UNCERTAIN = (3 + 16 * 2.0**-53) * 2.0**-53  # times both products' sizes: error of the orientation of three points
TOUCHING = 1e-6  # area that may be covered twice, in squared extents of the polygon: float32's error at a touch
CROSSING = 0.01  # share of a mesh's area that outlines which cross themselves may cover wrongly
SKEW = 1e-3  # volume of a quad's corners, in cubed extents, from which it lies in no plane

Place = Callable[[int], str]  # file and line, or number, of a polygon


@dataclass(frozen=True, eq=False)
class Polygons:
    """Faces with any number of corners, as a file lists them."""

    corners: Int[ndarray, " c"]  # vertex numbers from 0, polygon after polygon
    counts: Int[ndarray, " p"]  # corners of each polygon


def triangulated(vertices: Float[ndarray, "v 3"], polygons: Polygons, place: Place) -> Mesh:
    """The mesh of a file's polygons, in their order, winding kept, without the vertices that none uses.

    A polygon of k corners becomes k − 2 triangles whose areas add up to its own and whose outer edges are its
    edges; none overlap, seen along its normal. Degenerate polygons become degenerate triangles. Of an outline that
    crosses itself, seen along its normal, only the edges and the sum of areas with signs are right; a quad whose
    corners lie in no plane is split at its shorter diagonal then.

    Raises InputError, which begins with `place` of the polygon, for one with fewer than three corners, a
    corner that names no vertex, coordinates that are NaN, infinite or beyond MAX_COORDINATE, more than MAX_CORNERS
    corners without being convex, and outlines that cross themselves if what they cover wrongly is more than the share
    CROSSING of the mesh.
    """
    _check(vertices, polygons, place)
    corners, counts = polygons.corners, polygons.counts
    starts, rows = np.cumsum(counts) - counts, np.cumsum(counts - 2) - (counts - 2)
    faces = np.empty((int((counts - 2).sum()), 3), np.int32)
    scaled, wrong = _scaled(vertices, corners), np.zeros(len(counts))
    order = np.argsort(counts, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(counts[order])) + 1) if len(order) else []:
        count = int(counts[group[0]])
        loops = corners[starts[group, None] + np.arange(count)]
        local, wrong[group] = _triangles(scaled[loops], group, place)
        faces[rows[group, None] + np.arange(count - 2)] = np.take_along_axis(loops[:, None, :], local, axis=2)
    if wrong.any() and wrong.sum() > CROSSING * face_areas(Mesh(scaled, faces)).sum():
        raise InputError(
            f"{place(int(wrong.argmax()))}: the outline of the face crosses itself; triangulate it, or export it again"
        )
    return compact(Mesh(vertices, faces))


def _check(vertices: Float[ndarray, "v 3"], polygons: Polygons, place: Place) -> None:
    corners, counts = polygons.corners, polygons.counts
    if (few := counts < 3).any():
        i = int(few.argmax())
        raise InputError(f"{place(i)}: the face has {int(counts[i])} corners; wanted at least three")
    unknown = (corners < 0) | (corners >= len(vertices))
    if unknown.any():
        i, corner = _first(unknown, counts)
        raise InputError(
            f"{place(i)}: corner {corner} of the face is vertex {int(corners[unknown.argmax()]):,} counted from 0, "
            f"but there are {len(vertices):,}; export it again"
        )
    with np.errstate(invalid="ignore"):
        bad = ~(np.abs(vertices) <= MAX_COORDINATE).all(1)
    if bad.any() and (wrong := bad[corners]).any():
        i, corner = _first(wrong, counts)
        at = ", ".join(f"{x:g}" for x in vertices[corners[wrong.argmax()]])
        raise InputError(
            f"{place(i)}: corner {corner} of the face is at ({at}); wanted finite numbers up to {MAX_COORDINATE:g}"
        )


def _first(marked: Bool[ndarray, " c"], counts: Int[ndarray, " p"]) -> tuple[int, int]:
    """The polygon of the first corner that is marked, and which of its corners that is, from 1."""
    ends, corner = np.cumsum(counts), int(marked.argmax())
    i = int(np.searchsorted(ends, corner, side="right"))
    return i, corner - int(ends[i] - counts[i]) + 1


def _scaled(vertices: Float[ndarray, "v 3"], corners: Int[ndarray, " c"]) -> Float[ndarray, "v 3"]:
    """The vertices times a power of two, which rounds nothing: coordinates are at most 1."""
    used = np.zeros(len(vertices), bool)
    used[corners] = True
    finite = np.where(used[:, None], vertices, 0.0)
    return np.ldexp(finite, -int(np.frexp(np.abs(finite).max(initial=0.0))[1]))


def _triangles(
    points: Float[ndarray, "m k 3"], numbers: Int[ndarray, " m"], place: Place
) -> tuple[Int[ndarray, "m k-2 3"], Float[ndarray, " m"]]:
    """The triangles of m polygons of k corners each, as corner numbers of their polygon, and the area that is wrong."""
    count, wrong = points.shape[1], np.zeros(len(points))
    fan = np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], axis=1)
    result = np.broadcast_to(fan, (len(points), *fan.shape)).copy()
    if count == 3:
        return result, wrong
    normals = _area_vectors(points)
    planes = _planes(points, normals)
    left = np.arange(len(points))
    for start in range(min(count, STARTS)):
        convex = _fan_is_exact(np.roll(planes[left], -start, axis=1))
        result[left[convex]] = (fan + start) % count
        left = left[~convex]
    if len(left) and count > MAX_CORNERS:
        raise InputError(
            f"{place(int(numbers[left[0]]))}: the face has {count:,} corners and isn't convex; wanted at most "
            f"{MAX_CORNERS:,}, or triangles"
        )
    for i in left:
        result[i], wrong[i] = _clipped(points[i], planes[i], float(np.linalg.norm(normals[i])))
    return result, wrong


def _area_vectors(points: Float[ndarray, "m k 3"]) -> Float[ndarray, "m 3"]:
    """Newell's normals: their lengths are the polygons' areas."""
    edges = points[:, 1:] - points[:, :1]
    return np.cross(edges[:, :-1], edges[:, 1:]).sum(1) / 2


def _planes(points: Float[ndarray, "m k 3"], normals: Float[ndarray, "m 3"]) -> Float[ndarray, "m k 2"]:
    """Two coordinates of each polygon, those in which its area is largest, ordered so that it is positive."""
    axis = np.abs(normals).argmax(1)
    positive = np.take_along_axis(normals, axis[:, None], axis=1) >= 0
    after, before = (axis + 1)[:, None] % 3, (axis + 2)[:, None] % 3
    axes = np.where(positive, np.hstack([after, before]), np.hstack([before, after]))
    return np.take_along_axis(points, axes[:, None, :], axis=2)


def _fan_is_exact(planes: Float[ndarray, "m k 2"]) -> Bool[ndarray, " m"]:
    """Whether the triangles of the fan at the first corner are positive and within half a turn, beyond doubt."""
    edges = planes[:, 1:] - planes[:, :1]
    positive = _certainly_left(edges[:, :-1], edges[:, 1:])
    within = _certainly_left(edges[:, :1], edges[:, 2:])
    return np.all(positive, axis=1) & np.all(within, axis=1)


def _certainly_left(a: Float[ndarray, "m n 2"], b: Float[ndarray, "m l 2"]) -> Bool[ndarray, "m l"]:
    forth, back = a[..., 0] * b[..., 1], a[..., 1] * b[..., 0]
    return forth - back > UNCERTAIN * (np.abs(forth) + np.abs(back))


def _clipped(
    points: Float[ndarray, "k 3"], plane: Float[ndarray, "k 2"], area: float
) -> tuple[Int[ndarray, "k-2 3"], float]:
    """The triangles of one polygon, which may be concave or degenerate, and how much of their area is wrong."""
    extent = float(np.ptp(points, axis=0).max())
    triangles = manifold3d.triangulate([_unit(plane)], 0.0, False)
    if area <= TOUCHING * extent**2:  # in no projection does it have an area
        wrong = float(np.linalg.norm(_area_vectors(points[triangles]), axis=1).sum())
    else:
        wrong = _wrong_area(plane, triangles) * area
    if wrong <= 4 * TOUCHING * extent**2:
        return triangles, 0.0
    if len(points) == 4 and _volume(points) > SKEW * extent**3:
        return _across_shorter_diagonal(points), 0.0
    return triangles, wrong


def _unit(plane: Float[ndarray, "k 2"]) -> Float[ndarray, "k 2"]:
    """A polygon near the origin, stretched by powers of two to extents of about 1."""
    near = plane - plane.min(0)
    return np.ldexp(near, -np.frexp(near.max(0))[1])


def _wrong_area(plane: Float[ndarray, "k 2"], triangles: Int[ndarray, "f 3"]) -> float:
    """The area that triangles of an outline cover twice or outside it, as a share of its own."""
    a, b, c = plane[triangles].transpose(1, 0, 2)
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    areas = (ux * vy - uy * vx) / 2
    if (negative := -areas[areas < 0].sum()) > TOUCHING * areas.sum():
        return float(2 * negative / areas.sum())
    # Positive triangles overlap where the outline winds about a point twice.
    near = plane - plane.min(0)
    extent = near.max()
    union = manifold3d.CrossSection([near / extent], manifold3d.FillRule.Positive).area() * extent**2
    return float(1 - union / areas.sum())


def _volume(points: Float[ndarray, "4 3"]) -> float:
    a, b, c = points[1:] - points[0]
    return abs(float(np.cross(a, b) @ c))


def _across_shorter_diagonal(points: Float[ndarray, "4 3"]) -> Int[ndarray, "2 3"]:
    first, second = np.linalg.norm(points[:2] - points[2:], axis=1)
    return np.array([[0, 1, 2], [0, 2, 3]] if first <= second else [[1, 2, 3], [1, 3, 0]])
