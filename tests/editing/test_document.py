"""What is edited in a tab is what its script gives: however one got there, and whatever went wrong on the way."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.api.sources import IMPORT
from cagesdf.demo import DEMO
from cagesdf.editing.document import Document
from cagesdf.editing.script import MAX_OPERATIONS, Move, Redo, Resize, Style, Swap, Undo, dump, parse
from cagesdf.editing.session import Session
from cagesdf.errors import InputError
from cagesdf.geometry.meshes import is_closed
from cagesdf.inference.shapes import usual_settings
from cagesdf.viewing import opening
from tests.support.untrained import untrained

MOVES = (
    Move(part="arm_1", by=(0.02, 0.0, 0.01)),
    Resize(part="seat", axis="z", factor=1.1),
    Swap(style_of="b"),
    Style(code=(0.5, -0.25, 0.125, 1.0)),
)


def opened(session: Session) -> Document:
    return Document.opened("a", session.opened("a"))


def same(a: Document, b: Document) -> None:
    np.testing.assert_array_equal(a.state.cage.vectors(), b.state.cage.vectors())
    np.testing.assert_array_equal(a.state.latent, b.state.latent)


@given(st.lists(st.sampled_from([*MOVES, Undo(), Redo()]), max_size=8))
@settings(max_examples=25, deadline=None)
def test_the_saved_script_gives_the_same_state_to_the_last_bit(operations: list) -> None:
    session = untrained()
    document = opened(session)
    for operation in operations:
        try:
            document = document.then(operation, session.styles)
        except InputError:
            continue  # nothing to take back: the document is the one from before
    again = opened(session).continued(parse(dump(document.script)), session.styles)
    same(document, again)
    same(document, opened(session).continued(document.done, session.styles))
    same(document.reset(), opened(session))
    assert document.reset().script == ()


def test_undo_and_redo_stand_in_the_script(session: Session) -> None:
    document = opened(session).then(MOVES[0], session.styles)
    back = document.undone(session.styles)
    same(back, opened(session))
    same(back.redone(session.styles), document)
    assert [operation.op for operation in back.redone(session.styles).script] == ["move", "undo", "redo"]


def test_operations_that_were_taken_back_are_not_done(session: Session) -> None:
    styles = session.styles
    document = opened(session).then(MOVES[0], styles).then(MOVES[2], styles)
    back = document.undone(styles).undone(styles)
    assert back.done == ()
    assert back.redone(styles).done == MOVES[:1]
    other = back.redone(styles).then(MOVES[1], styles)
    assert other.done == MOVES[:2]
    again = opened(session).continued(other.done, styles)
    same(again, other)


def test_what_can_t_be_done_leaves_the_document_as_it_was(session: Session) -> None:
    document = opened(session)
    with pytest.raises(InputError, match="nothing to take back"):
        document.undone(session.styles)
    with pytest.raises(InputError, match="no part is called"):
        document.then(Move(part="wing", by=(0.0, 0.0, 0.0)), session.styles)
    with pytest.raises(InputError, match="codes have 4"):
        document.then(Style(code=(0.0,)), session.styles)
    assert document.script == ()
    with pytest.raises(InputError, match="operation 1: move"):
        document.continued((MOVES[2], Move(part="wing", by=(0.0, 0.0, 0.0))), session.styles)


def test_a_script_ends_where_files_end(session: Session) -> None:
    full = Document("a", (Undo(),) * MAX_OPERATIONS, opened(session).history, None, "a")
    with pytest.raises(InputError, match="save it and reset"):
        full.then(MOVES[0], session.styles)


def test_the_demo_opens_and_gives_a_closed_surface_and_is_small() -> None:
    opened = opening.opened(DEMO / "run", None, DEMO / "programs", None, IMPORT, usual_settings())
    assert is_closed(opened.session.live(48).surface(opened.session.opened(opened.first)).mesh)
    assert opened.generator is not None
    assert sum(path.stat().st_size for path in DEMO.rglob("*") if "__pycache__" not in path.parts) <= 4_000_000
