"""Closed solids: broken part meshes made closed, and the union of a shape's parts."""

import manifold3d
import numpy as np

from cagesdf.cuboid import Cage
from cagesdf.meshes import Mesh

# Faces of [-½, ½]³ over CORNER_ORDER, outwards.
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    dtype=np.int32,
)  # fmt: skip


def as_manifold(mesh: Mesh) -> manifold3d.Manifold:
    """The mesh as manifold3d's solid; its `status()` tells whether it is one."""
    return manifold3d.Manifold(
        manifold3d.Mesh64(
            vert_properties=np.ascontiguousarray(mesh.vertices, np.float64),
            tri_verts=np.ascontiguousarray(mesh.faces, np.uint64),
        )
    )


def from_manifold(solid: manifold3d.Manifold) -> Mesh:
    """The surface of a solid."""
    mesh = solid.to_mesh64()
    return Mesh(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int32))


def union(meshes: list[Mesh]) -> Mesh:
    """The outer surface of closed, outward meshes taken together: distances must be to this one.

    Raises ValueError if a mesh isn't closed, naming its position.
    """
    solids = [as_manifold(mesh) for mesh in meshes]
    for i, solid in enumerate(solids):
        if solid.status() != manifold3d.Error.NoError:
            raise ValueError(f"mesh {i} of {len(meshes)} is no closed solid ({solid.status()}); make it solid first")
    return from_manifold(manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add))


def cage_surface(cage: Cage) -> Mesh:
    """The outer surface of all cuboids of a cage taken together, canonical frame."""
    return union([Mesh(corners, CUBE_FACES) for corners in cage.corners()])
