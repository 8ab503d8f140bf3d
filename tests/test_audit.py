"""Rays vote as closed forms say, and a shape unlike the others stands out."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.audit import FEWEST, LINES, LOST, OUTLYING, audit, flags, vote, with_outliers
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.geometry.solid import union
from cagesdf.shape import Audit, Shape
from tests.support import toy

BALL = toy.ball([0, 0, 0], 0.5, 64)
POINTS = np.random.default_rng(0).uniform(-1, 1, (500, 3))
INSIDE = np.linalg.norm(POINTS, axis=1) < 0.49
CLEAR = INSIDE | (np.linalg.norm(POINTS, axis=1) > 0.5)


def flipped(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces[:, ::-1]))


def votes_slowly(mesh: Mesh, points: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Share of the rays that leave each point through an odd number of faces, solved one by one."""
    share = np.zeros(len(points))
    for i, point in enumerate(points):
        for ray in np.concatenate([lines, -lines]):
            crossed = 0
            for a, b, c in mesh.corners():
                u, v, t = np.linalg.solve(np.stack([b - a, c - a, -ray], axis=1), point - a)
                crossed += u > 0 and v > 0 and u + v < 1 and t > 0
            share[i] += crossed % 2
    return share / (2 * len(lines))


def test_votes_are_those_of_rays_traced_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = toy.ball([0.1, 0, 0], 0.6, 8)
    opened = Mesh(mesh.vertices, mesh.faces[5:])
    lines = np.random.default_rng(1).normal(size=(LINES, 3))
    monkeypatch.setattr("cagesdf.audit._spread", lambda count: (lines + 1) / 2)
    share = votes_slowly(opened, POINTS[:60], lines)
    wanted = np.where(share >= 0.75, 1, np.where(share <= 0.25, -1, 0))
    np.testing.assert_array_equal(vote(opened, POINTS[:60]), wanted)
    assert {-1, 1} <= set(wanted.tolist())


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_orientation_does_not_matter(seed: int) -> None:
    turned = np.random.default_rng(seed).random(len(BALL.faces)) < 0.5
    mesh = Mesh(BALL.vertices, np.where(turned[:, None], BALL.faces[:, ::-1], BALL.faces).astype(np.int32))
    np.testing.assert_array_equal(vote(mesh, POINTS[CLEAR]), np.where(INSIDE[CLEAR], 1, -1))


def test_overlapping_components_count_each_for_itself_and_a_cavity_is_not_clear() -> None:
    apart = join([BALL, toy.ball([0.4, 0, 0], 0.5, 64)])
    both = np.array([[0.2, 0.0, 0.01]])
    assert vote(apart, both)[0] == 0
    assert vote(apart, np.array([[-0.3, 0.0, 0.01]]))[0] == 1
    assert vote(join([BALL, flipped(toy.ball([0, 0, 0], 0.3))]), np.array([[0.01, 0.02, 0.0]]))[0] == 0


def test_a_wrong_sign_is_found() -> None:
    """A surface that lacks one of two parts, or has it too much, is on the other side at the points there."""
    parts = [BALL, toy.box([1, 0, 0], [0.5, 0.5, 0.5])]
    right = audit(parts, union(parts), 1e-5)
    assert (right.differ, right.clear > 400) == (0, True)
    assert right.inside == pytest.approx((4 / 3 * np.pi * 0.125 + 0.125) / (1.75 * 1 * 1), rel=0.01)
    assert audit(parts, parts[0], 1e-5).differ > 0.3 * right.clear
    assert audit(parts[:1], union(parts), 1e-5).differ == 0, "nothing is asked where no part is"


def test_there_is_no_audit_where_counting_would_take_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cagesdf.audit.MAX_PAIRS", 10)
    assert audit([BALL], BALL, 1e-5).clear == 0


def filled(share: float) -> Shape:
    return replace(toy.stool("stool"), audit=Audit(100, 0, share))


def test_a_shape_that_fills_its_box_unlike_the_others_is_told() -> None:
    shares = np.exp(np.random.default_rng(0).normal(-2, 0.3, 30))
    shapes = with_outliers([filled(share) for share in [*shares, 1e-4, 0.13]])
    assert [shape.audit.outlier < -OUTLYING for shape in shapes] == [*[False] * 30, True, False]
    assert [bool(flags(shape)) for shape in shapes] == [*[False] * 30, True, False]
    assert "less than others" in flags(shapes[30])[0]
    few = [filled(0.1)] * (FEWEST - 1)
    assert with_outliers(few) == few
    assert all(shape.audit.outlier == 0 for shape in with_outliers([filled(0.1)] * FEWEST))


@pytest.mark.parametrize("lost", [0.0, LOST, LOST + 1e-4, 0.9])
def test_a_part_that_lost_more_than_half_a_percent_of_its_surface_is_told_with_its_name_and_the_share(
    lost: float,
) -> None:
    shape = toy.stool("stool")
    part = replace(shape.parts[1], repair=replace(shape.parts[1].repair, lost=lost))
    told = [f"part {part.part_id} lost {lost:.2%} of its surface"] if lost > LOST else []
    assert flags(replace(shape, parts=(shape.parts[0], part, *shape.parts[2:]))) == told
