"""The editor in a real browser: the parts of a whole mesh, changed by hand."""

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cagesdf.cli.shapes import parts
from cagesdf.geometry.meshes import join
from cagesdf.viewing.colours import SELECTED
from tests.support import toy
from tests.support.page import CENTRE, EditorPage

pytestmark = pytest.mark.slow
Visit = Callable[[], EditorPage]
LEGS = [(820, -180), (1180, -180), (820, 180), (1180, 180)]  # x and z of the centres, millimetres
STOOL = join([toy.box((1000, 400, 0), (400, 40, 400)), *(toy.box((x, 190, z), (40, 380, 40)) for x, z in LEGS)])


def pinks(page: EditorPage) -> int:
    """Pixels of the view that are nearer to the selection's colour than to any grey."""
    canvas = page.page.locator("canvas").first
    with Image.open(io.BytesIO(canvas.screenshot())) as picture:
        pixels = np.array(picture.convert("RGB")).astype(int)
    red, green, blue = np.moveaxis(pixels, -1, 0)
    assert SELECTED[0] > SELECTED[2] > SELECTED[1]
    return int(((red > green + 30) & (blue > green + 10) & (red > blue)).sum())


def test_parts_that_are_found_are_merged_split_renamed_fitted_again_and_saved(visit: Visit, tmp_path: Path) -> None:
    page = visit()
    before = page.settled()
    toy.write_obj(tmp_path / "stool.obj", STOOL)  # one mesh without groups
    page.tab("File")
    page.upload("Load parts", "stool.obj", (tmp_path / "stool.obj").read_bytes())
    page.page.get_by_text("5 cuboids found").wait_for()
    first_fit = page.settled(before)
    assert [*page.parts] == [f"part_{number}" for number in range(1, 6)]
    page.tab("Found parts")
    page.control("Select several", "input").check()
    page.press("part_2")
    page.until(lambda: page.selected == ["part_2"], "one leg selected")
    page.press("part_3")
    page.until(lambda: page.selected == ["part_2", "part_3"], "two legs selected")
    page.press("Merge")
    page.until(lambda: page.status == "stool: 4 parts, not fitted yet", "two legs in one")
    assert [*page.parts] == ["part_1", "part_2", "part_4", "part_5"]
    page.control("Select several", "input").uncheck()
    page.select("part_1")
    page.tab("Cuboids")
    np.testing.assert_allclose(page.numbers(CENTRE), [1000, 400, 0], atol=1)
    page.tab("Found parts")
    page.dismiss()
    page.drawn()
    outlined = pinks(page)
    page.choose("Across", "x")
    page.until(lambda: page.numbers("At (file units)")[-1] == 1000, "the middle of the seat")
    page.slide("At (file units)", 1100)
    page.until(lambda: pinks(page) > outlined + 100, "a plane through the seat")
    page.picture("plane")
    page.press("Split there")
    page.until(lambda: page.status == "stool: 5 parts, not fitted yet", "two seats")
    page.tab("Cuboids")
    page.select("part_1_2")
    np.testing.assert_allclose(page.numbers(CENTRE), [1150, 400, 0], atol=1)
    page.tab("Found parts")
    page.control("Name").first.fill("flap")
    page.press("Rename")
    page.until(lambda: "flap" in page.parts, "the name in the list")
    page.press("Undo")
    page.until(lambda: "part_1_2" in page.parts, "the name of before")
    page.press("Redo")
    page.until(lambda: "flap" in page.parts, "the new name")
    page.picture("in parts")
    page.tab("File")
    page.press("Export")
    page.refused("press Fit again")
    page.tab("Found parts")
    page.press("Fit again")
    fitted = page.settled(first_fit)
    page.page.get_by_text("from the file's surface").wait_for()
    page.picture("fitted again")
    written = page.download("Save parts", tmp_path)
    changes = ("merge part_2 part_3", "split part_1 x 1100", "rename part_1_2 flap")
    parts(tmp_path / "stool.obj", tmp_path / "command", change=changes)
    assert written.name == "stool.parts.json"
    assert json.loads(written.read_text()) == json.loads((tmp_path / "command" / "stool.parts.json").read_text())
    page.press("Undo")
    page.until(lambda: "not fitted yet" in page.status, "the mesh in its parts")
    page.press("Redo")
    page.until(lambda: page.surface == fitted, "the fitted surface")
    kinds = [operation["op"] for operation in page.script(tmp_path)]
    assert kinds == ["build", "style", "build", "build", "build", "undo", "redo", "build", "style", "undo", "redo"]
