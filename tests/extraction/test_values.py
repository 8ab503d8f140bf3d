"""Where the network is evaluated: at few points, only in its cuboid, and with the signs of evaluating everywhere."""

from math import prod

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.extraction.lattice import Lattice
from cagesdf.extraction.values import (
    BEND,
    INNER,
    LIPSCHITZ,
    WEAK,
    dense_values,
    ends,
    first_strides,
    halvings,
    settled,
    sparse_values,
)

REACH = 0.1


def cuboid(rng: np.random.Generator) -> Cuboid:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return Cuboid(rng.uniform(-0.3, 0.3, 3), q * np.sign(np.linalg.det(q)), rng.uniform(0.05, 0.9, 3))


def cones(rng: np.random.Generator, lattice: Lattice, slope: float):
    """The least of many cones, and of plates thinner than any cell: as steep as can be, with kinks everywhere."""
    tips, heights = rng.uniform(-0.6, 0.6, (12, 3)), rng.uniform(-0.15, 0.02, 12)

    def evaluate(places: np.ndarray) -> np.ndarray:
        points = lattice.points(places)
        away = np.linalg.norm(points[:, None] - tips, axis=2) + heights
        return (slope * away.min(axis=1)).clip(-REACH, REACH).astype(np.float32)

    return evaluate


@given(size=st.tuples(*[st.integers(1, 21)] * 3), strides=st.tuples(*[st.sampled_from([1, 2, 8])] * 3))
@settings(max_examples=30, deadline=None)
def test_the_sublattices_have_each_point_once(size: tuple[int, int, int], strides: tuple[int, int, int]) -> None:
    times = np.zeros(size, int)
    for step, firsts in halvings(strides):
        for first in firsts:
            times[tuple(map(slice, first, size, step))] += 1
    assert (times == 1).all()


@given(seed=st.integers(0, 10**6), cell=st.sampled_from([0.031, 0.05, 0.09]), least=st.integers(1, 20))
@settings(max_examples=20, deadline=None)
def test_a_lattice_goes_from_face_to_face_in_steps_no_longer_than_the_cell(seed: int, cell: float, least: int) -> None:
    item = cuboid(np.random.default_rng(seed))
    lattice = Lattice.of(item, cell, least)
    assert (lattice.steps <= cell * (1 + 1e-6)).all()
    assert (lattice.cells >= least).all()
    assert ((lattice.cells == least) | (item.size / (lattice.cells - 1) > cell)).all(), "no more than it takes"
    places = np.argwhere(np.ones(lattice.shape))
    unit = Cage.of({"a": item}).to_unit(lattice.points(places), 0)
    np.testing.assert_allclose(unit, places / lattice.cells - 0.5, atol=1e-12)
    straight = Lattice(Cuboid(item.centre, np.eye(3), item.size), lattice.cells)
    assert len(np.unique(straight.points(places)[places[:, 0] == lattice.cells[0], 0])) == 1


@pytest.mark.parametrize(("cells", "size"), [(10, 1.0), (64, 2.1), (7, 0.7)])
def test_rounding_makes_no_further_cell(cells: int, size: float) -> None:
    item = Cuboid(np.zeros(3), np.eye(3), np.full(3, size))
    assert Lattice.of(item, size / cells, 1).cells.tolist() == [cells] * 3


@given(
    size=st.tuples(*[st.integers(3, 9)] * 3),
    strides=st.sampled_from([(2, 2, 2), (2, 1, 2), (4, 2, 4), (1, 4, 4)]),
    seed=st.integers(0, 10**6),
)
@settings(max_examples=20, deadline=None)
def test_bounds_of_points_halfway_are_those_of_going_from_point_to_point(
    size: tuple[int, int, int], strides: tuple[int, int, int], seed: int
) -> None:
    """Against a loop over the points around each, and no bound from beyond the lattice."""
    rng, steps = np.random.default_rng(seed), np.array([0.011, 0.01, 0.008])
    bound = rng.uniform(-0.1, 0.1, size).astype(np.float32)
    for first in next(firsts for step, firsts in halvings(strides) if any(firsts[0])):
        distance = np.linalg.norm(np.array(first) * steps)
        result = settled(bound, strides, first, steps)
        for index in np.ndindex(result.shape):
            place = np.array(index) * strides + first
            around = [
                place + np.array(first) * signs
                for signs in np.array(np.meshgrid(*[[-1, 1] if start else [0] for start in first])).T.reshape(-1, 3)
            ]
            known = np.array([bound[tuple(at)] if (at < size).all() else 0 for at in around], float)
            high = max(known.max() - LIPSCHITZ * distance, 0)
            low = min(known.min() + LIPSCHITZ * distance, 0)
            if max(strides) == 2:
                high, low = max(high, known.mean() - BEND * distance), min(low, known.mean() + BEND * distance)
            else:
                weak = WEAK * (np.array(strides) / 4 * steps)[np.array(strides) > 2].max()
                high, low = high * (high > weak), low * (low < -weak)
            assert result[index] == pytest.approx(high if high > -low else low, abs=1e-6)


@given(seed=st.integers(0, 10**6), share=st.floats(0.2, 1))
@settings(max_examples=30, deadline=None)
def test_fields_no_steeper_than_the_margin_are_never_misjudged_above_the_finest_step(seed: int, share: float) -> None:
    """Every point settled at a distance of more than a cell has the sign that evaluation gives."""
    rng = np.random.default_rng(seed)
    lattice = Lattice.of(cuboid(rng), 0.02, 12)
    evaluate = cones(rng, lattice, share * LIPSCHITZ)
    sparse, dense = (method(evaluate, REACH, lattice) for method in (sparse_values, dense_values))
    wrong = (sparse.values < 0) != (dense.values < 0)
    # The finest step settles from two sides: it may overlook a tip within a cell, and nothing larger.
    assert wrong.sum() <= 0.001 * dense.evaluations
    assert np.abs(dense.values[wrong]).max(initial=0) < LIPSCHITZ * lattice.steps.max()
    assert sparse.evaluations <= dense.evaluations == prod(lattice.shape)
    at_surface = ends(sparse.values < 0)[INNER]
    np.testing.assert_array_equal(sparse.values[INNER][at_surface], dense.values[INNER][at_surface])


def test_the_network_is_asked_only_in_the_cuboid_and_once_a_point() -> None:
    rng = np.random.default_rng(3)
    item, seen = cuboid(rng), []
    lattice = Lattice.of(item, 0.011, 12)
    cone = cones(rng, lattice, 1.0)

    def evaluate(places: np.ndarray) -> np.ndarray:
        seen.append(lattice.points(places))
        return cone(places)

    sampled = sparse_values(evaluate, REACH, lattice)
    points = np.concatenate(seen)
    assert Cage.of({"a": item}).signed_distance(points).max() < 1e-12
    assert sampled.evaluations == len(points) == len(np.unique(points, axis=0))
    assert sampled.evaluations < prod(lattice.shape) / 2


def test_the_first_points_are_as_far_apart_along_each_axis_as_a_value_can_settle() -> None:
    thin = Lattice(Cuboid(np.zeros(3), np.eye(3), np.array([1.6, 0.082, 0.41])), np.array([8, 10, 100]))
    assert first_strides(thin, 0.1) == (1, 8, 16)
    assert first_strides(Lattice(thin.cuboid, np.array([8, 2, 3])), 0.1) == (1, 1, 1)
    assert first_strides(Lattice(thin.cuboid, np.array([8, 10, 100])), 100.0) == (8, 16, 128), "no more than there are"
