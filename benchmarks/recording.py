"""The README's moving picture: in the editor a cuboid is dragged, and the surface follows.

    python -m benchmarks.recording docs/pictures/drag.gif

drives the real page in Chromium: a shape of the demo is opened, the back's cuboid is pulled up by its handle and let
down again. Each frame is a screenshot 1.2 s after a movement, when the surface has followed.
"""

import argparse
import io
import tempfile
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from playwright.sync_api import FloatRect, sync_playwright

from cagesdf.api.sources import IMPORT
from cagesdf.cuboid import Cuboid
from cagesdf.demo import DEMO
from cagesdf.editing.parts import part_names
from cagesdf.inference.shapes import usual_settings
from cagesdf.training.precision import processor
from cagesdf.viewing.opening import opened
from cagesdf.viewing.scene import handle_place
from cagesdf.viewing.server import serving
from tests.support.chromium import FLAGS, chromium
from tests.support.page import Camera, EditorPage

STEPS = 10  # frames of the way up, and of that down
PIXELS = 9  # of one step
WIDTH = 480  # of a frame, pixels
COLOURS = 96


def top(cuboid: Cuboid) -> tuple[np.ndarray, np.ndarray]:
    """The handle of the face that looks up most, and that face's direction."""
    axis = int(np.abs(cuboid.axes[:, 1]).argmax())
    side = 1 if cuboid.axes[axis, 1] > 0 else -1
    return handle_place(cuboid, axis, side), side * cuboid.axes[axis]


def frames(page: EditorPage, camera: Camera, cuboid: Cuboid, crop: FloatRect) -> list[Image.Image]:
    """Screenshots of a drag there and back."""
    handle, up = top(cuboid)
    start = np.array(page.pixel(handle, camera))
    upwards = np.array(page.pixel(handle + 0.1 * up, camera)) - start
    upwards *= PIXELS / np.linalg.norm(upwards)
    mouse, pictures = page.page.mouse, []
    mouse.move(*start)
    page.page.wait_for_timeout(500)
    mouse.down()
    page.drawn()
    mouse.move(*(start + upwards / 3))  # a drag begins with the second movement
    page.drawn()
    for step in [*range(1, STEPS + 1), *range(STEPS - 1, 0, -1)]:
        mouse.move(*(start + step * upwards))
        page.page.wait_for_timeout(1200)  # where the cuboid snaps to a contact, the surface stays: no sign to wait for
        page.drawn()
        with Image.open(io.BytesIO(page.page.screenshot(clip=crop))) as image:
            height = round(WIDTH * image.height / image.width)
            pictures.append(image.convert("RGB").resize((WIDTH, height), Image.Resampling.LANCZOS))
    mouse.up()
    return pictures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--shape", default="", help="of the demo; otherwise the first")
    parser.add_argument("--label", default="back_surface", help="of the part that is dragged")
    arguments = parser.parse_args()
    torch.set_num_threads(2)
    run = opened(DEMO / "run", None, None, None, IMPORT, usual_settings())
    shape = arguments.shape or run.first
    state = run.session.opened(shape)
    names = part_names(state.structure)
    part = next(part for part in names if arguments.label in names[part] or arguments.label in part)
    with serving({"demo": run}, "127.0.0.1", 0, 2) as editor, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), headless=True, args=list(FLAGS))
        with tempfile.TemporaryDirectory() as folder:
            page = EditorPage(browser.new_page(viewport={"width": 1280, "height": 800}), editor.address, Path(folder))
            if page.value("Shape") != shape:
                before = page.settled()
                page.choose("Shape", shape)
                page.settled(before)
            page.page.locator("button.mantine-Notification-closeButton").first.click()  # of software rendering
            page.select(names[part])
            page.choose("Tool", "Resize")
            page.drawn(10)
            client = next(iter(editor.server.get_clients().values())).camera
            camera = Camera(np.array(client.position), np.array(client.look_at), client.fov, client.image_height)
            canvas = page.page.locator("canvas").first.bounding_box()
            assert canvas is not None
            x, y, width, height = (canvas[key] for key in ("x", "y", "width", "height"))
            crop = FloatRect(x=x + 0.05 * width, y=y + 0.05 * height, width=0.9 * width, height=0.9 * height)
            pictures = frames(page, camera, state.cage[part], crop)
        browser.close()
    first, *others = [picture.quantize(COLOURS, dither=Image.Dither.NONE) for picture in pictures]
    first.save(arguments.out, save_all=True, append_images=others, duration=120, loop=0, optimize=True)
    print(f"{len(pictures)} frames, {arguments.out.stat().st_size / 1e6:.2f} MB; on {processor()}")


if __name__ == "__main__":
    main()
