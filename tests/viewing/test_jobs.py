"""Long work: it says how far it is, gives way at once, and nothing of what is cancelled arrives."""

import threading
import time
from collections.abc import Callable
from functools import partial

import pytest

from cagesdf.errors import InputError
from cagesdf.viewing.jobs import Cancelled, Jobs, Progress, Stand

PATIENCE = 60.0  # seconds: only what is broken takes them


class Desk:
    """Jobs, and what they showed, finished and said."""

    def __init__(self) -> None:
        self.shown: list[Stand | None] = []
        self.said: list[str] = []
        self.ended = threading.Event()
        self.jobs = Jobs(self.shown.append, self._finish, self._fail)

    def _finish(self, act: Callable[[], None]) -> None:
        act()
        self.ended.set()

    def _fail(self, text: str) -> None:
        self.said.append(text)
        self.ended.set()


def test_work_says_how_far_it_is_and_its_result_arrives() -> None:
    desk, results = Desk(), []

    def work(progress: Progress) -> Callable[[], None]:
        progress("reading")
        progress("writing", 0.5)
        return lambda: results.append(1)

    desk.jobs.start("copy", work)
    assert desk.ended.wait(PATIENCE)
    assert results == [1]
    assert [str(stand) for stand in desk.shown] == ["copy: begins", "copy: reading", "copy: writing (50%)", "None"]
    assert not desk.jobs.running


def test_cancelled_work_makes_room_at_once_learns_it_and_leaves_nothing() -> None:
    desk, results, learnt = Desk(), [], threading.Event()
    begun, go = threading.Event(), threading.Event()

    def work(progress: Progress) -> Callable[[], None]:
        try:
            begun.set()
            go.wait(PATIENCE)
            progress("more")
        except Cancelled:
            learnt.set()
            raise
        return lambda: results.append("first")

    desk.jobs.start("long", work)
    assert begun.wait(PATIENCE)
    with pytest.raises(InputError, match="long: wait for its end, or cancel it"):
        desk.jobs.start("other", work)
    assert desk.jobs.cancel() == "long"
    desk.jobs.start("other", lambda _: lambda: results.append("second"))
    assert desk.ended.wait(PATIENCE)
    go.set()
    assert learnt.wait(PATIENCE)
    assert results == ["second"]
    assert desk.said == []
    assert desk.jobs.cancel() is None


def test_what_is_wrong_with_work_is_said_and_other_work_may_begin() -> None:
    desk = Desk()

    def work(progress: Progress) -> Callable[[], None]:
        raise InputError("there is no such file")

    desk.jobs.start("read", work)
    assert desk.ended.wait(PATIENCE)
    assert desk.said == ["there is no such file"]
    desk.ended.clear()
    while desk.jobs.running:
        pass
    desk.jobs.start("read", lambda _: lambda: None)
    assert desk.ended.wait(PATIENCE)


def test_cancelling_breaks_off_work_that_never_says_how_far_it_is_and_catches_all_errors() -> None:
    desk, begun = Desk(), threading.Event()
    steps: list[int] = []

    def work(progress: Progress) -> Callable[[], None]:
        for step in range(10**9):
            try:
                time.sleep(1e-4)
                steps[:] = [step]
                begun.set()
            except Exception:
                raise AssertionError("an error of the step") from None
        return lambda: None

    desk.jobs.start("endless", work)
    assert begun.wait(PATIENCE)
    [thread] = [thread for thread in threading.enumerate() if thread.name == "endless"]
    assert desk.jobs.cancel() == "endless"
    thread.join(PATIENCE)
    assert not thread.is_alive()
    assert desk.said == []
    assert desk.shown[-1] is None


def test_a_job_that_is_cancelled_just_as_it_ends_never_reaches_the_next_one() -> None:
    """Whenever it comes, either the result arrives or nothing does, and the thread ends without a trace."""
    left: list[object] = []
    before, threading.excepthook = threading.excepthook, lambda arguments: left.append(arguments.exc_type)
    try:
        for delay in range(200):
            desk = Desk()
            results: list[int] = []
            desk.jobs.start("short", partial(lambda into, _: lambda: into.append(1), results))
            [*threads] = [thread for thread in threading.enumerate() if thread.name == "short"]
            for _ in range(delay):
                pass
            cancelled = desk.jobs.cancel()
            for thread in threads:
                thread.join(PATIENCE)
            assert (cancelled is None) == (results == [1])
    finally:
        threading.excepthook = before
    assert left == []
