"""Closed solids: broken part meshes made closed, and the union of a shape's parts.

The chain of `make_solid`, cheapest step first; a part's method is the last step that it needed:

    none        it was closed and outward
    flipped     it was inside out as a whole
    merged      vertices in one place made one, faces that came twice kept once
    oriented    faces turned to agree with their neighbours
    united      pieces that were inside out turned, overlapping pieces made one
    capped      cut apart where more than two faces meet, the holes of each piece closed
    wrapped     sheets that nothing closes, and faces that the other steps left out, given a thin surface around them
    untangled   a surface that runs into itself replaced by its outside

Steps that could take for ever are bounded: a part with too many pieces is wrapped as a whole, a
piece with too many open edges isn't capped, and the last two steps, in a process of their own, have
a limit of faces and of time. Only they need pymeshlab.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import igl
import manifold3d
import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cagesdf.cuboid import Cage
from cagesdf.errors import NotSolidError
from cagesdf.geometry.coverage import REACH, lost_areas
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, compact, face_areas, face_normals, is_closed, join, signed_volume, weld
from cagesdf.geometry.meshlab import alpha_wrap, self_union

# Faces of [-½, ½]³ over CORNER_ORDER, outwards.
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    dtype=np.int32,
)  # fmt: skip


METHODS = ("none", "flipped", "merged", "oriented", "united", "capped", "wrapped", "untangled")
KEEPING = METHODS[:2]  # every face, where it is
BOWL = 0.5  # a cap larger than this share of its piece, whose rim isn't flat, would fill a bowl
BOX = 0.6  # a piece on its convex hull that covers more than this share of it is that solid
FOLDED = 0.02  # caps whose folds take more than this share of a piece's volume are wrong
JITTER = 1e-9  # of a mesh's extent: enough for vertices that lie on an edge not to lie on it exactly
CUT_OFF = 1e-8  # share of its volume that a mesh may lose as it is read
SPECK = 1e-3  # sheets and flaps that make up less than this share of a part's area are dropped
PASSES = 3  # at giving plates to faces that were left out
NEAR = 1e-3  # canonical units: a face in the solid, or at most this far outside, is represented by it
ALPHA = 0.02  # canonical units: the wrap enters openings that are wider
OFFSET = 0.002  # canonical units: from a sheet to its wrap
TIGHT = 0.0005  # canonical units: the same when the wrap has been drawn tight
# Canonical units: the thickness of a part of nothing but sheets, 5 mm of a chair. Half of it is less than a cell at 256
# of them, where a plate of 2 TIGHT would be torn however well it was learnt.
SHEET = 0.012
FLAT = 2e-5  # canonical units: a region is flat if its vertices lie within so much along its normal
CREASE = 30.0  # degrees; sharper edges end a smooth region
SLIVER = 1e-12  # squared canonical units: a face with less area is degenerate
MAX_PRISMS = 500  # of a part; one with more smooth regions is wrapped as a whole
MAX_PIECES = 5000  # of a part, each closed for itself
MAX_OPEN_EDGES = 20_000  # of a piece, whose holes are filled
MAX_FACES = 200_000  # that are wrapped, or untangled
SECONDS = 120  # of CPU time for either; 2,000 loose faces all over the sphere take a sixth of it to wrap
PROBES = 256  # faces probed (just inside) for self-overlap


@dataclass(frozen=True, eq=False)
class Solid:
    """A part made closed, and what that took."""

    mesh: Mesh  # closed, outward, in the frame of the original mesh
    method: str  # the last of METHODS that was needed
    dropped: int  # pieces left out: sheets that the rest represents, specks
    plates: int  # sheets that were given a thickness: 2 TIGHT beside something solid, SHEET alone
    lost: float = 0.0  # share of the original mesh's area that lies outside, more than REACH from it


def as_manifold(mesh: Mesh) -> manifold3d.Manifold:
    """The mesh as manifold3d's solid; its `status()` tells whether it is one.

    Only for meshes that pass `is_closed`: the library can crash on others. As it reads a mesh whose
    vertices lie exactly on edges, it may turn edges that aren't flat and cut a corner off (3.5.4). If
    the volume says so, vertices are moved by JITTER, the same way in every run.
    """
    if len(mesh.faces) == 0:
        return _read(mesh)
    volume = signed_volume(mesh)
    solid = _read(mesh)
    if abs(solid.volume() - volume) <= CUT_OFF * abs(volume):
        return solid
    jitter = np.random.default_rng(0).uniform(-JITTER, JITTER, mesh.vertices.shape) * np.ptp(mesh.vertices)
    jittered = _read(mesh.with_vertices(mesh.vertices + jitter))
    return min(solid, jittered, key=lambda candidate: abs(candidate.volume() - volume))


def _read(mesh: Mesh) -> manifold3d.Manifold:
    return manifold3d.Manifold(
        manifold3d.Mesh64(
            vert_properties=np.require(mesh.vertices, np.float64, ["C", "W"]),  # files give read-only arrays
            tri_verts=np.ascontiguousarray(mesh.faces, np.uint64),
        )
    )


def from_manifold(solid: manifold3d.Manifold) -> Mesh:
    """The surface of a solid."""
    mesh = solid.to_mesh64()
    return Mesh(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int32))


def union(meshes: list[Mesh]) -> Mesh:
    """The outer surface of closed, outward meshes taken together: distances must be to this one.

    That goes for the connected components of one mesh, too, as in `outer_surface`. Raises ValueError if a
    mesh isn't closed, naming its position.
    """
    return from_manifold(_add([_without_inner_faces(solid) for solid in _closed_solids(meshes)]))


def outer_surface(mesh: Mesh) -> Mesh:
    """The outer surface of one closed, outward mesh whose connected components may overlap or touch.

    A mesh whose components have disjoint bounding boxes, as one with a single component, comes back as it is. A
    component that is inside out is a cavity of the smallest other that contains it. Raises ValueError as `union`.
    """
    [whole] = _closed_solids([mesh])
    outer = _without_inner_faces(whole)
    return mesh if outer is whole else from_manifold(outer)


def _without_inner_faces(whole: manifold3d.Manifold) -> manifold3d.Manifold:
    """The union of a solid's components, which manifold3d takes for meant; the solid itself if they lie apart."""
    components = whole.decompose()
    solids = sorted((part for part in components if part.volume() > 0), key=lambda part: part.volume())
    if _boxes_are_disjoint(solids):
        return whole
    for cavity in (_flipped(from_manifold(part)) for part in components if part.volume() < 0):
        hole = as_manifold(cavity)
        owner = next((i for i, part in enumerate(solids) if (hole - part).volume() < 1e-3 * hole.volume()), None)
        if owner is not None:
            solids[owner] -= hole
    return _add(solids)


def _boxes_are_disjoint(solids: Sequence[manifold3d.Manifold]) -> bool:
    """Whether no axis-aligned bounding box of a solid touches another's."""
    boxes = np.array([solid.bounding_box() for solid in solids]).reshape(-1, 2, 3)
    return not any(
        ((boxes[:i, 0] <= high) & (boxes[:i, 1] >= low)).all(axis=1).any() for i, (low, high) in enumerate(boxes)
    )


def _closed_solids(meshes: list[Mesh]) -> list[manifold3d.Manifold]:
    """Each mesh as a solid. Raises ValueError if one isn't closed, naming its position."""
    solids = [as_manifold(mesh) for mesh in meshes]
    for i, solid in enumerate(solids):
        if solid.status() != manifold3d.Error.NoError:
            raise ValueError(f"mesh {i} of {len(meshes)} is no closed solid ({solid.status()}); make it solid first")
    return solids


def cage_surface(cage: Cage) -> Mesh:
    """The outer surface of all cuboids of a cage taken together, canonical frame."""
    return union([Mesh(corners, CUBE_FACES) for corners in cage.corners()])


def make_solid(mesh: Mesh, tolerance: float, min_thickness: float) -> Solid:
    """A closed, outward mesh of the same part, and the last of METHODS that it needed.

    `mesh` and the lengths are canonical. Vertices nearer than `tolerance` are one; a piece whose
    `thickness` is below `min_thickness` is a sheet. Sheets that the rest of the part represents
    (within NEAR) are dropped, and specks are; others become plates 2 TIGHT thick, or SHEET where the part
    is hardly anything else. A mesh that is closed and outward comes back as it is.

    Raises NotSolidError if the mesh has no faces or no area, has vertices that aren't finite, is
    thinner than `min_thickness` even when closed, or exceeds what a step may take; InputError if
    the system libraries of pymeshlab are needed and missing.
    """
    if len(mesh.faces) == 0:
        raise NotSolidError("it has no faces; remove the part, or export it again")
    if not np.isfinite(mesh.vertices).all():
        raise NotSolidError("it has vertices that are NaN or infinite; export it again")
    try:
        welded = weld(mesh, tolerance)
    except ValueError as error:
        raise NotSolidError(f"{error}; simplify it, or lower the tolerance") from error
    if face_areas(welded).sum() < min_thickness**2:
        raise NotSolidError(f"its {len(mesh.faces)} faces have no area; remove the part, or export it again")
    solid = _as_a_whole(mesh, welded, min_thickness) or _in_pieces(welded, min_thickness)
    if _runs_into_itself(solid.mesh):
        solid = replace(solid, mesh=untangle(solid.mesh), method="untangled")
    if solid.plates and thickness(solid.mesh) < SHEET / 2:
        solid = replace(solid, mesh=union([solid.mesh, wrap(welded, SHEET / 2)]))
    if solid.method not in KEEPING:
        solid = _completed(solid, mesh, tolerance)
    if signed_volume(solid.mesh) <= 0 or thickness(solid.mesh) < min_thickness:
        raise NotSolidError(
            f"it has no volume when closed ({solid.method}): {thickness(solid.mesh):.2g} thick on average, wanted at "
            f"least {min_thickness:g}; give it a thickness, or lower min_thickness"
        )
    return solid


def thickness(mesh: Mesh) -> float:
    """Twice the volume over the area: of a closed board, its thickness, in mesh units."""
    return 2 * abs(signed_volume(mesh)) / max(float(face_areas(mesh).sum()), 1e-300)


def pieces(mesh: Mesh) -> list[Mesh]:
    """The patches that edges with exactly two faces hold together, the faces of each turned alike.

    A solid that touches itself along an edge, or two that share a face, fall apart there.
    """
    faces, patches = igl.bfs_orient(mesh.faces.astype(np.int64))
    return _split(Mesh(mesh.vertices, faces.astype(np.int32)), patches.astype(np.int64))


def _patches(mesh: Mesh) -> Int[ndarray, " f"]:
    """The number of the patch, as in `pieces`, of each face."""
    return igl.bfs_orient(mesh.faces.astype(np.int64))[1].astype(np.int64)


def _split(mesh: Mesh, patches: Int[ndarray, " f"]) -> list[Mesh]:
    ordered = mesh.faces[np.argsort(patches, kind="stable")]
    return [compact(Mesh(mesh.vertices, patch)) for patch in np.split(ordered, np.cumsum(np.bincount(patches))[:-1])]


# The steps that keep all faces: none, flipped, merged, oriented, united.


def _as_a_whole(mesh: Mesh, welded: Mesh, min_thickness: float) -> Solid | None:
    candidates = [("merged", welded)]
    # As it came, unless faces came twice; those that are smaller than the tolerance don't matter.
    if np.isclose(face_areas(welded).sum(), face_areas(mesh).sum(), rtol=1e-4):
        candidates.insert(0, ("none", mesh))
    for method, candidate in candidates:
        if is_closed(candidate) and (outward := _outward(candidate, min_thickness)):
            return Solid(outward[0], max(method, outward[1], key=METHODS.index), dropped=0, plates=0)
    return None


def _in_pieces(welded: Mesh, min_thickness: float) -> Solid:
    if _patches(welded).max() >= MAX_PIECES:
        return Solid(wrap(welded), "wrapped", dropped=0, plates=1)
    parts = pieces(welded)
    if all(is_closed(piece) and thickness(piece) >= min_thickness for piece in parts):
        return Solid(_unite(parts), "oriented" if len(parts) == 1 else "united", dropped=0, plates=0)
    return _close(parts, min_thickness)


def _outward(mesh: Mesh, min_thickness: float) -> tuple[Mesh, str] | None:
    """A closed mesh turned outward, its components united; None if one of them is flat.

    A component that is inside out within others is a cavity, and stays.
    """
    method = "none"
    if signed_volume(mesh) < 0:
        mesh, method = _flipped(mesh), "flipped"
    solid, patches = as_manifold(mesh), _patches(mesh)
    if solid.status() != manifold3d.Error.NoError or patches.max() >= MAX_PIECES:
        return None
    parts = _split(mesh, patches)
    if not all(map(is_closed, parts)):
        parts = [mesh]
    if min(map(thickness, parts)) < min_thickness:
        return None
    if len(parts) == 1:
        return mesh, method
    components = [as_manifold(part) for part in parts]
    body = _add([component for component in components if component.volume() > 0])
    inner = [as_manifold(_flipped(from_manifold(part))) for part in components if part.volume() < 0]
    cavities = [part for part in inner if (part - body).volume() < 1e-3 * part.volume()]
    body = _add([body, *(part for part in inner if part not in cavities)]) - _add(cavities)
    if abs(body.volume() - solid.volume()) <= 1e-9 * solid.volume():
        return mesh, method
    return from_manifold(body), "united"


def _flipped(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces[:, ::-1]))


def _add(solids: Sequence[manifold3d.Manifold]) -> manifold3d.Manifold:
    return manifold3d.Manifold.batch_boolean(list(solids), manifold3d.OpType.Add)


def _unite(closed: list[Mesh]) -> Mesh:
    """Closed meshes, of whichever orientation each, as one outward surface."""
    outward = [mesh if signed_volume(mesh) > 0 else _flipped(mesh) for mesh in closed]
    return outward[0] if len(outward) == 1 else union(outward)


# The steps that add faces: capped, wrapped.


def _close(parts: list[Mesh], min_thickness: float) -> Solid:
    closed = [_closed(piece, min_thickness) for piece in parts]
    solids = [solid for solid in closed if solid is not None]
    sheets = [piece for piece, solid in zip(parts, closed) if solid is None]
    if not solids:
        return Solid(wrap(join(sheets)), "wrapped", dropped=0, plates=len(sheets))
    body = _unite(solids)
    lost = np.split(lost_areas(join(sheets), body, NEAR), np.cumsum([len(sheet.faces) for sheet in sheets]))
    loose = [sheet for sheet, areas in zip(sheets, lost) if areas.sum() > SPECK * face_areas(sheet).sum()]
    if face_areas(join(loose)).sum() < SPECK * face_areas(join(parts)).sum():
        return Solid(body, "capped", dropped=len(sheets), plates=0)
    return Solid(union([body, wrap(join(loose))]), "wrapped", dropped=len(sheets) - len(loose), plates=len(loose))


def _closed(piece: Mesh, min_thickness: float) -> Mesh | None:
    """A piece with its holes closed; None if that makes no solid, or one that is too thin."""
    capped = cap(piece)
    cleared = _cleared(capped, min_thickness)
    solid = cleared if _is_sound(capped, cleared) else _box_like(piece)
    return solid if solid is not None and thickness(solid) >= min_thickness else None


def cap(mesh: Mesh) -> Mesh:
    """The mesh with each of its holes closed by triangles between the vertices of the rim.

    `mesh` is one piece, its faces turned alike. Rims in one plane are closed together, so that
    the end of a tube gets a ring. A bowl, which caps would fill, comes back as it is: its rims
    aren't flat, and the caps are larger than the share BOWL of the piece. So does a piece with
    more than MAX_OPEN_EDGES: filling takes the square of their number.
    """
    rims = _rims(mesh)
    if not 0 < sum(map(len, rims)) <= MAX_OPEN_EDGES:
        return mesh
    planes = [(rim, *_plane(mesh.vertices[rim])) for rim in rims]
    groups: dict[tuple[int, ...], list[Int[ndarray, " _"]]] = {}
    for rim, normal, point, _ in sorted(planes, key=lambda plane: -plane[3]):
        side = 1 if tuple(normal) > (0, 0, 0) else -1
        place = np.append(side * normal, side * normal @ point)
        groups.setdefault(tuple(np.round(place / NEAR).astype(int).tolist()), []).append(rim)
    caps = Mesh(mesh.vertices, np.concatenate([_fill(mesh.vertices, rims) for rims in groups.values()]))
    unevenness = max(float(np.abs((mesh.vertices[rim] - point) @ normal).max()) for rim, normal, point, _ in planes)
    if unevenness > NEAR and face_areas(caps).sum() > BOWL * face_areas(mesh).sum():
        return mesh
    return Mesh(mesh.vertices, np.concatenate([mesh.faces, caps.faces]))


def _cleared(mesh: Mesh, min_thickness: float) -> Mesh:
    """A closed mesh without slivers, folds and flat components; one that isn't closed, or nothing else, as it is.

    Flat components are flaps with a lid on them: a surface without an inside, which the next union may drop.
    """
    solid = _read(mesh) if is_closed(mesh) else manifold3d.Manifold()
    if solid.status() != manifold3d.Error.NoError or solid.is_empty():
        return mesh
    cleared = from_manifold(solid)
    components = _split(cleared, _patches(cleared))
    thick = [component for component in components if thickness(component) >= min_thickness]
    return join(thick) if 0 < len(thick) < len(components) and all(map(is_closed, thick)) else cleared


def _is_sound(capped: Mesh, cleared: Mesh) -> bool:
    """Whether caps made a solid: where they cross, folds change its volume or it exceeds the convex hull's."""
    if not is_closed(cleared):
        return False
    before, after = signed_volume(capped), signed_volume(cleared)
    hull = manifold3d.Manifold.hull_points(cleared.vertices)
    return abs(after - before) <= FOLDED * abs(before) + 1e-9 and abs(after) <= 1.001 * hull.volume() + 1e-9


def _box_like(mesh: Mesh) -> Mesh | None:
    """The convex hull, if the mesh covers most of it and has no face elsewhere: a box that lacks sides that meet."""
    hull = manifold3d.Manifold.hull_points(mesh.vertices)
    if hull.is_empty():
        return None
    closed = from_manifold(hull)
    covers = face_areas(mesh).sum() > BOX * face_areas(closed).sum()
    return closed if covers and SurfaceDistance(closed).unsigned(mesh.corners().mean(1)).max() < NEAR else None


def _rims(mesh: Mesh) -> list[Int[ndarray, " _"]]:
    """Simple loops of vertices around the holes, in the direction that the missing faces would have."""
    tail, head = mesh.faces.astype(np.int64).ravel(), np.roll(mesh.faces.astype(np.int64), -1, axis=1).ravel()
    count = len(mesh.vertices)
    edges, which = np.unique(np.minimum(tail, head) * count + np.maximum(tail, head), return_inverse=True)
    surplus = np.bincount(which, np.where(tail < head, 1, -1)).astype(np.int64)
    onward: dict[int, list[int]] = {}
    for edge, times in zip(np.repeat(edges, abs(surplus)).tolist(), np.repeat(surplus, abs(surplus)).tolist()):
        low, high = divmod(edge, count)
        start, end = (high, low) if times > 0 else (low, high)
        onward.setdefault(start, []).append(end)
    # As many open edges leave a vertex as reach it: a walk ends where it began, and each
    # return to a vertex on the way closes a loop.
    rims = []
    for first in sorted(onward):
        walk, place = [first], {first: 0}
        while onward[walk[-1]]:
            vertex = onward[walk[-1]].pop()
            if vertex not in place:
                place[vertex] = len(walk)
                walk.append(vertex)
                continue
            rims.append(np.array(walk[place[vertex] :]))
            for passed in walk[place[vertex] + 1 :]:
                del place[passed]
            del walk[place[vertex] + 1 :]
    return rims


def _plane(loop: Float[ndarray, "n 3"]) -> tuple[Float[ndarray, " 3"], Float[ndarray, " 3"], float]:
    """Unit normal, a point and the enclosed area of the plane nearest to a loop that runs counter-clockwise in it."""
    point = loop.mean(0)
    area = np.cross(loop - point, np.roll(loop, -1, axis=0) - point).sum(0) / 2
    normal = np.linalg.eigh((loop - point).T @ (loop - point))[1][:, 0]
    return (normal if normal @ area >= 0 else -normal), point, float(np.linalg.norm(area))


def _fill(vertices: Float[ndarray, "v 3"], rims: list[Int[ndarray, " _"]]) -> Int[ndarray, "f 3"]:
    """Triangles between the vertices of rims in one plane; the first rim encloses the largest area."""
    normal, _, _ = _plane(vertices[rims[0]])
    across = np.eye(3)[np.abs(normal).argmin()]
    right = np.cross(across, normal)
    right /= np.linalg.norm(right)
    basis = np.stack([right, np.cross(normal, right)], axis=1)
    triangles = manifold3d.triangulate([vertices[rim] @ basis for rim in rims])
    return np.concatenate(rims)[triangles].astype(np.int32)


def wrap(mesh: Mesh, away: float = TIGHT) -> Mesh:
    """A closed surface around any mesh, `away` from it; sheets become plates twice as thick.

    Flat regions become prisms, exact also where they meet. The rest gets CGAL's alpha wrap at OFFSET or more, each
    vertex drawn towards its nearest point on the mesh: the wrap itself can't be made as near as TIGHT without
    millions of faces, and fills the corners in which sheets meet. Canonical frame. Raises NotSolidError if the rest
    has more than MAX_FACES faces or its wrap takes longer than SECONDS, InputError with the line that installs
    system libraries if they are missing.
    """
    # Slivers lie in the regions beside them; CGAL crashes on a mesh of nothing else.
    regions = [region for region in _smooth_regions(mesh) if face_areas(region).max() > SLIVER]
    prisms = [_prism(region, away) for region in regions] if len(regions) <= MAX_PRISMS else []
    flat = [prism for prism in prisms if prism is not None]
    if not flat:
        return _alpha_wrap(mesh, away)
    rest = [region for region, prism in zip(regions, prisms) if prism is None]
    return union([*flat, _alpha_wrap(join(rest), away)] if rest else flat)


def _smooth_regions(mesh: Mesh) -> list[Mesh]:
    """Regions of faces connected by edges of exactly two faces, at most as sharp as CREASE; each turned alike."""
    faces, _ = igl.bfs_orient(mesh.faces.astype(np.int64))
    oriented = Mesh(mesh.vertices, faces.astype(np.int32))
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edge = np.minimum(tail, head) * len(mesh.vertices) + np.maximum(tail, head)
    order = np.argsort(edge, kind="stable")
    _, first, uses = np.unique(edge[order], return_index=True, return_counts=True)
    pairs = order[first[uses == 2, None] + [0, 1]] // 3  # of faces
    normals = face_normals(oriented)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    cosine = np.einsum("ex,ex->e", normals[pairs[:, 0]], normals[pairs[:, 1]])
    smooth = pairs[cosine > np.cos(np.radians(CREASE))]
    links = coo_array((np.ones(len(smooth), bool), smooth.T), (len(faces), len(faces)))
    return _split(oriented, connected_components(links, directed=False)[1].astype(np.int64))


def _prism(region: Mesh, away: float) -> Mesh | None:
    """A flat region with `away` on either side; None if it isn't flat, or touches itself in a vertex."""
    normal = face_normals(region).sum(0)
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    if not normal.any() or np.ptp(region.vertices @ normal) > FLAT:
        return None
    count, faces = len(region.vertices), region.faces
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    rim = ~np.isin(tail.astype(np.int64) * count + head, head.astype(np.int64) * count + tail)
    a, b = tail[rim], head[rim]
    sides = np.concatenate([np.stack([b, a, a + count], axis=1), np.stack([b, a + count, b + count], axis=1)])
    vertices = np.concatenate([region.vertices + away * normal, region.vertices - away * normal])
    prism = Mesh(vertices, np.concatenate([faces, faces[:, ::-1] + count, sides]).astype(np.int32))
    return prism if is_closed(prism) and as_manifold(prism).status() == manifold3d.Error.NoError else None


def _alpha_wrap(mesh: Mesh, away: float) -> Mesh:
    if len(mesh.faces) > MAX_FACES:
        raise NotSolidError(
            f"{len(mesh.faces):,} of its faces have no thickness, at most {MAX_FACES:,} get one; simplify it"
        )
    vertices, faces = alpha_wrap(mesh.vertices, mesh.faces, ALPHA, max(OFFSET, away), SECONDS)
    if len(faces) == 0:
        raise NotSolidError("nothing is left of it when a surface is stretched over it; export it again")
    distance, _, nearest = SurfaceDistance(mesh).closest(vertices)
    reach = np.maximum(distance, away)[:, None]
    return Mesh(nearest + (vertices - nearest) * (away / reach), faces.astype(np.int32))


def _completed(solid: Solid, mesh: Mesh, tolerance: float) -> Solid:
    """The solid of a mesh, with plates for faces that earlier steps left out, and the share of the area still lost.

    A lid that lies on a flap takes it away; so does the outside of a surface that runs into itself, and
    manifold3d's union of faces that lie exactly on each other, this one too: hence the PASSES.
    """
    areas, lost = face_areas(mesh), lost_areas(mesh, solid.mesh, REACH)
    for _ in range(PASSES):
        if lost.sum() <= SPECK * areas.sum():
            break
        flaps = weld(Mesh(mesh.vertices, mesh.faces[lost > SPECK * areas]), tolerance)
        method = max("wrapped", solid.method, key=METHODS.index)
        plates = solid.plates + int(_patches(flaps).max()) + 1
        solid = replace(solid, mesh=union([solid.mesh, wrap(flaps)]), method=method, plates=plates)
        lost = lost_areas(mesh, solid.mesh, REACH)
    return replace(solid, lost=float(lost.sum() / areas.sum()))


# The step that removes faces: untangled.


def _runs_into_itself(mesh: Mesh) -> bool:
    """Whether closed, outward faces overlap: below one of PROBES faces, the winding number is 2 or more."""
    faces = np.unique(np.linspace(0, len(mesh.faces) - 1, PROBES).astype(np.int64))
    normals = face_normals(mesh)[faces]
    points = (
        mesh.corners()[faces].mean(1) - NEAR * normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    )
    tree = igl.FastWindingNumberBVH()
    tree.init(np.ascontiguousarray(mesh.vertices), mesh.faces.astype(np.int64))
    return bool((tree.winding_number(points, 2.0) > 1.5).any())


def untangle(mesh: Mesh) -> Mesh:
    """The outer surface of a closed, outward mesh that runs into itself.

    Faces in the inside would turn signs and shorten distances. manifold3d takes them for meant.
    Raises NotSolidError if that takes more than MAX_FACES faces or SECONDS or the result isn't
    closed, InputError as `wrap` does.
    """
    if len(mesh.faces) > MAX_FACES:
        raise NotSolidError(f"it runs into itself and has {len(mesh.faces):,} faces, at most {MAX_FACES:,} are wanted")
    vertices, faces = self_union(mesh.vertices, mesh.faces, SECONDS)
    outside = Mesh(vertices, faces.astype(np.int32))
    if not is_closed(outside) or as_manifold(outside).status() != manifold3d.Error.NoError:
        raise NotSolidError("it runs into itself, and its outside isn't closed; repair it")
    return outside
