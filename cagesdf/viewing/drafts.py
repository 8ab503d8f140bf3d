"""Work that outlives its page: kept for a day for the browser that it was done in, and offered there again."""

import re
import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Set
from dataclasses import dataclass

from cagesdf.editing.document import Document
from cagesdf.editing.script import Script, dump
from cagesdf.viewing.uploads import Upload

DAY = 86_400.0  # seconds
MOST = 20  # drafts per browser
MOST_BYTES = 200_000_000  # all drafts together
_TOKEN = re.compile(r"[\w-]{43}", re.ASCII)  # 32 random bytes, as `secrets` writes them


@dataclass(frozen=True, eq=False)
class Entry:
    """A document, and its state before anything was done to it here."""

    first: Document  # as it was opened, or made
    last: Document
    upload: Upload | None  # the file that it comes from
    saved: Document  # as last saved or exported; otherwise `first`, or the shape before it was made here


@dataclass(frozen=True, eq=False)
class Draft:
    """A shape's edits, as they are kept for one browser."""

    run: str  # by name
    shape_id: str  # the shape of the run that it starts from
    name: str  # given by the user
    script: Script  # leads from the run's shape to it
    made: int  # leading operations that made the shape: undo and reset go no further back
    changes: int  # operations since then that weren't taken back
    upload: Upload | None  # the file that it comes from
    time: float  # last change, seconds since the epoch
    bytes: int  # estimate of its memory

    @staticmethod
    def of(entry: Entry, run: str, now: float) -> "Draft":
        """A document as it is now."""
        document, upload = entry.last, entry.upload
        size = len(dump(document.script)) + (0 if upload is None else upload.bytes)
        made, changes = len(entry.first.script), max(len(document.done) - len(entry.first.done), 0)
        return Draft(run, document.shape_id, document.name, document.script, made, changes, upload, now, size)

    def in_words(self, now: float) -> str:
        """Name, number of changes and age at a time (seconds since the epoch)."""
        minutes = max(now - self.time, 0) / 60
        age = "just now" if minutes < 1 else f"{minutes:.0f} min ago" if minutes < 60 else f"{minutes / 60:.0f} h ago"
        what = f"{self.changes} change{'s' * (self.changes != 1)}" if self.changes else "as it was made"
        return f"Continue {self.name}: {what}, {age}"


class Drafts:
    """The drafts of all browsers, in memory, each known by a token that no other browser has.

    The oldest ones go where there are more than may be: MOST for each browser, MOST_BYTES altogether, DAY old.
    """

    def __init__(self, clock: Callable[[], float] = time.time) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        # By browser, page and name; the one that changed last is at the end.
        self._drafts: OrderedDict[tuple[str, int, str], Draft] = OrderedDict()

    def keep(self, browser: str, page: int, run: str, entry: Entry) -> None:
        """A document that changed in a page; one that is as it was opened is nothing to keep."""
        key = browser, page, entry.last.name
        with self._lock:
            self._drafts.pop(key, None)
            if entry.last.script:
                self._drafts[key] = Draft.of(entry, run, self._clock())
            self._tidy(browser)

    def of(self, browser: str) -> dict[tuple[int, str], Draft]:
        """A browser's drafts by page and name, the newest first."""
        with self._lock:
            self._tidy(browser)
            return {key[1:]: draft for key, draft in reversed(self._drafts.items()) if key[0] == browser}

    def drop(self, browser: str, page: int, name: str) -> None:
        """Forget a draft."""
        with self._lock:
            self._drafts.pop((browser, page, name), None)

    def _tidy(self, browser: str) -> None:
        now = self._clock()
        keys = [key for key in self._drafts if key[0] == browser]
        for key in keys[: max(len(keys) - MOST, 0)]:
            del self._drafts[key]
        total = sum(draft.bytes for draft in self._drafts.values())
        for key, draft in list(self._drafts.items()):
            if now - draft.time <= DAY and total <= MOST_BYTES:
                break
            total -= draft.bytes
            del self._drafts[key]


@dataclass(frozen=True, eq=False)
class Page:
    """A page of a browser, and what it may know of that browser's drafts."""

    drafts: Drafts
    browser: str  # its token
    number: int  # unique among the server's pages
    open: Callable[[], Set[int]]  # numbers of the pages that are open

    def keep(self, run: str, entry: Entry) -> None:
        """A document that changed in this page."""
        self.drafts.keep(self.browser, self.number, run, entry)

    def offered(self, run: str) -> dict[tuple[int, str], Draft]:
        """Drafts of a run, by page and name, whose pages are no longer open; the newest first."""
        open_pages = self.open()
        return {
            key: draft
            for key, draft in self.drafts.of(self.browser).items()
            if key[0] not in open_pages and draft.run == run
        }

    def drop(self, key: tuple[int, str]) -> None:
        """Forget a draft of this browser."""
        self.drafts.drop(self.browser, *key)


def new_token() -> str:
    """A name for a browser that nobody can guess."""
    return secrets.token_urlsafe(32)


def is_token(text: str) -> bool:
    """True for texts of the form that `new_token` gives."""
    return _TOKEN.fullmatch(text) is not None
