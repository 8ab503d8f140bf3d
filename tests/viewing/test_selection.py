"""Clicks reach every part; what is hidden isn't selected; what is locked isn't changed."""

from itertools import accumulate

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cagesdf.errors import InputError
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.viewing.selection import Selection

parts = st.lists(st.sampled_from("abcde"), unique=True)
sets = parts.map(frozenset)
choices = st.tuples(parts.map(tuple), sets, sets)
Choice = tuple[tuple[str, ...], frozenset[str], frozenset[str]]


def chosen(*parts: str) -> Selection:
    return Selection(tuple(parts), frozenset("h"), frozenset("l"))


@given(parts.filter(bool), parts)
def test_clicks_in_one_place_go_through_all_that_is_there(there: list[str], selected: list[str]) -> None:
    seen = accumulate(there, lambda now, _: now.clicked(there, more=False), initial=chosen(*selected))
    assert sorted(selection.parts for selection in [*seen][1:]) == sorted((part,) for part in there)


@given(parts, parts)
def test_more_adds_the_nearest_or_takes_it_away_again(there: list[str], selected: list[str]) -> None:
    once = chosen(*selected).clicked(there, more=True)
    assert set(once.parts) ^ set(selected) == set(there[:1])
    assert set(once.clicked(there, more=True).parts) == set(selected)


def test_a_click_beside_everything_selects_nothing() -> None:
    assert chosen("a", "b").clicked((), more=False).parts == ()
    assert chosen("a", "b").clicked((), more=True).parts == ("a", "b")


@given(parts, choices)
def test_an_entry_of_the_list_is_selected_and_with_more_added_or_taken_away(entry: list[str], choice: Choice) -> None:
    was = Selection(*choice)
    assert was.listed(entry, more=False).parts == tuple(entry)
    added = was.listed(entry, more=True)
    if set(entry) <= set(was.parts):
        assert set(added.parts) == set(was.parts) - set(entry)
        assert set(added.listed(entry, more=True).parts) == set(was.parts)
    else:
        assert added.parts[: len(was.parts)] == was.parts
        assert set(added.parts) == set(was.parts) | set(entry)


@given(choices)
def test_what_is_hidden_is_not_selected_and_is_shown_again(choice: Choice) -> None:
    was = Selection(*choice)
    assert was.hide() == Selection((), was.hidden | set(was.parts), was.locked)
    assert was.hide().show_all().hidden == frozenset()


@given(st.sampled_from("abcde"), choices)
def test_an_eye_is_closed_and_opened(part: str, choice: Choice) -> None:
    was = Selection(*choice)
    once = was.blink(part)
    assert once.hidden ^ was.hidden == {part}
    assert not once.hidden & set(once.parts)
    assert once.blink(part).hidden == was.hidden


@given(choices.filter(lambda choice: bool(choice[0])))
def test_what_is_selected_is_locked_and_freed(choice: Choice) -> None:
    was = Selection(*choice)
    locked = was if set(was.parts) <= was.locked else was.lock_or_free()
    assert set(locked.parts) <= locked.locked
    assert locked.lock_or_free().locked == locked.locked - set(was.parts)


@given(parts, choices)
def test_parts_that_are_gone_are_not_selected(known: list[str], choice: Choice) -> None:
    was = Selection(*choice)
    assert was.within(known).parts == tuple(part for part in was.parts if part in known)


def test_operations_are_refused_of_nothing_and_of_locked_parts_by_name() -> None:
    structure = PartHierarchy.flat(("p", "q"), ("leg", "leg"), "")
    assert Selection(("q", "p")).names(structure) == ["leg_2", "leg_1"]
    assert Selection(("q", "p")).pattern(structure) == "leg_2|leg_1"
    with pytest.raises(InputError, match="no part is selected"):
        Selection().pattern(structure)
    with pytest.raises(InputError, match="leg_1 is locked"):
        Selection(("q", "p"), locked=frozenset("p")).pattern(structure)
