"""Cuboids and cages: frames, corners, distances, names of axes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import CORNER_ORDER, PROPER_PERMUTATIONS, Cage, Cuboid
from tests.support.analytic import box_sdf

SEEDS = st.integers(0, 2**32 - 1)


def random_cage(seed: int, parts: int = 4) -> Cage:
    rng = np.random.default_rng(seed)
    return Cage(
        tuple(f"p{i}" for i in range(parts)),
        rng.uniform(-1, 1, (parts, 3)),
        Rotation.random(parts, rng=rng).as_matrix(),
        rng.uniform(0.01, 1, (parts, 3)),
    )


@given(SEEDS)
def test_canonical_to_unit_and_back_is_the_identity(seed: int) -> None:
    cage = random_cage(seed)
    points = np.random.default_rng(seed).uniform(-2, 2, (20, 3))
    for i in range(len(cage)):
        np.testing.assert_allclose(cage.from_unit(cage.to_unit(points, i), i), points, atol=1e-12)


@given(SEEDS)
def test_corners_are_the_unit_cubes_corners_in_their_order(seed: int) -> None:
    cage = random_cage(seed)
    for i, corners in enumerate(cage.corners()):
        np.testing.assert_allclose(cage.to_unit(corners, i), CORNER_ORDER, atol=1e-12)


@given(SEEDS)
def test_distance_to_a_cuboid_is_the_closed_form_in_its_local_frame(seed: int) -> None:
    cage = random_cage(seed)
    points = np.random.default_rng(seed).uniform(-2, 2, (50, 3))
    distance = cage.signed_distance(points)
    for i in range(len(cage)):
        np.testing.assert_allclose(distance[:, i], box_sdf(cage.to_local(points, i), cage.size[i]), atol=1e-12)


@given(SEEDS)
def test_a_point_belongs_to_the_cuboid_of_least_distance(seed: int) -> None:
    cage = random_cage(seed)
    points = np.random.default_rng(seed).uniform(-1, 1, (50, 3))
    part, distance = cage.assign(points)
    every = [[cage.signed_distance(point[None])[0, i] for i in range(len(cage))] for point in points]
    np.testing.assert_allclose(distance, np.min(every, axis=1))
    np.testing.assert_array_equal(part, np.argmin(every, axis=1))


def test_a_tie_goes_to_the_first_cuboid() -> None:
    once = random_cage(0, parts=1)
    twice = Cage(("a", "b"), *(np.repeat(values, 2, axis=0) for values in (once.centre, once.axes, once.size)))
    assert (twice.assign(np.zeros((5, 3)))[0] == 0).all()


@given(seed=st.integers(0, 10**6), depth=st.sampled_from([0.0, 0.03]))
def test_the_holder_is_the_first_cuboid_whose_surface_is_deep_enough_below(seed: int, depth: float) -> None:
    cage = random_cage(seed)
    points = np.random.default_rng(seed).uniform(-1, 1, (200, 3))
    deep = cage.signed_distance(points) < -depth
    slow = np.where(deep.any(axis=1), deep.argmax(axis=1), -1)
    np.testing.assert_array_equal(cage.holder(points, depth), slow)


def test_there_are_24_proper_permutations() -> None:
    assert len({permutation.tobytes() for permutation in PROPER_PERMUTATIONS}) == 24
    np.testing.assert_allclose(np.linalg.det(PROPER_PERMUTATIONS), 1)


@given(SEEDS)
def test_naming_axes_keeps_the_box_and_is_the_best_of_24(seed: int) -> None:
    cage = random_cage(seed, parts=2)
    cuboid, other = cage["p0"], cage["p1"].axes
    named = cuboid.nearest_to(other)
    before, after = Cage.of({"x": cuboid}).corners()[0], Cage.of({"x": named}).corners()[0]
    np.testing.assert_allclose(sorted(before.round(9).tolist()), sorted(after.round(9).tolist()), atol=1e-8)
    assert np.linalg.det(named.axes) == pytest.approx(1)
    traces = [np.trace(cuboid.permuted(permutation).axes @ other.T) for permutation in PROPER_PERMUTATIONS]
    assert np.trace(named.axes @ other.T) == pytest.approx(max(traces))


@given(SEEDS)
def test_named_axes_do_not_depend_on_the_names_before(seed: int) -> None:
    cuboid = random_cage(seed, parts=1)["p0"]
    for permutation in PROPER_PERMUTATIONS:
        named = cuboid.permuted(permutation).nearest_to(np.eye(3))
        np.testing.assert_allclose(named.axes, cuboid.nearest_to(np.eye(3)).axes, atol=1e-12)
        np.testing.assert_allclose(named.size, cuboid.nearest_to(np.eye(3)).size)


def test_fifteen_numbers_hold_a_cuboid() -> None:
    cage = random_cage(3)
    assert cage.vectors().shape == (4, 15)
    back = Cage.from_vectors(cage.part_ids, cage.vectors())
    for ours, theirs in zip((back.centre, back.axes, back.size), (cage.centre, cage.axes, cage.size)):
        np.testing.assert_array_equal(ours, theirs)


def test_a_cage_keeps_the_order_of_its_cuboids() -> None:
    cuboid = Cuboid(np.zeros(3), np.eye(3), np.ones(3))
    cage = Cage.of({"b": cuboid, "a": cuboid})
    assert cage.part_ids == ("b", "a") == tuple(cage.cuboids())
    assert Cage.of({}).corners().shape == (0, 8, 3)
