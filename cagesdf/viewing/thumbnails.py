"""Thumbnails of surfaces, drawn in the background once, and kept."""

import base64
import contextlib
import io
import os
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray
from PIL import Image

from cagesdf.editing.session import Session
from cagesdf.editing.state import State
from cagesdf.extraction import PREVIEW
from cagesdf.rendering import CLAY, Scene, render_rows, side_by_side
from cagesdf.viewing.refusals import saying
from cagesdf.viewing.worker import PREVIEW_CELLS

SIZE = 150  # pixels along a side
BATCH = 6  # drawn by one process, which takes most of a second to start
KEPT = 600  # thumbnails, of some kilobytes each
NICENESS = 5  # of the thread, so that surfaces are made first

Picture = UInt8[ndarray, "size size 3"]


class Thumbnails:
    """The thumbnails of one run, for all tabs. `want` orders some, `forget` cancels an owner's orders."""

    def __init__(self, session: Session) -> None:
        self._live = session.live(PREVIEW_CELLS, fineness=PREVIEW)
        self._kept: OrderedDict[Hashable, Picture] = OrderedDict()
        self._waiting: deque[tuple[Hashable, Hashable, Callable[[], State], Callable[[Picture], None]]] = deque()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def want(
        self,
        owner: Hashable,
        states: Mapping[Any, Callable[[], State]],
        show: Callable[[Any, Picture], None],
        urgent: bool = False,
    ) -> None:
        """Have `show` called with the key and picture of each state: at once with those that are known, later with
        the others, in order, urgent ones before those of others. What this owner wanted before and hasn't got is
        forgotten.

        Equal keys have equal states.
        """
        with self._changed:
            known = {key: self._kept[key] for key in states if key in self._kept}
            self._waiting = deque(entry for entry in self._waiting if entry[0] != owner)
            new = [(owner, key, state, partial(show, key)) for key, state in states.items() if key not in known]
            self._waiting = deque([*new, *self._waiting] if urgent else [*self._waiting, *new])
            for key in known:
                self._kept.move_to_end(key)
            if self._waiting and self._thread is None:
                self._thread = threading.Thread(target=self._run, name="thumbnails", daemon=True)
                self._thread.start()
        for key, picture in known.items():
            show(key, picture)

    def forget(self, owner: Hashable) -> None:
        """Serve an owner no longer."""
        self.want(owner, {}, lambda key, picture: None)

    def close(self) -> None:
        """Draw nothing more. Waits for the pictures being drawn: an interpreter that ends meanwhile may crash."""
        with self._changed:
            self._waiting.clear()
            thread = self._thread
        if thread is not None:
            thread.join()

    def _run(self) -> None:
        if hasattr(os, "setpriority") and os.uname().sysname == "Linux":  # there, of this thread alone
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        while batch := self._next():
            with saying(lambda text: None):  # the log has it; a shape without a picture is no one's loss
                pictures = self._drawn([state() for _, _, state, _ in batch])
                with self._changed:
                    for (_, key, _, _), picture in zip(batch, pictures):
                        self._kept[key] = picture
                    while len(self._kept) > KEPT:
                        self._kept.popitem(last=False)
                for (_, _, _, show), picture in zip(batch, pictures):
                    show(picture)

    def _next(self) -> list[tuple[Hashable, Hashable, Callable[[], State], Callable[[Picture], None]]]:
        """The next orders of at most BATCH; an empty list ends the thread."""
        with self._changed:
            batch = [self._waiting.popleft() for _ in range(min(BATCH, len(self._waiting)))]
            if not batch:
                self._thread = None
            return batch

    def _drawn(self, states: Sequence[State]) -> list[Picture]:
        scenes = [Scene((self._live.surface(state).mesh,), (CLAY,)) for state in states]
        rows, _ = render_rows([[scene] for scene in scenes], SIZE)
        return [side_by_side(row, 1) for row in rows]


def blank() -> Picture:
    """A placeholder."""
    return np.full((SIZE, SIZE, 3), 245, np.uint8)


def as_url(picture: Picture) -> str:
    """A picture as a web address that holds it."""
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "jpeg", quality=85)
    return f"data:image/jpeg;base64,{base64.b64encode(stream.getvalue()).decode()}"
