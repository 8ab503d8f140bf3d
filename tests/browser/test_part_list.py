"""The editor in a real browser: parts that come and go."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.page import LENGTHS, EditorPage

pytestmark = pytest.mark.slow
Visit = Callable[[], EditorPage]


def test_parts_are_hidden_by_their_eyes_locked_added_and_split(visit: Visit, tmp_path: Path) -> None:
    page = visit()
    before = page.settled()
    assert page.hidden == []
    page.eye("seat_surface").click()
    page.until(lambda: page.hidden == ["seat_surface"], "the seat hidden")
    page.drawn(5)
    page.picture("hidden")
    page.eye("seat_surface").click()
    page.until(lambda: page.hidden == [], "the seat shown")
    page.select("leg_1")
    page.press("Lock")
    page.page.keyboard.press("Delete")
    page.refused("leg_1 is locked")
    page.press("Lock")
    page.page.locator(".icon-tabler-lock").wait_for(state="detached")
    page.press("Add")
    page.until(lambda: page.numbers(LENGTHS).min() > 0 and page.selected == ["part"], "a new part")
    added = page.settled(before)
    assert np.ptp(page.numbers(LENGTHS)) < 1e-3
    page.picture("added")
    page.press("Split")
    page.until(lambda: len(page.selected) == 1 and page.selected != ["part"], "its other half")
    halves = page.settled(added)
    page.press("Undo")
    page.until(lambda: page.surface == added, "the whole part")
    page.press("Redo")
    page.until(lambda: page.surface == halves, "two halves")
    assert [operation["op"] for operation in page.script(tmp_path)] == ["add", "split", "undo", "redo"]
