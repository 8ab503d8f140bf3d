"""Output of commands: sentences for people, JSON for programs, progress on standard error."""

import json
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated, Any

from cyclopts import Parameter

PATIENCE = 1.0  # seconds; progress of shorter work isn't printed

Json = Annotated[
    bool,
    Parameter(
        name="--json",
        negative=(),
        help="Print the JSON object to a terminal, too, instead of a sentence.",
    ),
]


def tell(result: Mapping[str, Any], sentence: str, as_json: bool) -> None:
    """Print a command's result: as a sentence to a terminal, otherwise or with `as_json` as JSON."""
    print(sentence if for_people(as_json) else json.dumps(result, ensure_ascii=False))


def for_people(as_json: bool) -> bool:
    """Whether output is for a terminal, and JSON isn't wanted."""
    return not as_json and sys.stdout.isatty()


def warn(sentences: Iterable[str]) -> None:
    """Print warnings about a result, which is written all the same, on standard error."""
    for sentence in sentences:
        _say(f"warning: {sentence}")


@contextmanager
def working(what: str, seconds: dict[str, float] | None = None, name: str = "") -> Iterator[None]:
    """Print the step on standard error if the context takes longer than PATIENCE; note its time in `seconds`."""
    start = time.perf_counter()
    timer = threading.Timer(PATIENCE, _say, [f"{what} …"])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
    if seconds is not None:
        seconds[name] = round(time.perf_counter() - start, 4)


class Count:
    """Progress through `total` items, printed on standard error at most once per PATIENCE seconds."""

    def __init__(self, what: str, total: int) -> None:
        self._what, self._total, self._done = what, total, 0
        self._last = time.perf_counter()

    def __call__(self) -> None:
        """Count one more item."""
        self._done += 1
        if (now := time.perf_counter()) - self._last > PATIENCE:
            self._last = now
            _say(f"{self._what}: {self._done:,} of {self._total:,}")


def _say(text: str) -> None:
    print(f"cagesdf: {text}", file=sys.stderr, flush=True)
