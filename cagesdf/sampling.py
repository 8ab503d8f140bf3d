"""Signed distance samples of one solid, each assigned to a cuboid, in chunks of one part (§3.4)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.distance import SurfaceDistance
from cagesdf.frames import HALF_EXTENT

COARSEST = 8  # cells along the cube before any is split
SPLIT_COST = 16  # expected candidates of a cell from which on it is split: its children cost 8 distances
TOP_UP_ROUNDS = 6  # each twice the last
CANDIDATES = 2**18  # drawn at once at most: bounds the memory


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
    until they have a multiple of `chunk` and at least `per_cuboid`. Where a cuboid's own region is (nearly)
    empty because others cover it, that can fail; such a part loses a random few points instead.
    """
    cube = _rounded(rng.uniform(-HALF_EXTENT, HALF_EXTENT, (uniform, 3)))
    boxes = uniform_in(cage, np.repeat(np.arange(len(cage)), per_cuboid), rng)
    points = np.concatenate([sample_near(surface, near, beta, rng), cube, boxes])
    parts = cage.assign(points)[0]
    count = np.bincount(parts, minlength=len(cage))
    extra, extra_parts = _top_up(cage, -(-np.maximum(count, per_cuboid) // chunk) * chunk - count, rng)
    points, parts = np.concatenate([points, extra]), np.concatenate([parts, extra_parts])
    rows, part = _chunks(parts, chunk, rng)
    sdf = surface.signed(points)
    return Samples(part, points[rows].astype(np.float32), sdf[rows].astype(np.float32), rows < near)


def sample_near(surface: SurfaceDistance, count: int, beta: float, rng: np.random.Generator) -> Float[ndarray, "n 3"]:
    """`count` points of the cube with density in proportion to exp(−beta·|sdf|), representable in float32.

    The weight is that of Davies et al. 2021; here by rejection, exactly and without repeats.
    Distance is 1-Lipschitz, so the weight in a cell of an octree is at most that of its centre's
    distance less its half diagonal: candidates are drawn in cells in proportion to volume ×
    bound and accepted with weight / bound.
    """
    centres, widths, bounds, total = _cells(surface, count, beta)
    mass = np.cumsum(bounds * widths**3)
    points, rate = np.zeros((0, 3)), total / mass[-1]
    while (lacking := count - len(points)) > 0:
        drawn = min(int(1.1 * lacking / rate) + 64, CANDIDATES)
        cells = np.searchsorted(mass, rng.random(drawn) * mass[-1], side="right").clip(max=len(mass) - 1)
        candidates = _rounded(centres[cells] + rng.uniform(-0.5, 0.5, (drawn, 3)) * widths[cells, None])
        weights = np.exp(-beta * surface.unsigned(candidates))
        accepted = candidates[rng.random(drawn) * bounds[cells] < weights]
        # Candidates come in random order, so the first are as good as any.
        points = np.concatenate([points, accepted[:lacking]])
        rate = max(len(accepted), 1) / drawn
    return points


def _cells(
    surface: SurfaceDistance, count: int, beta: float
) -> tuple[Float[ndarray, "m 3"], Float[ndarray, " m"], Float[ndarray, " m"], float]:
    """Leaves of an octree over the cube: centres, widths, bounds of the weight; and its total, estimated.

    A cell is split while more than SPLIT_COST candidates are expected in it.
    """
    width = 2 * HALF_EXTENT / COARSEST
    axis = (np.arange(COARSEST) + 0.5) * width - HALF_EXTENT
    centres = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    leaves: list[tuple[ndarray, ndarray, ndarray]] = []
    settled = 0.0
    while True:
        distance = surface.unsigned(centres)
        bounds = np.exp(-beta * np.maximum(distance - width * np.sqrt(3) / 2, 0))
        weights = np.exp(-beta * distance) * width**3
        total = settled + weights.sum()
        split = bounds * width**3 * count > SPLIT_COST * total
        leaves.append((centres[~split], np.full((~split).sum(), width), bounds[~split]))
        settled += weights[~split].sum()
        if not split.any():
            break
        width /= 2
        corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        centres = (centres[split][:, None] + corners * width).reshape(-1, 3)
    centres, widths, bounds = (np.concatenate(column) for column in zip(*leaves))
    return centres, widths, bounds, float(total)


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
        own = cage.assign(drawn)[0] == tried
        drawn, tried = drawn[own], tried[own]
        kept = _rank(tried) < lacking[tried]
        points, parts = np.concatenate([points, drawn[kept]]), np.concatenate([parts, tried[kept]])
        lacking = missing - np.bincount(parts, minlength=len(cage))
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
