"""Boxes that numbers are typed into: taken once they are typed, as they are written.

They are text to viser. Its own number boxes give every digit back as a number while it is typed, and -0.05 becomes 0.05
on the way, as -0 is 0.
"""

import math
import re
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from cagesdf.viewing.settling import Settling, after_pause

Typed = tuple[float | None, ...]  # None: as it was shown, whatever digits were left out there

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.ASCII | re.IGNORECASE)
LONGEST = 1_000  # letters of what is typed
MOST_DECIMALS = 9  # of numbers that are written without an exponent


class NumberField:
    """Numbers in a box, with blanks between them; a comma may stand for the point."""

    def __init__(
        self, box: Any, count: int, act: Callable[[Typed], None], guard: Callable[[Callable[[], None]], None]
    ) -> None:
        """`box` is one of viser's text boxes; `act` is called through `guard` with the `count` numbers typed there."""
        self._box, self._count, self._act = box, count, act
        self._known = ""  # the text that was shown, or taken
        self._shown: tuple[float, ...] = ()  # its numbers
        self._settling = Settling(self._take, partial(after_pause, guard))
        self._box.on_update(lambda event: None if event.client is None else self._settling.touch())

    def show(self, values: Iterable[float] | None, decimals: int) -> None:
        """Show numbers in a box that nobody is typing into; an empty one for None."""
        self._box.disabled = values is None
        if self._box.value != self._known:  # viser sets what is typed before it says so
            return
        text = "" if values is None else written(values, decimals)
        self._shown = read(text, self._count) or ()
        if text != self._known:
            self._box.value = self._known = text

    def flush(self) -> None:
        """Take what is being typed as it is."""
        self._settling.flush()

    def drop(self) -> None:
        """Forget what is being typed."""
        self._settling.drop()

    def _take(self) -> None:
        self._known = self._box.value
        numbers = read(self._known, self._count)
        if numbers is None or self._box.disabled:  # not whole yet: a minus alone
            return
        typed = tuple(None if number == was else number for number, was in zip(numbers, self._shown, strict=True))
        if any(number is not None for number in typed):
            self._act(typed)


def read(text: str, count: int) -> tuple[float, ...] | None:
    """The numbers of a text; None if it isn't `count` finite numbers."""
    words = [word.rstrip(",;").replace(",", ".").replace("--", "-") for word in text[:LONGEST].split()]
    if len(words) != count or not all(_NUMBER.fullmatch(word) for word in words):
        return None
    numbers = tuple(float(word) for word in words)
    return numbers if all(map(math.isfinite, numbers)) else None


def written(values: Iterable[float], decimals: int) -> str:
    """Numbers as `read` reads them, rounded to decimals, which are negative for tens; no 0 is negative."""
    form = f".{max(decimals, 0)}f" if -MOST_DECIMALS <= decimals <= MOST_DECIMALS else ".6g"
    return "  ".join(f"{round(float(value), decimals) + 0.0:{form}}" for value in values)
