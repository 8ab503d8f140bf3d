"""Numbers that are typed: one action, once no further digit comes."""

from collections.abc import Callable
from typing import Any

import pytest

from cagesdf.viewing.settling import Settling, after_pause


class Later:
    """A timer that is over when a test says so."""

    def __init__(self, act: Callable[[], None]) -> None:
        self.act, self.cancelled = act, False

    def cancel(self) -> None:
        self.cancelled = True


class Keyboard:
    def __init__(self) -> None:
        self.text, self.taken, self.timers = "", list[str](), list[Later]()
        self.settling = Settling(lambda: self.taken.append(self.text), self.later)

    def later(self, act: Callable[[], None]) -> Any:
        self.timers.append(Later(act))
        return self.timers[-1]

    def types(self, text: str) -> None:
        for digit in text:
            self.text += digit
            self.settling.touch()


def test_a_number_is_taken_once_and_whole() -> None:
    keyboard = Keyboard()
    keyboard.types("0.14")
    assert keyboard.taken == []
    assert [timer.cancelled for timer in keyboard.timers] == [True, True, True, False]
    assert keyboard.settling.waits
    keyboard.timers[-1].act()
    assert keyboard.taken == ["0.14"]
    assert not keyboard.settling.waits
    keyboard.timers[-1].act()
    assert keyboard.taken == ["0.14"], "a timer that comes late does nothing"


def test_what_is_done_next_comes_after_the_number_and_what_is_dropped_never() -> None:
    keyboard = Keyboard()
    keyboard.types("12")
    keyboard.settling.flush()
    keyboard.settling.flush()
    assert keyboard.taken == ["12"]
    keyboard.types("3")
    keyboard.settling.drop()
    keyboard.settling.flush()
    assert keyboard.taken == ["12"]
    assert all(timer.cancelled for timer in keyboard.timers)


@pytest.mark.parametrize("cancelled", [False, True])
def test_the_real_timer_calls_the_guard_unless_it_is_cancelled(
    cancelled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cagesdf.viewing.settling.PAUSE", 60.0 if cancelled else 0.01)
    guarded: list[Callable[[], None]] = []

    def act() -> None:
        raise AssertionError("the guard calls it, not the timer")

    timer = after_pause(guarded.append, act)
    if cancelled:
        timer.cancel()
    timer.join()
    assert timer.daemon
    assert guarded == ([] if cancelled else [act])
