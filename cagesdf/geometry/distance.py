"""Signed distance to a closed surface.

Distance and sign come from two trees: libigl's one call would scale the distance by the
winding number, which is wrong where a winding number is not 0 or 1.
"""

from functools import cached_property

import igl
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from cagesdf.geometry.meshes import Mesh

MORTON_BITS = 10
SLIVER = 1e-8  # faces lower than this, in mesh units
ON = 1e-9  # a point nearer to an edge or a vertex lies on it, mesh units
DOUBT = 1e-3  # cosine to an edge's or a vertex's normal below which the normal doesn't decide the side


class SurfaceDistance:
    """Distances to one mesh: two trees, built when first needed."""

    def __init__(self, mesh: Mesh) -> None:
        """`mesh` is in any frame; `inside` and `signed` need it closed and outward."""
        if len(mesh.faces) == 0:
            raise ValueError("can't measure the distance to a mesh without faces")
        self._vertices = np.ascontiguousarray(mesh.vertices, np.float64)
        self._faces = np.ascontiguousarray(mesh.faces, np.int64)
        self._distances: igl.AABB | None = None
        self._windings: igl.FastWindingNumberBVH | None = None

    def closest(
        self, points: Float[ndarray, "n 3"]
    ) -> tuple[Float[ndarray, " n"], Int[ndarray, " n"], Float[ndarray, "n 3"]]:
        """Exact unsigned distance, the nearest face and the nearest point on it."""
        if self._distances is None:
            self._distances = igl.AABB()
            self._distances.init(self._vertices, self._faces)
        squared, faces, nearest = np.empty(len(points)), np.empty(len(points), np.int64), np.empty((len(points), 3))
        if len(points):
            order = morton_order(points)
            squared[order], faces[order], nearest[order] = self._distances.squared_distance(
                self._vertices, self._faces, np.ascontiguousarray(points[order], np.float64)
            )
        return np.sqrt(squared), faces, nearest

    def unsigned(self, points: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
        """Exact unsigned distance."""
        return self.closest(points)[0]

    def inside(self, points: Float[ndarray, "n 3"]) -> Bool[ndarray, " n"]:
        """Whether the generalised winding number is above ½."""
        if self._windings is None:
            self._windings = igl.FastWindingNumberBVH()
            self._windings.init(self._vertices, self._faces)
        if len(points) == 0:
            return np.zeros(0, dtype=bool)
        order = morton_order(points)
        inside = np.empty(len(points), dtype=bool)
        inside[order] = self._windings.winding_number(np.ascontiguousarray(points[order], np.float64), 2.0) > 0.5
        return inside

    def signed(self, points: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
        """Exact distance, negative inside."""
        distance, faces, nearest = self.closest(points)
        return np.where(self.behind(points, distance, faces, nearest), -distance, distance)

    def behind(
        self,
        points: Float[ndarray, "n 3"],
        distance: Float[ndarray, " n"],
        faces: Int[ndarray, " n"],
        nearest: Float[ndarray, "n 3"],
    ) -> Bool[ndarray, " n"]:
        """Whether points lie inside, given their results of `closest`.

        Where the nearest point lies within a face, the face's normal tells the side; on an edge or a
        vertex, the angle-weighted normals of its faces do (Bærentzen and Aanæs 2005). Winding numbers,
        ten times slower close to the surface, are computed only where slivers or sharp edges leave doubt.
        """
        away = points - nearest
        along = np.einsum("nx,nx->n", away, self._normals[faces])
        inside = along < 0
        (unclear,) = np.nonzero(np.abs(along) <= (1 - 1e-6) * distance)
        normals = self._feature_normals(faces[unclear], nearest[unclear])
        along = np.einsum("nx,nx->n", away[unclear], normals)
        inside[unclear] = along < 0
        unclear = unclear[np.abs(along) <= DOUBT * distance[unclear]]
        inside[unclear] = self.inside(points[unclear])
        return inside

    def _feature_normals(self, faces: Int[ndarray, " n"], places: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Unit normals of the vertex or edge of a face that a point on its border lies on; zero if unknown."""
        corners = self._faces[faces]
        a = self._vertices[corners]
        edge = np.roll(a, -1, axis=1) - a
        to_place = places[:, None] - a
        from_corner = np.linalg.norm(to_place, axis=2)
        from_edge = np.linalg.norm(np.cross(edge, to_place), axis=2) / np.maximum(np.linalg.norm(edge, axis=2), 1e-300)
        corner, side = from_corner.argmin(axis=1), from_edge.argmin(axis=1)
        rows = np.arange(len(faces))
        edges, vertices = self._border_normals
        normals = np.where((from_edge[rows, side] < ON)[:, None], edges[faces, side], 0)
        on_corner = from_corner[rows, corner] < ON
        normals[on_corner] = vertices[corners[on_corner, corner[on_corner]]]
        return normals

    @cached_property
    def _normals(self) -> Float[ndarray, "f 3"]:
        """Unit normals; zero for slivers, whose computed normal may point anywhere."""
        a, b, c = self._vertices[self._faces].transpose(1, 0, 2)
        normals = np.cross(b - a, c - a)
        twice_area = np.linalg.norm(normals, axis=1)
        longest = np.linalg.norm([b - a, c - b, a - c], axis=2).max(axis=0)
        normals[twice_area <= SLIVER * longest] = 0
        return normals / np.maximum(twice_area, 1e-300)[:, None]

    @cached_property
    def _border_normals(self) -> tuple[Float[ndarray, "f 3 3"], Float[ndarray, "v 3"]]:
        """Unit normals of each face's edges (the k-th leaves its k-th corner) and of the vertices.

        Zero where a sliver takes part, or more than two faces meet in an edge: they might mislead.
        """
        faces, normals = self._faces, self._normals
        count = len(self._vertices)
        ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
        edge, uses = np.unique(ends @ [count, 1], return_inverse=True, return_counts=True)[1:]
        of_edges = _sums(edge, np.repeat(normals, 3, axis=0), len(uses))
        misleading = ~normals.any(axis=1)
        doubtful = (uses != 2) | (np.bincount(edge, np.repeat(misleading, 3), len(uses)) > 0)
        of_edges[doubtful] = 0

        a = self._vertices[faces]
        onward = np.roll(a, -1, axis=1) - a
        back = np.roll(a, 1, axis=1) - a
        turn = np.linalg.norm(np.cross(onward, back), axis=2)
        angle = np.arctan2(turn, np.einsum("fkx,fkx->fk", onward, back))
        of_vertices = _sums(faces.ravel(), (angle[:, :, None] * normals[:, None]).reshape(-1, 3), count)
        of_vertices[ends[doubtful[edge]].ravel()] = 0
        return _unit(of_edges)[edge].reshape(-1, 3, 3), _unit(of_vertices)


def _sums(groups: Int[ndarray, " n"], vectors: Float[ndarray, "n 3"], count: int) -> Float[ndarray, "c 3"]:
    return np.stack([np.bincount(groups, vectors[:, axis], count) for axis in range(3)], axis=1)


def _unit(vectors: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-300)[:, None]


def morton_order(points: Float[ndarray, "n 3"]) -> Int[ndarray, " n"]:
    """The order of points along a space-filling curve: neighbouring queries share tree nodes in the cache."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    low, high = points.min(0), points.max(0)
    cells = ((points - low) * ((2**MORTON_BITS - 1) / np.maximum(high - low, 1e-300))).astype(np.uint32).T
    # Spread the bits of each coordinate to every third place.
    spread = np.ascontiguousarray(cells)
    for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
        spread = (spread | (spread << np.uint32(shift))) & np.uint32(mask)
    x, y, z = spread
    return np.argsort((x << np.uint32(2)) | (y << np.uint32(1)) | z, kind="stable")
