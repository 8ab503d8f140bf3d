"""Minimum-volume cuboids (elsewhere: minimum oriented bounding boxes) that bound the parts (§3.2).

Search: the box of least volume with one face along a given plane has another face along an
edge of the part's silhouette in that plane (rotating calipers, here all edges at once). The very
smallest box may touch the convex hull with edges only, so the planes tried are those along two
hull edges; on a hull of many edges its facets do, which lie close. Then come the planes of the
best boxes' other faces, until the volume stops falling.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.spatial import ConvexHull

from cagesdf.cuboid import PROPER_PERMUTATIONS, Cuboid

FLAT = 1e-6  # extents below this share of the largest count as none
MERGE = 1e-6  # facet normals closer than this are one
FEW = 128  # hull edges that are tried two by two
POLISHED = 8  # boxes whose other faces are tried as planes
GAIN = 1e-3  # a smaller share of the volume is not worth another round
MANY = 1024  # planes, of which more are merged: on a hull so round they lie close
BATCH = 64  # planes at once at most
BATCH_EDGES = 2**16  # planes at once times hull edges: bounds the memory
UPRIGHT = 0.08  # share of the least volume by which a box along the canonical axes may be larger
ROOM = 1e-12  # canonical units added to each side, so that rounding leaves no point outside


def fit_cuboid(points: Float[ndarray, "n 3"], slack: float, min_size: float) -> Cuboid:
    """The cuboid that bounds `points` (canonical): least volume, named axes.

    Of the boxes whose volume is at most (1 + slack) times the least, it is the one nearest to the
    canonical axes, so that similar parts get similar boxes where the least volume is a near tie
    (square, round, flat parts). Sizes are at least `min_size`, in the result and in the volumes compared.

    Raises ValueError if there is no point, or one isn't finite.
    """
    if len(points) == 0 or not np.isfinite(points).all():
        raise ValueError(f"a cuboid needs finite points, got {len(points)} of which some are NaN or infinite")
    hull = _Hull.of(points, min_size)
    boxes = _search(hull, slack)
    near = boxes.volume <= (1 + slack) * boxes.volume.min()
    axes, traces = _name_axes(boxes.axes[near])
    # Rounded, so that equal boxes found on different ways tie; then the smaller one counts.
    return _box_along(axes[np.lexsort([boxes.volume[near], -traces.round(9)])[0]], points, min_size)


def straight_cuboid(points: Float[ndarray, "n 3"], slack: float, min_size: float) -> Cuboid:
    """The cuboid of `fit_cuboid`, or one along the canonical axes if that is at most UPRIGHT larger.

    Round bodies and lids stand upright, but the least box of a bell or a carinated body may lie askew. Raises
    ValueError as `fit_cuboid` does.
    """
    least = fit_cuboid(points, slack, min_size)
    straight = _box_along(np.eye(3), points, min_size)
    return straight if straight.size.prod() <= (1 + UPRIGHT) * least.size.prod() else least


def nearest_frames(directions: Float[ndarray, "k 3"]) -> Float[ndarray, "k 3 3"]:
    """For each direction (unit), the frame nearest to the canonical axes that has an axis along ±direction.

    Rows are the axes: those of the least rotation that takes the nearest canonical axis to ±direction.
    """
    nearest = np.eye(3)[np.abs(directions).argmax(axis=1)]
    targets = directions * np.sign(np.einsum("ki,ki->k", directions, nearest))[:, None]
    between = nearest + targets
    # Two half-turns about lines through the origin: first about the old axis, then about the bisector.
    turns = 2 * between[:, :, None] * between[:, None] / np.einsum("ki,ki->k", between, between)[:, None, None]
    return (2 * nearest[:, :, None] * nearest[:, None] - np.eye(3)) @ (turns - np.eye(3))


def _box_along(axes: Float[ndarray, "3 3"], points: Float[ndarray, "n 3"], min_size: float) -> Cuboid:
    # Perpendicular to the last digit, which frames along the edges of a hull with slivers are not.
    u, _, v = np.linalg.svd(axes)
    axes = u @ v
    local = points @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    return Cuboid((low + high) / 2 @ axes, axes, np.maximum(high - low + 2 * ROOM, min_size))


def _name_axes(frames: Float[ndarray, "k 3 3"]) -> tuple[Float[ndarray, "k 3 3"], Float[ndarray, " k"]]:
    """Each frame under the proper permutation nearest to the canonical axes, and its trace."""
    traces = np.einsum("pij,kji->kp", PROPER_PERMUTATIONS, frames)
    return PROPER_PERMUTATIONS[traces.argmax(axis=1)] @ frames, traces.max(axis=1)


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Candidates."""

    axes: Float[ndarray, "k 3 3"]  # rows are right-handed unit axes
    volume: Float[ndarray, " k"]  # sizes floored

    @staticmethod
    def joined(pieces: "list[_Boxes]") -> "_Boxes":
        return _Boxes(np.concatenate([b.axes for b in pieces]), np.concatenate([b.volume for b in pieces]))

    def best(self, count: int) -> "_Boxes":
        order = np.argsort(self.volume, kind="stable")[:count]
        return _Boxes(self.axes[order], self.volume[order])

    def limit(self, slack: float) -> float:
        """A volume above which no further box matters: it has too much slack, and is none to be polished."""
        polished = np.partition(self.volume, POLISHED - 1)[POLISHED - 1] if len(self.volume) >= POLISHED else np.inf
        return max(float((1 + slack) * self.volume.min()), float(polished))


@dataclass(frozen=True, eq=False)
class _Hull:
    """A convex hull, thickened where the points are flat."""

    points: Float[ndarray, "v 3"]  # hull vertices
    edges: Int[ndarray, "e 2"]  # indices into points
    sides: Int[ndarray, "e 2"]  # the two facets at each edge
    normals: Float[ndarray, "f 3"]  # unit, outwards
    areas: Float[ndarray, " f"]
    min_size: float  # floor of a box's sizes

    @staticmethod
    def of(points: Float[ndarray, "n 3"], min_size: float) -> "_Hull":
        hull = ConvexHull(_thickened(points, min_size))
        used = np.zeros(len(hull.points), bool)
        used[hull.simplices] = True
        simplices, vertices = (np.cumsum(used) - 1)[hull.simplices], hull.points[used]
        corners = vertices[simplices]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        # A facet's neighbour k lies opposite to its vertex k; each edge is taken from one side.
        facet, k = np.nonzero(hull.neighbors > np.arange(len(simplices))[:, None])
        edges = np.stack([simplices[facet, (k + 1) % 3], simplices[facet, (k + 2) % 3]], axis=1)
        sides = np.stack([facet, hull.neighbors[facet, k]], axis=1)
        return _Hull(vertices, edges, sides, hull.equations[:, :3], areas, min_size)

    def planes(self) -> Float[ndarray, "k 3"]:
        """Normals of the planes that a face of a smallest box may lie in."""
        sharp = self.edges[np.einsum("ij,ij->i", *(self.normals[side] for side in self.sides.T)) < 1 - MERGE]
        if len(sharp) > FEW:
            normals, tolerance = _distinct(self.normals, MERGE), MERGE
            while len(normals) > MANY:
                tolerance *= 2
                normals = _distinct(normals, tolerance)
            return normals
        along = self.points[sharp[:, 1]] - self.points[sharp[:, 0]]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        a, b = np.triu_indices(len(sharp), 1)
        normals = np.cross(along[a], along[b])
        length = np.linalg.norm(normals, axis=1)
        crossing = length > MERGE
        normals, a, b = normals[crossing] / length[crossing, None], a[crossing], b[crossing]
        # Only planes that the hull lies on one side of.
        depth = normals @ self.points.T
        low, high = depth.min(axis=1), depth.max(axis=1)
        rows = np.arange(len(depth))
        room = FLAT * (high - low)
        touching = [
            (at <= low + room) | (at >= high - room) for at in (depth[rows, sharp[a, 0]], depth[rows, sharp[b, 0]])
        ]
        return _distinct(normals[touching[0] & touching[1]], MERGE)

    def heights(self, directions: Float[ndarray, "k 3"]) -> Float[ndarray, " k"]:
        """Extents along unit directions."""
        along = directions @ self.points.T
        return along.max(axis=1) - along.min(axis=1)

    def least_volumes(self, normals: Float[ndarray, "k 3"]) -> Float[ndarray, " k"]:
        """A lower bound on boxes with a face normal to each direction: height × area of the shadow."""
        bounds = np.empty(len(normals))
        for start in range(0, len(normals), BATCH):  # what is at work stays in the cache
            batch = normals[start : start + BATCH]
            facing = batch @ self.normals.T
            shadows = np.abs(facing, out=facing) @ self.areas / 2
            bounds[start : start + BATCH] = np.maximum(self.heights(batch), self.min_size) * shadows
        return bounds

    def boxes_on(self, normals: Float[ndarray, "k 3"], limit: float) -> _Boxes:
        """The boxes, up to a volume, with a face normal to a direction and another along an edge of the outline."""
        on = _on_silhouette(normals @ self.normals.T, self.sides)
        outline, size = _padded(on)
        ends = self.edges[outline]  # k s 2
        along = self.points[ends[..., 1]] - self.points[ends[..., 0]]
        along -= (along @ normals[:, :, None]) * normals[:, None]
        length = np.sqrt(np.einsum("ksx,ksx->ks", along, along))
        along /= np.maximum(length, 1e-300)[..., None]
        across = _cross(normals, along)
        touched = np.zeros((len(normals), len(self.points)), bool)
        touched[np.arange(len(normals))[:, None, None], ends] = True
        corners = self.points[_padded(touched)[0]]  # k v 3
        volume = np.maximum(self.heights(normals), self.min_size)[:, None] * np.prod(
            [
                np.maximum(reach.max(axis=1) - reach.min(axis=1), self.min_size)
                for reach in (corners @ along.swapaxes(1, 2), corners @ across.swapaxes(1, 2))  # k v s
            ],
            axis=0,
        )
        # An edge along the normal has no direction in the plane.
        real = (np.arange(outline.shape[1]) < size[:, None]) & (length > FLAT * length.max()) & (volume <= limit)
        return _Boxes(np.stack([normals[np.nonzero(real)[0]], along[real], across[real]], axis=1), volume[real])

    def boxes_along(self, frames: Float[ndarray, "k 3 3"]) -> _Boxes:
        """The boxes with these axes."""
        sizes = self.heights(frames.reshape(-1, 3)).reshape(-1, 3)
        return _Boxes(frames, np.maximum(sizes, self.min_size).prod(axis=1))


def _thickened(points: Float[ndarray, "n 3"], min_size: float) -> Float[ndarray, "m 3"]:
    """The points, with copies `min_size` apart along the directions in which they have no extent."""
    centred = points - points.mean(axis=0)
    _, _, directions = np.linalg.svd(centred.T @ centred)
    extents = np.ptp(centred @ directions.T, axis=0)
    rank = int((extents > FLAT * extents.max()).sum())
    if rank < 2:  # a line's or point's section may be turned at will: as near to the canonical axes as can be
        directions = nearest_frames(directions[:1])[0] if rank else np.eye(3)
        extents = np.ptp(centred @ directions.T, axis=0)
    for direction in directions[extents <= FLAT * extents.max()]:
        points = np.concatenate([points - direction * min_size / 2, points + direction * min_size / 2])
    return points


def _search(hull: _Hull, slack: float) -> _Boxes:
    """Boxes that contain the hull: of those larger than the least by up to `slack`, not all."""
    normals = hull.planes()
    bounds = hull.least_volumes(normals)
    order = np.argsort(bounds, kind="stable")
    boxes = hull.boxes_along(np.eye(3)[None])
    count = max(1, min(BATCH, BATCH_EDGES // len(hull.edges)))
    for start in range(0, len(order), count):
        # Planes come by their lower bound: once it is above the best volume, no later one matters.
        batch = order[start : start + count]
        batch = batch[bounds[batch] <= (1 + slack) * boxes.volume.min()]
        if len(batch) == 0:
            break
        frames = nearest_frames(normals[batch])
        boxes = _Boxes.joined([boxes, hull.boxes_on(normals[batch], boxes.limit(slack)), hull.boxes_along(frames)])
    least = np.inf
    while boxes.volume.min() < least * (1 - GAIN):
        least = boxes.volume.min()
        others = boxes.best(POLISHED).axes.reshape(-1, 3)
        boxes = _Boxes.joined([boxes, hull.boxes_on(others, boxes.limit(slack))])
    return boxes


def _cross(normals: Float[ndarray, "k 3"], others: Float[ndarray, "k s 3"]) -> Float[ndarray, "k s 3"]:
    x, y, z = normals.T[:, :, None]
    a, b, c = np.moveaxis(others, 2, 0)
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=2)


def _distinct(normals: Float[ndarray, "f 3"], tolerance: float) -> Float[ndarray, "k 3"]:
    """One of each pair of opposite directions, and of directions in the same cell of size `tolerance`."""
    leading = np.abs(normals).argmax(axis=1)
    keys = normals * np.sign(np.take_along_axis(normals, leading[:, None], axis=1))
    _, first = np.unique((keys / tolerance).round().astype(np.int64), axis=0, return_index=True)
    return normals[np.sort(first)]


def _on_silhouette(facing: Float[ndarray, "k f"], sides: Int[ndarray, "e 2"]) -> Bool[ndarray, "k e"]:
    """Edges between a facet that faces a direction and one that doesn't."""
    towards = facing > 1e-9
    return towards[:, sides[:, 0]] != towards[:, sides[:, 1]]


def _padded(chosen: Bool[ndarray, "k n"]) -> tuple[Int[ndarray, "k s"], Int[ndarray, " k"]]:
    """The columns chosen in each row, of which there is one at least, filled up with the first; their numbers."""
    row, column = np.nonzero(chosen)
    size = np.bincount(row, minlength=len(chosen))
    starts = np.cumsum(size) - size
    table = np.repeat(column[starts][:, None], size.max(), axis=1)
    table[row, np.arange(len(row)) - starts[row]] = column
    return table, size
