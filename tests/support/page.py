"""The editor's page as a visitor sees it: what is read, typed, clicked and dragged there."""

import json
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from playwright.sync_api import ConsoleMessage, Locator, Page

from cagesdf.cuboid import Cage
from cagesdf.viewing.framing import world_per_pixel

PATIENCE = 240.0  # seconds; only what is broken takes them
SETTLED = "128 cells"
CENTRE, LENGTHS, ROTATION = "Centre (file units)", "Lengths (file units)", "Rotation (degrees)"
# By row of the list of parts: the name, and whether its eye is closed.
EYES = """() => [...document.querySelectorAll("button:has(.icon-tabler-eye, .icon-tabler-eye-off)")].map(eye =>
    [eye.parentElement.previousElementSibling.innerText, eye.querySelector(".icon-tabler-eye-off") !== null])"""
NOISE = "Unable to preventDefault inside passive event listener"  # viser's own, as nodes are dragged


class EditorPage:
    """One tab."""

    def __init__(self, page: Page, address: str, screenshots: Path) -> None:
        self.page, self._screenshots = page, screenshots
        page.set_default_timeout(1000 * PATIENCE)
        self.errors: list[str] = []
        self.requests: list[str] = []
        page.on("console", self._heard)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))
        page.goto(address, wait_until="commit")
        self.settled()

    def close(self) -> None:
        self.page.close()

    def to_background(self) -> None:
        """Draw nothing, as browsers do for a tab behind another one."""
        self.page.evaluate(
            "() => { window.front = requestAnimationFrame; window.frames = [];"
            " window.requestAnimationFrame = frame => window.frames.push(frame) }"
        )

    def to_front(self) -> None:
        """Draw again."""
        self.page.evaluate("() => { window.requestAnimationFrame = window.front; window.frames.forEach(window.front) }")

    def _heard(self, message: ConsoleMessage) -> None:
        if message.type == "error" and NOISE not in message.text:
            self.errors.append(message.text)

    # What is read

    def control(self, label: str, kind: str = "input, textarea") -> Locator:
        """The input beside a label."""
        row = self.page.locator(f"xpath=//label[normalize-space()='{label}']/ancestor::*[.//input or .//textarea][1]")
        return row.locator(kind)

    def value(self, label: str) -> str:
        return self.control(label).first.input_value()

    def numbers(self, label: str) -> np.ndarray:
        """The numbers of a control, in several boxes or in one."""
        boxes = [box.input_value() for box in self.control(label, "input").all()]
        return np.array([float(word) for text in boxes for word in text.split()])

    @property
    def surface(self) -> str:
        """Cells, and a mark of the surface's bytes."""
        return self.value("Mark")

    @property
    def refusals(self) -> str:
        """What is said to be wrong, and wasn't dismissed."""
        return " ".join(self.page.locator(".mantine-Notification-root").all_inner_texts())

    def refused(self, text: str) -> None:
        """Wait until something is said to be wrong."""
        self.until(lambda: text in self.refusals, f"{text!r} said")

    @property
    def status(self) -> str:
        return self.value("Status")

    @property
    def parts(self) -> dict[str, bool]:
        """Names in the list of parts, and whether their eyes are closed."""
        return {name.strip().removeprefix("▸ "): closed for name, closed in self.page.evaluate(EYES)}

    @property
    def hidden(self) -> list[str]:
        """Parts whose eyes are closed."""
        return [part for part, closed in self.parts.items() if closed]

    @property
    def selected(self) -> list[str]:
        """Parts that the list shows as selected."""
        labels = self.page.locator(".mantine-Button-root", has_text="▸ ").all_inner_texts()
        return [part for label in labels if (part := label.strip().removeprefix("▸ ")) in self.parts]

    def eye(self, part: str) -> Locator:
        """The button beside a part's name that hides it."""
        return self.page.locator(f'div:has(> button :text-matches("^(▸ )?{re.escape(part)}$")) + div > button')

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait for something to be so."""
        end = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > end:
                self.picture("failed")
                raise AssertionError(f"{what}: not so after {PATIENCE:.0f} s; status {self.status!r}, {self.surface!r}")
            self.page.wait_for_timeout(20)

    def settled(self, after: str | None = None) -> str:
        """The fine surface; with `after` another one than that."""
        found = ""

        def there() -> bool:
            nonlocal found
            found = self.surface if self.page.get_by_text("Mark", exact=True).count() else ""
            return found.startswith(SETTLED) and found != after

        self.until(there, "a fine surface")
        return found

    # What is done

    def tab(self, name: str) -> None:
        self.page.get_by_role("tab", name=name).click()

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def choose(self, label: str, option: str) -> None:
        """An entry of a drop-down list."""
        self.control(label).first.click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def slide(self, label: str, value: float) -> None:
        """A slider, by the number box beside it."""
        box = self.control(label, "input").last
        box.fill(str(value))
        box.press("Enter")

    def set_number(self, label: str, which: int, value: float) -> None:
        self.control(label).first.fill(self._with_number(label, which, str(value)))

    def type_number(self, label: str, which: int, text: str) -> None:
        """Letter by letter, as hands do, in place of what is there."""
        text = self._with_number(label, which, text)
        box = self.control(label).first
        box.select_text()
        box.press_sequentially(text, delay=120)

    def _with_number(self, label: str, which: int, text: str) -> str:
        words = self.value(label).split()
        words[which] = text
        return " ".join(words)

    def select(self, part: str) -> None:
        """By the list."""
        self.page.get_by_role("button", name=re.compile(rf"^(▸ )?{re.escape(part)}$")).click()
        self.until(lambda: self.status == f"selected: {part}", f"{part} selected")

    def dismiss(self) -> None:
        """Close all notices."""
        for notice in self.page.locator("button.mantine-Notification-closeButton").all():
            notice.click()

    @property
    def tiles(self) -> list[str]:
        """Names of the pictures that are in sight and can be clicked."""
        names = self.page.locator("button:has(img.tile):visible").all_inner_texts()
        return [name.strip() for name in names]

    def drawn_tile(self, name: str) -> bool:
        """Whether there is a picture above a name that can be clicked: more than a blank one."""
        tiles = self.page.locator("button", has=self.page.locator("img.tile")).filter(visible=True)
        tile = tiles.filter(has_text=re.compile(f"^{name}$"))
        return tile.count() == 1 and len(tile.locator("img").get_attribute("src") or "") > 2000

    def ground(self) -> tuple[float, float]:
        """A place in the lower left corner of the view, which neither the shape nor a notice reaches."""
        x, y = self.page.evaluate(
            "() => { const y = innerHeight - 20; let x = 0;"
            " while (document.elementFromPoint(x, y)?.tagName !== 'CANVAS') x += 5; return [x + 20, y] }"
        )
        return x, y

    def click_nothing(self) -> None:
        self.page.mouse.click(*self.ground())

    def drawn(self, frames: int = 3) -> None:
        """Wait until the scene was drawn so many times: what came meanwhile is in it, and the mouse meets it."""
        self.page.evaluate(
            "count => new Promise(done => { const next = () => count-- > 0 ? requestAnimationFrame(next) : done();"
            " next() })",
            frames,
        )

    def drag(self, start: tuple[float, float], way: tuple[float, float], steps: int = 8) -> None:
        """With the mouse, as hands do: slowly, and at each place until it is drawn, however long that takes."""
        mouse = self.page.mouse
        mouse.move(start[0] - 2, start[1] - 2)
        self.drawn()
        mouse.move(*start)
        self.page.wait_for_timeout(500)
        self.drawn()
        mouse.down()
        self.drawn()
        for i in range(1, steps + 1):
            mouse.move(start[0] + way[0] * i / steps, start[1] + way[1] * i / steps)
            self.page.wait_for_timeout(100)
            self.drawn()
        mouse.up()

    def download(self, button: str, folder: Path) -> Path:
        """What a button gives to save."""
        with self.page.expect_download() as download:
            self.press(button)
        path = folder / download.value.suggested_filename
        download.value.save_as(path)
        return path

    def upload(self, button: str, name: str, content: bytes) -> None:
        with self.page.expect_file_chooser() as chooser:
            self.press(button)
        chooser.value.set_files({"name": name, "mimeType": "text/plain", "buffer": content})

    def script(self, folder: Path) -> list[dict]:
        """What was done so far."""
        self.tab("File")
        return json.loads(self.download("Save script", folder).read_text())

    def picture(self, name: str) -> Path:
        path = self._screenshots / f"{name}.png"
        self.page.screenshot(path=path)
        return path

    # Where things are

    def pixel(self, point: np.ndarray, camera: "Camera") -> tuple[float, float]:
        """Where a point of the scene is seen."""
        box = self.page.locator("canvas").first.bounding_box()
        assert box is not None
        x, y = camera.project(point, box["width"] / box["height"])
        return box["x"] + (1 + x) / 2 * box["width"], box["y"] + (1 - y) / 2 * box["height"]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole."""

    position: np.ndarray  # (3,)
    look_at: np.ndarray  # (3,)
    fov: float  # vertical, radians
    height: int  # of the picture, pixels

    def pixel_at(self, point: np.ndarray) -> float:
        """A pixel's length at a place."""
        return world_per_pixel(float(np.linalg.norm(self.position - point)), self.fov, self.height)

    def frame(self) -> np.ndarray:
        """Right, up and forward, by rows."""
        forward = self.look_at - self.position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(right, forward), forward])

    def project(self, point: np.ndarray, aspect: float) -> tuple[float, float]:
        """In [-1, 1] over the canvas, up being positive."""
        x, y, depth = self.frame() @ (point - self.position)
        scale = np.tan(self.fov / 2) * depth
        return float(x / (scale * aspect)), float(y / scale)

    def first_hit(self, cage: Cage, point: np.ndarray) -> str:
        """The cuboid that is met first on the way to a point of one of them."""
        steps = np.linspace(0, 1.5, 30_001)[:, None] * (point - self.position) + self.position
        inside = cage.signed_distance(steps) <= 0
        return cage.part_ids[int(inside[inside.any(axis=1)][0].argmax())]
