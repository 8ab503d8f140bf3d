"""Samples: distances exact, densities as claimed, chunks whole."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import ks_2samp, kstest

from cagesdf.cage_fitting.cages import fit_cage
from cagesdf.cuboid import Cage
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.solid import union
from cagesdf.sampling import shapes as sampling
from cagesdf.sampling.shapes import (
    BOUND_BITS,
    Samples,
    bound_cells,
    rounded_up,
    sample_near,
    sample_points,
    uniform_in,
    weight_bound,
)
from tests.support import toy
from tests.support.analytic import box_sdf, sphere_sdf

SIZE = np.array([0.9, 0.5, 0.2])
SEEN = 40_000  # points from which on a wrong bound shows
# Turned so that the board's normal lies along the cells' diagonal, where their bound is tight.
TURN = np.linalg.qr(np.array([[1.0, 1, 1], [1, -1, 0], [1, 1, -2]]).T)[0][:, [1, 2, 0]]


def board_sdf(points: np.ndarray) -> np.ndarray:
    """Distance to the turned board, in closed form."""
    return box_sdf(points @ TURN, SIZE)


def plain_rejection(count: int, beta: float, rng: np.random.Generator) -> np.ndarray:
    """The definition: uniform in the cube, kept with probability exp(−beta·|sdf|)."""
    points = np.zeros((0, 3))
    while len(points) < count:
        drawn = rng.uniform(-HALF_EXTENT, HALF_EXTENT, (500_000, 3))
        points = np.concatenate([points, drawn[rng.random(len(drawn)) < np.exp(-beta * np.abs(board_sdf(drawn)))]])
    return points[:count]


@pytest.fixture(scope="module")
def board() -> SurfaceDistance:
    box = toy.box([0, 0, 0], SIZE)
    return SurfaceDistance(box.with_vertices(box.vertices @ TURN.T))


@pytest.fixture(scope="module")
def plain() -> np.ndarray:
    """More than is compared, so that its own luck counts less."""
    return plain_rejection(4 * SEEN, 60.0, np.random.default_rng(2))


def agreement(ours: np.ndarray, plain: np.ndarray) -> float:
    """The least p of Kolmogorov and Smirnov's test over |sdf|, sdf, and the coordinates in two frames."""

    def columns(points: np.ndarray) -> list[np.ndarray]:
        sdf = board_sdf(points)
        return [np.abs(sdf), sdf, *points.T, *(points @ TURN).T]

    return min(ks_2samp(a, b).pvalue for a, b in zip(columns(ours), columns(plain)))


def few_at_a_time(board: SurfaceDistance) -> np.ndarray:
    """SEEN points, a hundred a call: cells are coarsest then, and a wrong bound of theirs matters most."""
    return np.concatenate([sample_near(board, 100, 60.0, np.random.default_rng([1, k]))[0] for k in range(SEEN // 100)])


def test_importance_samples_are_distributed_as_by_plain_rejection(board: SurfaceDistance, plain: np.ndarray) -> None:
    points, _ = sample_near(board, SEEN, 60.0, np.random.default_rng(1))
    assert agreement(points, plain) > 1e-3


def test_a_gentle_weight_is_sampled_as_by_plain_rejection(board: SurfaceDistance) -> None:
    points, _ = sample_near(board, SEEN, 10.0, np.random.default_rng(1))
    assert agreement(points, plain_rejection(SEEN, 10.0, np.random.default_rng(2))) > 1e-3


def test_the_density_does_not_depend_on_how_far_the_tree_is_refined(board: SurfaceDistance, plain: np.ndarray) -> None:
    """The tree's depth follows the number of points; a few must be distributed as many."""
    assert agreement(few_at_a_time(board), plain) > 1e-3


def test_the_comparison_sees_cells_bounded_by_their_centres(
    board: SurfaceDistance, plain: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sampling, "HALF_DIAGONAL", 0)
    assert agreement(few_at_a_time(board), plain) < 1e-6


def test_the_comparison_sees_a_distance_taken_to_change_half_as_fast_as_it_may(
    board: SurfaceDistance, plain: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_low(distance: np.ndarray, way: np.ndarray, beta: float) -> np.ndarray:
        return weight_bound(distance, 0.5 * way, beta)

    monkeypatch.setattr(sampling, "weight_bound", too_low)
    assert agreement(few_at_a_time(board), plain) < 1e-6


def solids(rng: np.random.Generator) -> SurfaceDistance:
    """The union of a few balls and turned boxes."""
    meshes = [toy.ball(rng.uniform(-0.6, 0.6, 3), rng.uniform(0.02, 0.4), 24) for _ in range(rng.integers(1, 4))]
    for turn in Rotation.random(rng.integers(0, 4), rng=rng).as_matrix():
        box = toy.box([0, 0, 0], rng.uniform(0.01, 0.6, 3))
        meshes.append(box.with_vertices(box.vertices @ turn.T + rng.uniform(-0.5, 0.5, 3)))
    return SurfaceDistance(union(meshes))


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1), st.sampled_from([5.0, 60.0, 400.0]), st.sampled_from([10, 300, 5000]))
def test_no_weight_in_a_cell_exceeds_its_bounds(seed: int, beta: float, count: int) -> None:
    rng = np.random.default_rng(seed)
    surface = solids(rng)
    cells = bound_cells(surface, count, beta)
    offsets = np.concatenate([rng.uniform(-0.5, 0.5, (len(cells.width), 3)), rng.choice([-0.5, 0.5], (2000, 3))])
    cell = np.concatenate([np.arange(len(cells.width)), rng.integers(len(cells.width), size=2000)])
    points = (cells.centre[cell] + offsets * cells.width[cell, None]).astype(np.float32).astype(np.float64)
    weights = np.exp(-beta * surface.unsigned(points))
    way = np.linalg.norm(points - cells.centre[cell], axis=1)
    assert (weights <= weight_bound(cells.distance[cell], way, beta) * (1 + 1e-9)).all()
    assert (weight_bound(cells.distance[cell], way, beta) <= cells.bound[cell]).all()


def test_cells_fill_the_cube_once(board: SurfaceDistance) -> None:
    cells = bound_cells(board, 5000, 60.0)
    assert (cells.width**3).sum() == pytest.approx((2 * HALF_EXTENT) ** 3, rel=1e-12)
    probe = np.random.default_rng(0).uniform(-HALF_EXTENT, HALF_EXTENT, (500, 3))
    within = np.abs(probe[:, None] - cells.centre).max(axis=2) <= cells.width / 2
    np.testing.assert_array_equal(within.sum(axis=1), 1)


def test_importance_samples_of_a_thin_sheet_are_distributed_as_their_closed_form() -> None:
    """Far from its rim, a sheet's distance |z| has the density β·exp(−β|z|)."""
    sheet = SurfaceDistance(toy.box([0, 0, 0], [2, 2, 1e-6]))
    points, _ = sample_near(sheet, 8000, 60.0, np.random.default_rng(3))
    inner = points[(np.abs(points[:, :2]) < 0.7).all(axis=1)]
    assert kstest(np.abs(inner[:, 2]), "expon", args=(0, 1 / 60)).pvalue > 0.01
    assert kstest(inner[:, 0], "uniform", args=(-0.7, 1.4)).pvalue > 0.01


def test_no_importance_sample_is_drawn_twice_and_none_lies_beyond_the_cube(board: SurfaceDistance) -> None:
    points, _ = sample_near(board, 100_000, 60.0, np.random.default_rng(4))
    assert points.shape == (100_000, 3)
    assert len(np.unique(points, axis=0)) == 100_000
    assert np.abs(points).max() <= np.float32(HALF_EXTENT)


def test_importance_samples_come_with_their_signed_distances(board: SurfaceDistance) -> None:
    points, sdf = sample_near(board, 5000, 60.0, np.random.default_rng(4))
    np.testing.assert_allclose(sdf, board_sdf(points), atol=1e-12)
    np.testing.assert_array_equal(points, points.astype(np.float32))


def test_what_is_drawn_beyond_the_wanted_number_is_left_out_at_random(
    board: SurfaceDistance, plain: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Candidates are drawn cell by cell; with a margin as large as the number wanted, half must go."""
    monkeypatch.setattr(sampling, "MARGIN", 2 * SEEN)
    points, _ = sample_near(board, SEEN // 4, 60.0, np.random.default_rng(6))
    assert agreement(points, plain) > 1e-3


def test_points_in_cuboids_fill_them_evenly() -> None:
    cage = fit_cage(toy.stool("a", lean=0.3), 0.01, 1e-3, 1e-6, 10, np.random.default_rng(0)).cage
    points = uniform_in(cage, np.full(4000, 2), np.random.default_rng(0))
    unit = cage.to_unit(points, 2)
    for axis in range(3):
        assert kstest(unit[:, axis], "uniform", args=(-0.5, 1)).pvalue > 0.01


def sampled(per_cuboid: int = 256, near: int = 3000, seed: int = 0) -> tuple[Samples, Cage, SurfaceDistance]:
    shape = toy.stool("a")
    cage = fit_cage(shape, 0.01, 1e-3, 1e-6, 10, np.random.default_rng(0)).cage
    surface = SurfaceDistance(union([part.mesh for part in shape.parts]))
    return sample_points(surface, cage, near, 500, per_cuboid, 60.0, 64, np.random.default_rng(seed)), cage, surface


def test_chunks_are_whole_and_share_the_part_that_most_contains_their_points() -> None:
    samples, cage, _ = sampled()
    assert samples.points.shape == (len(samples.part), 64, 3)
    assert samples.points.dtype == samples.sdf.dtype == np.float32
    owner = cage.assign(samples.points.reshape(-1, 3).astype(np.float64))[0].reshape(-1, 64)
    np.testing.assert_array_equal(owner, np.repeat(samples.part[:, None], 64, axis=1))


def test_distances_are_exact_at_the_stored_positions() -> None:
    samples, _, surface = sampled()
    points = samples.points.reshape(-1, 3).astype(np.float64)
    unsigned, inside = surface.unsigned(points), surface.inside(points)
    np.testing.assert_array_equal(samples.sdf.ravel(), np.where(inside, -unsigned, unsigned).astype(np.float32))


def test_sampled_distances_of_a_sphere_are_the_closed_form() -> None:
    ball = toy.ball([0, 0, 0], 0.8, 128)
    cage = Cage(("ball",), np.zeros((1, 3)), np.eye(3)[None], np.full((1, 3), 1.6))
    rng = np.random.default_rng(0)
    samples = sample_points(SurfaceDistance(ball), cage, 3000, 500, 64, 60.0, 64, rng)
    # The mesh lies inside the sphere by up to 1e-3 of its radius.
    assert np.abs(samples.sdf - sphere_sdf(samples.points, 0.8)).max() < 8e-4


def test_every_part_gets_its_minimum_and_no_point_of_another_kind_is_lost() -> None:
    samples, cage, _ = sampled(per_cuboid=300)
    count = np.bincount(samples.part, minlength=len(cage)) * 64
    assert (count >= 300).all()
    assert samples.near.sum() == 3000
    assert (~samples.near).sum() >= 500 + 300 * len(cage)


def test_thin_and_small_cuboids_get_their_minimum_too() -> None:
    """A needle, a sheet, a speck and a box that another covers but for a hundredth, around a plain ball."""
    size = np.array([[1.0, 1, 1], [1e-3, 1.5, 1e-3], [1, 1e-3, 1], [1e-3, 1e-3, 1e-3], [0.9, 1.01, 0.9]])
    centre = np.array([[0.0, 0, 0], [0.3, 0, 0.1], [0, 0.8, 0], [0.9, 0, 0], [0, 0, 0]])
    cage = Cage(tuple("abcde"), centre, np.tile(np.eye(3), (5, 1, 1)), size)
    surface = SurfaceDistance(toy.ball([0, 0, 0], 0.5))
    samples = sample_points(surface, cage, 500, 200, 100, 60.0, 64, np.random.default_rng(0))
    owned = np.bincount(samples.part, minlength=5) * 64
    assert (owned >= 100).all()
    points = samples.points.reshape(-1, 3).astype(np.float64)
    np.testing.assert_array_equal(cage.assign(points)[0], np.repeat(samples.part, 64))


def test_uniform_points_fill_the_cube() -> None:
    shape = toy.stool("a")
    cage = fit_cage(shape, 0.01, 1e-3, 1e-6, 10, np.random.default_rng(0)).cage
    surface = SurfaceDistance(union([part.mesh for part in shape.parts]))
    samples = sample_points(surface, cage, 1, 6000, 0, 60.0, 64, np.random.default_rng(0))
    points = samples.points[~samples.near]
    away = points[(cage.assign(points.astype(np.float64))[1] > 0)]
    probe = np.random.default_rng(1).uniform(-HALF_EXTENT, HALF_EXTENT, (6000, 3))
    wanted = probe[cage.assign(probe)[1] > 0]
    for axis in range(3):
        assert ks_2samp(away[:, axis], wanted[:, axis]).pvalue > 0.01


def test_a_cuboid_that_others_cover_loses_points_instead_of_gaining_foreign_ones() -> None:
    """The second cuboid is the first: ties go to the first, so its own region is empty."""
    box = np.full((1, 3), 1.0)
    cage = Cage(("a", "b"), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), np.repeat(box, 2, axis=0))
    surface = SurfaceDistance(toy.box([0, 0, 0], [1, 1, 1]))
    samples = sample_points(surface, cage, 1000, 100, 256, 60.0, 64, np.random.default_rng(0))
    assert (samples.part == 0).all()
    assert len(samples.part) * 64 >= 1000 + 100 + 2 * 256


def test_rows_of_a_part_are_mixed_over_its_chunks() -> None:
    samples, _, _ = sampled()
    shares = samples.near[samples.part == 4].mean(axis=1)
    assert 0.15 < shares.min() < shares.max() < 0.75
    assert shares.std() < 0.12


def test_the_same_seed_gives_the_same_samples_and_another_others() -> None:
    first, again, other = sampled()[0], sampled()[0], sampled(seed=1)[0]
    for name in ("part", "points", "sdf", "near"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert first.points.shape != other.points.shape or (first.points != other.points).any()


@given(st.floats(1e-300, 1.0))
def test_rounded_bounds_are_no_smaller_hardly_larger_and_few(bound: float) -> None:
    rounded = rounded_up(np.array([bound]))
    assert bound <= rounded[0] <= bound * (1 + 2.0 ** (1 - BOUND_BITS))
    assert np.array_equal(rounded_up(rounded), rounded)
    assert (np.frexp(rounded)[0] * 2.0**BOUND_BITS) % 1 == 0, "other digits than the first are 0 on every processor"
