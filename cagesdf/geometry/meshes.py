"""Triangle meshes: the record, and functions of single meshes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

MAX_PAIRS = 20_000_000  # of vertices that are welded; more of them take all memory


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles over shared vertices, counter-clockwise seen from outside."""

    vertices: Float[ndarray, "v 3"]  # float64
    faces: Int[ndarray, "f 3"]  # int32 indices into vertices

    def corners(self) -> Float[ndarray, "f 3 3"]:
        """The three corner positions of each face."""
        return self.vertices[self.faces]

    def with_vertices(self, vertices: Float[ndarray, "v 3"]) -> "Mesh":
        """The same faces over moved vertices."""
        return Mesh(vertices, self.faces)


def join(meshes: list[Mesh]) -> Mesh:
    """All meshes as one, nothing merged."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes] or [np.zeros((0, 3))]),
        np.concatenate(
            [mesh.faces + start for mesh, start in zip(meshes, starts)] or [np.zeros((0, 3), np.int32)], dtype=np.int32
        ),
    )


def weld(mesh: Mesh, tolerance: float) -> Mesh:
    """Merge vertices nearer than `tolerance` (mesh units), chains of them too; drop faces that collapse.

    A face that appears twice, in either winding, is kept once: real collections hold each
    face in both windings, which cancels winding numbers. Unused vertices go. Vertices must be
    finite. Raises ValueError if more than MAX_PAIRS pairs of places are as near.
    """
    places, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    tree = cKDTree(places)
    if (count := (tree.count_neighbors(tree, tolerance) - len(places)) // 2) > MAX_PAIRS:
        raise ValueError(f"{count:,} pairs of its {len(places):,} vertices are nearer than {tolerance:g}")
    pairs = tree.query_pairs(tolerance, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), bool), pairs.T), shape=(len(places),) * 2)
    clusters = connected_components(links, directed=False)[1][place.ravel()]
    _, first, cluster = np.unique(clusters, return_index=True, return_inverse=True)
    a, b, c = first[cluster][mesh.faces].T
    faces = np.stack([a, b, c], axis=1)[(a != b) & (b != c) & (c != a)]
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return compact(Mesh(mesh.vertices, faces[np.sort(once)].astype(np.int32)))


def compact(mesh: Mesh) -> Mesh:
    """Drop vertices that no face uses."""
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.faces] = True
    renumbered = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return Mesh(mesh.vertices[used], renumbered[mesh.faces])


def face_normals(mesh: Mesh) -> Float[ndarray, "f 3"]:
    """Cross products of the edges: length twice the face's area."""
    first, second, third = mesh.faces.T.astype(np.intp)  # a coordinate at a time: three times as fast as np.cross
    ux, uy, uz = (column[second] - column[first] for column in mesh.vertices.T)
    vx, vy, vz = (column[third] - column[first] for column in mesh.vertices.T)
    return np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx], axis=1)


def vertex_normals(mesh: Mesh) -> Float[ndarray, "v 3"]:
    """Unit normals, the mean of the faces' around each vertex, weighted by area; 0 where that is nothing."""
    count, corners = len(mesh.vertices), mesh.faces.T.astype(np.intp)
    across = np.ascontiguousarray(face_normals(mesh).T)
    sums = np.stack([sum(np.bincount(corner, row, count) for corner in corners) for row in across], axis=1)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, lengths, out=np.zeros(sums.shape), where=lengths > 0)


def face_areas(mesh: Mesh) -> Float[ndarray, " f"]:
    """Areas, in squared mesh units."""
    return np.linalg.norm(face_normals(mesh), axis=1) / 2


def signed_volume(mesh: Mesh) -> float:
    """Volume by the divergence theorem; negative if a closed mesh is inside out."""
    centred = mesh.vertices - mesh.vertices.mean(0)
    a, b, c = (centred[corner] for corner in mesh.faces.T)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def box_volume(mesh: Mesh) -> float:
    """Volume of the axis-aligned box around a mesh, in cubic mesh units."""
    return float(np.ptp(mesh.vertices, axis=0).prod())


def is_closed(mesh: Mesh) -> bool:
    """Whether each directed edge has exactly one opposite partner: no hole, one orientation.

    Edges at which four faces meet are allowed if their directions pair up. An empty mesh is
    not closed.
    """
    if len(mesh.faces) == 0:
        return False
    forth, back = edge_keys(mesh)
    return np.array_equal(forth, back)


def topology(mesh: Mesh) -> tuple[int, int]:
    """Connected closed surfaces of a closed manifold mesh, and its genus, summed over them (Euler, Poincaré)."""
    edges = np.concatenate([mesh.faces[:, :2], mesh.faces[:, 1:]])
    count = len(mesh.vertices)
    links = coo_array((np.ones(len(edges), bool), edges.T), (count, count))
    piece = connected_components(links, directed=False)[1]
    used = np.unique(mesh.faces)
    pieces = len(np.unique(piece[used]))
    characteristic = len(used) - len(mesh.faces) // 2
    return pieces, pieces - characteristic // 2


def face_components(mesh: Mesh) -> Int[ndarray, " f"]:
    """A number for each face, the same for faces that share a vertex, or have neighbours that do."""
    a, b, c = mesh.faces.T
    links = coo_array((np.ones(2 * len(a), bool), (np.r_[a, b], np.r_[b, c])), shape=(len(mesh.vertices),) * 2)
    return connected_components(links, directed=False)[1][a].astype(np.int64)


def edge_keys(mesh: Mesh) -> tuple[Int[ndarray, " m"], Int[ndarray, " n"]]:
    """Directed edges as numbers that opposites share, each sorted: edges that go up in index, and down.

    An edge from a vertex to itself counts both ways.
    """
    tail, head = mesh.faces.astype(np.int64), np.roll(mesh.faces, -1, axis=1).astype(np.int64)
    up, down = tail <= head, tail >= head
    count = len(mesh.vertices)
    return np.sort(tail[up] * count + head[up]), np.sort(head[down] * count + tail[down])


def sample_surface(
    mesh: Mesh, count: int, rng: np.random.Generator
) -> tuple[Float[ndarray, "n 3"], Int[ndarray, " n"]]:
    """`count` points uniform on the surface, and the face that each lies on.

    Raises ValueError if the mesh has no area.
    """
    areas = face_areas(mesh)
    total = np.cumsum(areas)
    if len(areas) == 0 or not total[-1] > 0:
        raise ValueError(f"can't sample a surface of {len(areas)} faces and no area")
    faces = np.searchsorted(total, rng.random(count) * total[-1], side="right").clip(max=len(areas) - 1)
    u, v = rng.random((2, count, 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    a, b, c = mesh.vertices[mesh.faces[faces]].transpose(1, 0, 2)
    return a + u * (b - a) + v * (c - a), faces
