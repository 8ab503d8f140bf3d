"""What visitors do to their shapes, without a browser."""

import numpy as np
import pytest

from cagesdf.editing.document import Document
from cagesdf.editing.script import Delete, Move
from cagesdf.editing.session import Session
from cagesdf.errors import InputError
from cagesdf.viewing.hand import on_top
from cagesdf.viewing.selection import Selection
from cagesdf.viewing.shelf import Shelf
from cagesdf.viewing.workspace import Workspace

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
