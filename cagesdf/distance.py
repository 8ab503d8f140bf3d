"""Signed distance to a closed surface.

Distance and sign come from two trees: libigl's one call would scale the distance by the
winding number, which is wrong where a winding number is not 0 or 1.
"""

from functools import cached_property

import igl
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from cagesdf.meshes import Mesh

MORTON_BITS = 10
SLIVER = 1e-8  # faces lower than this, in mesh units


class SurfaceDistance:
    """Distances to one mesh: two trees, built when first asked."""

    def __init__(self, mesh: Mesh) -> None:
        """`mesh` is closed and outward where `inside` or `signed` are asked; any frame."""
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
        """Exact distance, negative inside.

        Where the nearest point lies within a face, the face's normal tells the side. Winding numbers,
        ten times slower close to the surface, are asked only where it lies on an edge or vertex.
        """
        distance, faces, nearest = self.closest(points)
        along = np.einsum("nx,nx->n", points - nearest, self._normals[faces])
        inside = along < 0
        unclear = np.abs(along) <= (1 - 1e-6) * distance
        inside[unclear] = self.inside(points[unclear])
        return np.where(inside, -distance, distance)

    @cached_property
    def _normals(self) -> Float[ndarray, "f 3"]:
        """Unit normals; zero for slivers, whose computed normal may point anywhere."""
        a, b, c = self._vertices[self._faces].transpose(1, 0, 2)
        normals = np.cross(b - a, c - a)
        twice_area = np.linalg.norm(normals, axis=1)
        longest = np.linalg.norm([b - a, c - b, a - c], axis=2).max(axis=0)
        normals[twice_area <= SLIVER * longest] = 0
        return normals / np.maximum(twice_area, 1e-300)[:, None]


def morton_order(points: Float[ndarray, "n 3"]) -> Int[ndarray, " n"]:
    """The order of points along a space-filling curve: neighbouring queries share tree nodes in the cache."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    low, high = points.min(0), points.max(0)
    cells = ((points - low) / np.maximum(high - low, 1e-300) * (2**MORTON_BITS - 1)).astype(np.uint64)
    # Spread the bits of each coordinate to every third place.
    spread = cells
    for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
        spread = (spread | (spread << np.uint64(shift))) & np.uint64(mask)
    return np.argsort(spread @ np.array([4, 2, 1], np.uint64), kind="stable")
