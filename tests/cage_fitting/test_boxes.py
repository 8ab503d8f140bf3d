"""Minimum-volume cuboids: bounding, small, and named alike on similar parts."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from cagesdf.cage_fitting.boxes import UPRIGHT, _Hull, fit_cuboid, nearest_frames, straight_cuboid
from cagesdf.cuboid import CORNER_ORDER, Cage, Cuboid
from tests.support import toy

SEEDS = st.integers(0, 2**32 - 1)
FLOOR = 1e-3
ROTATIONS = Rotation.random(100, rng=np.random.default_rng(5)).as_matrix()


def fit(points: np.ndarray, slack: float = 0.01) -> Cuboid:
    return fit_cuboid(points, slack, FLOOR)


def overshoot(points: np.ndarray, cuboid: Cuboid) -> float:
    return float(Cage.of({"it": cuboid}).signed_distance(points).max())


def volumes(points: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """The obvious way: turn the points, take the extents."""
    return np.maximum(np.ptp(frames @ points.T, axis=2), FLOOR).prod(axis=1)


def lathe(rng: np.random.Generator) -> np.ndarray:
    height = np.linspace(-0.5, 0.5, 20)[:, None]
    radius = 0.05 + 0.02 * np.sin(rng.uniform(5, 15) * height)
    angle = np.arange(32) / 32 * 2 * np.pi
    return np.stack([radius * np.cos(angle), height + 0 * angle, radius * np.sin(angle)], axis=-1).reshape(-1, 3)


def test_a_posed_box_returns_its_size_from_a_hundred_rotations() -> None:
    size = np.array([0.2, 0.5, 0.9])
    for rotation in ROTATIONS:
        cuboid = fit_cuboid(CORNER_ORDER * size @ rotation + [0.3, -0.2, 0.1], 0.0, FLOOR)
        np.testing.assert_allclose(np.sort(cuboid.size), size, atol=1e-9)
        np.testing.assert_allclose(cuboid.centre, [0.3, -0.2, 0.1], atol=1e-9)


@pytest.mark.parametrize(
    ("size", "wanted"),
    [
        ([0.4, 0.0, 0.9], [FLOOR, 0.4, 0.9]),
        ([0.4, 1e-8, 0.9], [FLOOR, 0.4, 0.9]),
        ([0.4, 1e-4, 0.9], [FLOOR, 0.4, 0.9]),
        ([0.0, 0.0, 0.9], [FLOOR, FLOOR, 0.9]),
        ([1e-9, 1e-5, 0.9], [FLOOR, FLOOR, 0.9]),
        ([0.0, 0.0, 0.0], [FLOOR, FLOOR, FLOOR]),
    ],
)
def test_flat_and_needle_parts_have_their_size_in_every_pose(size: list[float], wanted: list[float]) -> None:
    for rotation in ROTATIONS[:30]:
        points = CORNER_ORDER * size @ rotation + 0.1
        cuboid = fit(points)
        np.testing.assert_allclose(np.sort(cuboid.size), wanted, rtol=0.02, atol=1e-8)
        assert overshoot(points, cuboid) <= 0


@given(SEEDS, st.integers(1, 30), st.integers(0, 3))
def test_the_cuboid_bounds_its_points_whatever_they_are(seed: int, count: int, flat: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * np.where(np.arange(3) < flat, 0, rng.uniform(0.01, 1, 3))
    points = points @ Rotation.random(rng=rng).as_matrix() + rng.normal(size=3)
    cuboid = fit(points)
    assert overshoot(points, cuboid) <= 0
    assert np.linalg.det(cuboid.axes) == pytest.approx(1)
    np.testing.assert_allclose(cuboid.axes @ cuboid.axes.T, np.eye(3), atol=1e-9)
    assert (cuboid.size >= FLOOR).all()


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_no_rotation_found_by_brute_force_beats_the_volume_by_more_than_the_slack(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(rng.integers(4, 40), 3)) * rng.uniform(0.1, 1, 3)
    frames = Rotation.random(2000, rng=rng).as_matrix()
    start = frames[volumes(points, frames).argmin()]
    simplex = np.vstack([np.zeros(3), 0.2 * np.eye(3)])
    best = minimize(
        lambda turn: volumes(points, (Rotation.from_rotvec(turn).as_matrix() @ start)[None])[0],
        np.zeros(3),
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxiter": 200},
    ).fun
    # The search itself may miss the last half per cent of the least volume.
    assert fit(points).size.prod() <= 1.015 * best


def test_a_regular_tetrahedron_gets_the_cube_that_no_face_of_it_touches() -> None:
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 2
    for rotation in ROTATIONS[:20]:
        assert fit(corners @ rotation).size.prod() == pytest.approx(1, rel=1e-6)


@given(SEEDS, st.floats(-1, 1))
def test_moving_mirroring_and_repeating_points_changes_nothing(seed: int, by: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(20, 3)) * [0.2, 0.4, 0.9]
    cuboid = fit(points)
    moved = fit(np.concatenate([points, points[:7]])[rng.permutation(27)] + by)
    np.testing.assert_allclose(moved.centre, cuboid.centre + by, atol=1e-9)
    np.testing.assert_allclose(moved.size, cuboid.size, atol=1e-9)
    np.testing.assert_allclose(fit(-points).size, cuboid.size, atol=1e-9)


def test_points_inside_the_hull_do_not_matter() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(30, 3))
    inner = points.mean(axis=0) + 0.5 * (points - points.mean(axis=0))
    np.testing.assert_allclose(fit(np.concatenate([points, inner])).axes, fit(points).axes, atol=1e-9)


@pytest.mark.parametrize("kind", ["box", "ball", "lathe", "square bar"])
def test_slightly_leaning_parts_keep_the_canonical_axes_apart(kind: str) -> None:
    """Their largest side, or any square or round section, must not decide which axis is x."""
    rng = np.random.default_rng(1)
    shapes = {
        "box": CORNER_ORDER * [0.5, 0.49, 0.51],
        "ball": toy.ball([0, 0, 0], 0.3, 48).vertices,
        "lathe": lathe(rng),
        "square bar": CORNER_ORDER * [0.1, 0.8, 0.1],
    }
    for rotation in Rotation.from_rotvec(rng.uniform(-0.2, 0.2, (20, 3))).as_matrix():
        turn = Rotation.from_matrix(fit(shapes[kind] @ rotation).axes).magnitude()
        assert turn <= Rotation.from_matrix(rotation).magnitude() + 1e-6


def test_a_box_within_the_slack_that_lies_straighter_is_taken() -> None:
    points = CORNER_ORDER * [0.5, 0.6, 0.7] @ Rotation.from_euler("y", 0.002).as_matrix()
    np.testing.assert_allclose(fit(points, slack=0.01).axes, np.eye(3), atol=1e-12)
    assert np.abs(fit(points, slack=0.0).axes - np.eye(3)).max() == pytest.approx(0.002, rel=0.01)


def test_a_leaning_round_leg_does_not_turn_about_itself() -> None:
    tilt = Rotation.from_euler("x", 0.15).as_matrix()
    cuboid = fit(lathe(np.random.default_rng(2)) @ tilt.T)
    np.testing.assert_allclose(cuboid.axes, tilt.T, atol=1e-6)


@given(SEEDS)
def test_of_all_frames_along_a_direction_the_nearest_is_found(seed: int) -> None:
    directions = np.random.default_rng(seed).normal(size=(3, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    direction, frame = directions[1], nearest_frames(directions)[1]
    assert np.linalg.det(frame) == pytest.approx(1)
    assert np.abs(frame @ direction).max() == pytest.approx(1)
    turns = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, 200)[:, None] * direction).as_matrix()
    others = Cage(tuple(map(str, range(200))), np.zeros((200, 3)), frame @ turns, np.ones((200, 3)))
    assert np.trace(frame) >= max(np.trace(c.nearest_to(np.eye(3)).axes) for c in others.cuboids().values()) - 1e-9


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_boxes_along_outlines_are_those_that_all_points_give_edge_by_edge(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(15, 3)) * rng.uniform(0.1, 1, 3)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    shadow = points @ (np.eye(3) - np.outer(normal, normal))
    wanted = []
    for i, j in itertools.combinations(range(len(points)), 2):
        along = (shadow[j] - shadow[i]) / np.linalg.norm(shadow[j] - shadow[i])
        frame = np.array([normal, along, np.cross(normal, along)])
        height = (points - points[i]) @ frame[2]
        if height.min() > -1e-9 or height.max() < 1e-9:  # an edge of the shadow
            wanted.append(np.ptp(points @ frame.T, axis=0).prod())
    normals = np.array([ROTATIONS[0, 0], normal])
    boxes = _Hull.of(points, FLOOR).boxes_on(normals, np.inf)
    own = (boxes.axes[:, 0] == normal).all(axis=1)
    np.testing.assert_allclose(np.sort(boxes.volume[own]), np.sort(wanted), rtol=1e-9)
    limit = float(np.median(boxes.volume))
    below = _Hull.of(points, FLOOR).boxes_on(normals, limit)
    np.testing.assert_array_equal(below.volume, boxes.volume[boxes.volume <= limit])
    np.testing.assert_allclose(np.linalg.det(below.axes), 1)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((4, 3), np.nan)])
def test_no_points_or_nan_are_refused(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="needs finite points"):
        fit(points)


def test_a_round_part_of_thousands_of_facets_is_bounded_nearly_as_tightly_as_can_be() -> None:
    """More facets than planes are tried: near ones stand for each other."""
    points = np.random.default_rng(0).normal(size=(2000, 3))
    points = points / np.linalg.norm(points, axis=1, keepdims=True) * [1.0, 0.8, 0.4] @ ROTATIONS[0]
    cuboid = fit(points)
    assert overshoot(points, cuboid) <= 0
    assert cuboid.size.prod() < 1.01 * 8 * 1.0 * 0.8 * 0.4


def test_a_round_body_stands_upright_though_its_least_box_lies_askew_and_a_board_that_leans_leans() -> None:
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 48, endpoint=False), np.linspace(-1, 1, 65))
    radius = (1 - np.abs(height) ** 1.9) ** (1 / 1.9)
    body = np.stack([radius * np.cos(angle), height, 0.8 * radius * np.sin(angle)], axis=-1).reshape(-1, 3)
    assert np.abs(fit(body).axes - np.eye(3)).max() > 0.2
    upright = straight_cuboid(body, 0.01, FLOOR)
    np.testing.assert_array_equal(upright.axes, np.eye(3))
    np.testing.assert_allclose(upright.size, [2, 2, 1.6], atol=1e-9)
    board = CORNER_ORDER * [0.5, 0.4, 0.03] @ Rotation.from_rotvec([0.05, 0, 0]).as_matrix()
    np.testing.assert_allclose(straight_cuboid(board, 0.01, FLOOR).size, [0.5, 0.4, 0.03], atol=1e-6)


@given(seed=st.integers(0, 20_000))
@settings(max_examples=20, deadline=None)
def test_a_straight_cuboid_bounds_its_points_and_is_hardly_larger_than_the_least(seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(30, 3))
    straight = straight_cuboid(points, 0.01, FLOOR)
    local = (points - straight.centre) @ straight.axes.T
    assert (np.abs(local) <= straight.size / 2 + 1e-9).all()
    assert straight.size.prod() <= (1 + UPRIGHT) * fit(points).size.prod()
