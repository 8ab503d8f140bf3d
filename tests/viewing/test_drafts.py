"""What is kept of pages that are gone: for the browser that it is of, for a day, within bounds; and taken up again."""

from collections.abc import Mapping

import numpy as np
import pytest

from cagesdf.editing.document import Document
from cagesdf.editing.script import Move, Style
from cagesdf.editing.session import Session
from cagesdf.errors import InputError
from cagesdf.geometry.meshes import Mesh
from cagesdf.shape import GIVEN, RawShape
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.viewing import drafts as module
from cagesdf.viewing.drafts import DAY, MOST, Drafts, Entry, Page, is_token, new_token
from cagesdf.viewing.shelf import Shelf
from cagesdf.viewing.uploads import Upload

MOVE = Move(part="seat", by=(0.0, 0.01, 0.0))
ANNA, BERT = new_token(), new_token()


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def drafts(clock: Clock) -> Drafts:
    return Drafts(clock)


def entry(session: Session, name: str = "a", moves: int = 1, upload: Upload | None = None) -> Entry:
    first = Document.opened("a", session.opened("a")).named(name)
    return Entry(first, first.continued((MOVE,) * moves, session.styles), upload, first)


def shelf(session: Session, page: Page | None = None) -> Shelf:
    def fresh(shape_id: str) -> Document:
        return Document.opened(shape_id, session.opened(shape_id))

    return Shelf(fresh, frozenset(session.run.sequences), lambda entry: page.keep("run", entry) if page else None)


def names(drafts: Mapping[tuple[int, str], module.Draft]) -> list[str]:
    return [draft.name for draft in drafts.values()]


def test_a_browser_sees_its_own_drafts_alone_the_newest_first(session: Session, drafts: Drafts) -> None:
    drafts.keep(ANNA, 0, "run", entry(session, "a"))
    drafts.keep(ANNA, 0, "run", entry(session, "new"))
    drafts.keep(BERT, 1, "run", entry(session, "b"))
    drafts.keep(ANNA, 0, "run", entry(session, "a", 2))
    assert names(drafts.of(ANNA)) == ["a", "new"]
    assert [len(draft.script) for draft in drafts.of(ANNA).values()] == [2, 1]
    assert names(drafts.of(BERT)) == ["b"]
    assert names(drafts.of(new_token())) == []


def test_drafts_are_offered_once_their_page_is_closed_and_of_the_same_run(session: Session, drafts: Drafts) -> None:
    pages = {0, 1}
    drafts.keep(ANNA, 0, "run", entry(session))
    page = Page(drafts, ANNA, 1, lambda: pages)
    assert page.offered("run") == {}
    pages.discard(0)
    assert names(page.offered("run")) == ["a"]
    assert page.offered("other") == {}
    page.drop((0, "a"))
    assert page.offered("run") == {}


def test_what_was_opened_and_not_changed_is_not_kept(session: Session, drafts: Drafts) -> None:
    drafts.keep(ANNA, 0, "run", entry(session))
    drafts.keep(ANNA, 0, "run", entry(session, moves=0))
    assert drafts.of(ANNA) == {}


def test_a_draft_is_gone_after_a_day(session: Session, drafts: Drafts, clock: Clock) -> None:
    drafts.keep(ANNA, 0, "run", entry(session))
    clock.now += DAY
    assert names(drafts.of(ANNA)) == ["a"]
    clock.now += 1
    assert drafts.of(ANNA) == {}


def test_the_oldest_go_where_there_are_too_many_or_they_are_too_large(
    session: Session, drafts: Drafts, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(MOST + 3):
        drafts.keep(ANNA, 0, "run", entry(session, str(number)))
    assert names(drafts.of(ANNA)) == [str(number) for number in reversed(range(3, MOST + 3))]
    raw = RawShape("large", "train", (), PartHierarchy.flat(("a",), ("",), ""))
    large = Upload("large.obj", raw, Mesh(np.zeros((1000, 3)), np.zeros((0, 3), np.int32)), GIVEN)
    monkeypatch.setattr(module, "MOST_BYTES", 25_000)
    drafts.keep(BERT, 1, "run", entry(session, "large", upload=large))
    assert names(drafts.of(BERT)) == ["large"]
    assert sum(draft.bytes for browser in (ANNA, BERT) for draft in drafts.of(browser).values()) <= 25_000


def test_tokens_are_told_from_other_text() -> None:
    assert is_token(ANNA)
    assert ANNA != BERT
    assert not any(map(is_token, ("", "a" * 42, "a" * 44, "a" * 42 + "é", "a" * 42 + ";")))


def test_a_draft_leads_to_the_same_state_in_another_page_and_undo_ends_where_it_was_made(
    session: Session, drafts: Drafts
) -> None:
    before = shelf(session, Page(drafts, ANNA, 0, set))
    style = Style(code=(0.5, 0.25, 0.125, 1.0))
    made = before.add(before.take("a").then(style, session.styles).named("new"), None)
    before.put(made.then(MOVE, session.styles))
    after = shelf(session, Page(drafts, ANNA, 1, lambda: {1}))
    [draft] = Page(drafts, ANNA, 1, lambda: {1}).offered("run").values()
    document = after.restore(draft, session.styles)
    assert document.name == "new"
    np.testing.assert_array_equal(document.state.cage.vectors(), before.take("new").state.cage.vectors())
    np.testing.assert_array_equal(document.state.latent, np.array(style.code, np.float32))
    back = after.undone("new", session.styles)
    np.testing.assert_array_equal(back.state.cage.vectors(), made.state.cage.vectors())
    after.put(back)
    with pytest.raises(InputError, match="nothing to take back"):
        after.undone("new", session.styles)


def test_a_shape_that_is_left_is_taken_up_where_it_was_left_and_a_draft_of_it_has_a_name_of_its_own(
    session: Session, drafts: Drafts
) -> None:
    drafts.keep(ANNA, 0, "run", entry(session))
    [draft] = drafts.of(ANNA).values()
    own = shelf(session)
    own.take("a")
    assert own.restore(draft, session.styles).name == "a"
    own.take("b")
    assert own.take("a").script == (MOVE,)
    assert own.restore(draft, session.styles).name == "a_2"
    assert own.made == ["a_2"]


def test_work_is_unsaved_until_it_is_saved_or_taken_back(session: Session) -> None:
    own = shelf(session)
    document = own.take("a")
    assert not own.unsaved
    own.put(document.then(MOVE, session.styles))
    assert own.unsaved
    own.put(own.undone("a", session.styles))
    assert not own.unsaved
    own.put(own.take("a").redone(session.styles))
    own.save("a")
    assert not own.unsaved
    own.add(own.first("a").then(MOVE, session.styles).named("new"), None)
    assert own.unsaved
