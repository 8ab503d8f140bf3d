"""Latency from a drag to its surface, through a browser: the table of docs/editor.md.

    python -m benchmarks.viewing [data/runs/chair/cagesdf] [--moves 60]

drags cuboids of one shape by the gizmo: from each movement of the mouse until the page names the coarse surface, and
until it names the fine one, the hand at rest. Without a run, the demo's. The browser draws without a graphics card
here, on the same cores: with one it is faster.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import torch
from playwright.sync_api import sync_playwright

from cagesdf.api.sources import imported
from cagesdf.cuboid import Cage
from cagesdf.demo import DEMO
from cagesdf.editing.parts import part_names
from cagesdf.inference.shapes import usual_settings
from cagesdf.training.precision import processor
from cagesdf.viewing.opening import opened
from cagesdf.viewing.scene import GIZMO_PIXELS
from cagesdf.viewing.server import serving
from cagesdf.viewing.worker import COARSE, FINE
from tests.support.chromium import FLAGS, chromium
from tests.support.page import Camera, EditorPage

# Of the page: from the next movement of the mouse until the status names a surface of this many cells; with its text.
CLOCK = """(box, cells) => { window.took = new Promise(done => addEventListener("pointermove", event => {
    const timer = setInterval(() => {
        if (!box.value.startsWith(`${cells} cells`)) return;
        clearInterval(timer);
        done([(performance.now() - event.timeStamp) / 1000, box.value]);
    }, 2);
}, {capture: true, once: true})) }"""
STEPS = 10  # movements of one drag
PIXELS = 6  # of one movement


def grip(cage: Cage, part: str, camera: Camera) -> np.ndarray:
    """A point of the gizmo's arrow that goes upwards most."""
    cuboid = cage[part]
    up = int(np.abs(cuboid.axes[:, 1]).argmax())
    return cuboid.centre + 0.9 * GIZMO_PIXELS * camera.pixel_at(cuboid.centre) * cuboid.axes[up]


def drags(
    page: EditorPage, camera: Camera, cage: Cage, parts: list[tuple[str, str]], moves: int
) -> dict[int, list[tuple[float, float]]]:
    """Seconds by cells: from each movement to its surface, and of the extraction alone."""
    result: dict[int, list[tuple[float, float]]] = {COARSE: [], FINE: []}
    mouse = page.page.mouse
    for part, name in parts * moves:
        if len(result[COARSE]) >= moves:
            break
        page.settled()
        page.select(name)
        x, y = page.pixel(grip(cage, part, camera), camera)
        mouse.move(x, y)
        page.page.wait_for_timeout(800)
        mouse.down()
        page.page.wait_for_timeout(200)
        for i in range(1, STEPS + 1):
            for cells in (COARSE, FINE):
                page.settled()
                page.control("Status").first.evaluate(CLOCK, cells)
                mouse.move(x + (cells == FINE), y - PIXELS * i)
                seconds, status = page.page.evaluate("() => window.took")
                result[cells].append((seconds, float(status.split(" in ")[1].split(" s")[0])))
        mouse.up()
        page.page.wait_for_timeout(1000)
        page.press("Reset")
        page.page.wait_for_timeout(1500)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, nargs="?", default=DEMO / "run")
    parser.add_argument("--moves", type=int, default=60)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    run = opened(arguments.run, None, None, None, imported, usual_settings())
    state = run.session.opened(run.first)
    names = part_names(state.structure)
    with serving({"demo": run}, "127.0.0.1", 0, 2) as editor, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), headless=True, args=list(FLAGS))
        with tempfile.TemporaryDirectory() as folder:
            page = EditorPage(browser.new_page(viewport={"width": 1200, "height": 800}), editor.address, Path(folder))
            client = next(iter(editor.server.get_clients().values())).camera
            camera = Camera(np.array(client.position), np.array(client.look_at), client.fov, client.image_height)
            latencies = drags(page, camera, state.cage, [(part, names[part]) for part in names], arguments.moves)
        browser.close()
    print(f"On {processor()}.\n")
    print("| cells | n | p50 s | p95 s | largest s | the surface alone, p50 s |\n|---|---|---|---|---|---|")
    for cells, seconds in latencies.items():
        whole, making = np.array(seconds).T
        p50, p95 = np.percentile(whole, [50, 95])
        print(f"| {cells} | {len(whole)} | {p50:.2f} | {p95:.2f} | {whole.max():.2f} | {np.median(making):.2f} |")


if __name__ == "__main__":
    main()
