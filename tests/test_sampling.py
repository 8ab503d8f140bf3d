"""Samples: distances exact, densities as claimed, chunks whole."""

import numpy as np
import pytest
import toy
from analytic import box_sdf, sphere_sdf
from scipy.stats import ks_2samp, kstest

from cagesdf.cuboid import Cage
from cagesdf.distance import SurfaceDistance
from cagesdf.fitting.cages import fit_cage
from cagesdf.frames import HALF_EXTENT
from cagesdf.sampling import Samples, sample_near, sample_points, uniform_in
from cagesdf.solid import union

SIZE = np.array([0.9, 0.5, 0.2])


def plain_rejection(count: int, beta: float, rng: np.random.Generator) -> np.ndarray:
    """The definition: uniform in the cube, kept with probability exp(−beta·|sdf|)."""
    points = np.zeros((0, 3))
    while len(points) < count:
        drawn = rng.uniform(-HALF_EXTENT, HALF_EXTENT, (500_000, 3))
        points = np.concatenate([points, drawn[rng.random(len(drawn)) < np.exp(-beta * np.abs(box_sdf(drawn, SIZE)))]])
    return points[:count]


@pytest.fixture(scope="module")
def board() -> SurfaceDistance:
    return SurfaceDistance(toy.box([0, 0, 0], SIZE))


@pytest.mark.parametrize("beta", [10.0, 60.0])
def test_importance_samples_are_distributed_as_by_plain_rejection(board: SurfaceDistance, beta: float) -> None:
    ours = sample_near(board, 8000, beta, np.random.default_rng(1))
    plain = plain_rejection(8000, beta, np.random.default_rng(2))
    assert ks_2samp(np.abs(box_sdf(ours, SIZE)), np.abs(box_sdf(plain, SIZE))).pvalue > 0.01
    assert ks_2samp(box_sdf(ours, SIZE), box_sdf(plain, SIZE)).pvalue > 0.01
    for axis in range(3):
        assert ks_2samp(ours[:, axis], plain[:, axis]).pvalue > 0.01


def test_importance_samples_of_a_thin_sheet_are_distributed_as_their_closed_form() -> None:
    """Far from its rim, a sheet's distance |z| has the density β·exp(−β|z|)."""
    sheet = SurfaceDistance(toy.box([0, 0, 0], [2, 2, 1e-6]))
    points = sample_near(sheet, 8000, 60.0, np.random.default_rng(3))
    inner = points[(np.abs(points[:, :2]) < 0.7).all(axis=1)]
    assert kstest(np.abs(inner[:, 2]), "expon", args=(0, 1 / 60)).pvalue > 0.01
    assert kstest(inner[:, 0], "uniform", args=(-0.7, 1.4)).pvalue > 0.01


def test_no_importance_sample_is_drawn_twice_and_none_lies_beyond_the_cube(board: SurfaceDistance) -> None:
    points = sample_near(board, 5000, 60.0, np.random.default_rng(4))
    assert points.shape == (5000, 3)
    assert len(np.unique(points, axis=0)) == 5000
    assert np.abs(points).max() <= np.float32(HALF_EXTENT)


def test_the_density_does_not_depend_on_how_far_the_tree_is_refined(board: SurfaceDistance) -> None:
    """The tree's depth follows the number of points; a few must be distributed as many."""
    many = sample_near(board, 20000, 60.0, np.random.default_rng(5))
    few = np.concatenate([sample_near(board, 40, 60.0, np.random.default_rng(100 + k)) for k in range(50)])
    assert ks_2samp(box_sdf(many, SIZE), box_sdf(few, SIZE)).pvalue > 0.01


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
