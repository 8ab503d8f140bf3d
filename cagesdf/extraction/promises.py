"""What is promised of every surface: bounded by its cuboids, closed, manifold, outward; symmetric on demand."""

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cagesdf.cuboid import Cage
from cagesdf.distance import SurfaceDistance
from cagesdf.errors import InputError
from cagesdf.meshes import Mesh, compact, edge_keys, join, signed_volume
from cagesdf.solid import as_manifold, cage_surface, from_manifold

OVERSHOOT = 1e-3  # a surface leaves its cuboids by no more, in cells
TWIN = 1e-3  # a cuboid's mirror image is another one if its corners are no further from that one's, canonical units
ON_PLANE = 1e-9  # what is nearer to the mirror than this lies on it, canonical units
AS_LARGE = 1 - 1e-6  # two pieces with this ratio of volumes are as large as each other


def symmetric_none(mesh: Mesh, cage: Cage) -> Mesh:
    """The mesh as it is."""
    return mesh


def symmetric_x(mesh: Mesh, cage: Cage) -> Mesh:
    """The half of a closed mesh at x ≥ 0, and its mirror image: vertices (x, y, z) and (-x, y, z), bit for bit.

    It stays within the cuboids and within their mirror images. Raises InputError if a cuboid of the
    cage has no mirror image among the cuboids.
    """
    check_mirrored(cage)
    whole = as_manifold(mesh) ^ as_manifold(mirror_image(cage_surface(cage)))
    half = from_manifold(whole.trim_by_plane((1.0, 0.0, 0.0), 0.0))
    half.vertices[np.abs(half.vertices[:, 0]) < ON_PLANE, 0] = 0
    # Without the faces in the mirror the half is open exactly there, and its image closes it.
    apart = half.vertices[:, 0] != 0
    half = compact(Mesh(half.vertices, half.faces[apart[half.faces].any(axis=1)]))
    both = join([half, mirror_image(half)])
    count = len(half.vertices)
    once = np.arange(2 * count)
    once[count:][half.vertices[:, 0] == 0] -= count
    return compact(Mesh(both.vertices, once[both.faces].astype(np.int32)))


SYMMETRIES: dict[str, Callable[[Mesh, Cage], Mesh]] = {"none": symmetric_none, "x": symmetric_x}


def mirror_image(mesh: Mesh) -> Mesh:
    """A mesh mirrored at x = 0, outward as before."""
    return Mesh(mesh.vertices * [-1.0, 1.0, 1.0], np.ascontiguousarray(mesh.faces[:, ::-1]))


def check_mirrored(cage: Cage) -> None:
    """Raise InputError if a cuboid has no mirror image at x = 0 among the cuboids, itself included."""
    corners = cage.corners()
    for part_id, image in zip(cage.part_ids, corners * [-1.0, 1.0, 1.0]):
        # Axes may be named in another order: each corner is compared with the nearest one.
        gaps = np.linalg.norm(corners[:, :, None] - image, axis=-1)
        gap = gaps.min(axis=1).max(axis=1).min()
        if gap > TWIN:
            raise InputError(
                f"symmetry x: cuboid {part_id!r} has no mirror image at x = 0 among the {len(cage)} cuboids, "
                f"the nearest is {gap:.2g} away, wanted at most {TWIN:g} (canonical units); mirror the cuboids, "
                "or ask for no symmetry"
            )


def keep_loose(mesh: Mesh) -> Mesh:
    """The mesh as it is."""
    return mesh


def drop_loose(mesh: Mesh) -> Mesh:
    """The largest piece of a closed mesh, with its cavities, and what is as large: its mirror image."""
    shells = [from_manifold(shell) for shell in as_manifold(mesh).decompose()]
    if len(shells) < 2:
        return mesh
    volumes = [signed_volume(shell) for shell in shells]
    kept = [shell for shell, volume in zip(shells, volumes) if volume >= AS_LARGE * max(volumes)]
    solid = SurfaceDistance(join(kept))
    kept += [s for s, volume in zip(shells, volumes) if volume < 0 and solid.inside(s.vertices[:1])[0]]
    return join(kept)


LOOSE: dict[str, Callable[[Mesh], Mesh]] = {"keep": keep_loose, "drop": drop_loose}


def count_pieces(mesh: Mesh) -> int:
    """How many pieces of a closed, manifold mesh hang together, cavities not counted."""
    count = len(mesh.vertices)
    ends = (np.concatenate([mesh.faces[:, 0], mesh.faces[:, 0]]), mesh.faces[:, 1:].T.ravel())
    shells, shell = connected_components(coo_array((np.ones(len(ends[0]), bool), ends), (count, count)), directed=False)
    if shells < 2:
        return shells
    a, b, c = mesh.corners().transpose(1, 0, 2)
    return int((np.bincount(shell[mesh.faces[:, 0]], np.einsum("ij,ij->i", a, np.cross(b, c)), shells) > 0).sum())


def check(mesh: Mesh, cage: Cage, cell: float) -> float:
    """How far a mesh leaves its cuboids, in cells.

    Raises ValueError if that is more than OVERSHOOT, or if the mesh has faces and is not closed,
    manifold and outward: an error of the extraction.
    """
    if len(mesh.faces) == 0:
        return 0.0
    outside = mesh.vertices[cage.holder(mesh.vertices, 0.0) < 0]
    overshoot = max(0.0, float(cage.assign(outside)[1].max(initial=0))) / cell
    forth, back = edge_keys(mesh)
    if not np.array_equal(forth, back):
        wrong = "is not closed"
    elif (forth[1:] == forth[:-1]).any():
        wrong = "has edges at which more than two faces meet"
    elif signed_volume(mesh) <= 0:
        wrong = "is inside out"
    elif overshoot > OVERSHOOT:
        wrong = f"leaves its cuboids by {overshoot:.2g} cells"
    else:
        return overshoot
    raise ValueError(
        f"the surface of {len(mesh.faces)} faces {wrong}; this is an error of the extraction, please report it"
    )
