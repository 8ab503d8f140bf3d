"""Operations of the hand put cuboids where the hand put them."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage
from cagesdf.editing.document import Document
from cagesdf.editing.parts import part_names
from cagesdf.editing.script import Operation
from cagesdf.editing.session import Session
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.viewing.angles import AXES, angles_of
from cagesdf.viewing.hand import Hand, decimals_of, gizmo_frame, on_top
from tests.support.mixed import stool, with_shapes
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
    held = hand(*SESSION.opened("a").cage.part_ids[:2])
    for wrong in (lambda: [*held.resized((1.0, 1.0, 1.0))], lambda: [*held.turned((0.0, 0.0, 1.0))], held.row):
        with pytest.raises(InputError, match="wanted one cuboid selected, not 2"):
            wrong()


def test_numbers_that_were_not_typed_stay_as_they_are_to_the_last_bit() -> None:
    before = hand(PART).state
    moved = after([hand(PART).placed((None, 0.25, None))])
    raw = before.similarity.to_raw(np.stack([before.cage[PART].centre, moved.cage[PART].centre]))
    np.testing.assert_allclose(raw[1], [raw[0, 0], 0.25, raw[0, 2]], atol=1e-12)
    [sized] = hand(PART).resized((None, None, 0.4))
    assert sized.axis == "z"
    turned = after(hand(PART).turned((None, 10.0, None)))
    was = angles_of(before, before.cage[PART])
    np.testing.assert_allclose(angles_of(turned, turned.cage[PART]), [was[0], 10, was[2]], atol=1e-6)


def test_several_parts_are_moved_by_the_middle_of_their_box() -> None:
    parts = SESSION.opened("a").cage.part_ids[:2]
    held = hand(*parts)
    centre, _ = gizmo_frame(held.state, parts)
    assert centre is not None
    raw = held.state.similarity.to_raw(centre[None])[0]
    state = after([held.placed((None, raw[1] + 0.1, None))])
    moved, _ = gizmo_frame(state, parts)
    assert moved is not None
    np.testing.assert_allclose(held.state.similarity.to_raw(moved[None])[0], raw + np.array([0, 0.1, 0]), atol=1e-9)


@given(st.integers(2, 6), st.floats(0.12, 0.3), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.integers(0, 5))
@settings(max_examples=20)
def test_one_more_in_a_row_leaves_its_ends_and_evens_what_is_between(
    count: int, apart: float, lean: float, first: float, which: int
) -> None:
    """Also where the row leans, and stood unevenly."""
    uneven = np.linspace(0, 1, count) ** 1.2
    spots = first + apart * count * uneven
    legs = {f"leg_{i}": float(x) for i, x in enumerate(spots)}
    structure = stool(legs)
    cuboids = {
        name: replace(cuboid, centre=cuboid.centre + np.array([0, 0, lean * cuboid.centre[0]]))
        if name in legs
        else cuboid
        for name, cuboid in structure.cage().cuboids().items()
    }
    session = with_shapes(SESSION, row=structure.with_cuboids(cuboids))
    state = session.opened("row")
    held = hand(f"leg_{min(which, count - 1)}", state=state)
    assert held.row() == list(legs) or held.row() == list(legs)[::-1]
    after_all = Document.opened("row", state).continued(tuple(held.one_more()), session.styles).state
    labels = after_all.structure.labels()
    centres = np.array([after_all.cage[part].centre for part in after_all.cage.part_ids if labels[part] == "leg"])
    centres = centres[np.argsort(centres[:, 0])]
    start, end = state.cage["leg_0"].centre, state.cage[f"leg_{count - 1}"].centre
    np.testing.assert_allclose(centres, np.linspace(start, end, count + 1), atol=1e-9)
    np.testing.assert_array_equal(after_all.cage["top"].centre, state.cage["top"].centre)


def test_a_row_without_room_or_that_is_none_is_refused() -> None:
    session = with_shapes(
        SESSION, tight=stool({"p": -0.1, "q": 0.05, "r": 0.17}), alone=stool({"p": 0.0}),
        corner=stool({"p": -0.4, "q": 0.0, "r": 0.4}),
    )  # fmt: skip
    with pytest.raises(InputError, match=r"no room in the row: 4 would stand 0\.09 apart, 0\.1 thick"):
        hand("p", state=session.opened("tight")).one_more()
    with pytest.raises(InputError, match="no other part repeats it"):
        hand("p", state=session.opened("alone")).one_more()
    corner = session.opened("corner")
    cuboids = corner.cage.cuboids()
    bent = corner.with_cage(Cage.of(cuboids | {"q": replace(cuboids["q"], centre=np.array([0.0, -0.4, 0.2]))}))
    with pytest.raises(InputError, match="don't stand in a row"):
        hand("p", state=bent).one_more()


def test_decimals_follow_the_size_of_the_shape() -> None:
    state = SESSION.opened("a")
    for unit, decimals in ((1.0, 4), (1000.0, 1), (1e-3, 7), (1e20, -16), (1e-20, 24)):
        scaled = replace(state, similarity=replace(state.similarity, scale=state.similarity.scale / unit))
        assert abs(decimals_of(scaled) - decimals) <= 1
