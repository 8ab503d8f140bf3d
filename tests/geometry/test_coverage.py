"""The area that a solid leaves out of a surface is what dense points say, and exactly so where it is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.geometry import coverage
from cagesdf.geometry.coverage import REACH, lost_areas
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, face_areas, join, sample_surface
from cagesdf.geometry.solid import union
from tests.support import toy

BOX = toy.box([0, 0, 0], [1, 0.5, 0.5])
SQUARE = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [1, 0.2, 0], [0, 0.2, 0]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def lost(mesh: Mesh, solid: Mesh) -> float:
    return float(lost_areas(mesh, solid, REACH).sum() / face_areas(mesh).sum())


def soup(count: int, rng: np.random.Generator) -> Mesh:
    corners = rng.uniform(-0.6, 0.6, (count, 1, 3)) + rng.normal(0, 0.2, (count, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3))


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_it_is_the_share_of_dense_points_that_are_outside_and_far(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = soup(int(rng.integers(1, 20)), rng)
    points, _ = sample_surface(mesh, 20_000, rng)
    assert lost(mesh, BOX) == pytest.approx((SurfaceDistance(BOX).signed(points) > REACH).mean(), abs=0.015)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-0.2, 0.8))
def test_of_a_sheet_that_leaves_a_box_the_part_outside_is_lost_in_any_pose(seed: int, place: float) -> None:
    turn = Rotation.random(random_state=seed).as_matrix()
    sheet = SQUARE.with_vertices((SQUARE.vertices + np.array([place, 0, 0])) @ turn.T)
    outside = np.clip(0.5 + place - REACH, 0, 1) if place > -0.5 else 0
    assert lost(sheet, BOX.with_vertices(BOX.vertices @ turn.T)) == pytest.approx(outside, abs=0.01)


@pytest.mark.parametrize("height", [0, REACH - 1e-6, -REACH, -0.2])
def test_a_sheet_on_a_box_just_above_it_or_in_it_is_not_lost_at_all(height: float) -> None:
    sheet = SQUARE.with_vertices(SQUARE.vertices * [0.9, 1, 1] + [-0.45, 0, 0.25 + height])
    assert lost(sheet, BOX) == 0


def test_a_sheet_above_a_box_is_lost_whole() -> None:
    assert lost(SQUARE.with_vertices(SQUARE.vertices - [0.5, 0.1, -0.25 - REACH - 1e-6]), BOX) == pytest.approx(1)


def test_faces_of_overlapping_solids_that_their_union_removes_are_not_lost() -> None:
    other = toy.ball([0.4, 0.1, 0], 0.3)
    assert lost(join([BOX, other]), union([BOX, other])) == 0


@pytest.mark.parametrize("gap", [0.1, 0.03, 0.01])
def test_a_strip_of_a_large_face_between_two_boxes_is_lost(gap: float) -> None:
    """Corners of the face lie on the boxes."""
    boxes = join([toy.box([side * (0.15 + gap / 2), 0, 0], [0.3, 0.5, 0.5]) for side in (-1, 1)])
    sheet = SQUARE.with_vertices(SQUARE.vertices * [0.6, 1, 1] + [-0.3, 0, 0.25])
    assert lost(sheet, boxes) == pytest.approx((gap - 2 * REACH) / 0.6, abs=0.004)


def test_faces_that_the_solid_has_cost_no_distance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(coverage, "SurfaceDistance", lambda mesh: None)
    order = np.random.default_rng(0).permutation(len(BOX.faces))
    turned = Mesh(BOX.vertices, np.ascontiguousarray(BOX.faces[order][:, ::-1]))
    assert lost(turned, BOX) == 0


def test_the_number_of_distances_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    closest = SurfaceDistance.closest
    monkeypatch.setattr(coverage, "MAX_CELLS", 1000)

    def counted(surface: SurfaceDistance, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        asked.append(len(points))
        return closest(surface, points)

    monkeypatch.setattr(SurfaceDistance, "closest", counted)
    assert 0 < lost(soup(50, np.random.default_rng(0)), BOX) < 1
    assert sum(asked) <= 3000
