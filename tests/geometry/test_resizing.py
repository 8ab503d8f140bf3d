"""Details that keep their size: laws of the warp, and slow versions beside its closed form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold
from scipy.optimize import minimize

from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, is_closed, join
from cagesdf.geometry.resizing import (
    BINS,
    LEAST,
    RAYS,
    SOFTEST,
    AxisWarp,
    chords,
    keeping_warp,
    stretches,
    vulnerability,
)
from cagesdf.geometry.solid import from_manifold, union
from tests.support import toy

SEEDS = st.integers(0, 2**32 - 1)
FACTORS = st.floats(0.2, 4)
EVEN = np.linspace(-0.5, 0.5, BINS + 1)


def in_unit(mesh: Mesh) -> tuple[Mesh, np.ndarray]:
    """A mesh in the unit frame of the upright box around it, and that box's lengths."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return mesh.with_vertices((mesh.vertices - (low + high) / 2) / (high - low)), high - low


def leg(block: float = 0.1) -> Mesh:
    """A slim square shaft, 1 high, with a block at its upper end."""
    return union([toy.box([0, 0.5, 0], [0.04, 1, 0.04]), toy.box([0, 1 - block / 2, 0], [0.1, block, 0.1])])


def lump(seed: int) -> Mesh:
    """A random closed part: a few boxes and balls, turned."""
    rng = np.random.default_rng(seed)
    solids = [Manifold.cube(rng.uniform(0.1, 1, 3).tolist(), True).translate(rng.uniform(-0.4, 0.4, 3).tolist())]
    solids += [Manifold.sphere(rng.uniform(0.1, 0.4), 16).translate(rng.uniform(-0.5, 0.5, 3).tolist())]
    return from_manifold(sum(solids[1:], solids[0]).rotate(rng.uniform(0, 90, 3).tolist()))


def warp_of(unit: Mesh, size: np.ndarray, moved: np.ndarray, detail: float = 1.0) -> AxisWarp:
    return keeping_warp(vulnerability(unit, size), size, moved, detail)


def slow_stretches(weights: np.ndarray, total: float) -> np.ndarray:
    """The minimum, searched for numerically."""
    stiffness, least = weights / weights.mean() + SOFTEST, min(LEAST, total)
    result = minimize(
        lambda s: stiffness @ (s - 1) ** 2,
        np.full(len(weights), total),
        jac=lambda s: 2 * stiffness * (s - 1),
        bounds=[(least, None)] * len(weights),
        constraints={"type": "eq", "fun": lambda s: s.mean() - total, "jac": lambda s: np.full(len(s), 1 / len(s))},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    return result.x


@given(SEEDS, st.floats(0.05, 5))
@settings(max_examples=40)
def test_the_closed_form_is_the_minimum_that_a_search_finds(seed: int, total: float) -> None:
    weights = np.random.default_rng(seed).exponential(size=10) ** 3
    np.testing.assert_allclose(stretches(weights, total), slow_stretches(weights, total), atol=2e-5)


@given(SEEDS, st.floats(1e-3, 100))
def test_factors_have_their_mean_and_their_bound_and_stiffer_bins_change_less(seed: int, total: float) -> None:
    weights = np.random.default_rng(seed).exponential(size=BINS) ** 4
    factors = stretches(weights, total)
    assert factors.mean() == pytest.approx(total, rel=1e-9)
    assert factors.min() >= min(LEAST, total)
    changes = np.abs(factors - 1)[np.argsort(weights)]
    assert (np.diff(changes) <= 1e-9).all()


def test_bins_that_weigh_nothing_stretch_evenly() -> None:
    np.testing.assert_array_equal(stretches(np.zeros(5), 2.0), np.full(5, 2.0))


@given(SEEDS, FACTORS, FACTORS, FACTORS)
@settings(max_examples=25, deadline=None)
def test_a_warp_is_monotone_and_keeps_the_ends_of_its_cuboid(seed: int, x: float, y: float, z: float) -> None:
    unit, size = in_unit(lump(seed))
    warp = warp_of(unit, size, size * [x, y, z])
    assert (np.diff(warp.knots, axis=1) > 0).all()
    np.testing.assert_array_equal(warp.knots[:, [0, -1]], [[-0.5, 0.5]] * 3)
    np.testing.assert_allclose(np.ptp(warp(unit.vertices), axis=0), 1, atol=1e-12)


@given(SEEDS, st.floats(0.2, 5))
@settings(max_examples=25, deadline=None)
def test_a_cuboid_that_grows_as_the_unit_does_moves_nothing(seed: int, detail: float) -> None:
    unit, size = in_unit(lump(seed))
    warp = warp_of(unit, size, size * detail, detail)
    np.testing.assert_allclose(warp(unit.vertices), unit.vertices, atol=1e-12)


@given(FACTORS, FACTORS, FACTORS)
@settings(max_examples=25, deadline=None)
def test_walls_and_caps_are_free_so_that_a_box_is_stretched_evenly(x: float, y: float, z: float) -> None:
    unit, size = in_unit(toy.box([0, 0, 0], [0.3, 1.2, 0.05]))
    np.testing.assert_allclose(warp_of(unit, size, size * [x, y, z]).knots, [EVEN] * 3, atol=1e-9)


@given(SEEDS, st.integers(0, 2), FACTORS)
@settings(max_examples=25, deadline=None)
def test_mirrored_parts_warp_as_mirror_images(seed: int, axis: int, factor: float) -> None:
    unit, size = in_unit(lump(seed))
    mirror = np.where(np.arange(3) == axis, -1.0, 1.0)
    mirrored = Mesh(unit.vertices * mirror, unit.faces[:, ::-1].copy())
    moved = size * [factor, 1 / factor, factor**2]
    ours, theirs = warp_of(unit, size, moved), warp_of(mirrored, size, moved)
    np.testing.assert_allclose(theirs(mirrored.vertices), ours(unit.vertices) * mirror, atol=1e-9)


@given(SEEDS, FACTORS, st.floats(0.1, 10))
@settings(max_examples=15, deadline=None)
def test_the_unit_of_lengths_does_not_matter(seed: int, factor: float, unit_length: float) -> None:
    unit, size = in_unit(lump(seed))
    moved = size * [factor, 1, 1 / factor]
    ours, theirs = (warp_of(unit, scale * size, scale * moved).knots for scale in (1.0, unit_length))
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_equal_parts_give_equal_bytes() -> None:
    unit, size = in_unit(lump(3))
    ours, theirs = (warp_of(unit, size, size * [2, 0.5, 1]).knots.tobytes() for _ in range(2))
    assert ours == theirs


@pytest.mark.parametrize("factor", [0.6, 1.5, 2.0])
def test_a_block_and_a_shaft_keep_their_size_where_an_even_stretch_would_change_them(factor: float) -> None:
    unit, size = in_unit(leg())
    moved = size * [factor, factor, factor]
    before, after = unit.vertices * size, warp_of(unit, size, moved)(unit.vertices) * moved
    lower_edge = np.isclose(before[:, 1], 0.4) & np.isclose(np.abs(before[:, 0]), 0.05)
    block = moved[1] / 2 - after[lower_edge, 1]
    shaft = 2 * np.abs(after[np.isclose(before[:, 1], -0.5), 0])
    assert np.abs(block - 0.1).max() < 0.25 * abs(factor - 1) * 0.1
    assert np.abs(shaft - 0.04).max() < 0.25 * abs(factor - 1) * 0.04


def test_beads_keep_their_length_beside_a_plain_shaft() -> None:
    balls = [toy.ball([0, y, 0], 0.05, 24) for y in (0.05, 0.13, 0.21)]
    unit, size = in_unit(union([*balls, toy.box([0, 0.6, 0], [0.06, 0.8, 0.06])]))
    warp = warp_of(unit, size, size * [1, 2, 1])
    low, high = warp(np.array([[0, -0.5, 0], [0, 0.2 - 0.5, 0]]))[:, 1] * 2
    assert high - low < 0.27  # evenly stretched: 0.4


def test_weights_of_a_stepped_block_are_the_areas_around_its_chords() -> None:
    unit, size = in_unit(leg(block=0.25))  # the block begins at a border of bins
    weights = vulnerability(unit, size) / (size.prod() / size)[:, None]
    cells = [np.abs((np.arange(count) + 0.5) / count - 0.5) < 0.2 for count in RAYS]
    shaft = np.outer(*cells).mean()
    # Along y the shaft's rays meet all bins, the others the upper quarter.
    np.testing.assert_allclose(weights[1, : BINS * 3 // 4], shaft / BINS, atol=1e-9)
    np.testing.assert_allclose(weights[1, BINS * 3 // 4 :], shaft / BINS + (1 - shaft) / (BINS / 4), atol=1e-9)
    assert weights[0].sum() == pytest.approx(0.25 + 0.75 * cells[1].mean(), abs=1e-9)


@given(SEEDS, st.integers(0, 2))
@settings(max_examples=15, deadline=None)
def test_chords_reach_from_the_first_to_the_last_point_inside_along_each_ray(seed: int, axis: int) -> None:
    """A slow way: signed distances of many points along each ray."""
    unit, _ = in_unit(lump(seed))
    depths = (np.arange(100) + 0.5) / 100 - 0.5
    lattice = [(np.arange(count) + 0.5) / count - 0.5 for count in RAYS]
    u, v, w = np.meshgrid(*lattice, depths, indexing="ij")
    points = np.empty((u.size, 3))
    first, second = (k for k in range(3) if k != axis)
    points[:, first], points[:, second], points[:, axis] = u.ravel(), v.ravel(), w.ravel()
    inside = (SurfaceDistance(unit).signed(points) < 0).reshape(u.shape)
    between = np.maximum.accumulate(inside, axis=2) & np.maximum.accumulate(inside[..., ::-1], axis=2)[..., ::-1]
    start, end = chords(unit, axis)
    assert (end > start).all()
    assert (end - start).sum() / (RAYS[0] * RAYS[1]) == pytest.approx(between.mean(), abs=0.01)


def test_a_gap_between_two_pieces_is_a_chord_as_they_are() -> None:
    unit, _ = in_unit(join([toy.box([-1, 0, 0], [1, 1, 1]), toy.box([1, 0, 0], [1, 1, 1])]))
    start, end = chords(unit, 0)
    assert len(start) == 3 * RAYS[0] * RAYS[1]
    np.testing.assert_allclose(end - start, 1 / 3)


def test_a_warp_moves_what_lies_outside_with_the_nearest_face() -> None:
    warp = AxisWarp(np.array([[-0.5, 0.3, 0.5]] * 3))
    np.testing.assert_allclose(warp(np.array([[0.7, -0.6, 0.0]])), [[0.7, -0.6, 0.3]])


def test_a_warped_part_stays_closed_and_keeps_its_volume_positive() -> None:
    unit, size = in_unit(lump(5))
    warped = unit.with_vertices(warp_of(unit, size, size * [0.3, 3, 1])(unit.vertices))
    assert is_closed(warped)
    assert union([warped]).faces.shape[0] > 0
