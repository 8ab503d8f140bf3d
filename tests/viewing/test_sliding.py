"""Controls that go on being changed: one step of the script, from where they began."""

from typing import Any

import numpy as np
import pytest

from cagesdf.editing.document import Document
from cagesdf.editing.parts import part_names
from cagesdf.editing.script import Move, Style
from cagesdf.editing.session import Session
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.viewing.fields import Typed
from cagesdf.viewing.hand import Hand
from cagesdf.viewing.sliding import Sliding
from tests.support.untrained import untrained

PART = "seat"
ALONE: dict[str, Any] = {"mirror": False, "repeat": False, "attach": False, "details": "stretch"}


@pytest.fixture(scope="module")
def session() -> Session:
    return untrained()


@pytest.fixture
def opened(session: Session) -> Document:
    return Document.opened("a", session.opened("a"))


def hand(state: State) -> Hand:
    return Hand(state, (PART,), part_names(state.structure)[PART], ALONE)


def style(x: float) -> Style:
    return Style(code=(x, 0.0, 0.0, 0.0))


def directed(sliding: Sliding, document: Document, x: float, session: Session, *control: str) -> Document:
    """After a slider of the style has moved to a place."""
    return sliding.changed(document, control, lambda _: [style(x)], session.styles)


def placed(sliding: Sliding, document: Document, place: Typed, session: Session) -> Document:
    return sliding.changed(document, ("centre", PART), lambda state: [hand(state).placed(place)], session.styles)


def resized(sliding: Sliding, document: Document, lengths: Typed, session: Session) -> Document:
    return sliding.changed(document, ("lengths", PART), lambda state: hand(state).resized(lengths), session.styles)


def test_a_slider_that_moves_on_is_one_operation(session: Session, opened: Document) -> None:
    sliding, first = Sliding(), Move(part="*", by=(0.1, 0.0, 0.0))
    document = before = opened.then(first, session.styles)
    for x in (0.1, 0.2, 0.3):
        document = directed(sliding, document, x, session, "direct")
    assert document.script == (first, style(0.3))
    back = document.undone(session.styles).state
    np.testing.assert_array_equal(back.latent, before.state.latent)
    np.testing.assert_array_equal(back.cage.vectors(), before.state.cage.vectors())


def test_a_place_that_is_typed_on_is_the_last_one_that_was_typed(session: Session, opened: Document) -> None:
    sliding, document = Sliding(), opened
    for x in (0.0, 0.1, 0.14, 0.14, 0.192):
        place = (x, 0.2, 0.3)
        document = placed(sliding, document, place, session)
        centre = document.state.similarity.to_raw(document.state.cage[PART].centre[None])[0]
        np.testing.assert_allclose(centre, place, atol=1e-9)
    assert len(document.script) == 1


def test_lengths_that_are_typed_on_are_the_last_ones_whatever_was_refused(session: Session, opened: Document) -> None:
    sliding, document, scale = Sliding(), opened, opened.state.similarity.scale
    start = np.sort(opened.state.cage[PART].size) / scale
    for x in (0.1, 0.0, 0.25, 0.3):
        lengths = (x, 0.4, 0.5)
        try:
            document = resized(sliding, document, lengths, session)
        except InputError:
            assert x == 0
            continue
        np.testing.assert_allclose(np.sort(document.state.cage[PART].size) / scale, lengths, atol=1e-9)
    assert len(document.script) == 3, "one for each axis"
    assert (np.abs(start - lengths) > 0.01).any()


def test_what_another_control_does_stays(session: Session, opened: Document) -> None:
    sliding, document = Sliding(), opened
    for control in (("direct",), ("other",), (), ()):
        document = directed(sliding, document, float(len(document.script)), session, *control)
    assert len(document.script) == 4
    for x in (8.0, 9.0):
        sliding.end()
        document = directed(sliding, document, x, session, "direct")
    assert len(document.script) == 6
