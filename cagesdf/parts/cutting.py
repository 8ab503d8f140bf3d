"""Cuts through a component that a cuboid fits badly, by planes.

A plane is worth trying where a part may end: along the faces beside concave edges, through closed loops of these, and
where the area of the section jumps or is least along an axis of the component's cuboid. A component is cut again and
again, each time by the plane that leaves the least volume of cuboids; then cuts that did not pay are undone again:
a frame of four boards gains nothing from the first cut and much from the last. The search runs on a coarser copy of the
component, the cuts are made in the component itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import manifold3d
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cagesdf.cage_fitting.boxes import fit_cuboid
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, face_areas, face_normals
from cagesdf.geometry.solid import from_manifold

SLACK, MIN_SIZE = 0.01, 1e-3  # of cuboids, as `fit_cuboid` has them; fit_cuboids' defaults
FILLED = 0.7  # share of its cuboid: a solid that fills more is not cut
CUTS = 24  # tried in a component
PLANES = 20  # tried for each of them
COARSE = 1500  # faces of the copy that is searched
TOLERANCES = (5e-4, 1e-3, 2e-3, 4e-3, 8e-3)  # canonical units: how coarse the copy may be
CONCAVE = np.sin(np.radians(15))  # edges that are turned in by more
FLAT = 0.03  # of its extent: a loop of concave edges no less flat has a plane
ASIDE = 2e-4  # canonical units
SECTIONS = 40  # along each axis
ANGLES = 12  # tried turns of a cuboid about an axis, within a right angle
CRUMB = 1e-4  # share of a solid's volume that is no piece
HOLLOW = 1.3  # outer volume over volume, above which a curved solid is a vessel
HELD = 0.4  # share of its cuboid that a vessel's outer volume takes: a ball's is half
CONVEX = 0.9  # share of its convex hull: a solid that fills more is one part, however little of its cuboid that is
ROUND = 0.7  # share of a solid's area along the axes of its cuboid, below which it is curved
VESSEL_GAIN = 0.1  # of the outer volume: a cut of a vessel that takes less off the cuboids isn't made
BAY = 0.05  # of the outer volume: nor is one that takes less off the convex hulls, as a slice of a round body does
GRID = 28  # cells along each axis, of the outer volume

Plane = tuple[float, float, float, float]  # unit normal n and offset d: the plane n·x = d


@dataclass(frozen=True, eq=False)
class Fragment:
    """A connected piece of a component, in some half-spaces."""

    solid: manifold3d.Manifold  # canonical
    component: int  # number of the component
    planes: tuple[Plane, ...]  # it lies where n·x ≤ d


@dataclass(eq=False)
class _Cut:
    """A piece of the searched copy and, once it is cut, those it falls into."""

    solid: manifold3d.Manifold
    points: Float[ndarray, "v 3"]  # of its convex hull
    hull: float  # volume of that
    box: float  # volume of its cuboid, about
    plane: Plane | None = None
    children: "list[_Cut]" = field(default_factory=list)

    @staticmethod
    def of(solid: manifold3d.Manifold, axes: Float[ndarray, "3 3"]) -> "_Cut":
        points = hull_points(solid)
        return _Cut(solid, points, solid.hull().volume(), box_about(points, axes)[0])

    def leaves(self) -> "list[_Cut]":
        return [leaf for child in self.children for leaf in child.leaves()] if self.children else [self]


def hull_points(solid: manifold3d.Manifold) -> Float[ndarray, "v 3"]:
    """Vertices of a solid's convex hull; the solid's own where it has none."""
    hull = solid.hull()
    source = solid if hull.is_empty() else hull
    return np.array(source.to_mesh64().vert_properties[:, :3])


def box_about(points: Float[ndarray, "v 3"], axes: Float[ndarray, "3 3"]) -> tuple[float, Float[ndarray, "3 3"]]:
    """Volume and axes (rows) of a small box around points, with a side along one of `axes` or the principal ones.

    At most some per cent larger than the least box of that kind; `fitting.boxes.fit_cuboid` is exact.
    """
    centred = points - points.mean(axis=0)
    principal = np.linalg.svd(centred.T @ centred)[2]
    along = np.concatenate([axes, principal])
    across = np.roll(along.reshape(2, 3, 3), 1, axis=1).reshape(6, 3)
    third = np.cross(along, across)
    angle = np.arange(ANGLES) * (np.pi / 2 / ANGLES)
    second = np.cos(angle)[:, None, None] * across + np.sin(angle)[:, None, None] * third
    frames = np.stack(np.broadcast_arrays(along, second, np.cross(along, second)), axis=2).reshape(-1, 3, 3)
    reach = frames.reshape(-1, 3) @ centred.T
    volumes = (reach.max(axis=1) - reach.min(axis=1)).reshape(-1, 3).prod(axis=1)
    best = int(volumes.argmin())
    return float(volumes[best]), frames[best]


def cut(solid: manifold3d.Manifold, plane: Plane) -> list[tuple[manifold3d.Manifold, Plane]]:
    """The connected pieces on either side of a plane, each with the half-space n·x ≤ d it lies in; crumbs left out.

    A crumb is a piece with less than CRUMB of the volume. Of two solids that touch in an edge or a vertex each is one.
    """
    *normal, offset = plane
    above, below = solid.split_by_plane(normal, offset)
    x, y, z, d = plane
    sides: list[tuple[manifold3d.Manifold, Plane]] = [(below, (x, y, z, d)), (above, (-x, -y, -z, -d))]
    least = CRUMB * solid.volume()
    return [(piece, half) for side, half in sides for piece in side.decompose() if piece.volume() > least]


def fragments(solid: manifold3d.Manifold, component: int, price: float) -> list[Fragment]:
    """The pieces of a component, cut where that pays: `price` is the volume that one more cuboid must save.

    A nearly convex component, as a ball or a cone is, stays whole: its cuboid holds much air, but no place in it is an
    end of a part. A curved, hollow component, as a vessel is, is only cut where that takes VESSEL_GAIN of its outer
    volume off the cuboids and BAY off the convex hulls: handles and spouts, never its wall.
    """
    coarse = _coarse(solid)
    points = hull_points(coarse)
    cuboid = fit_cuboid(points, SLACK, MIN_SIZE)
    root, axes = _Cut(coarse, points, coarse.hull().volume(), float(cuboid.size.prod())), cuboid.axes
    if root.box - solid.volume() > price and solid.volume() < FILLED * root.box:
        outer = _outer_volume(coarse, axes) if _is_curved(coarse, axes) else solid.volume()
        if outer > max(HOLLOW * solid.volume(), HELD * root.box):
            _search(root, max(price, VESSEL_GAIN * outer), BAY * outer)
        elif solid.volume() < CONVEX * root.hull:
            _search(root, price)
            _undo(root, price)
    return _made(root, Fragment(solid, component, ()))


def _coarse(solid: manifold3d.Manifold) -> manifold3d.Manifold:
    """A copy of at most about COARSE faces."""
    coarse = solid
    for tolerance in TOLERANCES:
        if coarse.num_tri() <= COARSE:
            break
        simpler = solid.simplify(tolerance)
        if len(simpler.decompose()) == 1 and simpler.volume() > 0.9 * solid.volume():
            coarse = simpler
    return coarse


def _search(root: _Cut, price: float, bay: float | None = None) -> None:
    """Cut the piece with the most empty space in its cuboid, CUTS times.

    With `bay` only where each cut pays, and takes that volume off the convex hulls.
    """
    waiting = [root]
    for _ in range(CUTS):
        waiting = [piece for piece in waiting if _is_worth_cutting(piece, price)]
        if not waiting:
            return
        piece = max(waiting, key=lambda item: item.box - item.solid.volume())
        waiting.remove(piece)
        best = _best_cut(piece, price, bay)
        if best is None or (bay is not None and _cost(best[1], price) >= piece.box + price):
            continue
        piece.plane, piece.children = best
        waiting += piece.children


def _is_worth_cutting(piece: _Cut, price: float) -> bool:
    volume = piece.solid.volume()
    return piece.box - volume > price and volume < FILLED * piece.box


def _cost(pieces: Sequence[_Cut], price: float) -> float:
    return sum(piece.box + price for piece in pieces)


def _best_cut(piece: _Cut, price: float, bay: float | None) -> tuple[Plane, list[_Cut]] | None:
    axes = fit_cuboid(piece.points, SLACK, MIN_SIZE).axes
    best: tuple[Plane, list[_Cut]] | None = None
    for plane in planes(piece.solid, axes):
        sides = cut(piece.solid, plane)
        if len(sides) < 2:
            continue
        pieces = [_Cut.of(solid, axes) for solid, _ in sides]
        if bay is not None and piece.hull - sum(side.hull for side in pieces) < bay:
            continue
        if best is None or _cost(pieces, price) < _cost(best[1], price) - 1e-9 * price:
            best = plane, pieces
    return best


def _undo(piece: _Cut, price: float) -> float:
    """Undo cuts that didn't pay, from the last to the first; returns the cost of the remaining pieces."""
    whole = piece.box + price
    if piece.children:
        parts = sum(_undo(child, price) for child in piece.children)
        if parts < whole:
            return parts
        piece.plane, piece.children = None, []
    return whole


def _made(piece: _Cut, fragment: Fragment) -> list[Fragment]:
    """The pieces of a fragment after the cuts of the searched copy; each is cut like the copy's piece in its place."""
    if piece.plane is None:
        return [fragment]
    boxes = np.array([child.solid.bounding_box() for child in piece.children])
    result = []
    for solid, half in cut(fragment.solid, piece.plane):
        nearest = int(np.abs(boxes - np.array(solid.bounding_box())).sum(axis=1).argmin())
        below = Fragment(solid, fragment.component, (*fragment.planes, half))
        result += _made(piece.children[nearest], below)
    return result or [fragment]


# Planes that are worth trying.


def planes(solid: manifold3d.Manifold, axes: Float[ndarray, "3 3"]) -> list[Plane]:
    """At most PLANES planes along which a part may end, the likeliest first; `axes` are the solid's cuboid's rows."""
    mesh = from_manifold(solid)
    found = [*_section_planes(mesh, axes), *_concave_planes(mesh)]
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    chosen: list[Plane] = []
    for _, normal, offset in sorted(found, key=lambda item: -item[0]):
        inside = mesh.vertices @ normal - offset
        if min(inside.max(), -inside.min()) < 1e-3 * extent:
            continue
        if not any(_alike(normal, offset, plane, extent) for plane in chosen):
            x, y, z = normal.tolist()
            chosen.append((x, y, z, _beside(mesh, normal, offset)))
        if len(chosen) == PLANES:
            break
    return chosen


def _beside(mesh: Mesh, normal: Float[ndarray, " 3"], offset: float) -> float:
    """The offset of a plane moved by ASIDE to where the section is smaller.

    A cut in the very plane of faces leaves sheets without a thickness, which hold pieces together.
    """
    below, above = _section_areas(mesh, normal, np.array([offset - ASIDE, offset + ASIDE]))
    return offset - ASIDE if below < above else offset + ASIDE


_Weighted = tuple[float, Float[ndarray, " 3"], float]  # weight, unit normal, offset


def _alike(normal: Float[ndarray, " 3"], offset: float, plane: Plane, extent: float) -> bool:
    cosine = float(normal @ plane[:3])
    return abs(cosine) > 0.9995 and abs(offset - float(np.sign(cosine)) * plane[3]) < 0.005 * extent


def _concave_planes(mesh: Mesh) -> list[_Weighted]:
    """Planes of the faces beside concave edges, and through loops of these, by the edges' length."""
    a, b, left, right, concave = _edges(mesh)
    lengths = np.linalg.norm(mesh.vertices[b] - mesh.vertices[a], axis=1)
    normals = face_normals(mesh)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    chosen = np.flatnonzero(concave)
    if not len(chosen):
        return []
    faces = np.concatenate([left[chosen], right[chosen]])
    weights = np.tile(lengths[chosen], 2)
    own = normals[faces]
    side = np.sign(own[np.arange(len(own)), np.abs(own).argmax(axis=1)])
    own = own * side[:, None]
    offsets = np.einsum("fx,fx->f", own, mesh.vertices[mesh.faces[faces, 0]])
    keys = np.round(np.column_stack([own * 50, offsets * 200])).astype(np.int64)
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    totals = np.bincount(group.ravel(), weights)
    found: list[_Weighted] = [
        (float(total), own[i], float(offsets[i])) for total, i in zip(totals, first) if own[i].any()
    ]
    loops = coo_array((np.ones(len(chosen), bool), (a[chosen], b[chosen])), (len(mesh.vertices),) * 2)
    labels = connected_components(loops, directed=False)[1]
    for label in np.unique(labels[a[chosen]]):
        edges = chosen[labels[a[chosen]] == label]
        points = mesh.vertices[np.unique(np.concatenate([a[edges], b[edges]]))]
        if len(points) < 4:
            continue
        centre = points.mean(axis=0)
        _, extents, directions = np.linalg.svd(points - centre, full_matrices=False)
        if extents[1] > 1e-9 and extents[2] < FLAT * extents[0]:
            found.append((float(lengths[edges].sum()), directions[2], float(directions[2] @ centre)))
    return found


def _edges(mesh: Mesh) -> tuple[ndarray, ndarray, ndarray, ndarray, Bool[ndarray, " e"]]:
    """Ends of each edge between two faces, these, and whether it is concave."""
    faces = mesh.faces.astype(np.int64)
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = len(mesh.vertices)
    forth, back = np.argsort(tail * count + head, kind="stable"), np.argsort(head * count + tail, kind="stable")
    # The k-th half-edge in one order is the opposite of the k-th in the other.
    left, right = forth // 3, back // 3
    up = tail[forth] < head[forth]
    left, right, a, b = left[up], right[up], tail[forth][up], head[forth][up]
    normals = face_normals(mesh)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    along = mesh.vertices[b] - mesh.vertices[a]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    turn = np.einsum("ex,ex->e", np.cross(normals[left], normals[right]), along)
    return a, b, left, right, turn < -CONCAVE


def _section_planes(mesh: Mesh, axes: Float[ndarray, "3 3"]) -> list[_Weighted]:
    """Planes across the cuboid's axes where the area of the section jumps most, or is less than on either side."""
    found: list[_Weighted] = []
    for axis in axes:
        low, high = float((mesh.vertices @ axis).min()), float((mesh.vertices @ axis).max())
        step = (high - low) / SECTIONS
        places = low + step * (np.arange(SECTIONS) + 0.5)
        areas = _section_areas(mesh, axis, places)
        jumps = np.abs(np.diff(areas))
        scale = max(float(areas.max()), 1e-300)
        for i in np.argsort(-jumps, kind="stable")[:4]:
            near = max(jumps[max(i - 1, 0)], jumps[min(i + 1, len(jumps) - 1)])
            if jumps[i] > 0.1 * scale and jumps[i] >= near:
                place = _refined(mesh, axis, float(places[i]), float(places[i + 1]))
                found.append((4 * float(jumps[i] / scale), axis, place))
        least = [
            i
            for i in range(2, SECTIONS - 2)
            if areas[i] == areas[i - 2 : i + 3].min() < 0.5 * min(areas[:i].max(), areas[i:].max())
        ]
        found += [(1.0 - float(areas[i] / scale), axis, float(places[i])) for i in least]
    return found


def _refined(mesh: Mesh, axis: Float[ndarray, " 3"], low: float, high: float) -> float:
    """The place of the jump between two sections: at a vertex, where one is as near as can be told."""
    for _ in range(5):
        places = np.linspace(low, high, 5)
        areas = _section_areas(mesh, axis, places)
        i = int(np.abs(np.diff(areas)).argmax())
        low, high = float(places[i]), float(places[i + 1])
    heights = mesh.vertices @ axis
    nearest = float(heights[np.abs(heights - (low + high) / 2).argmin()])
    return nearest if low <= nearest <= high else (low + high) / 2


def _section_areas(mesh: Mesh, axis: Float[ndarray, " 3"], places: Float[ndarray, " s"]) -> Float[ndarray, " s"]:
    """Areas of the sections n·x = place of a closed mesh: the shadow along the axis of all faces above the plane."""
    heights = (mesh.vertices @ axis)[mesh.faces]
    order = np.argsort(heights, axis=1)
    low, middle, high = np.take_along_axis(heights, order, axis=1).T
    shadows = face_normals(mesh) @ axis / 2  # signed area seen along the axis
    z = places[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        top = np.square(high - z) / ((high - low) * (high - middle))
        bottom = np.square(z - low) / ((high - low) * (middle - low))
    share = np.where(z <= low, 1.0, np.where(z >= high, 0.0, np.where(z < middle, 1 - bottom, top)))
    return np.abs(np.nan_to_num(share) @ shadows)


# Vessels.


def _is_curved(solid: manifold3d.Manifold, axes: Float[ndarray, "3 3"]) -> bool:
    mesh = from_manifold(solid)
    areas = face_areas(mesh)
    cosines = np.abs(face_normals(mesh) @ axes.T).max(axis=1) / np.maximum(2 * areas, 1e-300)
    return bool(areas[cosines > 0.98].sum() < ROUND * areas.sum())


def _outer_volume(solid: manifold3d.Manifold, axes: Float[ndarray, "3 3"]) -> float:
    """Volume of a solid and of the space that it encloses from both sides along two axes, as vessels and rings do.

    On a grid, as a multiple of the solid's volume there: thin walls may fall between its points.
    """
    mesh = from_manifold(solid)
    local = mesh.vertices @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    cells = (np.indices((GRID,) * 3).reshape(3, -1).T + 0.5) / GRID * (high - low) + low
    inside = SurfaceDistance(mesh).inside(cells @ axes).reshape((GRID,) * 3)
    enclosed = np.zeros(inside.shape, np.int64)
    for axis in range(3):
        below = np.logical_or.accumulate(inside, axis)
        above = np.flip(np.logical_or.accumulate(np.flip(inside, axis), axis), axis)
        enclosed += below & above
    return solid.volume() * float((enclosed >= 2).sum() / max(inside.sum(), 1))
