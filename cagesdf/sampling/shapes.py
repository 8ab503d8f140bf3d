"""Signed distance samples of one solid, each assigned to a cuboid, in chunks of one part (§3.4)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from cagesdf.cuboid import CORNER_ORDER, Cage
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.distance import SurfaceDistance, morton_order

COARSEST = 8  # cells along the cube before any is split
SPLIT_COST = 64  # expected candidates of a cell from which on it is split; measured, and flat from 32 to 64
TOP_UP_ROUNDS = 10  # each twice the last
HOPELESS = 6  # rounds without a point of a part's own, after which it gets no more
CANDIDATES = 2**18  # drawn at once at most: bounds the memory
MARGIN = 64  # candidates drawn beyond those expected to do
HALF_DIAGONAL = 0.5 * 3**0.5  # of a cell over its width
BOUND_BITS = 12  # of a cell's bound: rejects one candidate in 4,000 more, and has the same bits on all processors
ROUNDING = 1.1e-7  # how far float32 can move a point of the cube, and out of its cell


@dataclass(frozen=True, eq=False)
class Samples:
    """Points with their distances, in chunks that share a part; `k` points a chunk."""

    part: Int[ndarray, " c"]  # number of the cuboid that most contains the chunk's points
    points: Float[ndarray, "c k 3"]  # canonical, float32
    sdf: Float[ndarray, "c k"]  # at those very positions; canonical units, negative inside, float32
    near: Bool[ndarray, "c k"]  # importance sampled rather than uniform


def sample_points(
    surface: SurfaceDistance,
    cage: Cage,
    near: int,
    uniform: int,
    per_cuboid: int,
    beta: float,
    chunk: int,
    rng: np.random.Generator,
) -> Samples:
    """Training samples of a closed surface and its cage, both canonical.

    `near` points are importance sampled (`sample_near`), `uniform` uniform in the cube
    [-HALF_EXTENT, HALF_EXTENT]³, `per_cuboid` uniform in each cuboid. Each belongs to the part
    whose cuboid most contains it. Parts are then filled up with uniform points of their own
    until they have a multiple of `chunk` and at least `per_cuboid`. That fails only where less than some
    thousandths of a cuboid are its own because others cover it; such a part loses a random few points instead.
    """
    drawn, drawn_sdf = sample_near(surface, near, beta, rng)
    cube = _rounded(rng.uniform(-HALF_EXTENT, HALF_EXTENT, (uniform, 3)))
    boxes = uniform_in(cage, np.repeat(np.arange(len(cage)), per_cuboid), rng)
    points = np.concatenate([drawn, cube, boxes])
    parts = cage.assign(points)[0]
    count = np.bincount(parts, minlength=len(cage))
    extra, extra_parts = _top_up(cage, -(-np.maximum(count, per_cuboid) // chunk) * chunk - count, rng)
    points, parts = np.concatenate([points, extra]), np.concatenate([parts, extra_parts])
    rows, part = _chunks(parts, chunk, rng)
    sdf = np.concatenate([drawn_sdf, surface.signed(points[near:])])
    return Samples(part, points[rows].astype(np.float32), sdf[rows].astype(np.float32), rows < near)


def sample_near(
    surface: SurfaceDistance, count: int, beta: float, rng: np.random.Generator
) -> tuple[Float[ndarray, "n 3"], Float[ndarray, " n"]]:
    """`count` points of the cube with density in proportion to exp(−beta·|sdf|), and their signed distances.

    Points are representable in float32. The weight is that of Davies et al. 2021; here by rejection,
    exactly and without repeats. Distance is 1-Lipschitz, so no weight in a cell of an octree exceeds
    that of its centre's distance less its half diagonal: candidates are drawn in cells in proportion to
    volume × bound. Nor does a candidate's weight exceed that of its centre's distance less its own distance
    from the centre, so that many are dropped before their distance is computed.
    """
    cells = bound_cells(surface, count, beta)
    share = cells.bound * cells.width**3
    rate = cells.total / share.sum()
    kept, accepted, tried = [(np.zeros((0, 3)), np.zeros(0))], 0, 0
    while (lacking := count - accepted) > 0:
        drawn = min(int(lacking / rate) + MARGIN, CANDIDATES)
        kept.append(_accepted(surface, cells, rng.multinomial(drawn, share / share.sum()), beta, rng))
        accepted, tried = accepted + len(kept[-1][0]), tried + drawn
        rate = max(accepted, 1) / tried
    # A batch is in the order of its cells: leaving out the last ones would favour the first.
    chosen = np.sort(rng.choice(accepted, count, replace=False, shuffle=False))
    return np.concatenate([points for points, _ in kept])[chosen], np.concatenate([sdf for _, sdf in kept])[chosen]


@dataclass(frozen=True, eq=False)
class Cells:
    """Leaves of an octree over the cube, along a space-filling curve."""

    centre: Float[ndarray, "m 3"]
    width: Float[ndarray, " m"]
    distance: Float[ndarray, " m"]  # of the centre, unsigned
    bound: Float[ndarray, " m"]  # no weight in the cell is larger
    total: float  # integral of the weight over the cube, estimated


def _accepted(
    surface: SurfaceDistance, cells: Cells, counts: Int[ndarray, " m"], beta: float, rng: np.random.Generator
) -> tuple[Float[ndarray, "n 3"], Float[ndarray, " n"]]:
    """Points kept by rejection among `counts` uniform candidates in each cell, and their signed distances."""
    cell = np.repeat(np.arange(len(counts)), counts)
    centre = cells.centre[cell]
    points = _rounded(centre + (rng.random(centre.shape) - 0.5) * cells.width[cell, None])
    height = rng.random(len(cell)) * cells.bound[cell]
    radius = np.sqrt(np.square(points - centre).sum(axis=1))
    hopeful = height < weight_bound(cells.distance[cell], radius, beta)
    points, height = points[hopeful], height[hopeful]
    nearest = surface.closest(points)
    kept = height < np.exp(-beta * nearest[0])
    points, nearest = points[kept], tuple(column[kept] for column in nearest)
    return points, np.where(surface.behind(points, *nearest), -nearest[0], nearest[0])


def weight_bound(distance: Float[ndarray, " n"], radius: Float[ndarray, " n"], beta: float) -> Float[ndarray, " n"]:
    """Upper bound of exp(−beta·|sdf|) within `radius` of a point at `distance`, unsigned: SDFs are 1-Lipschitz."""
    return np.exp(-beta * np.maximum(distance - radius, 0))


def rounded_up(bounds: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    """The least numbers of BOUND_BITS binary digits that are no smaller.

    Exponentials differ in their last digit from one kind of processor to another, and these choose the points.
    """
    mantissa, exponent = np.frexp(bounds)
    return np.ldexp(np.ceil(mantissa * 2.0**BOUND_BITS) / 2.0**BOUND_BITS, exponent)


def bound_cells(surface: SurfaceDistance, count: int, beta: float) -> Cells:
    """An octree fine enough for `count` points: a cell is split while more than SPLIT_COST candidates are expected."""
    width = 2 * HALF_EXTENT / COARSEST
    axis = (np.arange(COARSEST) + 0.5) * width - HALF_EXTENT
    centres = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    leaves: list[tuple[ndarray, ...]] = []
    settled = 0.0
    while True:
        distance = surface.unsigned(centres)
        bounds = rounded_up(weight_bound(distance, np.full(len(centres), width * HALF_DIAGONAL + ROUNDING), beta))
        weights = np.exp(-beta * distance) * width**3
        total = settled + weights.sum()
        split = bounds * width**3 * count > SPLIT_COST * total
        leaf = ~split
        leaves.append((centres[leaf], np.full(leaf.sum(), width), distance[leaf], bounds[leaf]))
        settled += weights[leaf].sum()
        if not split.any():
            break
        width /= 2
        centres = (centres[split][:, None] + CORNER_ORDER * width).reshape(-1, 3)
    centres, widths, distance, bounds = (np.concatenate(column) for column in zip(*leaves))
    order = morton_order(centres)
    return Cells(centres[order], widths[order], distance[order], bounds[order], float(total))


def uniform_in(cage: Cage, cuboids: Int[ndarray, " n"], rng: np.random.Generator) -> Float[ndarray, "n 3"]:
    """A point uniform in each of the numbered cuboids; canonical, representable in float32."""
    offsets = rng.uniform(-0.5, 0.5, (len(cuboids), 3)) * cage.size[cuboids]
    return _rounded(cage.centre[cuboids] + np.einsum("na,nax->nx", offsets, cage.axes[cuboids]))


def _rounded(points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
    # Distances are measured where the stored point will be.
    return points.astype(np.float32).astype(np.float64)


def _top_up(
    cage: Cage, missing: Int[ndarray, " p"], rng: np.random.Generator
) -> tuple[Float[ndarray, "n 3"], Int[ndarray, " n"]]:
    """`missing[p]` points uniform in cuboid p where no other contains them more; fewer if that is hardly anywhere."""
    points, parts = np.zeros((0, 3)), np.zeros(0, np.int64)
    lacking = missing
    for attempt in range(TOP_UP_ROUNDS):
        if not lacking.any():
            break
        tried = np.repeat(np.arange(len(cage)), np.where(lacking > 0, (lacking + 16) * 2**attempt, 0))
        drawn = uniform_in(cage, tried, rng)
        accepted = cage.assign(drawn)[0] == tried
        drawn, tried = drawn[accepted], tried[accepted]
        kept = _rank(tried) < lacking[tried]
        points, parts = np.concatenate([points, drawn[kept]]), np.concatenate([parts, tried[kept]])
        counts = np.bincount(parts, minlength=len(cage))
        lacking = np.where((counts > 0) | (attempt < HOPELESS - 1), missing - counts, 0)
    return points, parts


def _rank(groups: Int[ndarray, " n"]) -> Int[ndarray, " n"]:
    """Position of each entry among those of its group; `groups` is sorted."""
    return np.arange(len(groups)) - np.searchsorted(groups, groups)


def _chunks(
    parts: Int[ndarray, " n"], chunk: int, rng: np.random.Generator
) -> tuple[Int[ndarray, "c k"], Int[ndarray, " c"]]:
    """Rows of each chunk and its part. Rows of a part are mixed; those that fill no chunk are left out."""
    order = rng.permutation(len(parts))
    order = order[np.argsort(parts[order], kind="stable")]
    rank = _rank(parts[order])
    whole = np.bincount(parts) // chunk * chunk
    rows = order[rank < whole[parts[order]]].reshape(-1, chunk)
    return rows, parts[rows[:, 0]]
