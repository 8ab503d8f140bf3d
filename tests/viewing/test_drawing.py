"""What is drawn anew: surfaces that tear; styles that fit come first; pictures are made once."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from cagesdf.editing.document import Document
from cagesdf.editing.session import Session
from cagesdf.editing.styles import ranked
from cagesdf.errors import InputError
from cagesdf.viewing import drawing, thumbnails
from cagesdf.viewing.drawing import TRIES, first_that_holds
from cagesdf.viewing.jobs import Progress
from cagesdf.viewing.thumbnails import Picture, Thumbnails
from tests.support.mixed import stool, with_shapes

PATIENCE = 60.0  # seconds: only what is broken takes them


@pytest.fixture
def tearing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A state tears as often as the first number of its latent says."""
    monkeypatch.setattr(drawing, "tears", lambda state, live, each: int(state.latent[0]))


def draws(session: Session, *tears: int) -> tuple[list[Document], Iterator[Callable[[], Document]]]:
    """Documents whose latents say how often they tear."""
    state = session.opened("a")
    documents = [Document.opened("a", replace(state, latent=np.full_like(state.latent, number))) for number in tears]
    return documents, iter([lambda document=document: document for document in documents])


@pytest.mark.parametrize(("tears", "taken"), [((0, 3), 0), ((2, 1, 0, 0), 2), ((4, 2, 3, 9, 5, 0), 1)])
def test_the_first_draw_that_holds_is_taken_or_the_one_that_tears_least(
    session: Session, tearing: None, tears: tuple[int, ...], taken: int
) -> None:
    assert TRIES == 5
    documents, drawn = draws(session, *tears)
    assert first_that_holds(session, drawn, Progress("", lambda stand: None)) is documents[taken]


def test_draws_that_give_no_shape_are_passed_over_and_named_if_all_are_so(session: Session, tearing: None) -> None:
    def none() -> Document:
        raise InputError("too thin")

    [document], drawn = draws(session, 0)
    progress = Progress("", lambda stand: None)
    assert first_that_holds(session, iter([none, *drawn]), progress) is document
    with pytest.raises(InputError, match="no draw gave a shape to edit: too thin; lower"):
        first_that_holds(session, iter([none, none]), progress)


def test_styles_of_the_same_structure_come_first_then_those_with_the_same_labels(session: Session) -> None:
    more = with_shapes(
        session, four=stool({f"l{i}": i / 4 for i in range(4)}), two=stool({"p": -0.4, "q": 0.4}),
        odd=stool({"p": -0.4, "q": 0.4, "r": 0.0}, "pillar"), wide=stool({"p": -0.9, "q": 0.9}),
    )  # fmt: skip
    assert ranked(more.opened("two"), more.styles)[:3] == ["two", "wide", "four"]
    assert ranked(more.opened("a"), more.styles)[:2] == ["a", "b"]
    assert sorted(ranked(more.opened("odd"), more.styles)) == sorted(more.styles.shapes)


class Wall:
    """What thumbnails showed."""

    def __init__(self) -> None:
        self.shown: list[tuple[str, int]] = []
        self._changed = threading.Condition()

    def put(self, key: str, picture: Picture) -> None:
        with self._changed:
            self.shown.append((key, int(picture[0, 0, 0])))
            self._changed.notify()

    def until(self, count: int) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.shown) >= count, timeout=PATIENCE)


def test_pictures_are_drawn_once_in_order_and_forgotten_owners_get_none(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, wall, begun, go = [], Wall(), threading.Event(), threading.Event()

    def drawn(self: Thumbnails, states: list[int]) -> list[Picture]:
        begun.set()
        go.wait(PATIENCE)
        made.extend(states)
        return [np.full((2, 2, 3), state, np.uint8) for state in states]

    monkeypatch.setattr(Thumbnails, "_drawn", drawn)
    monkeypatch.setattr(thumbnails, "BATCH", 2)
    monkeypatch.setattr(thumbnails, "KEPT", 4)
    pictures = Thumbnails(session)
    states = {str(number): (lambda number=number: number) for number in range(6)}
    pictures.want("first", {key: states[key] for key in "01"}, wall.put)
    assert begun.wait(PATIENCE)
    pictures.want("second", {key: states[key] for key in "2345"}, wall.put)
    pictures.want("third", {"5": states["5"]}, wall.put)
    pictures.want("urgent", {"4": states["4"]}, wall.put, urgent=True)
    pictures.forget("second")
    go.set()
    wall.until(4)
    assert wall.shown == [("0", 0), ("1", 1), ("4", 4), ("5", 5)]
    pictures.want("first", {key: states[key] for key in "51"}, wall.put)
    assert wall.shown[4:] == [("1", 1), ("5", 5)] or wall.shown[4:] == [("5", 5), ("1", 1)]
    pictures.want("first", {"2": states["2"]}, wall.put)
    wall.until(7)
    pictures.want("first", {"0": states["0"]}, wall.put)  # four are kept, and it was the oldest
    wall.until(8)
    assert made == [0, 1, 4, 5, 2, 0]
    pictures.want("first", {"7": states["2"]}, wall.put)
    pictures.close()
    assert not any(thread.name == "thumbnails" for thread in threading.enumerate())
