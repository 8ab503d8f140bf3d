"""Figures of generated sets: known values, laws, and slow versions beside the fast ones."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from cagesdf.evaluation.shape_sets import (
    FIGURES,
    Described,
    Draw,
    chamfer,
    coverage,
    definitions,
    drawn,
    frechet_distance,
    kernel_distance,
    one_nna,
    resampling_noise,
    score,
)

seeds = st.integers(0, 2**32 - 1)


def clouds(rng: np.random.Generator, count: int, points: int = 24) -> np.ndarray:
    """Ellipsoids of points, each stretched and moved by itself."""
    shapes = rng.normal(size=(count, points, 3)) * rng.uniform(0.2, 1, (count, 1, 3))
    return (shapes + rng.uniform(-0.3, 0.3, (count, 1, 3))).astype(np.float32)


def described(rng: np.random.Generator, count: int, failed: tuple[int, ...] = ()) -> Described:
    """Shapes whose features are their means and extents; failed ones at the origin."""
    points, lost = clouds(rng, count), np.isin(np.arange(count), failed)
    points[lost] = 0
    features = np.concatenate([points.mean(axis=1), np.ptp(points, axis=1)], axis=1).astype(np.float64)
    return Described(points, features, lost)


def slow_chamfer(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    distances = cdist(a.astype(float), b.astype(float))
    forth, back = distances.min(axis=1), distances.min(axis=0)
    return (forth.mean() + back.mean()) / 2, (forth**2).mean() + (back**2).mean()


@given(seeds)
def test_chamfer_distances_are_those_of_the_whole_matrix_of_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = clouds(rng, 3), clouds(rng, 2, points=17)
    found = chamfer(first, second)
    for i, a in enumerate(first):
        for j, b in enumerate(second):
            assert [d[i, j] for d in found] == pytest.approx(slow_chamfer(a, b), rel=1e-5)


def test_a_cloud_is_at_no_distance_from_itself_in_any_order_and_distances_are_symmetric() -> None:
    rng = np.random.default_rng(0)
    some = clouds(rng, 4, points=500)
    shuffled = some[:, rng.permutation(500)]
    for there, back in zip(chamfer(some, shuffled), chamfer(shuffled, some)):
        assert (np.diag(there) == 0).all()
        np.testing.assert_allclose(there, back.T, rtol=1e-6)
    moved = some + np.float32(1e-3)
    assert np.diag(chamfer(some, moved)[0]) == pytest.approx(1e-3 * 3**0.5, rel=1e-3)


def normal_set(mean: np.ndarray, covariance: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """A set whose own mean and covariance are exactly these."""
    x = rng.normal(size=(count, len(mean)))
    x -= x.mean(axis=0)
    x = x @ np.linalg.inv(np.linalg.cholesky(np.cov(x.T))).T
    return x @ np.linalg.cholesky(covariance).T + mean


def test_the_frechet_distance_of_normal_distributions_is_the_closed_form() -> None:
    rng = np.random.default_rng(1)
    mean = np.array([1.0, -2.0, 0.5])
    first = normal_set(np.zeros(3), np.diag([1.0, 4.0, 9.0]), 40, rng)
    second = normal_set(mean, np.diag([4.0, 4.0, 1.0]), 25, rng)
    assert frechet_distance(first, second) == pytest.approx(mean @ mean + 1 + 0 + 4)
    assert frechet_distance(first, first + mean) == pytest.approx(mean @ mean)


@given(seeds, st.integers(2, 9), st.integers(2, 9))
def test_the_frechet_distance_is_that_of_the_covariances_root_also_of_few_shapes(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(n, 4)), 1 + rng.normal(size=(m, 4)) * [1, 2, 3, 4]
    a, b = np.cov(first.T), np.cov(second.T)
    values, vectors = np.linalg.eigh(a)
    root = vectors * np.sqrt(values.clip(0)) @ vectors.T
    roots = np.sqrt(np.linalg.eigvalsh(root @ b @ root).clip(0)).sum()
    apart = first.mean(axis=0) - second.mean(axis=0)
    expected = apart @ apart + np.trace(a) + np.trace(b) - 2 * roots
    assert frechet_distance(first, second) == pytest.approx(expected, rel=1e-4)
    assert frechet_distance(first, second) == pytest.approx(frechet_distance(second, first))
    turn = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    assert frechet_distance(first @ turn, second @ turn) == pytest.approx(frechet_distance(first, second))


@given(seeds)
def test_a_set_is_at_no_frechet_distance_from_itself_in_any_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    some = rng.normal(size=(5, 8))
    assert frechet_distance(some, some[rng.permutation(5)]) == pytest.approx(0, abs=1e-9)


def test_the_kernel_distance_of_two_sets_of_one_population_is_zero_on_average_and_frechets_is_not() -> None:
    population = np.random.default_rng(2).normal(size=(8, 3))
    found = []
    for chosen in combinations(range(8), 3):
        rest = sorted(set(range(8)) - set(chosen))
        pair = population[list(chosen)], population[rest]
        found.append((kernel_distance(*pair), frechet_distance(*pair)))
    kernel, frechet = np.mean(found, axis=0)
    assert kernel == pytest.approx(0, abs=1e-12)
    assert frechet > 0.5


@given(seeds)
def test_the_kernel_distance_is_the_mean_over_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(3, 2)), rng.normal(size=(4, 2))

    def kernel(a: np.ndarray, b: np.ndarray) -> float:
        return (a @ b / 2 + 1) ** 3

    within = [
        np.mean([kernel(x[i], x[j]) for i in range(len(x)) for j in range(len(x)) if i != j]) for x in (first, second)
    ]
    between = np.mean([kernel(a, b) for a in first for b in second])
    assert kernel_distance(first, second) == pytest.approx(sum(within) - 2 * between)


@pytest.mark.parametrize("measure", [frechet_distance, kernel_distance])
def test_one_shape_has_no_distribution(measure) -> None:
    with pytest.raises(ValueError, match="two shapes at least, got sets of 1 and 3"):
        measure(np.zeros((1, 2)), np.zeros((3, 2)))


def test_the_same_shapes_cover_all_and_one_shape_covers_one() -> None:
    distances = np.abs(np.subtract.outer(np.arange(5.0), np.arange(5.0)))
    none = np.zeros(5, bool)
    assert coverage(distances, none) == 1
    assert coverage(distances[[2, 2, 2, 2, 2]], none) == 0.2
    assert coverage(distances, np.arange(5) > 2) == 0.6
    assert coverage(distances, ~none) == 0


@given(seeds)
def test_who_is_told_apart_is_found_by_leaving_one_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places, own = rng.normal(size=(9, 2)), np.arange(9) < 4
    distances = cdist(places, places)
    np.fill_diagonal(distances, np.inf)
    expected = np.mean([own[distances[i].argmin()] == own[i] for i in range(9)])
    np.fill_diagonal(distances, 0)
    found = one_nna(distances[own][:, own], distances[own][:, ~own], distances[~own][:, ~own], np.zeros(4, bool))
    assert found == pytest.approx(expected)


def test_sets_far_apart_are_told_apart_interleaved_ones_never_and_failed_shapes_always() -> None:
    line = np.arange(6.0)
    among, near = (np.abs(np.subtract.outer(line, line + shift)) for shift in (0, 0.4))
    assert one_nna(among, among + 100, among, np.zeros(6, bool)) == 1
    assert one_nna(among, near, among, np.zeros(6, bool)) == 0
    assert one_nna(among, near, among, np.arange(6) == 0) == pytest.approx(1 / 12)
    lost = one_nna(among, near, among, np.arange(6) < 2)
    assert lost == pytest.approx(3 / 12), "both, and the reference that has no generated shape near it any more"
    assert one_nna(among, near, among, np.ones(6, bool)) == 1


def test_draws_are_disjoint_and_as_many_as_there_are() -> None:
    rng = np.random.default_rng(3)
    some = described(rng, 11)
    draws = drawn(some, 3, 5, rng)
    rows = np.concatenate([draw.rows for draw in draws])
    assert len(draws) == 3
    assert len(set(rows.tolist())) == 9
    for draw in draws:
        assert draw.within == pytest.approx(chamfer(some.points[draw.rows], some.points[draw.rows])[1])
    assert len(drawn(some, 3, 2, rng)) == 2
    again, others = (drawn(some, 3, 5, np.random.default_rng(seed)) for seed in (1, 2))
    assert [draw.rows.tolist() for draw in again] != [draw.rows.tolist() for draw in others], "chance decides"
    assert sorted(rows.tolist()) != rows.tolist()


@pytest.fixture
def sets() -> tuple[Described, Described, list[Draw]]:
    """Training shapes, references, draws of these."""
    rng = np.random.default_rng(4)
    train, reference = described(rng, 12), described(rng, 30)
    return train, reference, drawn(reference, 10, 3, rng)


def test_copies_of_training_shapes_have_no_novelty_and_copies_of_references_cover_them(sets) -> None:
    train, reference, draws = sets
    copies = score(train.of(np.arange(10)), train, reference, draws)
    assert (copies.figures["gen"], copies.figures["gen_squared"]) == (0, 0)
    assert copies.nearest.tolist() == list(range(10))
    again = score(reference, train, reference, [])
    assert (again.figures["cov"], again.figures["cov_squared"]) == (0, 0)
    assert (again.figures["fd"], again.figures["gen"] > 0) == (pytest.approx(0, abs=1e-9), True)
    assert np.isnan(again.figures["coverage"]), "there is no draw"


def test_figures_are_means_of_least_distances(sets) -> None:
    train, reference, draws = sets
    some = described(np.random.default_rng(5), 10)
    found = score(some, train, reference, draws)
    assert set(found.figures) == set(FIGURES)
    for suffix, which in (("", 0), ("_squared", 1)):
        table = {
            name: np.array([[slow_chamfer(a, b)[which] for b in others.points] for a in some.points])
            for name, others in (("gen", train), ("cov", reference), ("var", some))
        }
        np.fill_diagonal(table["var"], np.inf)
        assert found.figures["gen" + suffix] == pytest.approx(table["gen"].min(axis=1).mean(), rel=1e-5)
        assert found.figures["cov" + suffix] == pytest.approx(table["cov"].min(axis=0).mean(), rel=1e-5)
        assert found.figures["var" + suffix] == pytest.approx(table["var"].min(axis=1).mean(), rel=1e-5)
        if not suffix:
            assert found.distance == pytest.approx(table["gen"].min(axis=1), rel=1e-5)
    squared, within = (
        np.array([[slow_chamfer(a, b)[1] for b in others.points] for a in some.points]) for others in (reference, some)
    )
    rows, whole = [draw.rows for draw in draws], np.zeros(10, bool)
    assert found.figures["coverage"] == pytest.approx(np.mean([coverage(squared[:, row], whole) for row in rows]))
    apart = [one_nna(within, squared[:, draw.rows], draw.within, whole) for draw in draws]
    assert found.figures["told_apart"] == pytest.approx(np.mean(apart))


def test_the_order_of_shapes_changes_nothing_but_which_is_which(sets) -> None:
    train, reference, draws = sets
    some, order = described(np.random.default_rng(6), 10), np.random.default_rng(7).permutation(10)
    first, again = score(some, train, reference, draws), score(some.of(order), train, reference, draws)
    assert again.figures == pytest.approx(first.figures)
    assert again.nearest.tolist() == first.nearest[order].tolist()


def test_a_failed_shape_makes_every_figure_worse_or_leaves_it(sets) -> None:
    train, reference, draws = sets
    whole, broken = (
        score(described(np.random.default_rng(8), 10, failed), train, reference, draws) for failed in ((), (0, 4, 5))
    )
    for name in ("gen", "var", "gen_squared", "var_squared", "coverage"):
        assert broken.figures[name] < whole.figures[name], name
    for name in ("fd", "kpd", "cov", "cov_squared", "told_apart"):
        assert broken.figures[name] > whole.figures[name], name
    assert np.isinf(broken.distance[[0, 4, 5]]).all()
    nothing = score(described(np.random.default_rng(8), 10, tuple(range(10))), train, reference, draws).figures
    assert (nothing["gen"], nothing["var"], nothing["coverage"], nothing["told_apart"]) == (0, 0, 0, 1)
    assert all(np.isfinite(value) for value in nothing.values())


def test_two_samples_of_a_surface_are_nearer_the_more_points_they_have() -> None:
    ball = np.random.default_rng(9).normal(size=(2, 800, 3)).astype(np.float32)
    ball /= np.linalg.norm(ball, axis=-1, keepdims=True)
    few, many = resampling_noise(ball, 100), resampling_noise(ball, 400)
    # A point's neighbour is nearer by the root of the number of points, squares by that number.
    assert few["unsquared"] / many["unsquared"] == pytest.approx(2, rel=0.1)
    assert few["squared"] / many["squared"] == pytest.approx(4, rel=0.2)
    assert resampling_noise(ball, 401) == {}


def test_a_file_says_what_its_figures_mean() -> None:
    about = definitions(512, 2048, 4, 11)
    assert (about["version"], about["points"], about["draws"], about["seed"]) == (1, 512, 4, 11)
    assert "origin" in about["failures"]


def test_one_shape_has_the_figures_that_one_shape_can_have(sets) -> None:
    train, reference, draws = sets
    one = described(np.random.default_rng(5), 1)
    found = score(one, train, reference, draws).figures
    alone = score(one.of(np.array([0, 0])), train, reference, draws).figures
    for name in ("gen", "gen_squared", "cov", "cov_squared"):
        assert found[name] == pytest.approx(alone[name]), name
    assert (found["var"], found["var_squared"]) == (0, 0), "there is no other"
    assert {name for name in FIGURES if np.isnan(found[name])} == {"fd", "kpd", "coverage", "told_apart"}


def test_one_failed_shape_is_as_bad_as_many(sets) -> None:
    train, reference, draws = sets
    one = score(described(np.random.default_rng(5), 1, (0,)), train, reference, draws)
    assert (one.figures["gen"], one.figures["var"], one.distance[0]) == (0, 0, np.inf)


def test_no_shapes_have_the_worst_figures_and_no_distances(sets) -> None:
    train, reference, draws = sets
    found = score(described(np.random.default_rng(5), 0), train, reference, draws)
    worst = {"gen": 0, "var": 0, "gen_squared": 0, "var_squared": 0, "coverage": 0, "told_apart": 1}
    assert {name: value for name, value in found.figures.items() if not np.isnan(value)} == worst
    assert set(found.figures) == set(FIGURES)
    assert len(found.nearest) == len(found.distance) == 0
    failed = score(described(np.random.default_rng(5), 4, (0, 1, 2, 3)), train, reference, draws).figures
    assert {name: failed[name] for name in worst} == worst, "as bad as shapes that all failed"
