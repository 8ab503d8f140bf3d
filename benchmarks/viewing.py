"""Latencies of the editor, through a browser and by the page's own clock: the table of docs/editor.md.

    python -m benchmarks.viewing [data/runs/chair/cagesdf] [--moves 40]

measures, from an event of the mouse until the page says the result: a click until the selection; a movement of a
dragged arrow until the coarse surface and, the hand at rest, the fine one; a click on a style, on New shape, and an
upload of six meshes until their first surface; a click on Export until the file. Without a run, the demo's. The
browser draws without a graphics card here, on the same cores: how long one frame takes is measured, too.
"""

import argparse
import io
import re
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
import trimesh
from playwright.sync_api import sync_playwright

from cagesdf.api.sources import IMPORT
from cagesdf.cuboid import Cage
from cagesdf.demo import DEMO
from cagesdf.editing.parts import part_names
from cagesdf.inference.shapes import usual_settings
from cagesdf.training.precision import processor
from cagesdf.viewing.opening import opened
from cagesdf.viewing.picking import along
from cagesdf.viewing.scene import GIZMO_PIXELS
from cagesdf.viewing.server import serving
from cagesdf.viewing.worker import FINE_CELLS, PREVIEW_CELLS
from tests.support.chromium import FLAGS, chromium
from tests.support.page import Camera, EditorPage

# In the page: from the next event of a kind until the status matches each of some patterns in turn, or, without any,
# until a file is given to save. The event's own time counts, however long it waited for its turn.
CLOCK = """([status, kind, wanted]) => { window.took = new Promise((done, fail) => addEventListener(kind, event => {
    const seconds = [], passed = () => (performance.now() - event.timeStamp) / 1000;
    setTimeout(() => fail(new Error(`${kind}: not all of ${wanted} after a minute`)), 60000);
    if (!wanted.length) {
        const create = URL.createObjectURL;
        URL.createObjectURL = content => {
            URL.createObjectURL = create;
            done([passed()]);
            return create.call(URL, content);
        };
        return;
    }
    const before = status.value;
    const timer = setInterval(() => {
        if (!seconds.length && status.value === before) return;
        if (new RegExp(wanted[seconds.length]).test(status.value)) seconds.push(passed());
        if (seconds.length < wanted.length) return;
        clearInterval(timer);
        done(seconds);
    }, 2);
}, {capture: true, once: true})) }"""
# Times of frames from now on, until `window.going` is false.
FRAMES = """() => { window.times = []; window.going = true;
    const next = now => { times.push(now); if (going) requestAnimationFrame(next) };
    requestAnimationFrame(next) }"""
TURNS = 40  # movements of the mouse by which the camera is turned
STEPS = 10  # movements of one drag
PIXELS = 6  # of one movement
REPEATS = 5  # of what takes seconds
STOOL = {"seat": ([400, 40, 400], [0, 400, 0]), "back": ([400, 500, 40], [0, 670, -180])} | {
    f"leg_{number}": ([40, 380, 40], [x, 190, z])
    for number, (x, z) in enumerate([(-180, -180), (180, -180), (-180, 180), (180, 180)])
}  # extents and centres of boxes, millimetres


@dataclass(frozen=True)
class Row:
    """Some latencies, and those that issue 18 wants."""

    name: str
    seconds: list[float]
    wanted: str

    def __str__(self) -> str:
        p50, p95 = np.percentile(self.seconds, [50, 95])
        n, largest = len(self.seconds), max(self.seconds)
        return f"| {self.name} | {n} | {p50:.2f} | {p95:.2f} | {largest:.2f} | {self.wanted} |"


def timed(page: EditorPage, kind: str, act: Callable[[], None], *wanted: str) -> list[float]:
    """Seconds from the next event of a kind, which `act` brings about, until the status says each of `wanted`; a file's
    without any."""
    status = page.control("Status").first.element_handle()
    page.page.evaluate(CLOCK, [status, kind, wanted])
    act()
    return list(page.page.evaluate("() => window.took"))


def grip(cage: Cage, part: str, camera: Camera) -> np.ndarray:
    """A point of the gizmo's arrow that goes upwards most."""
    cuboid = cage[part]
    up = int(np.abs(cuboid.axes[:, 1]).argmax())
    return cuboid.centre + 0.9 * GIZMO_PIXELS * camera.pixel_at(cuboid.centre) * cuboid.axes[up]


def clicks(page: EditorPage, camera: Camera, cage: Cage, names: dict[str, str], count: int) -> list[float]:
    """Clicks in the view on cuboids that are in front, in turn."""
    front = [part for part in names if along(cage, camera.position, cage[part].centre - camera.position)[0] == part]
    seconds = []
    for number in range(count):
        part = front[number % len(front)]
        x, y = page.pixel(cage[part].centre, camera)
        page.page.keyboard.press("Escape")
        page.until(lambda: page.status == "selected: nothing", "nothing selected")
        page.page.mouse.move(x, y)
        page.drawn()
        seconds += timed(
            page, "pointerup", partial(page.page.mouse.click, x, y), f"^selected: {re.escape(names[part])}$"
        )
    return seconds


def drags(page: EditorPage, camera: Camera, cage: Cage, names: dict[str, str], moves: int) -> dict[int, list[float]]:
    """Movements of dragged arrows, by the cells of the surface that is waited for."""
    result: dict[int, list[float]] = {PREVIEW_CELLS: [], FINE_CELLS: []}
    mouse = page.page.mouse
    for part, name in [*names.items()] * moves:
        if len(result[PREVIEW_CELLS]) >= moves:
            break
        page.settled()
        page.select(name)
        x, y = page.pixel(grip(cage, part, camera), camera)
        mouse.move(x, y)
        page.page.wait_for_timeout(800)
        mouse.down()
        page.page.wait_for_timeout(200)
        for i in range(1, STEPS + 1):
            page.settled()
            move = partial(mouse.move, x, y - PIXELS * i)
            for cells, seconds in zip(
                result, timed(page, "pointermove", move, *(f"^{cells} cells" for cells in result))
            ):
                result[cells].append(seconds)
        mouse.up()
        page.page.wait_for_timeout(1000)
        page.press("Reset")
        page.page.wait_for_timeout(1500)
    return result


def styles(page: EditorPage, shapes: list[str]) -> list[float]:
    """Clicks on pictures of styles, for the whole shape, until the first surface."""
    page.page.keyboard.press("Escape")
    page.tab("Style")
    seconds = []
    for shape in shapes:
        tiles = page.page.locator("button", has=page.page.locator("img.tile")).filter(visible=True)
        tile = tiles.filter(has_text=re.compile(f"^{shape}$"))
        before = page.settled()
        seconds += timed(page, "click", tile.first.click, f"^{PREVIEW_CELLS} cells")
        page.settled(before)
    return seconds


def new_shapes(page: EditorPage, count: int) -> list[float]:
    """Clicks on New shape until the first surface of the shape that is kept."""
    page.tab("Shapes")
    seconds = []
    for _ in range(count):
        before = page.settled()
        seconds += timed(page, "click", lambda: page.press("New shape"), f"^{PREVIEW_CELLS} cells")
        page.settled(before)
    return seconds


def uploads(page: EditorPage, count: int) -> list[float]:
    """Uploads of six meshes until the first surface."""
    page.tab("File")
    seconds = []
    for number in range(count):
        before = page.settled()
        upload = partial(page.upload, "Load parts", f"stool_{number}.zip", stool(1 + 0.02 * number))
        seconds += timed(page, "change", upload, f"^{PREVIEW_CELLS} cells")
        page.settled(before)
    return seconds


def stool(stretch: float) -> bytes:
    """A zip of six meshes, as high as `stretch` says: another surface each time."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, (extents, centre) in STOOL.items():
            mesh = trimesh.creation.box(extents)
            mesh.apply_translation(centre)
            mesh.vertices[:, 1] *= stretch
            archive.writestr(f"{name}.stl", mesh.export(file_type="stl"))
    return content.getvalue()


def exports(page: EditorPage, count: int) -> list[float]:
    """Clicks on Export, of a surface that is there, until the page has the file."""
    page.tab("File")
    seconds = []
    for _ in range(count):
        page.settled()
        seconds += timed(page, "click", lambda: page.press("Export"))
        page.page.wait_for_timeout(500)
    return seconds


def frames(page: EditorPage) -> list[float]:
    """Seconds between frames while the mouse turns the camera, and nothing else is done."""
    mouse, (x, y) = page.page.mouse, page.ground()
    mouse.move(x, y)
    mouse.down()
    page.page.evaluate(FRAMES)
    for i in range(TURNS):
        mouse.move(x + 4 * (min(i, TURNS - i)), y)  # there and back
        page.page.wait_for_timeout(40)
    times = page.page.evaluate("() => { window.going = false; return window.times }")
    mouse.up()
    page.drawn()
    return (np.diff(times) / 1000).tolist()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, nargs="?", default=DEMO / "run")
    parser.add_argument("--moves", type=int, default=40)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    programs = DEMO / "programs" if arguments.run == DEMO / "run" else None
    run = opened(arguments.run, None, programs, None, IMPORT, usual_settings())
    state = run.session.opened(run.first)
    names = part_names(state.structure)
    with serving({"run": run}, "127.0.0.1", 0, 2) as editor, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), headless=True, args=list(FLAGS))
        with tempfile.TemporaryDirectory() as folder:
            page = EditorPage(
                browser.new_page(viewport={"width": 1200, "height": 800}, accept_downloads=True),
                editor.address,
                Path(folder),
            )
            client = next(iter(editor.server.get_clients().values())).camera
            camera = Camera(np.array(client.position), np.array(client.look_at), client.fov, client.image_height)
            page.page.wait_for_timeout(20_000)  # pictures of styles are drawn
            page.tab("Style")
            shown = page.tiles
            page.tab("Cuboids")
            print(f"On {processor()}.\n")
            print("| | n | p50 s | p95 s | largest s | wanted s |\n|---|---|---|---|---|---|", flush=True)
            for row in measured(page, camera, state.cage, names, shown[1:] * 2, arguments.moves):
                print(row, flush=True)
        browser.close()


def measured(
    page: EditorPage, camera: Camera, cage: Cage, names: dict[str, str], shapes: list[str], moves: int
) -> Iterator[Row]:
    """A row after the other of what docs/editor.md shows, as it is measured."""
    yield Row("one frame, the camera being turned", frames(page), "")
    yield Row("click in the view → selection", clicks(page, camera, cage, names, moves // 2), "0.3")
    dragged = drags(page, camera, cage, names, moves)
    yield Row(f"arrow dragged → {PREVIEW_CELLS} cells", dragged[PREVIEW_CELLS], "p50 0.15, p95 0.3")
    yield Row(f"hand at rest (0.3 s of it waiting) → {FINE_CELLS} cells", dragged[FINE_CELLS], "")
    yield Row(f"style clicked → {PREVIEW_CELLS} cells", styles(page, shapes), "0.6")
    yield Row("Export → file (.glb)", exports(page, REPEATS), "2")
    yield Row(f"New shape → {PREVIEW_CELLS} cells", new_shapes(page, REPEATS), "3")
    yield Row(f"six meshes uploaded → {PREVIEW_CELLS} cells", uploads(page, REPEATS), "10")


if __name__ == "__main__":
    main()
