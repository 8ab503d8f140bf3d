"""The page for the parts of a whole mesh: merged, split by a plane, called otherwise, fitted again, saved."""

import math
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import viser
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.editing.document import Document
from cagesdf.editing.script import Build
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.parts.changing import AXES, Dissection
from cagesdf.parts.written import SUFFIX, written_json
from cagesdf.viewing.jobs import Progress, Work
from cagesdf.viewing.opening import Importer
from cagesdf.viewing.uploads import Upload
from cagesdf.viewing.workspace import Workspace

NONE = "Load a mesh in **File**: the parts that are found in it are shown and changed here."
USE = (
    "Select parts in the list or the view. **Merge** makes one of several, **Split there** cuts one by the plane, "
    "**Rename** gives one another name, **Label** all of them the same kind (legs, slats)."
)
UNFITTED = "**Changed.** The view shows the mesh in its parts. **Fit again** gives the network's surface for them."
STEPS = 500  # of the slider, at least
BEYOND = 0.15  # of its part's extent: how far the plane reaches beyond

Corners = Float[ndarray, "4 3"]


@dataclass(frozen=True)
class Desk:
    """The shape that is open in a tab, and what may be done with it."""

    space: Workspace
    become: Callable[[Document], None]  # show another document of the same shape
    start: Callable[[str, Work], None]  # work in the background
    download: Callable[[str, bytes], None]  # give a file to save
    plane: Callable[[Corners | None], None]  # show a piece of a plane, canonical; nothing with None


class PartsPage:
    """Controls for the parts of the mesh that the open shape comes from."""

    def __init__(
        self,
        gui: viser.GuiApi,
        desk: Desk,
        importer: Importer,
        guard: Callable[[Callable[[], None]], None],
    ) -> None:
        """`guard` calls an action and says what is wrong."""
        self._desk, self._space, self._importer = desk, desk.space, importer
        self._text = gui.add_markdown(NONE)
        self._aimed: tuple[object, ...] = ()  # the state and parts that the slider's range is for

        def buttons(label: str, acts: Mapping[str, Callable[[], None]]) -> Any:
            group = gui.add_button_group(label, tuple(acts))
            group.on_click(lambda _: guard(acts[group.value]))
            return group

        def button(label: str, icon: viser.IconName, act: Callable[[], None]) -> Any:
            handle = gui.add_button(label, icon=icon)
            handle.on_click(lambda _: guard(act))
            return handle

        self._find = button("Find parts", viser.Icon.SCAN, lambda: self._change("Find parts", []))
        cut = buttons("Cut", {"Merge": self._merge, "Split there": self._split})
        self._axis = gui.add_dropdown("Across", AXES, initial_value="y", hint="the plane's normal")
        self._axis.on_update(lambda event: None if event.client is None else guard(self._turn))
        self._place: Any = gui.add_slider("At (file units)", 0.0, 1.0, 0.001, 0.5)
        self._place.on_update(lambda event: None if event.client is None else guard(self._aim))
        self._name = gui.add_text("Name", "")
        call = buttons("Call", {"Rename": self._rename, "Label": self._label})
        self._fit = button("Fit again", viser.Icon.REFRESH, self._fit_again)
        save = button("Save parts", viser.Icon.DEVICE_FLOPPY, self._save)
        self._controls: list[Any] = [cut, self._axis, self._place, self._name, call, self._fit, save]
        self.show()

    def show(self) -> None:
        """The open shape, after a change of it or of the selection."""
        document, upload, selected = self._space.document, self._space.upload, self._space.selection.parts
        if upload is None or not upload.raw.whole:
            self._text.content, found, given, unfitted = NONE, False, False, False
        else:
            given = upload.origin.parts == "given" and upload.newest(document) is None
            found, unfitted = not given, upload.unfitted(document) is not None
            self._text.content = _about(upload, given, unfitted)
        for control in self._controls:
            control.visible = found
        self._find.visible, self._fit.disabled, self._place.disabled = given, not unfitted, len(selected) != 1
        aimed = document.state, selected
        if aimed != self._aimed:
            self._aimed = aimed
            self._desk.plane(None)
            self._range()

    # The plane

    def _range(self) -> None:
        """Let the slider reach through the selected part, and begin in its middle."""
        selected = self._space.selection.parts
        if len(selected) != 1:
            return
        corners = _corners(self._space.document.state, selected[0])[:, AXES.index(self._axis.value)]
        low, high = float(corners.min()), float(corners.max())
        digits = max(0, math.ceil(-math.log10((high - low) / STEPS)))
        self._place.min, self._place.max = round(low, digits), round(high, digits)
        self._place.step, self._place.precision = 10.0**-digits, digits
        self._place.value = round((low + high) / 2, digits)

    def _turn(self) -> None:
        self._range()
        self._aim()

    def _aim(self) -> None:
        """Show the plane through the selected part."""
        state, selected = self._space.document.state, self._space.selection.parts
        if len(selected) == 1:
            self._desk.plane(plane_through(state, selected[0], self._axis.value, self._place.value))

    def _one(self) -> str:
        selected = self._space.selection.parts
        if len(selected) != 1:
            raise InputError(f"wanted one part selected, not {len(selected)}")
        return selected[0]

    # Changes

    def _merge(self) -> None:
        selected = self._space.selection.parts
        if len(selected) < 2:
            raise InputError("wanted several parts selected: shift-click in the view, or Select several in the list")
        self._change("Merge", [shlex.join(["merge", *selected])])

    def _split(self) -> None:
        self._change("Split", [shlex.join(["split", self._one(), self._axis.value, f"{self._place.value:.9g}"])])

    def _rename(self) -> None:
        self._change("Rename", [shlex.join(["rename", self._one(), self._name.value])])

    def _label(self) -> None:
        selected = self._space.selection.parts
        if not selected:
            raise InputError("no part is selected; click those that are meant")
        self._change("Label", [shlex.join(["label", part, self._name.value]) for part in selected])

    def _change(self, what: str, lines: list[str]) -> None:
        """Change the parts as `cagesdf parts --change` does; found first, where they weren't."""
        document, upload = self._space.document, self._upload()
        if lines and upload.newest(document) is None and upload.origin.parts == "given":
            raise InputError("its parts are the file's groups; Find parts takes its surface apart instead")

        def work(progress: Progress) -> Callable[[], None]:
            dissection = self._dissection(document, upload, progress).changed(lines)
            after = document.then(upload.build(dissection), self._space.styles)
            return lambda: self._finish(document, after)

        self._desk.start(what, work)

    def _dissection(self, document: Document, upload: Upload, progress: Progress) -> Dissection:
        dissection = upload.newest(document)
        if dissection is None:
            progress("finding parts")
            dissection = self._importer.dissect(upload.raw, upload.file)
        return dissection

    def _finish(self, before: Document, after: Document) -> None:
        if self._space.document is not before:
            raise InputError("the shape was changed meanwhile; nothing was done to its parts")
        self._desk.become(after)

    def _fit_again(self) -> None:
        """Cuboids and codes of the parts as they are now; one undo leads back to them."""
        document, upload = self._space.document, self._upload()
        dissection = upload.unfitted(document)
        if dissection is None:
            raise InputError("the parts are fitted; change them first")

        def work(progress: Progress) -> Callable[[], None]:
            raw = replace(upload.raw, written=dissection.written())
            build, style = self._importer.take(raw, upload.file, progress).operations()
            upload.dissections[build.structure] = dissection
            replaced = document.before if isinstance(document.script[-1], Build) else None
            after = (replaced or document).then(build, self._space.styles).then(style, self._space.styles)
            return lambda: self._finish(document, after)

        self._desk.start("Fit", work)

    def _save(self) -> None:
        document, upload = self._space.document, self._upload()

        def work(progress: Progress) -> Callable[[], None]:
            text = written_json(self._dissection(document, upload, progress).written())
            return lambda: self._desk.download(f"{upload.raw.shape_id}{SUFFIX}", text.encode())

        self._desk.start("Save parts", work)

    def _upload(self) -> Upload:
        upload = self._space.upload
        if upload is None or not upload.raw.whole:
            raise InputError("this shape comes from no whole mesh; load one in File")
        return upload


def plane_through(state: State, part: str, axis: str, place: float) -> Corners:
    """A rectangle, canonical, of the plane across one of the file's axes at a place, somewhat larger than a part."""
    corners = _corners(state, part)
    low, high = corners.min(axis=0), corners.max(axis=0)
    low, high = low - BEYOND * (high - low), high + BEYOND * (high - low)
    row = AXES.index(axis)
    first, second = (other for other in range(3) if other != row)
    rectangle = np.full((4, 3), float(place))
    rectangle[:, first] = np.array([low, high, high, low])[:, first]
    rectangle[:, second] = np.array([low, low, high, high])[:, second]
    return state.similarity.to_canonical(rectangle)


def _corners(state: State, part: str) -> Float[ndarray, "8 3"]:
    """The corners of a part's cuboid in the file's frame and unit."""
    return state.similarity.to_raw(Cage.of({part: state.cage[part]}).corners()[0])


def _about(upload: Upload, given: bool, unfitted: bool) -> str:
    if unfitted:
        return f"{UNFITTED}\n\n{USE}"
    if given:
        return f"The groups of {upload.file} are its parts: {upload.origin.reason}. **Find parts** looks for others."
    return f"Parts of **{upload.file}**, found in its surface.\n\n{USE}"
