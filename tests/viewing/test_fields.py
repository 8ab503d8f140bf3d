"""Numbers in boxes: read as they were written, taken once, and only those that were typed."""

import math
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cagesdf.viewing import fields
from cagesdf.viewing.fields import NumberField, Typed, read, written

VALUES = (0.1234, -2.0, 30.0)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=4), st.integers(0, 6))
def test_what_is_written_is_read_to_its_decimals(values: list[float], decimals: int) -> None:
    numbers = read(written(values, decimals), len(values))
    assert numbers is not None
    for number, value in zip(numbers, values, strict=True):
        assert abs(number - value) <= 0.5000001 * 10.0**-decimals
    assert "-0 " not in written([-1e-9, 1.0], 0)


@given(st.integers(-30, 30), st.tuples(*[st.floats(-1, 1)] * 3))
def test_numbers_of_shapes_of_any_size_are_written_to_a_ten_thousandth_and_read(power: int, shares: Typed) -> None:
    values = [share * 10.0**power for share in shares if share is not None]
    numbers = read(written(values, 4 - power), 3)
    assert numbers is not None
    assert max(abs(number - value) for number, value in zip(numbers, values, strict=True)) <= 1e-4 * 10.0**power


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("1 2 3", (1, 2, 3)),
        (" .5  -0.05\t1e-3 ", (0.5, -0.05, 0.001)),
        ("1, 2, 3", (1, 2, 3)),
        ("0,5 1,25; -3,0", (0.5, 1.25, -3)),
        ("--1 2. +3", (-1, 2, 3)),
    ],
)
def test_numbers_are_read_as_people_write_them(text: str, numbers: Typed) -> None:
    assert read(text, 3) == numbers


@pytest.mark.parametrize(
    "text", ["", "1 2", "1 2 3 4", "1 - 3", "1 2 x", "nan 1 2", "inf 1 2", "1_0 1 2", "1 2 1e999", "٣ 1 2"]
)
def test_what_is_no_numbers_is_none(text: str) -> None:
    assert read(text, 3) is None


@given(st.text(max_size=30), st.integers(1, 3))
def test_any_text_is_read_or_not(text: str, count: int) -> None:
    numbers = read(text, count)
    assert numbers is None or (len(numbers) == count and all(map(math.isfinite, numbers)))


class Keyboard:
    """A field, and somebody who types into it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.taken: list[Typed] = []
        self.timers: list[Any] = []
        monkeypatch.setattr(fields, "after_pause", self._later)
        self.box = SimpleNamespace(value="", disabled=True, on_update=lambda act: setattr(self, "updated", act))
        self.updated: Any
        self.field = NumberField(self.box, 3, self.taken.append, lambda act: act())

    def _later(self, guard: Any, act: Any) -> Any:
        self.timers.append(act)
        return SimpleNamespace(cancel=lambda: None)

    def types(self, text: str, whole: bool = False) -> None:
        """Letter by letter, or at once."""
        for end in range(len(text) if whole else 1, len(text) + 1):
            self.box.value = text[:end]
            self.updated(SimpleNamespace(client=1))

    def pauses(self) -> None:
        self.timers[-1]()


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Keyboard:
    keyboard = Keyboard(monkeypatch)
    keyboard.field.show(VALUES, 2)
    return keyboard


def test_numbers_are_taken_once_and_those_that_stayed_are_none(keyboard: Keyboard) -> None:
    assert keyboard.box.value == "0.12  -2.00  30.00"
    keyboard.types("0.12 -0.05 30.00")
    assert keyboard.taken == []
    keyboard.pauses()
    assert keyboard.taken == [(None, -0.05, None)], "0.1234 isn't rounded by typing another number"
    keyboard.field.flush()
    assert len(keyboard.taken) == 1


def test_nothing_is_taken_of_what_isn_t_whole_or_isn_t_new(keyboard: Keyboard) -> None:
    for text in ("0.12 - 30", "0.12 -2 30", ""):
        keyboard.types(text, whole=True)
        keyboard.pauses()
    assert keyboard.taken == []


def test_a_box_that_somebody_types_into_keeps_its_text_and_others_are_shown_anew(keyboard: Keyboard) -> None:
    keyboard.types("0.5 -2", whole=True)
    keyboard.field.show((7.0, 8.0, 9.0), 0)
    assert keyboard.box.value == "0.5 -2"
    keyboard.pauses()
    keyboard.field.show((7.0, 8.0, 9.0), 0)
    assert keyboard.box.value == "7  8  9"
    keyboard.field.show(None, 0)
    assert (keyboard.box.value, keyboard.box.disabled) == ("", True)


def test_what_is_dropped_is_never_taken_and_what_is_flushed_at_once(keyboard: Keyboard) -> None:
    keyboard.types("1 2 3", whole=True)
    keyboard.field.drop()
    keyboard.pauses()
    keyboard.field.flush()
    assert keyboard.taken == []
    keyboard.types("1 2 30", whole=True)
    keyboard.field.flush()
    assert keyboard.taken == [(1, 2, None)]
