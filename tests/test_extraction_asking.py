"""Where the network is asked: little, only in cuboids, and with the surface of asking everywhere."""

import numpy as np
import pytest
import torch
from analytic import sphere_sdf
from hypothesis import given, settings
from hypothesis import strategies as st
from test_extraction import Analytic

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.extraction import METHODS, CageField
from cagesdf.extraction.asking import LIPSCHITZ, ask_densely, ask_sparsely, first_stride, sublattices
from cagesdf.extraction.field import outside_union
from cagesdf.extraction.joining import Joined, part_of
from cagesdf.extraction.lattice import Lattice, Region
from cagesdf.frames import OUTSIDE


def rotation(rng: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def cuboid(rng: np.random.Generator) -> Cuboid:
    return Cuboid(rng.uniform(-0.3, 0.3, 3), rotation(rng), rng.uniform(0.05, 0.9, 3))


def cones(rng: np.random.Generator, slope: float):
    """The least of many cones, and of plates thinner than any cell: as steep as can be, with kinks everywhere."""
    tips, heights = rng.uniform(-0.6, 0.6, (12, 3)), rng.uniform(-0.15, 0.02, 12)

    def ask(points: np.ndarray) -> np.ndarray:
        away = np.linalg.norm(points[:, None] - tips, axis=2) + heights
        return (slope * away.min(axis=1)).clip(-OUTSIDE, OUTSIDE).astype(np.float32)

    return ask


@given(size=st.tuples(*[st.integers(1, 21)] * 3), stride=st.sampled_from([1, 2, 8]))
@settings(max_examples=30, deadline=None)
def test_the_sublattices_have_each_point_once(size: tuple[int, int, int], stride: int) -> None:
    times = np.zeros(size, int)
    for step, first in sublattices(stride):
        times[tuple(slice(start, None, step) for start in first)] += 1
    assert (times == 1).all()


@given(seed=st.integers(0, 10**6), cell=st.sampled_from([0.031, 0.05, 0.09]))
@settings(max_examples=20, deadline=None)
def test_a_region_has_the_points_that_the_cuboid_contains_and_their_depths(seed: int, cell: float) -> None:
    rng = np.random.default_rng(seed)
    item = cuboid(rng)
    region = Region.around(item, cell)
    places = np.argwhere(np.ones(region.lattice.shape))
    distance = Cage.of({"a": item}).signed_distance(region.lattice.points(places))[:, 0]
    clear = np.abs(distance) > 1e-6
    np.testing.assert_array_equal(region.inside.reshape(-1)[clear], distance[clear] <= 0)
    assert not region.inside[[0, -1]].any()
    x, y, z = region.lattice.start
    around = Lattice((x - 2, y - 2, z - 2), (400, 400, 400), cell)
    rows, flat, depth = region.among(places + 2, around)
    np.testing.assert_array_equal(rows, np.flatnonzero(region.inside))
    np.testing.assert_array_equal(flat, rows)
    np.testing.assert_allclose(depth, distance[rows], atol=1e-6)


@given(seed=st.integers(0, 10**6), share=st.floats(0.2, 1))
@settings(max_examples=30, deadline=None)
def test_fields_no_steeper_than_the_margin_are_never_misjudged_above_the_finest_step(seed: int, share: float) -> None:
    """Every point settled at a distance of more than a cell has the sign that asking gives."""
    rng = np.random.default_rng(seed)
    region, ask = Region.around(cuboid(rng), 0.02), cones(rng, share * LIPSCHITZ)
    sparse, dense = ask_sparsely(ask, region), ask_densely(ask, region)
    wrong = sparse.negative != dense.negative
    # The finest step settles from two sides: it may overlook a tip within a cell, and nothing larger.
    assert wrong.sum() <= 0.001 * region.inside.sum()
    assert np.abs(dense.exact[wrong]).max(initial=0) < LIPSCHITZ * 0.02
    known = ~np.isnan(sparse.exact)
    np.testing.assert_array_equal(sparse.exact[known], dense.exact[known])
    assert sparse.asked == known.sum() <= dense.asked


def bumpy(slope: float) -> Analytic:
    """A ball with waves, of any slope."""
    return Analytic(lambda points: slope * (sphere_sdf(points, 0.55) + 0.02 * np.sin(20 * points[:, 1])))


@pytest.mark.parametrize("slope", [0.7, 1.0, 6.0])
def test_asking_sparsely_gives_the_surface_of_asking_everywhere(slope: float) -> None:
    """Also for a network much steeper than a distance: the surface is followed."""
    cage = Cage.of(
        {
            "body": Cuboid(np.array([0, -0.1, 0]), np.eye(3), np.array([1.2, 1.3, 1.1])),
            "neck": Cuboid(np.array([0, 0.6, 0]), np.eye(3), np.array([0.5, 0.6, 0.5])),
        }
    )
    field = CageField(bumpy(slope), torch.zeros(4), cage, outside_union)
    parts = {name: [part_of(field, k, 0.02, method) for k in range(2)] for name, method in METHODS.items()}
    joined = {name: Joined(field, some, 0.02) for name, some in parts.items()}
    asked = {name: sum(p.answers.asked for p in some) + joined[name].asked for name, some in parts.items()}
    np.testing.assert_array_equal(joined["sparse"].negative, joined["dense"].negative)
    ends = ~np.isnan(joined["dense"].values)
    np.testing.assert_array_equal(joined["sparse"].values[ends], joined["dense"].values[ends])
    assert asked["sparse"] < asked["dense"] / 2.5
    assert asked["dense"] == sum(int(part.region.inside.sum()) for part in parts["dense"])


def test_the_network_is_asked_only_in_cuboids_and_once_a_point() -> None:
    rng = np.random.default_rng(3)
    item, seen = cuboid(rng), []
    region, cone = Region.around(item, 0.011), cones(rng, 1.0)

    def ask(points: np.ndarray) -> np.ndarray:
        seen.append(points)
        return cone(points)

    answers = ask_sparsely(ask, region)
    points = np.concatenate(seen)
    assert Cage.of({"a": item}).signed_distance(points).max() < 1e-6
    assert answers.asked == len(points) == len(np.unique(np.rint(points / 0.011), axis=0))


def test_the_first_points_are_as_far_apart_as_a_value_can_settle() -> None:
    assert [first_stride(cell) for cell in (0.2, 0.02, 0.0082, 0.0041)] == [1, 2, 8, 16]
