"""Parts that are added: where they are, whose style they have; and which parts are alike."""

from dataclasses import replace

import numpy as np
import pytest

from cagesdf.editing.links import alike
from cagesdf.editing.operations import edited
from cagesdf.editing.parts import part_names
from cagesdf.editing.script import Add, Duplicate, Mix, Style, Swap, Undo, dump, parse
from cagesdf.editing.session import Session, state_field
from cagesdf.editing.state import State
from cagesdf.structure.stored import read_structure
from tests.support.attached import IDENTITY, STYLES, do, stool, vector
from tests.support.untrained import untrained

SHELF = Add(name="shelf", centre=(0.0, -0.4, 0.0), lengths=(0.5, 0.05, 0.55))


def test_a_part_that_is_added_looks_like_the_part_whose_lengths_are_most_like_its_own() -> None:
    rod = Add(name="rod", centre=(0.0, -0.3, 0.25), lengths=(0.05, 0.5, 0.05))
    other = Add(name="shelf", centre=(0.0, -0.5, 0.0), lengths=(0.5, 0.05, 0.5), like="back")
    after = do(stool(), rod, SHELF, other)
    new = [part for part in after.cage.part_ids if part not in stool().cage.part_ids]
    assert after.seen_as(new[0]) in {f"leg_{i}" for i in range(4)}
    assert [after.seen_as(part) for part in new[1:]] == ["seat", "back"]
    assert [part_names(after.structure)[part] for part in new[1:]] == ["shelf_1", "shelf_2"]


def test_it_stands_where_and_as_large_as_the_user_says_and_the_others_stay_to_the_last_bit() -> None:
    before = stool()
    after = do(before, SHELF)
    part = after.cage.part_ids[-1]
    np.testing.assert_allclose(after.cage[part].centre, SHELF.centre)
    np.testing.assert_allclose(after.cage[part].size, SHELF.lengths)
    assert all(vector(after, part) == vector(before, part) for part in before.cage.part_ids)
    turned = replace(before, similarity=replace(IDENTITY, rotation=np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])))
    np.testing.assert_allclose(do(turned, SHELF).cage[part].size, [0.55, 0.5, 0.05])


def test_it_is_taken_back_written_and_read() -> None:
    before = stool()
    assert edited(before, (SHELF, Undo()), STYLES).present is before
    assert parse(dump((SHELF,))) == (SHELF,)
    after = do(before, SHELF)
    structure = read_structure(after.structure.to_json())
    assert (structure.parts(), structure.relations()) == (after.structure.parts(), after.structure.relations())


def test_front_and_back_legs_are_alike_and_a_seat_is_like_nothing() -> None:
    links = alike(stool())
    assert {part: set(others) for part, others in links.items() if others} == {
        "leg_0": {"leg_2", "leg_3"},
        "leg_1": {"leg_2", "leg_3"},
        "leg_2": {"leg_0", "leg_1", "leg_3"},
        "leg_3": {"leg_0", "leg_1", "leg_2"},
    }


@pytest.fixture(scope="module")
def session() -> Session:
    return untrained()


def codes(session: Session, state: State) -> dict[str, bytes]:
    field = state_field(session.run, state)
    return {part: code.numpy().tobytes() for part, code in zip(field.cage.part_ids, field.codes)}


def test_codes_of_other_parts_stay_to_the_last_bit_and_the_new_part_follows_styles(session: Session) -> None:
    before = session.opened("a")
    after = session.edited(before, (SHELF,)).present
    was, now = codes(session, before), codes(session, after)
    assert now == {part: was[after.seen_as(part)] for part in after.cage.part_ids}
    swapped = session.edited(after, (Swap(style_of="b"),)).present
    assert all(code != now[part] for part, code in codes(session, swapped).items())


def test_a_new_part_keeps_what_was_mixed_into_the_part_that_it_is_like(session: Session) -> None:
    before = session.opened("a")
    new = Add(name="shelf", centre=(0.0, 0.0, 0.0), lengths=(0.5, 0.05, 0.5), like="seat")
    mixed = (Mix(part="seat", style_of="b"), new, Duplicate(part="arm", by=(0.0, 0.1, 0.0)))
    for script in (mixed, (*mixed, Style(code=(0.5,) * len(before.latent)))):
        now = codes(session, session.edited(before, script).present)
        assert now["shelf"] == now["seat"] != codes(session, before)["seat"]
