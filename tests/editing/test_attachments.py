"""Contacts before an edit are contacts after it, and what isn't attached doesn't move."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.deformation.matching import CONTACT, gaps, touching
from cagesdf.editing.attachments import PLAY, attached
from cagesdf.editing.script import Move, Resize, Rotate
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from tests.support.attached import box, do, stool, vector


def opened(before: Cage, after: Cage) -> np.ndarray:
    """By how much contacts are more open than before, (p, p); none where there was no contact."""
    return np.where(touching(before), gaps(after) - np.maximum(gaps(before), 0), -np.inf)


def groups(cage: Cage, part: str) -> set[str]:
    """All parts that hang on to one."""
    found, touches = {part}, touching(cage)
    for _ in cage.part_ids:
        rows = np.isin(cage.part_ids, list(found))
        found |= {cage.part_ids[j] for j in np.flatnonzero(touches[rows].any(axis=0))}
    return found


PARTS = st.sampled_from(["leg_0", "leg_3", "seat", "back"])
OPERATIONS = st.one_of(
    st.builds(Move, part=PARTS, by=st.tuples(*[st.floats(-0.2, 0.2)] * 3)),
    st.builds(
        Resize,
        part=PARTS,
        axis=st.sampled_from("xyz"),
        factor=st.floats(0.6, 1.5),
        keep=st.sampled_from(["low", "centre", "high"]),
    ),
    st.builds(Rotate, part=PARTS, axis=st.sampled_from("xyz"), angle=st.floats(-30, 30)),
)
SWITCHES = st.fixed_dictionaries({"mirror": st.booleans(), "repeat": st.booleans()})


@settings(max_examples=25, deadline=None)
@given(OPERATIONS, SWITCHES)
def test_contacts_before_are_contacts_after_and_what_is_not_attached_stays_to_the_last_bit(
    operation: Move | Resize | Rotate, switches: dict[str, bool]
) -> None:
    before = stool()
    alone = do(before, operation.model_copy(update=switches))
    after = do(before, operation.model_copy(update={**switches, "attach": True}))
    told = {part for part in before.cage.part_ids if vector(alone, part) != vector(before, part)}
    both_told = np.outer(*[np.isin(before.cage.part_ids, list(told))] * 2)
    assert (opened(before.cage, after.cage)[~both_told] <= PLAY + 1e-12).all()
    assert all(vector(after, part) == vector(alone, part) for part in told)
    assert vector(after, "lamp") == vector(before, "lamp")


boxes = st.builds(
    box,
    st.tuples(*[st.floats(-0.5, 0.5)] * 3),
    st.tuples(*[st.floats(0.05, 0.5)] * 3),
    st.floats(-40, 40),
)


@settings(max_examples=25, deadline=None)
@given(st.lists(boxes, min_size=2, max_size=6), boxes)
def test_heaps_of_cuboids_keep_their_contacts_and_what_hangs_on_to_nothing_changed_stays(
    heap: list[Cuboid], other: Cuboid
) -> None:
    before = Cage.of({str(i): cuboid for i, cuboid in enumerate(heap)})
    after = attached(before, Cage.of({**before.cuboids(), "0": other}), {"0"})
    assert (opened(before, after) <= PLAY + 1e-12).all()
    apart = set(before.part_ids) - groups(before, "0")
    rows = np.isin(before.part_ids, list(apart))
    np.testing.assert_array_equal(after.vectors()[rows], before.vectors()[rows])


def test_without_a_change_nothing_follows() -> None:
    cage = stool().cage
    np.testing.assert_array_equal(attached(cage, cage, {"seat"}).vectors(), cage.vectors())


def test_a_higher_seat_has_longer_legs_that_stand_where_they_stood_and_takes_the_back_s_foot_along() -> None:
    before = stool()
    after = do(before, Move(part="seat", by=(0, 0.1, 0), attach=True))
    for i in range(4):
        leg, was = after.cage[f"leg_{i}"], before.cage[f"leg_{i}"]
        np.testing.assert_allclose(leg.size - was.size, [0, 0.1, 0], atol=1e-9)
        np.testing.assert_allclose(leg.centre - was.centre, [0, 0.05, 0], atol=1e-9)
    back, was = after.cage["back"], before.cage["back"]
    np.testing.assert_allclose(back.centre[1] + back.size[1] / 2, was.centre[1] + was.size[1] / 2)
    np.testing.assert_allclose(back.centre[1] - back.size[1] / 2, was.centre[1] - was.size[1] / 2 + 0.1)


def test_a_longer_leg_lifts_the_seat_whose_thickness_stays_and_does_not_run_through_it() -> None:
    before = stool()
    longer = Resize(part="leg_0", axis="y", factor=1.2, keep="low", attach=True)
    after = do(before, longer)
    assert after.cage["seat"].size[1] == before.cage["seat"].size[1]
    np.testing.assert_allclose(after.cage["seat"].centre[1] - before.cage["seat"].centre[1], 0.1, atol=1e-3)
    np.testing.assert_allclose(after.cage["leg_3"].size[1], 0.6, atol=1e-3)
    assert (gaps(after.cage)[4, :4] > -CONTACT).all()


def test_a_leg_that_slides_under_the_seat_takes_nothing_along() -> None:
    before = stool()
    after = do(before, Move(part="leg_3", by=(-0.1, 0, 0), attach=True))
    same = [part for part in before.cage.part_ids if vector(after, part) == vector(before, part)]
    assert same == [part for part in before.cage.part_ids if part != "leg_3"]


def test_all_legs_follow_one_though_the_structure_knows_only_that_two_mirror_each_other() -> None:
    before = stool()
    longer = Resize(part="leg_0", axis="y", factor=1.2, keep="high")
    assert lengths(do(before, longer)) == pytest.approx([0.6, 0.6, 0.5, 0.5])
    assert lengths(do(before, replaced(longer, mirror=False))) == pytest.approx([0.6, 0.5, 0.5, 0.5])
    assert lengths(do(before, replaced(longer, repeat=True))) == pytest.approx([0.6] * 4)


def lengths(state: State) -> list[float]:
    return [float(state.cage[f"leg_{i}"].size[1]) for i in range(4)]


def replaced(operation: Any, **fields: bool) -> Any:
    return operation.model_copy(update=fields)


@settings(max_examples=20, deadline=None)
@given(st.tuples(*[st.floats(-0.2, 0.2)] * 3))
def test_a_mirrored_change_of_a_mirrored_stool_leaves_it_mirrored(by: tuple[float, float, float]) -> None:
    after = do(stool(), Move(part="leg_0", by=by, attach=True)).cage
    images = {"leg_0": "leg_1", "leg_2": "leg_3", "seat": "seat", "back": "back"}
    corners = dict(zip(after.part_ids, after.corners()))
    for part, image in images.items():
        gaps_between = np.linalg.norm(corners[part][:, None] * [-1, 1, 1] - corners[image], axis=2)
        assert gaps_between.min(axis=1).max() < 1e-6


def test_scripts_without_attach_mean_what_they_meant() -> None:
    before = stool()
    after = do(before, Move(part="seat", by=(0, 0.1, 0)))
    assert vector(after, "leg_0") == vector(before, "leg_0")


def test_a_part_that_would_leave_the_reach_by_following_is_refused() -> None:
    state = stool()
    with pytest.raises(InputError, match="away"):
        do(replace(state), Move(part="leg_0", by=(0, -3, 0), attach=True))
