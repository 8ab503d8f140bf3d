"""What stands and what falls, on cages made by hand, and how far cuboids are apart."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation as Turn

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.shape_generation.static_stability import NEAR, distances, rooted, stable


def box(x: float, y: float, z: float, width: float, height: float, depth: float) -> Cuboid:
    """An upright one; x, y, z are the middle of its bottom."""
    return Cuboid(np.array([x, y + height / 2, z]), np.eye(3), np.array([width, height, depth], float))


def table(
    height: float = 0.8, lift: float = 0.0, legs: tuple[tuple[float, float], ...] = ((-1, -1), (-1, 1), (1, -1), (1, 1))
) -> Cage:
    """A top of 1 by 1 on legs below its corners, or below such shares of them; `lift` is a gap below the top."""
    top = {"top": box(0, height + lift, 0, 1, 0.1, 1)}
    return Cage.of(top | {f"leg{i}": box(0.45 * x, 0, 0.45 * z, 0.1, height, 0.1) for i, (x, z) in enumerate(legs)})


def moved(cage: Cage, turn: Turn, way: tuple[float, float, float]) -> Cage:
    return Cage(cage.part_ids, turn.apply(cage.centre) + way, cage.axes @ turn.as_matrix().T, cage.size)


def test_a_table_is_rooted_and_stable_wherever_it_stands_and_however_it_is_turned_about_its_axis() -> None:
    for angle, height in ((0.0, 0.0), (0.7, 5.0), (2.0, -3.0)):
        cage = moved(table(), Turn.from_rotvec([0, angle, 0]), (1.0, height, 2.0))
        assert rooted(cage)
        assert stable(cage)


def test_a_top_that_floats_is_not_rooted_beyond_two_per_cent_of_the_size() -> None:
    size = float(np.linalg.norm([1, 0.9, 1]))
    assert rooted(table(lift=0.9 * NEAR * size))
    floating = table(lift=1.2 * NEAR * size)
    assert not rooted(floating)
    assert not stable(floating), "what floats falls"


def test_a_part_in_the_air_beside_what_stands_is_not_rooted() -> None:
    cage = Cage.of({**table().cuboids(), "lamp": box(0, 1.5, 0, 0.1, 0.1, 0.1)})
    assert not rooted(cage)


def test_a_table_on_its_legs_of_one_side_falls_over() -> None:
    cage = table(legs=((1, -1), (1, 1)))
    assert rooted(cage)
    assert not stable(cage)


def test_three_legs_hold_where_the_centre_of_mass_is_between_them_and_two_opposite_ones_do_by_their_width() -> None:
    assert stable(table(legs=((-1, -1), (1, -1), (0, 1))))
    assert not stable(table(legs=((-1, -1), (1, -1), (0, -0.7))))
    assert stable(table(legs=((-1, -1), (1, 1))))


def test_a_heavy_part_beside_the_feet_tips_the_whole() -> None:
    beam = {"foot": box(0, 0, 0, 0.4, 0.1, 0.4), "beam": box(0.6, 0.1, 0, 1.6, 0.1, 0.4)}
    assert not stable(Cage.of(beam))
    assert stable(Cage.of({**beam, "weight": box(-0.1, 0.2, 0, 0.2, 2.0, 0.4), "more": box(-0.15, 0, 0, 0.1, 2, 1)}))


def test_what_does_not_hang_together_stands_by_itself() -> None:
    fallen = box(3, 0, 0, 0.1, 1, 0.1)
    both = {**table().cuboids(), "post": fallen}
    assert stable(Cage.of(both))
    tilted = Cuboid(np.array([3.0, 0.5, 0.0]), Turn.from_rotvec([0, 0, 0.5]).as_matrix().T, np.array([0.1, 1.1, 0.1]))
    lying = {**table().cuboids(), "post": tilted}
    assert rooted(Cage.of(lying))
    assert not stable(Cage.of(lying))


def slow_distance(a: Cuboid, b: Cuboid) -> float:
    """The least distance of two points, one in each, by bounded optimisation: it is convex."""

    def between(places: np.ndarray) -> tuple[float, np.ndarray]:
        u, v = places[:3], places[3:]
        gap = a.centre + (u * a.size) @ a.axes - b.centre - (v * b.size) @ b.axes
        return gap @ gap, 2 * np.concatenate([a.size * (a.axes @ gap), -b.size * (b.axes @ gap)])

    found = minimize(between, np.zeros(6), jac=True, bounds=[(-0.5, 0.5)] * 6, tol=1e-16)
    return float(np.sqrt(found.fun))


@given(st.integers(0, 2**32 - 1))
def test_distances_are_those_of_the_nearest_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axes = Turn.random(2, rng=rng).as_matrix()
    a, b = (Cuboid(rng.uniform(-1, 1, 3), axes[i], rng.uniform(0.05, 0.8, 3)) for i in range(2))
    found = distances(Cage.of({"a": a, "b": b}), np.inf)
    assert found[0, 1] == found[1, 0]
    assert found[0, 0] == 0
    assert found[0, 1] == pytest.approx(slow_distance(a, b), abs=1e-4)


def test_crossed_edges_are_nearer_than_any_corner() -> None:
    ridge = Turn.from_euler("z", 45, degrees=True).as_matrix().T
    edge = np.sqrt(0.5)
    lower = Cuboid(np.zeros(3), ridge, np.array([1.0, 1.0, 4.0]))
    across = Turn.from_euler("y", 90, degrees=True).as_matrix().T
    upper = Cuboid(np.array([0, 2 * edge + 0.3, 0]), ridge @ across, np.array([1.0, 1.0, 4.0]))
    assert distances(Cage.of({"a": lower, "b": upper}), 1.0)[0, 1] == pytest.approx(0.3)


def test_beyond_the_limit_distances_are_still_no_less_than_it() -> None:
    cage = Cage.of({"a": box(0, 0, 0, 1, 1, 1), "b": box(2, 2, 2, 1, 1, 1)})
    assert distances(cage, 0.5)[0, 1] > 0.5
    assert distances(cage, np.inf)[0, 1] == pytest.approx(np.sqrt(3))
