"""Edits of shapes, and steps back and forth, without a browser."""

import numpy as np
import pytest

from cagesdf.editing.document import Document
from cagesdf.editing.script import Delete, Move
from cagesdf.editing.session import Session
from cagesdf.errors import InputError
from cagesdf.viewing.drafts import Entry
from cagesdf.viewing.hand import on_top
from cagesdf.viewing.selection import Selection
from cagesdf.viewing.shelf import Shelf
from cagesdf.viewing.workspace import Workspace
from tests.support.mixed import stool, with_shapes

UP = Move(part="seat", by=(0.0, 0.01, 0.0))
FURTHER = Move(part="seat", by=(0.0, 0.03, 0.0))


@pytest.fixture
def space(session: Session) -> Workspace:
    def fresh(shape_id: str) -> Document:
        return Document.opened(shape_id, session.opened(shape_id))

    return Workspace(Shelf(fresh, frozenset(session.run.sequences), lambda entry: None), session.styles, "a")


def test_parts_that_are_added_are_selected_and_not_when_they_are_gone_again(space: Workspace) -> None:
    before = space.state
    space.add(on_top(before))
    [new] = space.selection.parts
    assert {*space.state.cage.part_ids} - {*before.cage.part_ids} == {new}
    assert space.one(space.state) is not None
    space.undo()
    assert space.selection.parts == ()
    np.testing.assert_array_equal(space.state.cage.centre, before.cage.centre)
    space.redo()
    assert new in space.state.cage.part_ids


def test_a_control_that_goes_on_replaces_what_it_did_and_another_one_adds_to_it(space: Workspace) -> None:
    space.do(UP, ("height",))
    space.do(FURTHER, ("height",))
    assert space.document.script == (FURTHER,)
    space.do(UP, ("other",))
    assert space.document.script == (FURTHER, UP)
    space.undo()
    space.do(UP, ("other",))
    assert space.document.script[-1] == UP
    assert len(space.document.done) == 2


def test_a_hand_tries_without_doing(space: Workspace) -> None:
    before = space.document
    moved = space.tried(UP)
    assert space.document is before
    space.do(UP)
    np.testing.assert_array_equal(space.state.cage.centre, moved.cage.centre)


def test_what_is_refused_leaves_all_as_it_was(space: Workspace) -> None:
    space.selection = space.selection.of(space.state.cage.part_ids[:1])
    document, selection = space.document, space.selection
    for operation in (Move(part="nobody", by=(1.0, 0.0, 0.0)), Delete(part="*")):
        with pytest.raises(InputError):
            space.add(operation)
        assert space.document is document
        assert space.selection == selection
    with pytest.raises(InputError, match="nothing to take back"):
        space.undo()
    space.selection = selection.lock_or_free()
    with pytest.raises(InputError, match="locked"):
        space.hand(space.state, {})


def test_shapes_are_left_and_taken_up_again_as_they_were(space: Workspace) -> None:
    space.selection = space.selection.of(space.state.cage.part_ids)
    space.do(UP)
    left = space.document
    space.open(space.shelf.take("b"))
    assert space.selection == Selection()
    assert space.document.shape_id == "b"
    space.open(space.shelf.take("a"))
    assert space.document is left
    space.reset()
    assert space.document.script == ()


def test_a_reset_is_one_step_that_is_taken_back_and_done_again(space: Workspace) -> None:
    space.do(UP)
    space.do(FURTHER)
    edited = space.document
    space.reset()
    assert space.document.script == ()
    space.undo()
    assert space.document is edited
    space.redo()
    assert space.document.script == ()
    space.undo()
    space.undo()
    assert space.document.done == (UP,)
    space.undo()
    with pytest.raises(InputError, match="nothing to take back"):
        space.undo()


def test_drafts_keep_what_was_reset_until_something_else_is_done(session: Session) -> None:
    kept: list[Entry] = []
    shelf = Shelf(lambda name: Document.opened(name, session.opened(name)), frozenset("ab"), kept.append)
    space = Workspace(shelf, session.styles, "a")
    space.do(UP)
    space.reset()
    assert [entry.last.script for entry in kept] == [(UP,)]
    space.do(FURTHER)
    assert kept[-1].last.script == (FURTHER,)


def test_a_script_that_is_loaded_is_one_step(space: Workspace, session: Session) -> None:
    space.do(UP)
    before = space.document
    loaded = space.shelf.first("a").continued((FURTHER, UP), session.styles)
    space.replace(loaded)
    space.do(UP)
    space.undo()
    assert space.document.done == (FURTHER, UP)
    space.undo()
    assert space.document is before
    space.redo()
    assert space.document is loaded


def test_several_operations_of_one_control_are_one_step(space: Workspace) -> None:
    space.do(FURTHER)
    before = space.document
    space.slide(("angles",), lambda _: [UP, UP])
    space.slide(("angles",), lambda _: [UP, FURTHER, UP])
    assert len(space.document.done) == 4
    space.undo()
    assert space.document is before
    space.redo()
    assert len(space.document.done) == 4
    space.undo()
    space.undo()
    assert space.document.done == ()


def test_locked_parts_hold_a_row_where_it_is(session: Session) -> None:
    more = with_shapes(session, row=stool({"p": -0.4, "q": 0.0, "r": 0.4}))
    shelf = Shelf(lambda name: Document.opened(name, more.opened(name)), frozenset(more.run.sequences), lambda _: None)
    space = Workspace(shelf, more.styles, "row")
    space.selection = Selection(("p",), locked=frozenset("r"))
    with pytest.raises(InputError, match="leg_3: locked, and would have to make room"):
        space.one_more(space.hand(space.state, {}))
    space.selection = Selection(("p",))
    before = space.document
    space.one_more(space.hand(space.state, {}))
    assert len(space.selection.parts) == 1
    assert space.selection.parts[0] not in before.state.cage.part_ids
    space.undo()
    assert space.document is before
