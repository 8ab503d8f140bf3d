"""The controls of one tab. They say what was done to them; what it means is the tab's business."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import viser

from cagesdf.formats.parts_folder import MESH_SUFFIXES
from cagesdf.viewing.files import FORMATS

HELLO = (
    "**Click a cuboid**, then drag its arrows and rings, or the balls on its faces. "
    "Shift-click takes several. **Style** changes the surface alone. **File** saves what you made."
)
NOTHING = "–"
MESHES = ",".join((".zip", *MESH_SUFFIXES))
PLACES = 3.0  # standard deviations that the sliders of principal directions reach


@dataclass(frozen=True)
class Actions:
    """What a tab does when a control is used. The status line says what goes wrong in one."""

    open_shape: Callable[[str], None]
    undo: Callable[[], None]
    redo: Callable[[], None]
    reset: Callable[[], None]
    select: Callable[[str], None]  # a part's name, or the label of several
    place: Callable[[tuple[float, float, float]], None]  # centre, user's unit
    lengths: Callable[[tuple[float, float, float]], None]  # along the cuboid's own axes, user's unit
    turn: Callable[[tuple[float, float, float]], None]  # about the axes x, y, z, degrees
    escape: Callable[[], None]  # select nothing
    frame: Callable[[], None]  # look at what is selected
    duplicate: Callable[[], None]  # what is selected
    delete: Callable[[], None]
    split: Callable[[], None]
    redraw: Callable[[], None]  # what is shown changed, not the shape
    set_parameter: Callable[[str, float], None]
    blend: Callable[[str, float], None]
    mix: Callable[[str, float], None]  # into the parts that are selected
    direct: Callable[[int, float], None]  # number of a principal direction, standard deviations
    surprise: Callable[[float], None]  # temperature
    generate: Callable[[float], None]  # temperature
    save: Callable[[], None]
    load: Callable[[str, bytes], None]
    export: Callable[[str], None]  # one of FORMATS
    export_cuboids: Callable[[str], None]
    upload_program: Callable[[str, bytes], None]
    upload_parts: Callable[[str, bytes], None]


class Panel:
    """Handles of the controls."""

    # viser's own types for these say that values can't be set.
    shape: Any
    status: Any
    surface: Any
    part: Any
    centre: Any
    lengths: Any
    turn: Any
    mirror: Any
    repeat: Any
    snap: Any
    shown: Any
    truth: Any
    parameter: Any
    value: Any
    style: Any
    weight: Any
    part_style: Any
    part_weight: Any
    temperature: Any
    directions: list[Any]

    def __init__(
        self,
        client: viser.ClientHandle,
        actions: Actions,
        shapes: Sequence[str],
        directions: int,
        by_part: bool,
        generates: bool,
        has_truth: bool,
        guard: Callable[[Callable[[], None]], None],
    ) -> None:
        """`guard` calls an action and says what is wrong."""
        gui = self._gui = client.gui
        self._guard = guard
        gui.main_panel.dock_right()
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium", brand_color=(232, 96, 28))
        gui.set_panel_label("cagesdf")
        gui.add_markdown(HELLO)
        self.shape = gui.add_dropdown("Shape", tuple(shapes))
        self._on(self.shape, lambda: actions.open_shape(self.shape.value))
        history = gui.add_button_group("History", ("Undo", "Redo", "Reset"))
        steps = {"Undo": actions.undo, "Redo": actions.redo, "Reset": actions.reset}
        history.on_click(lambda _: guard(steps[history.value]))
        self.status = gui.add_text("Status", "", disabled=True, multiline=True)
        self.surface = gui.add_text("Surface", "", disabled=True, hint="cells, faces, and a mark of its bytes")
        self._keys(actions)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Cuboids"):
            self._cuboids(actions, has_truth)
        with tabs.add_tab("Style"):
            self._style(actions, shapes, directions, by_part)
        with tabs.add_tab("New"):
            self._new(actions, generates)
        with tabs.add_tab("File"):
            self._file(actions)

    def _keys(self, actions: Actions) -> None:
        keys: tuple[tuple[str, str, Any, Any, Callable[[], None]], ...] = (
            ("Ctrl Z", "Undo", "Z", "cmd/ctrl", actions.undo),
            ("Ctrl Shift Z", "Redo", "Z", "cmd/ctrl+shift", actions.redo),
            ("Esc", "Select nothing", "escape", None, actions.escape),
            ("Del", "Delete what is selected", "delete", None, actions.delete),
            ("Shift D", "Duplicate what is selected", "D", "shift", actions.duplicate),
            ("F", "Frame what is selected, or all", "F", None, actions.frame),
        )
        for _, label, key, modifier, act in keys:
            command = self._gui.add_command(label, hotkey=key, modifier=modifier)
            command.on_trigger(partial(lambda act, _: self._guard(act), act))
        with self._gui.add_folder("Keys", expand_by_default=False):
            self._gui.add_markdown("\n".join(f"- **{written}**: {label}" for written, label, *_ in keys))

    def _cuboids(self, actions: Actions, has_truth: bool) -> None:
        gui = self._gui
        self.part = gui.add_dropdown("Part", (NOTHING,))
        self._on(self.part, lambda: actions.select(self.part.value))
        self.centre = gui.add_vector3("Centre (file units)", (0.0, 0.0, 0.0), step=0.001, disabled=True)
        self._on(self.centre, lambda: actions.place(self.centre.value))
        self.lengths = gui.add_vector3(
            "Lengths (file units)", (1.0, 1.0, 1.0), min=(0.0, 0.0, 0.0), step=0.001, disabled=True
        )
        self._on(self.lengths, lambda: actions.lengths(self.lengths.value))
        self.turn = gui.add_vector3("Turn by (degrees)", (0.0, 0.0, 0.0), step=1.0, disabled=True)
        self._on(self.turn, lambda: actions.turn(self.turn.value))
        members = gui.add_button_group("Selected", ("Duplicate", "Split", "Delete"))
        steps = {"Duplicate": actions.duplicate, "Split": actions.split, "Delete": actions.delete}
        members.on_click(lambda _: self._guard(steps[members.value]))
        self.mirror = gui.add_checkbox("Mirrored parts follow", True)
        self.repeat = gui.add_checkbox("Repeated parts follow", True)
        self.snap = gui.add_checkbox("Snap to contact", True)
        self.shown = gui.add_checkbox("Show cuboids", True)
        self._on(self.shown, actions.redraw)
        self.truth = gui.add_slider("True shape", 0.0, 1.0, 0.05, 0.0, visible=has_truth)
        self._on(self.truth, actions.redraw)
        self.program = gui.add_folder("Through the program", expand_by_default=False)
        with self.program:
            self.parameter = gui.add_dropdown("Parameter", (NOTHING,))
            self.value = gui.add_number("Value", 0.0, step=0.001)
        self._on(self.parameter, lambda: self.show_value(self._values))
        self._on(self.value, lambda: actions.set_parameter(self.parameter.value, self.value.value))
        self._values: Mapping[str, float] = {}

    def _style(self, actions: Actions, shapes: Sequence[str], directions: int, by_part: bool) -> None:
        gui = self._gui
        self.style = gui.add_dropdown("Style of", (NOTHING, *shapes))
        self.weight = gui.add_slider("Towards it", 0.0, 1.0, 0.01, 1.0)
        blend = lambda: actions.blend(self.style.value, self.weight.value)  # noqa: E731
        self._on(self.style, blend)
        self._on(self.weight, blend)
        with gui.add_folder("Selected parts", visible=by_part):
            self.part_style = gui.add_dropdown("Their style of", (NOTHING, *shapes))
            self.part_weight = gui.add_slider("Their way to it", 0.0, 1.0, 0.01, 1.0)
        mix = lambda: actions.mix(self.part_style.value, self.part_weight.value)  # noqa: E731
        self._on(self.part_style, mix)
        self._on(self.part_weight, mix)
        self.directions = [gui.add_slider(f"Direction {i + 1}", -PLACES, PLACES, 0.05, 0.0) for i in range(directions)]
        for i, slider in enumerate(self.directions):
            self._on(slider, partial(lambda i, slider: actions.direct(i, slider.value), i, slider))
        self.temperature = gui.add_slider("Temperature", 0.0, 2.0, 0.05, 1.0, hint="how far new styles and shapes go")
        button = gui.add_button("Surprise me", icon=viser.Icon.DICE_5)
        button.on_click(lambda _: self._guard(lambda: actions.surprise(self.temperature.value)))

    def _new(self, actions: Actions, generates: bool) -> None:
        gui = self._gui
        text = "New cuboids and a new style." if generates else "This run has no generator of new cuboids beside it."
        gui.add_markdown(text)
        button = gui.add_button("New shape", icon=viser.Icon.SPARKLES, disabled=not generates)
        button.on_click(lambda _: self._guard(lambda: actions.generate(self.temperature.value)))
        self.made = gui.add_folder("History")

    def _file(self, actions: Actions) -> None:
        gui = self._gui
        self.format = gui.add_dropdown("Format", FORMATS, initial_value="glb")
        export = gui.add_button("Export", icon=viser.Icon.DOWNLOAD)
        export.on_click(lambda _: self._guard(lambda: actions.export(self.format.value)))
        cuboids = gui.add_button("Export cuboids", icon=viser.Icon.BOX)
        cuboids.on_click(lambda _: self._guard(lambda: actions.export_cuboids(self.format.value)))
        save = gui.add_button("Save script", icon=viser.Icon.DEVICE_FLOPPY)
        save.on_click(lambda _: self._guard(actions.save))
        load = gui.add_upload_button("Load script", icon=viser.Icon.FOLDER_OPEN, mime_type=".json")
        load.on_upload(lambda _: self._guard(lambda: actions.load(load.value.name, load.value.content)))
        program = gui.add_upload_button("Load program", icon=viser.Icon.CODE, mime_type=".txt")
        program.on_upload(
            lambda _: self._guard(lambda: actions.upload_program(program.value.name, program.value.content))
        )
        parts = gui.add_upload_button(
            "Load parts",
            icon=viser.Icon.CUBE_PLUS,
            mime_type=MESHES,
            hint="a mesh with named parts, or a zip of meshes",
        )
        parts.on_upload(lambda _: self._guard(lambda: actions.upload_parts(parts.value.name, parts.value.content)))

    def add_made(self, picture: np.ndarray, label: str, take: Callable[[], None]) -> None:
        """A thumbnail of a generated shape, and a button that takes it up again."""
        with self.made:
            self._gui.add_image(picture)
            self._gui.add_button(label).on_click(lambda _: self._guard(take))

    def show_parts(self, names: Sequence[str], selected: str | None) -> None:
        """The parts there are and the labels that several share, and the one part selected."""
        self.part.options = (NOTHING, *names)
        self.part.value = selected or NOTHING

    def show_cuboid(self, selected: int, centre: np.ndarray | None, lengths: np.ndarray | None) -> None:
        """How many are selected, and numbers of the cuboid; None: not exactly one is."""
        self.turn.disabled = not selected
        self.turn.value = (0.0, 0.0, 0.0)
        for box, numbers in ((self.centre, centre), (self.lengths, lengths)):
            box.disabled = numbers is None
            if numbers is not None:
                box.value = tuple(round(float(number), 4) for number in numbers)

    def show_program(self, values: Mapping[str, float]) -> None:
        """The program's parameters; without one the folder isn't there."""
        self._values = values
        self.program.visible = bool(values)
        names = tuple(values) or (NOTHING,)
        if names != tuple(self.parameter.options):
            self.parameter.options = names
        self.show_value(values)

    def show_value(self, values: Mapping[str, float]) -> None:
        """The value of the parameter that is chosen."""
        if self.parameter.value in values:
            self.value.value = round(values[self.parameter.value], 5)

    def show_style(self, places: np.ndarray) -> None:
        """Where the style is along the principal directions."""
        for slider, place in zip(self.directions, places):
            slider.value = float(np.clip(place, -PLACES, PLACES))

    def _on(self, handle: Any, act: Callable[[], None]) -> None:
        # Without a client the tab itself set the value.
        handle.on_update(lambda event: None if event.client is None else self._guard(act))
