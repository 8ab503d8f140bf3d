"""The pictures of docs/editor.md: screenshots of someone at work in the editor.

    python -m benchmarks.pictures docs/pictures

opens the demo in Chromium, gives a chair with slats another chair's legs and one more slat (editor.png), and draws
three new shapes, of which the second is open (editor_new.png).
"""

import argparse
import io
import tempfile
from functools import partial
from pathlib import Path

import torch
from PIL import Image
from playwright.sync_api import sync_playwright

from cagesdf.api.sources import IMPORT
from cagesdf.demo import DEMO
from cagesdf.inference.shapes import usual_settings
from cagesdf.viewing.opening import opened
from cagesdf.viewing.server import serving
from tests.support.chromium import FLAGS, chromium
from tests.support.page import EditorPage

CHAIR, LEGS = "chair_0002", "chair_0007"
NEW = ("new", "new_2", "new_3")
SIZE = (1280, 800)
WIDTH = 1024  # of a picture, pixels
COLOURS = 128


def save(page: EditorPage, path: Path) -> None:
    """A screenshot without notices."""
    page.dismiss()
    page.page.mouse.move(SIZE[0] / 2, 2)
    page.page.wait_for_timeout(1000)
    page.drawn()
    with Image.open(io.BytesIO(page.page.screenshot())) as image:
        size = WIDTH, round(WIDTH * image.height / image.width)
        small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    small.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


def mixed(page: EditorPage) -> None:
    """A chair with another one's legs and one more slat, which is selected; pictures of styles."""
    before = page.settled()
    page.choose("Shape", CHAIR)
    before = page.settled(before)
    page.press("all 4: leg")
    page.tab("Style")
    page.choose("Style of", LEGS)
    before = page.settled(before)
    page.tab("Cuboids")
    parts = [*page.parts]
    page.select(next(part for part in parts if part.startswith("slat")))
    page.press("One more")
    page.until(lambda: len(page.parts) > len(parts), "one more slat")
    page.settled(before)


def _open(page: EditorPage, name: str) -> bool:
    return page.value("Shape") == name


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    run = opened(DEMO / "run", None, DEMO / "programs", None, IMPORT, usual_settings())
    with serving({"demo": run}, "127.0.0.1", 0, 2) as editor, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), headless=True, args=list(FLAGS))
        with tempfile.TemporaryDirectory() as folder:
            page = EditorPage(
                browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]}), editor.address, Path(folder)
            )
            mixed(page)
            page.tab("Style")
            page.until(lambda: all(map(page.drawn_tile, page.tiles)), "pictures of styles")
            save(page, arguments.out / "editor.png")
            page.tab("Shapes")
            for name in NEW:
                before = page.settled()
                page.press("New shape")
                page.until(partial(_open, page, name), name)
                page.settled(before)
            page.until(lambda: all(page.drawn_tile(name) for name in NEW), "pictures of the new shapes")
            before = page.settled()
            page.choose("Shape", NEW[1])
            page.settled(before)
            page.tab("Shapes")
            save(page, arguments.out / "editor_new.png")
        browser.close()


if __name__ == "__main__":
    main()
