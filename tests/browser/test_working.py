"""The editor in a real browser: one page in which someone works for a while. Each test leaves the shape as it was."""

import io
import re
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import Browser, Dialog, Locator

from cagesdf.demo import DEMO
from cagesdf.editing.script import Style, dump
from cagesdf.editing.session import Live, Session
from cagesdf.editing.state import State
from cagesdf.extraction import Each
from cagesdf.formats.obj import read_obj_groups
from cagesdf.io.runs import read_run
from cagesdf.viewing import drawing
from cagesdf.viewing.keys import KEYS
from cagesdf.viewing.scene import LOOKS
from cagesdf.viewing.server import Editor
from tests.browser.conftest import visiting
from tests.support.page import CENTRE, EditorPage

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page(browser: Browser, editor: Editor, screenshots: Path) -> Iterator[EditorPage]:
    with visiting(browser, editor, screenshots) as come:
        yield come()


def camera_direction(editor: Editor) -> np.ndarray:
    """From what is looked at to the camera of the newest page; unit."""
    camera = editor.server.get_clients()[max(editor.server.get_clients())].camera
    offset = np.array(camera.position) - np.array(camera.look_at)
    return offset / np.linalg.norm(offset)


def along(editor: Editor, axis: int) -> bool:
    """Whether the newest page looks along an axis."""
    return bool(abs(camera_direction(editor)[axis]) > 0.99)


def reads(page: EditorPage, label: str, text: str) -> bool:
    return page.value(label) == text


def pixels(picture: Locator) -> np.ndarray:
    with Image.open(io.BytesIO(picture.screenshot())) as shot:
        return np.array(shot.convert("L")).astype(int)


def test_keys_do_what_the_card_says(page: EditorPage, editor: Editor) -> None:
    press, names = page.page.keyboard.press, [*page.parts]
    page.tab("Cuboids")
    for key, tool in (("r", "Turn"), ("l", "Resize"), ("g", "Move")):
        press(key)
        page.until(partial(reads, page, "Tool", tool), f"{tool} by {key}")
    press("b")
    page.until(lambda: page.selected == names, "everything selected")
    press("Escape")
    page.until(lambda: page.status == "selected: nothing" and page.selected == [], "nothing selected")
    page.select(names[0])
    press("h")
    page.until(lambda: page.hidden == names[:1], "it is hidden")
    press("Shift+H")
    page.until(lambda: page.hidden == [], "everything is shown")
    for key, axis in (("1", 2), ("3", 0), ("7", 1)):
        press(key)
        page.until(partial(along, editor, axis), f"a view along {'xyz'[axis]}")
    press("5")
    page.until(lambda: bool(np.abs(camera_direction(editor)).max() < 0.9), "the perspective view")
    page.tab("View")
    for look in (*LOOKS[1:], LOOKS[0]):
        press("z")
        page.until(partial(reads, page, "Look", look), look)
    press("c")
    page.until(lambda: not page.control("Show cuboids", "input").is_checked(), "no cuboids")
    press("c")
    press("i")
    card = page.page.get_by_role("dialog")
    card.get_by_text("Shift+click").wait_for()
    text = card.inner_text()
    assert all(str(key) in text and keys[0].does.lower() in text for keys in KEYS.values() for key in keys)
    page.picture("card")
    card.get_by_role("button", name="Close").click()
    card.wait_for(state="detached")
    press("Control+k")
    page.page.get_by_placeholder(re.compile("search|command", re.IGNORECASE)).fill("frame the")
    page.page.get_by_text("Frame the selection").wait_for()
    page.picture("palette")
    press("Escape")


def test_a_direction_has_a_picture_of_both_ends(page: EditorPage) -> None:
    page.tab("Style")
    picture = page.page.locator("img:not(.tile)").filter(visible=True).first

    def halves() -> tuple[np.ndarray, np.ndarray]:
        shot = pixels(picture)
        middle = shot.shape[1] // 2
        return shot[:, :middle], shot[:, -middle:]

    page.until(lambda: min(half.std() for half in halves()) > 5, "a surface in both halves")
    low, high = halves()
    assert np.abs(low - high).mean() > 1, "two different surfaces"
    page.picture("directions")


def endless(state: State, live: Live, each: Each) -> int:
    while True:
        time.sleep(0.05)


def test_long_work_says_how_far_it_is_and_is_cancelled_and_nothing_has_changed(
    page: EditorPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drawing, "tears", endless)
    before, shape = page.settled(), page.value("Shape")
    page.tab("Shapes")
    tiles = page.page.locator("img.tile").filter(visible=True).count()
    page.press("New shape")
    page.press("Cancel: New shape")
    page.until(lambda: page.status == "New shape: cancelled", "cancelled")
    assert page.page.get_by_role("button", name="Cancel", exact=True).is_disabled()
    page.press("New shape")
    page.until(lambda: re.match(r"New shape: .* of at most 5", page.status) is not None, "what is done")
    page.picture("busy")
    part = next(iter(page.parts))
    page.press(part)
    page.until(lambda: page.selected == [part], "everything else goes on meanwhile")
    page.press("Cancel: New shape")
    page.until(lambda: page.page.get_by_role("button", name="Cancel", exact=True).is_disabled(), "cancelled again")
    assert (page.surface, page.value("Shape")) == (before, shape)
    assert page.page.locator("img.tile").filter(visible=True).count() == tiles, "a picture of a new shape"


def test_a_surface_in_pieces_is_warned_of_and_a_sound_one_isn_t(page: EditorPage) -> None:
    before = page.settled()
    page.page.get_by_text("Health: closed, 1 component").wait_for()
    assert "⚠" not in page.page.locator("body").inner_text()
    session = Session(read_run(DEMO / "run"))
    code = -3 * session.opened(page.value("Shape")).latent
    page.tab("File")
    script = dump((Style(code=tuple(code.tolist())),))
    page.upload("Load script", "torn.json", script.encode())
    page.settled(before)
    page.page.get_by_text("in pieces, or without a surface; another style or thicker cuboids help").wait_for()
    page.page.get_by_text(re.compile("thick; wanted 2 cells: [0-9]+ cells would hold it")).wait_for()
    page.picture("warning")
    page.press("Undo")
    page.until(lambda: page.surface == before, "the surface of before")
    page.page.get_by_text("⚠").wait_for(state="detached")
    page.press("Reset")


def test_made_shapes_have_names_and_stand_in_the_list_newest_first(page: EditorPage, tmp_path: Path) -> None:
    first, before = page.value("Shape"), page.settled()
    program = (
        "Assembly Program_0 {\nbbox = Cuboid(1.0, 1.0, 1.0, True)\ncube0 = Cuboid(0.8, 0.1, 0.8, True)\n"
        "cube1 = Cuboid(0.1, 0.5, 0.1, True)\nattach(cube1, bbox, 0.5, 0.0, 0.5, 0.1, 0.0, 0.1)\n"
        "attach(cube0, cube1, 0.1, 0.0, 0.1, 0.5, 1.0, 0.5)\nreflect(cube1, X)\n}\n"
    )
    page.tab("File")
    for name in ("My stool", "other"):
        page.upload("Load program", f"{name}.txt", program.encode())
        page.until(partial(reads, page, "Shape", name), name)
    assert not any("cube" in part or "Program" in part for part in page.parts)
    page.page.keyboard.press("Escape")
    page.control("Shape").first.click()
    options = [option.strip() for option in page.page.get_by_role("option").all_inner_texts()]
    assert options[:3] == ["other", "My stool", first]
    assert {"chair_0001", "table_0000", "vase_0000"} <= {*options}
    page.page.keyboard.press("Escape")
    page.tab("Shapes")
    page.until(lambda: page.drawn_tile("My stool") and page.drawn_tile("other"), "pictures of both")
    tiles = page.page.locator("button", has=page.page.locator("img.tile")).filter(visible=True)
    assert [text.strip() for text in tiles.all_inner_texts()] == ["other", "My stool", *options[2:11]]
    page.picture("made")
    page.tab("File")
    page.choose("Format", "obj")
    export = page.download("Export", tmp_path)
    assert export.name == "other.obj"
    assert {name for name, _ in read_obj_groups(export)} == {*page.parts}
    page.tab("Cuboids")
    page.page.get_by_text("Through the program").click()
    page.control("Of").first.click()
    groups = page.page.get_by_role("option").all_inner_texts()
    assert {*page.parts} & {*groups}
    assert not any("cube" in group or "Program" in group for group in groups)
    page.page.keyboard.press("Escape")
    page.choose("Shape", first)
    page.until(lambda: page.surface == before, "the first shape")


def test_a_shape_is_opened_by_its_picture_and_gets_one_more_spindle_in_one_step(
    page: EditorPage, tmp_path: Path
) -> None:
    before = page.settled()
    page.tab("Shapes")
    page.until(lambda: page.drawn_tile("chair_0007"), "its picture")
    page.page.locator("button", has_text=re.compile("^chair_0007$")).filter(visible=True).click()
    page.until(lambda: page.value("Shape") == "chair_0007", "the chair")
    chair, parts = page.settled(before), [*page.parts]
    spindles = [part for part in parts if part.startswith("spindle")]
    page.select(spindles[0])
    page.press("One more")
    page.until(lambda: len(page.parts) == len(parts) + 1, "one more")
    page.settled(chair)
    page.picture("one_more")
    page.tab("File")
    page.choose("Format", "glb")
    scene = trimesh.load_scene(page.download("Export", tmp_path))
    solids = [scene.geometry[name] for name in scene.geometry if name.startswith("parts/spindle")]
    assert len(solids) == len(spindles) + 1
    assert all(solid.is_watertight for solid in solids)
    places = np.sort([solid.bounds.mean(axis=0)[0] for solid in solids])
    np.testing.assert_allclose(np.diff(places), np.diff(places).mean(), rtol=0.05)
    page.press("Undo")
    page.until(lambda: page.surface == chair, "the chair as it was")
    assert [*page.parts] == parts


def test_work_is_offered_again_after_the_page_is_loaded_anew(page: EditorPage) -> None:
    page.tab("Cuboids")
    before, shape, part = page.settled(), page.value("Shape"), next(iter(page.parts))
    page.select(part)
    page.set_number(CENTRE, 1, float(page.numbers(CENTRE)[1] + 0.03))
    moved = page.settled(before)
    page.page.once("dialog", Dialog.accept)
    page.page.reload(wait_until="commit")
    page.until(lambda: page.page.get_by_text("Mark", exact=True).count() > 0, "the page")
    page.page.get_by_role("button", name=re.compile(f"^Continue {shape}: 1 change, ")).click()
    page.until(lambda: page.surface == moved, "the moved part")
    page.press("Reset")
    page.until(lambda: page.surface == before, "as it was at first")
    page.press("Undo")
    page.until(lambda: page.surface == moved, "the moved part again")
    page.press("Undo")
    page.until(lambda: page.surface == before, "as it was")
    page.page.get_by_role("button", name="Forget all").click()  # work of the tests before
    again = page.page.get_by_role("button", name=re.compile("^Click again to forget [0-9]+$"))
    again.wait_for()
    assert page.page.get_by_text("Earlier work").count() > 0, "nothing is forgotten at the first click"
    again.click()
    page.until(lambda: page.page.get_by_text("Earlier work").count() == 0, "nothing to continue")
