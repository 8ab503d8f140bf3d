"""Surfaces in the background, the newest state first.

A state that is wanted gets a coarse surface at once. When none newer has come for REST seconds it gets the fine one,
and a newer one then ends that work at the next cuboid. Coarse surfaces are always finished and shown, so that
something follows the hand however fast it moves.
"""

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass

from cagesdf.editing.session import Live, Session
from cagesdf.editing.state import State
from cagesdf.extraction import PREVIEW, Each, Extraction, Part
from cagesdf.viewing.refusals import saying

PREVIEW_CELLS = 64  # cells
FINE_CELLS = 128  # the default of `cagesdf edit`: the page shows the surface that the command writes
REST = 0.3  # seconds


@dataclass(frozen=True, eq=False)
class Made:
    """A surface, and the state that it was made of."""

    state: State
    extraction: Extraction
    cells: int
    seconds: float  # from the beginning of its work


class Overtaken(Exception):
    """A newer state is wanted."""


class Worker:
    """A thread that makes surfaces for one tab. `close` ends it."""

    def __init__(
        self,
        session: Session,
        pool: ThreadPoolExecutor,
        show: Callable[[Made], None],
        tell: Callable[[float | None], None],
        fail: Callable[[str], None],
    ) -> None:
        """`show` is called from the thread with each surface; `tell` with the share of a fine one's cuboids that is
        done, None once it is made or given up; `fail` with an error's text. `pool` evaluates cuboids, and may be
        shared."""
        self._tell = tell
        self._pool = pool
        self._show, self._fail = show, fail
        self._coarse = session.live(PREVIEW_CELLS, fineness=PREVIEW)
        self._fine = session.live(FINE_CELLS)
        self._changed = threading.Condition()
        self._wanted: State | None = None
        self._number = 0  # the newest state's
        self._working = 0  # number of the state that is worked at
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="surfaces", daemon=True)
        self._thread.start()

    def want(self, state: State) -> None:
        """Make the surface of this state next; a state that was waiting is dropped."""
        with self._changed:
            self._wanted = state
            self._number += 1
            self._changed.notify()

    def rest(self) -> None:
        """Give the fine surface up that is being made, at the next cuboid; the coarse one stays."""
        with self._changed:
            self._number += 1
            self._changed.notify()

    def close(self) -> None:
        """End the thread, at the next cuboid."""
        with self._changed:
            self._closed = True
            self._number += 1
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while (state := self._next()) is not None:
            with saying(self._fail), suppress(Overtaken):
                self._make(self._coarse, PREVIEW_CELLS, state, self._pool.map)
                if self._rested():
                    try:
                        self._make(self._fine, FINE_CELLS, state, self._unless_overtaken)
                    finally:
                        self._tell(None)

    def _next(self) -> State | None:
        """The newest state, once there is one; None at the end."""
        with self._changed:
            while self._wanted is None and not self._closed:
                self._changed.wait()
            state, self._wanted = self._wanted, None
            self._working = self._number
            return None if self._closed else state

    def _rested(self) -> bool:
        """Wait for REST seconds. Returns whether no newer state came."""
        with self._changed:
            return not self._changed.wait_for(lambda: self._number != self._working, timeout=REST)

    def _make(self, live: Live, cells: int, state: State, each: Each) -> None:
        start = time.perf_counter()
        extraction = live.surface(state, each)
        self._show(Made(state, extraction, cells, time.perf_counter() - start))

    def _unless_overtaken(self, work: Callable[[int], Part], cuboids: Iterable[int]) -> Iterator[Part]:
        def checked(cuboid: int) -> Part:
            if self._number != self._working:
                raise Overtaken
            return work(cuboid)

        wanted = list(cuboids)
        for done, part in enumerate(self._pool.map(checked, wanted)):
            self._tell((done + 1) / len(wanted))
            yield part
