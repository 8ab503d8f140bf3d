"""Operations of the hand put cuboids where the hand put them."""

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.editing.document import Document
from cagesdf.editing.parts import part_names
from cagesdf.editing.script import Operation
from cagesdf.editing.session import Session
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.viewing.angles import AXES, angles_of
from cagesdf.viewing.hand import Hand, gizmo_frame, on_top
from tests.support.untrained import untrained

SESSION = untrained()
FOLLOWERS = {"mirror": False, "repeat": False, "attach": False, "details": "stretch"}
PART = "seat"


def hand(*parts: str, state: State | None = None) -> Hand:
    state = state or SESSION.opened("a")
    names = part_names(state.structure)
    return Hand(state, parts, "|".join(names[part] for part in parts), FOLLOWERS)


def after(operations: Iterable[Operation], session: Session = SESSION) -> State:
    return Document.opened("a", session.opened("a")).continued(tuple(operations), session.styles).state


@given(st.tuples(*[st.floats(-0.2, 0.2)] * 3))
@settings(max_examples=20)
def test_a_dragged_gizmo_brings_the_cuboid_where_it_is(way: tuple[float, float, float]) -> None:
    held = hand(PART)
    centre, axes = gizmo_frame(held.state, held.parts)
    assert centre is not None
    operation = held.dragged(centre + way, axes, snap=False)
    if operation is None:
        assert not np.any(way)
        return
    np.testing.assert_allclose(after([operation]).cage[PART].centre, centre + way, atol=1e-9)


@pytest.mark.parametrize("row", range(3))
@pytest.mark.parametrize("degrees", [-30.0, 10.0])
def test_a_turned_gizmo_turns_the_cuboid(row: int, degrees: float) -> None:
    held = hand(PART)
    centre, axes = gizmo_frame(held.state, held.parts)
    assert centre is not None
    turned = axes @ Rotation.from_rotvec(degrees * axes[row], degrees=True).as_matrix().T
    operation = held.dragged(centre, turned, snap=False)
    assert operation is not None
    cuboid = after([operation]).cage[PART]
    np.testing.assert_allclose(cuboid.axes, turned, atol=1e-9)
    np.testing.assert_allclose(cuboid.centre, centre, atol=1e-9)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [-1, 1])
def test_a_pulled_face_moves_and_the_face_across_stays(axis: int, side: int) -> None:
    before = hand(PART).state.cage[PART]
    cuboid = after([hand(PART).pulled(axis, side, 0.05)]).cage[PART]
    faces = {sign: cuboid.centre + sign * cuboid.size[axis] / 2 * cuboid.axes[axis] for sign in (-1, 1)}
    old = {sign: before.centre + sign * before.size[axis] / 2 * before.axes[axis] for sign in (-1, 1)}
    np.testing.assert_allclose(faces[side], old[side] + side * 0.05 * before.axes[axis], atol=1e-9)
    np.testing.assert_allclose(faces[-side], old[-side], atol=1e-9)


def test_numbers_that_are_typed_are_the_cuboid_s() -> None:
    held = hand(PART)
    similarity = held.state.similarity
    state = after([held.placed((0.1, 0.2, 0.3))])
    np.testing.assert_allclose(similarity.to_raw(state.cage[PART].centre[None])[0], [0.1, 0.2, 0.3], atol=1e-9)
    lengths = (0.5, 0.3, 0.7)
    sized = after(held.resized(lengths)).cage[PART]
    rows = [held.state.own_axis(axis)[0] for axis in AXES]
    np.testing.assert_allclose(sized.size[rows] / similarity.scale, lengths, rtol=1e-6)
    turned = after(held.turned((5.0, -12.0, 20.0)))
    np.testing.assert_allclose(angles_of(turned, turned.cage[PART]), [5, -12, 20], atol=1e-6)
    with pytest.raises(InputError, match="lengths are at least"):
        [*held.resized((0.0, 1.0, 1.0))]


def test_a_copy_stands_beside_and_halves_touch() -> None:
    before = hand(PART).state
    copied = after([hand(PART).duplicate()])
    [new] = set(copied.cage.part_ids) - set(before.cage.part_ids)
    boxes = {part: copied.cage.corners()[copied.cage.part_ids.index(part)] for part in (PART, new)}
    low, high = (np.array([extreme(box, axis=0) for box in boxes.values()]) for extreme in (np.min, np.max))
    assert (low.max(axis=0) > high.min(axis=0)).any(), "apart along an axis"
    halves = after([hand(PART).split()])
    [new] = set(halves.cage.part_ids) - set(before.cage.part_ids)
    whole, first, second = before.cage[PART], halves.cage[PART], halves.cage[new]
    assert first.size.prod() + second.size.prod() == pytest.approx(whole.size.prod())
    assert (first.size == whole.size).sum() == 2
    assert first.size[int(whole.size.argmax())] == pytest.approx(whole.size.max() / 2)


def test_a_new_part_stands_on_the_shape() -> None:
    before = SESSION.opened("a")
    state = after([on_top(before)])
    [new] = set(state.cage.part_ids) - set(before.cage.part_ids)
    new_box = state.cage.corners()[state.cage.part_ids.index(new)]
    assert new_box[:, 1].min() == pytest.approx(before.cage.corners()[..., 1].max())


def test_one_is_wanted_where_several_have_no_numbers() -> None:
    state = SESSION.opened("a")
    with pytest.raises(InputError, match="wanted one cuboid selected, not 2"):
        hand(*state.cage.part_ids[:2]).placed((0.0, 0.0, 0.0))
