"""Parts that come and go, in laws: what is left alone stays as it is, and what comes looks like what it comes from."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage
from cagesdf.editing import members
from cagesdf.editing.links import linked, mirrors, part_relations, repeats
from cagesdf.editing.parts import part_names, select
from cagesdf.editing.script import Delete, Duplicate, Harmonise, Mix, Move, Operation, Redo, Scale, Split, Undo
from cagesdf.editing.session import Session, state_field
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.geometry.meshes import is_closed
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.structure.relations import Reflection
from tests.support.mirrored import chair, do, is_mirrored, jug

FAR = (4.0, 0.0, 0.0)
patterns = st.sampled_from(["seat", "arm_1", "leg_1", "leg_*", "back|arm_2"])
switches = st.booleans()
COMING_AND_GOING = st.one_of(
    st.builds(Duplicate, part=patterns, by=st.tuples(*[st.floats(-1, 1)] * 3), mirror=switches, repeat=switches),
    st.builds(Delete, part=patterns, mirror=switches, repeat=switches),
    st.builds(
        Split, part=patterns, axis=st.sampled_from("xyz"), at=st.floats(0.3, 0.7), mirror=switches, repeat=switches
    ),
)


def touched(before: State, after: State) -> set[str]:
    """Parts that are in both, with other cuboids."""
    return {
        part
        for part in before.cage.part_ids
        if part in after.cage.part_ids and not np.array_equal(
            Cage.of({part: before.cage[part]}).vectors(), Cage.of({part: after.cage[part]}).vectors()
        )
    }  # fmt: skip


@settings(max_examples=12)
@given(COMING_AND_GOING)
def test_what_is_not_named_stays_to_the_last_bit_and_undo_brings_the_very_state_back(
    operation: Duplicate | Delete | Split,
) -> None:
    before = chair()
    after = do(before, operation)
    assert do(before, operation, Undo()) is before
    named = set(select(before.structure, operation.part))
    links = [kind for kind, follow in ((mirrors, operation.mirror), (repeats, operation.repeat)) if follow]
    followers = set(linked(named, [kind(before) for kind in links]))
    if not links:
        assert {*before.cage.part_ids} - {*after.cage.part_ids} <= named
    assert touched(before, after) <= (followers if isinstance(operation, Split) else set())
    kept = [part for part in before.cage.part_ids if part in after.cage.part_ids]
    assert [*after.cage.part_ids[: len(kept)]] == kept
    assert after.structure.parts() == after.cage.part_ids
    assert after.seen is before.seen
    assert {end for each in after.structure.relations() for end in (each.a, each.b)} <= {*after.cage.part_ids}


def test_other_parts_keep_their_codes_and_copies_and_halves_have_their_originals(session: Session) -> None:
    mix = Mix(part="arm_1", style_of="b", mirror=False)
    before = session.edited(session.opened("a"), (mix,)).present
    codes = dict(zip(before.cage.part_ids, state_field(session.run, before).codes.numpy()))
    script = (
        Duplicate(part="arm_1", by=FAR, mirror=False),
        Split(part="seat", axis="x"),
        Delete(part="back"),
        Delete(part="leg_1", mirror=False),
    )
    after = do(before, *script)
    for part, code in zip(after.cage.part_ids, state_field(session.run, after).codes.numpy()):
        original = part if part in codes else part.rpartition("_")[0]
        np.testing.assert_array_equal(code, codes[original])
    assert after.cage.part_ids[-2:] == ("arm_3", "seat_2")  # the other arm is called arm_2
    harmonised = state_field(session.run, do(after, Harmonise()))
    assert harmonised.codes.shape[0] == len(after.cage)


def test_a_copy_has_the_surface_of_its_original_and_the_whole_stays_closed(session: Session) -> None:
    before = session.opened("a")
    script = (Duplicate(part="leg_1", by=(0.2, 0.0, 0.0)), Split(part="seat", axis="x", at=0.4), Delete(part="back"))
    after = do(before, *script)
    found = session.live(32).surface(after)
    assert is_closed(found.mesh)
    once = session.live(32).surface(before)
    for part in set(before.cage.part_ids) & set(after.cage.part_ids) - {"seat"}:
        np.testing.assert_array_equal(found.parts[part].vertices, once.parts[part].vertices)
    [leg] = select(before.structure, "leg_1")
    way = after.cage[f"{leg}_2"].centre - after.cage[leg].centre
    copy, original = found.parts[f"{leg}_2"], found.parts[leg]
    for end in (np.min, np.max):
        np.testing.assert_allclose(end(copy.vertices, axis=0) - way, end(original.vertices, axis=0), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(way), 0.2 * before.similarity.scale)


def test_copies_repeat_their_originals_and_mirror_each_other() -> None:
    before = jug()
    after = do(before, Duplicate(part="handle_1", by=(0.0, 1.0, 2.0)), Scale(factors=(1.1, 1.0, 0.9)))
    assert [*part_names(after.structure).values()] == ["body", "handle_1", "handle_2", "handle_3", "handle_4"]
    assert mirrors(after)["2_2"].keys() == {"3_2"}
    assert repeats(after)["2"].keys() == {"2_2"}
    unscaled = do(before, Duplicate(part="handle_1", by=(0.0, 1.0, 2.0)))
    is_mirrored(unscaled, "2_2", "3_2")
    moved = do(unscaled, Move(part="handle_1", by=(0.5, 0.25, 0.0), repeat=True))
    is_mirrored(moved, "2_2", "3_2")
    for original, copy in (("2", "2_2"), ("3", "3_2")):
        np.testing.assert_allclose(
            moved.cage[copy].centre - moved.cage[original].centre,
            unscaled.cage[copy].centre - unscaled.cage[original].centre,
            atol=1e-12,
        )
    alone = do(before, Duplicate(part="handle_1", by=(0.0, 1.0, 2.0), mirror=False))
    assert len(alone.cage) == 4
    assert not mirrors(alone)["2_2"]


@settings(max_examples=20)
@given(st.sampled_from("xyz"), st.floats(0.1, 0.9))
def test_halves_fill_the_cuboid_and_mirrored_halves_mirror_each_other(axis: Literal["x", "y", "z"], at: float) -> None:
    before = jug()
    after = do(before, Split(part="handle_1", axis=axis, at=at))
    halves = [after.cage["2"], after.cage["2_2"]]
    corners = Cage.of({"2": halves[0], "2_2": halves[1]}).corners().reshape(-1, 3)
    own = before.cage["2"]
    local = (corners - own.centre) @ own.axes.T
    np.testing.assert_allclose(local.max(axis=0) - local.min(axis=0), own.size)
    np.testing.assert_allclose(sum(half.size.prod() for half in halves), own.size.prod())
    row, sign = before.own_axis(axis)
    np.testing.assert_allclose(halves[0].size[row], at * own.size[row])
    assert sign * (halves[1].centre - halves[0].centre) @ own.axes[row] > 0
    is_mirrored(after, "2", "3")
    is_mirrored(after, "2_2", "3_2")
    alone = do(before, Split(part="handle_1", axis=axis, at=at, mirror=False))
    assert not [each for each in alone.structure.relations() if isinstance(each, Reflection)]


def test_relations_between_groups_become_those_of_their_parts() -> None:
    before = chair()
    after = do(before, Delete(part="seat"))
    assert isinstance(after.structure, PartHierarchy)
    assert {part: {*others} for part, others in mirrors(after).items()} == {
        part: {*others} for part, others in mirrors(before).items() if part != "seat"
    }
    again = PartHierarchy.from_json(after.structure.to_json())
    assert part_relations(replace(after, structure=again)) == part_relations(after)


def test_what_is_deleted_comes_back_in_its_place_and_goes_again() -> None:
    before, gone = chair(), Delete(part="leg_2|arm_1", mirror=False)
    np.testing.assert_array_equal(
        do(before, gone, Undo(), Redo()).cage.vectors(), do(before, gone).cage.vectors()
    )  # fmt: skip


@pytest.mark.parametrize(
    ("operation", "said"),
    [
        (Delete(part="*"), "it leaves no part"),
        (Split(part="seat", axis="z", at=1e-5), "thin"),
        (Duplicate(part="seat", by=(1e6, 0.0, 0.0)), "away"),
        (Duplicate(part="wing", by=(0.0, 0.0, 0.0)), "no part is called so"),
    ],
)
def test_what_can_not_be_is_refused(operation: Operation, said: str) -> None:
    with pytest.raises(InputError, match=said):
        do(chair(), operation)


def test_too_many_parts_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(members, "MAX_PARTS", 20)
    with pytest.raises(InputError, match="operation 0: duplicate: it makes 24 parts; wanted at most 20"):
        do(chair(), Duplicate(part="*", by=(0.0, 0.0, 0.0)))
