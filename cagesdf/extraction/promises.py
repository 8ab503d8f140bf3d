"""Invariants of every surface: within its cuboids, closed, manifold, outward; symmetric on demand."""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import InputError
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, compact, edge_keys, face_normals, join, signed_volume
from cagesdf.geometry.solid import as_manifold, cage_surface, from_manifold, union

OVERSHOOT = 1e-3  # largest distance by which a surface may leave its cuboids, in cells
TWIN = 1e-3  # a cuboid's mirror image is another one if its corners are no further from that one's, canonical units
ON_PLANE = 1e-9  # what is nearer to the mirror than this lies on it, canonical units
AS_LARGE = 1 - 1e-6  # two pieces with this ratio of volumes are as large as each other

Meshes = Mapping[str, Mesh]  # by part


def symmetric_none(mesh: Mesh, parts: Meshes, cage: Cage) -> tuple[Mesh, Meshes]:
    """A mesh and its parts as they are."""
    return mesh, parts


def symmetric_x(mesh: Mesh, parts: Meshes, cage: Cage) -> tuple[Mesh, Meshes]:
    """A mesh and its parts made symmetric: the half at x ≥ 0 and its image, (x, y, z) and (-x, y, z) bit for bit.

    A part's image is its twin's, that of the cuboid's mirror image. All stay within the cuboids and within
    their mirror images. Raises InputError if a cuboid of the cage has no mirror image among the cuboids.
    """
    mirrored: dict[str, Mesh] = {}
    for part_id, twin in twins(cage).items():
        if part_id == twin:
            mirrored[part_id] = both_halves(right_half(parts[part_id], cage[part_id]))
        elif part_id not in mirrored:
            half, twin_half = right_half(parts[part_id], cage[twin]), right_half(parts[twin], cage[part_id])
            mirrored[part_id] = union([mesh for mesh in (half, mirror_image(twin_half)) if len(mesh.faces)])
            mirrored[twin] = mirror_image(mirrored[part_id])
    return both_halves(right_half(mesh, *cage.cuboids().values())), {part_id: mirrored[part_id] for part_id in parts}


SYMMETRIES: dict[str, Callable[[Mesh, Meshes, Cage], tuple[Mesh, Meshes]]] = {"none": symmetric_none, "x": symmetric_x}


def mirror_image(mesh: Mesh) -> Mesh:
    """A mesh mirrored at x = 0, outward as before."""
    return Mesh(mesh.vertices * [-1.0, 1.0, 1.0], np.ascontiguousarray(mesh.faces[:, ::-1]))


def right_half(mesh: Mesh, *cuboids: Cuboid) -> Mesh:
    """The closed intersection of a closed mesh with x ≥ 0 and with the mirror images of some cuboids."""
    images = mirror_image(cage_surface(Cage.of({str(i): cuboid for i, cuboid in enumerate(cuboids)})))
    half = from_manifold((as_manifold(mesh) ^ as_manifold(images)).trim_by_plane((1.0, 0.0, 0.0), 0.0))
    half.vertices[np.abs(half.vertices[:, 0]) < ON_PLANE, 0] = 0
    return half


def both_halves(half: Mesh) -> Mesh:
    """A closed mesh at x ≥ 0, and its mirror image, joined at x = 0."""
    # Without the faces in the mirror the half is open exactly there, and its image closes it.
    apart = half.vertices[:, 0] != 0
    half = compact(Mesh(half.vertices, half.faces[apart[half.faces].any(axis=1)]))
    both = join([half, mirror_image(half)])
    count = len(half.vertices)
    once = np.arange(2 * count)
    once[count:][half.vertices[:, 0] == 0] -= count
    return compact(Mesh(both.vertices, once[both.faces].astype(np.int32)))


def twins(cage: Cage) -> dict[str, str]:
    """The mirror image at x = 0 of each cuboid: another one, or itself. Raises InputError if one has none."""
    corners = cage.corners()
    # Axes may be named in another order: each corner is compared with the nearest one.
    gaps = np.array(
        [
            np.linalg.norm(corners[:, :, None] - image, axis=-1).min(axis=1).max(axis=1)
            for image in corners * [-1.0, 1.0, 1.0]
        ]
    ).reshape(len(cage), len(cage))
    images: dict[str, str] = {}
    for part_id, gap in zip(cage.part_ids, gaps):
        if part_id in images:
            continue
        taken = np.isin(cage.part_ids, list(images))
        twin = int(np.where(taken, np.inf, gap).argmin())
        if gap[twin] > TWIN:
            raise InputError(
                f"symmetry x: cuboid {part_id!r} has no mirror image at x = 0 among the {len(cage)} cuboids, "
                f"the nearest is {gap[twin]:.2g} away, wanted at most {TWIN:g} (canonical units); mirror the cuboids, "
                "or ask for no symmetry"
            )
        images[part_id] = cage.part_ids[twin]
        images[cage.part_ids[twin]] = part_id
    return images


def keep_loose(mesh: Mesh) -> Mesh:
    """The mesh as it is."""
    return mesh


def drop_loose(mesh: Mesh) -> Mesh:
    """The largest component of a closed mesh, with its cavities, and one that is as large: its mirror image."""
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
    """Number of connected components of a closed, manifold mesh, cavities not counted."""
    count = len(mesh.vertices)
    ends = (np.concatenate([mesh.faces[:, 0], mesh.faces[:, 0]]), mesh.faces[:, 1:].T.ravel())
    shells, shell = connected_components(coo_array((np.ones(len(ends[0]), bool), ends), (count, count)), directed=False)
    if shells < 2:
        return shells
    first = mesh.faces[:, 0]
    volumes = np.einsum("ij,ij->i", mesh.vertices[first], face_normals(mesh))
    return int((np.bincount(shell[first], volumes, shells) > 0).sum())


def check(mesh: Mesh, cage: Cage, cell: float) -> float:
    """Largest distance by which a mesh leaves its cuboids, in cells.

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
