"""The editor in a real browser: parts that come and go, keys, long work, warnings, names and refusals."""

import io
import re
import threading
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cagesdf.viewing.server import Editor
from tests.support.page import CENTRE, LENGTHS, EditorPage

pytestmark = pytest.mark.slow
Visit = Callable[[], EditorPage]


def along(editor: Editor, axis: int) -> bool:
    """Whether the newest page's camera looks along an axis."""
    way = np.abs(look(editor)[1])
    return bool(way[axis] > 10 * np.delete(way, axis).max())


def look(editor: Editor) -> tuple[np.ndarray, np.ndarray]:
    """From the newest page's camera: what it looks at, and the way there."""
    camera = editor.server.get_clients()[max(editor.server.get_clients())].camera
    target = np.array(camera.look_at)
    return target, target - np.array(camera.position)


def test_parts_are_hidden_by_their_eyes_locked_added_and_split(visit_narrow: Visit, tmp_path: Path) -> None:
    page = visit_narrow()
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


def test_nothing_follows_where_attaching_and_following_are_switched_off(visit_narrow: Visit) -> None:
    page = visit_narrow()
    before = page.settled()
    places = {}
    for part in ("leg_1", "leg_2", "seat_surface"):
        page.select(part)
        places[part] = np.concatenate([page.numbers(CENTRE), page.numbers(LENGTHS)])
    for box in ("Attached follow", "Mirrors follow", "Repeats follow"):
        page.control(box, "input").uncheck()
    page.set_number(CENTRE, 1, float(page.numbers(CENTRE)[1] + 0.05))
    page.settled(before)
    for part in ("leg_1", "leg_2"):
        page.select(part)
        np.testing.assert_array_equal(np.concatenate([page.numbers(CENTRE), page.numbers(LENGTHS)]), places[part])


def test_keys_take_tools_views_looks_and_parts(visit_narrow: Visit, editor: Editor) -> None:
    page = visit_narrow()
    keyboard = page.page.keyboard
    page.select("seat_surface")
    for key, tool in (("r", "Turn"), ("l", "Resize"), ("g", "Move")):
        keyboard.press(key)
        page.until(partial(lambda tool: page.value("Tool") == tool, tool), tool)
    _, far = look(editor)
    keyboard.press("f")
    page.until(lambda: np.linalg.norm(look(editor)[1]) < 0.95 * np.linalg.norm(far), "the seat framed")
    for key, axis in (("1", 2), ("3", 0), ("7", 1)):
        keyboard.press(key)
        page.until(
            partial(along, editor, axis),
            f"a view along axis {axis}",
        )
    keyboard.press("5")
    page.until(lambda: np.abs(look(editor)[1]).min() > 0.1, "the perspective view")
    page.tab("View")
    for name in ("Clay", "Wireframe", "Parts"):
        keyboard.press("z")
        page.until(partial(lambda name: page.value("Look") == name, name), name)
        page.drawn(5)
        page.picture(f"look_{name.lower()}")
    keyboard.press("h")
    page.until(lambda: page.hidden == ["seat_surface"], "the seat hidden")
    keyboard.press("Shift+H")
    page.until(lambda: page.hidden == [], "all shown")
    keyboard.press("b")
    page.until(lambda: len(page.selected) > 4, "all selected")
    keyboard.press("Escape")
    page.until(lambda: page.selected == [], "nothing selected")


def test_work_that_is_cancelled_ends_in_the_middle_of_a_step_and_leaves_nothing(visit_narrow: Visit) -> None:
    page = visit_narrow()
    before, shape = page.settled(), page.value("Shape")
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(24):
            mesh = trimesh.creation.icosphere(5)
            mesh.apply_translation([1.5 * (number % 6), 0, 1.5 * (number // 6)])
            archive.writestr(f"ball_{number}.stl", mesh.export(file_type="stl"))
    page.tab("File")
    page.upload("Load parts", "balls.zip", content.getvalue())
    page.until(lambda: "reading and closing parts" in page.status, "work at it")
    page.picture("working")
    assert "balls.zip" in {thread.name for thread in threading.enumerate()}
    page.press("Cancel: balls.zip")
    page.until(lambda: page.status == "balls.zip: cancelled", "cancelled")
    page.until(lambda: "balls.zip" not in {thread.name for thread in threading.enumerate()}, "the step ended")
    assert (page.surface, page.value("Shape")) == (before, shape)
    assert "balls" not in page.refusals
    page.tab("New")
    page.press("New shape")
    page.press("Cancel: New shape")
    page.until(lambda: page.status == "New shape: cancelled", "that cancelled")
    page.until(lambda: "New shape" not in {thread.name for thread in threading.enumerate()}, "its step ended")
    assert page.value("Shape") == shape


def test_a_part_that_is_too_thin_is_warned_of_and_directions_end_where_training_codes_do(
    visit_narrow: Visit, tmp_path: Path
) -> None:
    page = visit_narrow()
    before = page.settled()
    for box in ("Attached follow", "Mirrors follow", "Repeats follow"):
        page.control(box, "input").uncheck()
    page.select("leg_1")
    page.set_number(LENGTHS, 0, 0.004)
    page.settled(before)
    page.page.get_by_text(re.compile("leg_1 is .* file units, .* cells thick; wanted 2 cells")).wait_for()
    page.picture("warning")
    page.press("Reset")
    page.until(lambda: page.surface == before, "the surface at first")
    page.page.get_by_text("wanted 2 cells").wait_for(state="detached")
    page.tab("Style")
    page.slide("Direction 1", 99)
    page.settled(before)
    assert 0 < float(page.control("Direction 1", "input").last.input_value()) < 10
    ends = page.page.locator("img:not(.tile)")
    page.until(lambda: ends.count() >= 5, "pictures of both ends")
    page.picture("directions")
    assert [operation["op"] for operation in page.script(tmp_path)] == ["style"]


def test_new_shapes_have_names_of_their_own_the_newest_first_and_plain_names_of_numbers(
    visit_narrow: Visit, tmp_path: Path
) -> None:
    page = visit_narrow()
    before = page.settled()
    for name in ("new", "new_2"):
        page.tab("New")
        page.press("New shape")
        page.until(partial(lambda name: page.value("Shape") == name, name), name)
        before = page.settled(before)
    page.until(lambda: page.drawn_tile("new") and page.drawn_tile("new_2"), "pictures of both")
    tiles = [text.strip() for text in page.page.locator("button:has(img.tile)").all_inner_texts()]
    assert [text for text in tiles if text.startswith("new")] == ["new_2", "new"]
    assert not page.page.get_by_text("Mark", exact=True).is_visible()
    page.tab("Cuboids")
    page.page.get_by_text("Through the program").click()
    page.control("Of").first.click()
    groups = page.page.get_by_role("option").all_inner_texts()
    page.page.keyboard.press("Escape")
    page.control("Parameter").first.click()
    numbers = page.page.get_by_role("option").all_inner_texts()
    page.picture("parameters")
    page.page.keyboard.press("Escape")
    assert any(group in page.parts for group in groups)
    assert any(number in ("width", "height", "depth") for number in numbers)
    assert not any("Program_" in text for text in (*groups, *numbers))
    page.tab("File")
    assert page.download("Export", tmp_path).name == "new_2.glb"


def test_what_is_wrong_with_a_file_names_it_as_its_owner_does_until_it_is_dismissed(visit_narrow: Visit) -> None:
    page = visit_narrow()
    page.tab("File")
    page.upload("Load parts", "My chair.OBJ", b"v 0 0 0\nf 1 2 3\n")
    page.refused("My chair.OBJ, line 2")
    page.until(lambda: page.status == "ready", "the work at its end")
    page.picture("wrong_file")
    page.page.wait_for_timeout(3000)
    notice = page.page.locator(".mantine-Notification-root", has_text="My chair.OBJ, line 2")
    red = notice.evaluate("notice => getComputedStyle(notice, '::before').backgroundColor")
    red, green, blue = (int(number) for number in re.findall(r"\d+", red)[:3])
    assert red > 1.5 * max(green, blue)
    notice.locator("button").click()
    notice.wait_for(state="detached")
    page.upload("Load script", "My legs.json", b"[{]")
    page.refused("My legs.json: is no JSON")
