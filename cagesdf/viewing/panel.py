"""The controls of one tab. Each calls an action; the tab decides what it does."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import viser

from cagesdf.formats.parts_folder import MESH_SUFFIXES
from cagesdf.viewing.fields import NumberField, Typed
from cagesdf.viewing.files import FORMATS
from cagesdf.viewing.framing import VIEWS
from cagesdf.viewing.pictures import PictureGrid
from cagesdf.viewing.scene import LOOKS, TOOLS
from cagesdf.viewing.thumbnails import blank

HELLO = (
    "**Click a cuboid**, then drag its arrows (**G** moves, **R** turns, **L** pulls faces). "
    "**Style** changes the surface alone. **File** saves what you made. **I** lists all keys."
)
NOTHING = "–"
BRAND = (232, 96, 28)
MESHES = ",".join((".zip", *MESH_SUFFIXES))
IDLE = "Cancel"
WHOLE = "the whole shape"
FORGET = "Forget all"


@dataclass(frozen=True)
class Actions:
    """Actions of a tab that controls call. Errors of an action are shown in a notice."""

    open_shape: Callable[[str], None]
    restore: Callable[[int], None]  # a draft, by its number in `show_drafts`
    forget: Callable[[], None]  # all drafts; asked twice
    undo: Callable[[], None]
    redo: Callable[[], None]
    reset: Callable[[], None]
    place: Callable[[Typed], None]  # centre, user's unit
    lengths: Callable[[Typed], None]  # along the cuboid's own axes, user's unit
    angles: Callable[[Typed], None]  # degrees; see `angles.angles_of`
    redraw: Callable[[], None]  # the view changed, not the shape
    compare: Callable[[], None]  # the opacity of the true surface changed
    look: Callable[[], None]  # the look of the surface changed
    darken: Callable[[], None]  # dark or light was chosen
    view: Callable[[str], None]  # from one of `framing.VIEWS`
    help: Callable[[], None]
    open_run: Callable[[str], None]
    set_parameter: Callable[[str, float | None], None]
    restyle: Callable[[str, float], None]  # a shape's id, how far; of the parts that are selected, or of the whole
    more_styles: Callable[[], None]  # pictures of further ones
    more_shapes: Callable[[], None]  # the same
    cancel: Callable[[], None]
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

    # viser's type stubs say that values of these can't be set.
    shape: Any
    status: Any
    surface: Any
    health: Any
    tool: Any
    mirror: Any
    repeat: Any
    attach: Any
    details: Any
    snap: Any
    shown: Any
    truth: Any
    look: Any
    dark: Any
    mark: Any
    group: Any
    parameter: Any
    style: Any
    weight: Any
    work: Any
    cancel: Any
    temperature: Any

    def __init__(
        self,
        client: viser.ClientHandle,
        actions: Actions,
        runs: Sequence[str],
        run: str,
        shapes: Sequence[str],
        ends: Sequence[tuple[float, float]],
        generates: bool,
        guard: Callable[[Callable[[], None]], None],
        guard_typed: Callable[[Callable[[], None]], None],
    ) -> None:
        """`ends` are those of the sliders of principal directions; `guard` calls an action and says what is wrong.

        `guard_typed` does so when a number has settled, while another one may be being typed.
        """
        gui = self._gui = client.gui
        self._guard, self._guard_typed = guard, guard_typed
        gui.main_panel.dock_right()
        self.theme(dark=False)
        gui.set_panel_label("cagesdf")
        self._top = gui.add_markdown(HELLO)
        self._drafts_of = gui.add_folder("Earlier work", visible=False)
        self._draft_buttons: list[Any] = []
        self._restore, self._forget = actions.restore, actions.forget
        self._shapes = tuple(shapes)
        self.run = gui.add_dropdown("Run", tuple(runs), initial_value=run, visible=len(runs) > 1)
        self._on(self.run, lambda: actions.open_run(self.run.value))
        self.shape = gui.add_dropdown("Shape", tuple(shapes))
        self._on(self.shape, lambda: actions.open_shape(self.shape.value))
        history = gui.add_button_group("History", ("Undo", "Redo", "Reset"))
        steps = {"Undo": actions.undo, "Redo": actions.redo, "Reset": actions.reset}
        history.on_click(lambda _: guard(steps[history.value]))
        self.status = gui.add_text("Status", "", disabled=True)
        self.surface = gui.add_text("Surface", "", disabled=True, hint="cells and faces")
        self.work = gui.add_progress_bar(0.0, color=BRAND)
        self.cancel = gui.add_button(IDLE, disabled=True, icon=viser.Icon.X)
        self.cancel.on_click(lambda _: guard(actions.cancel))
        self.health = gui.add_markdown("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Cuboids"):
            self._cuboids(actions)
        with tabs.add_tab("Style"):
            self._style(actions, shapes, ends)
        with tabs.add_tab("Shapes"):
            self._open(actions, generates)
        with tabs.add_tab("File"):
            self._file(actions)
        self.found = tabs.add_tab("Found parts")
        with tabs.add_tab("View"):
            self._view(actions)
        with gui.add_folder("Details", expand_by_default=False):
            self.mark = gui.add_text("Mark", "", disabled=True, hint="of the surface's bytes: equal ones, equal marks")

    def theme(self, dark: bool) -> None:
        """A dark page or a light one."""
        self._gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="large", brand_color=BRAND, dark_mode=dark
        )

    def _view(self, actions: Actions) -> None:
        gui = self._gui
        self.look = gui.add_dropdown("Look", LOOKS)
        self._on(self.look, actions.look)
        self.shown = gui.add_checkbox("Show cuboids", True)
        self._on(self.shown, actions.redraw)
        self.truth = gui.add_slider("True shape", 0.0, 1.0, 0.05, 0.0)
        self._on(self.truth, actions.compare)
        views = gui.add_button_group("From", tuple(VIEWS))
        views.on_click(lambda _: self._guard(lambda: actions.view(views.value)))
        self.dark = gui.add_checkbox("Dark", False)
        self._on(self.dark, actions.darken)
        keys = gui.add_button("Keys", icon=viser.Icon.KEYBOARD)
        keys.on_click(lambda _: self._guard(actions.help))

    def _cuboids(self, actions: Actions) -> None:
        gui = self._gui
        self.tool = gui.add_dropdown("Tool", TOOLS, hint="G moves, R turns, L pulls faces")
        self._on(self.tool, actions.redraw)
        self._centre = self._numbers("Centre (file units)", 3, actions.place)
        self._lengths = self._numbers("Lengths (file units)", 3, actions.lengths)
        self._angles = self._numbers("Rotation (degrees)", 3, actions.angles)
        self.mirror = gui.add_checkbox("Mirrors follow", True, hint="parts that mirror these")
        self.repeat = gui.add_checkbox("Repeats follow", True, hint="parts that repeat these")
        self.attach = gui.add_checkbox("Attached follow", True, hint="what touches stays in contact")
        self.details = gui.add_dropdown(
            "Details", ("stretch", "keep"), hint="of parts that change their lengths: stretch along, or keep their size"
        )
        self.snap = gui.add_checkbox("Snap to contact", True)
        self.program = gui.add_folder("Through the program", expand_by_default=False)
        with self.program:
            self.group = gui.add_dropdown("Of", (NOTHING,))
            self.parameter = gui.add_dropdown("Parameter", (NOTHING,))
            self._value = self._numbers(
                "Value", 1, lambda typed: actions.set_parameter(self._shown_parameter, typed[0])
            )
        self._on(self.group, self._show_parameters)
        self._on(self.parameter, self._show_value)
        self._values: Mapping[str, float] = {}
        self._shown_parameter = NOTHING  # own name of the one that the number is for
        self._grouped: Mapping[str, Mapping[str, str]] = {}

    def _style(self, actions: Actions, shapes: Sequence[str], ends: Sequence[tuple[float, float]]) -> None:
        gui = self._gui
        self._style_for = gui.add_markdown("")
        self.style = gui.add_dropdown("Style of", (NOTHING, *shapes))
        self.weight = gui.add_slider("Towards it", 0.0, 1.0, 0.01, 1.0)
        restyle = lambda: actions.restyle(self.style.value, self.weight.value)  # noqa: E731
        self._on(self.style, restyle)
        self._on(self.weight, restyle)
        button = gui.add_button("Surprise me", icon=viser.Icon.DICE_5, hint="a new style that fits the cuboids")
        button.on_click(lambda _: self._guard(lambda: actions.surprise(self.temperature.value)))
        self.temperature = gui.add_slider("Temperature", 0.0, 2.0, 0.05, 1.0, hint="how far new styles and shapes go")

        def pick(shape_id: str) -> None:
            self.style.value, self.weight.value = shape_id, 1.0
            self._guard(restyle)

        self.styles = PictureGrid(gui, "Styles, those that fit best first", pick)
        self.more = gui.add_button("More styles", icon=viser.Icon.CHEVRON_DOWN)
        self.more.on_click(lambda _: self._guard(actions.more_styles))
        with gui.add_folder("Directions", visible=bool(ends)):
            self.ends: list[Any] = []
            self.directions: list[Any] = []
            for i, (low, high) in enumerate(ends):
                self.ends.append(gui.add_image(np.hstack([blank(), blank()])))
                slider = gui.add_slider(
                    f"Direction {i + 1}", low, high, 0.01, low, hint="standard deviations, as far as training shapes go"
                )
                self.directions.append(slider)
                self._on(slider, partial(lambda i, slider: actions.direct(i, slider.value), i, slider))

    def _open(self, actions: Actions, generates: bool) -> None:
        gui = self._gui
        text = "New cuboids and a new style." if generates else "This run has no generator of new cuboids beside it."
        gui.add_markdown(text)
        button = gui.add_button("New shape", icon=viser.Icon.SPARKLES, disabled=not generates)
        button.on_click(lambda _: self._guard(lambda: actions.generate(self.temperature.value)))
        pick = lambda name: self._guard(lambda: actions.open_shape(name))  # noqa: E731
        self.made = PictureGrid(gui, "Made here", pick)
        self.trained = PictureGrid(gui, "Of the run", pick)
        self._more_trained = gui.add_button("More shapes", icon=viser.Icon.CHEVRON_DOWN)
        self._more_trained.on_click(lambda _: self._guard(actions.more_shapes))

    def _file(self, actions: Actions) -> None:
        gui = self._gui
        self.format = gui.add_dropdown(
            "Format", FORMATS, initial_value="glb", hint="glb, obj: each part a closed mesh; stl, ply: their union"
        )
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
            hint="a mesh, whose groups are its parts or whose parts are found, or a zip with a mesh for each",
        )
        parts.on_upload(lambda _: self._guard(lambda: actions.upload_parts(parts.value.name, parts.value.content)))

    def show_drafts(self, drafts: Sequence[str]) -> None:
        """Earlier work in words, with a button each; none without any."""
        for button in self._draft_buttons:
            button.remove()
        self._draft_buttons = []
        self._drafts_of.visible = bool(drafts)
        with self._drafts_of:
            for number, text in enumerate(drafts):
                button = self._gui.add_button(text, icon=viser.Icon.HISTORY)
                button.on_click(partial(lambda number, _: self._guard(lambda: self._restore(number)), number))
                self._draft_buttons.append(button)
            if drafts:
                forget = self._gui.add_button(FORGET, color="gray", icon=viser.Icon.TRASH)
                forget.on_click(lambda _: self._guard(lambda: self._ask_to_forget(forget, len(drafts))))
                self._draft_buttons.append(forget)

    def _ask_to_forget(self, button: Any, count: int) -> None:
        """Forget at the second click."""
        if button.label == FORGET:
            button.label = f"Click again to forget {count}"
        else:
            self._forget()

    def show_work(self, what: str | None, done: float) -> None:
        """The job in the background (None: no job) and the share of it that is done."""
        self.cancel.label = IDLE if what is None else f"{IDLE}: {what}"
        self.cancel.disabled = what is None
        self.work.value, self.work.animated = 100 * float(np.clip(done, 0, 1)), what is not None

    def show_styles(self, shape_ids: Sequence[str], most: int) -> bool:
        """The styles in this order, the first of them as tiles; whether these are others than before."""
        options = (NOTHING, *shape_ids)
        if options != tuple(self.style.options):
            self.style.options = options
        self.more.visible = len(shape_ids) > most
        return self.styles.show(shape_ids[:most])

    def show_trained(self, most: int) -> Sequence[str]:
        """The first shapes of the run as tiles; returns their ids."""
        self._more_trained.visible = len(self._shapes) > most
        self.trained.show(self._shapes[:most])
        return self._shapes[:most]

    def show_target(self, parts: str, style_of: str) -> None:
        """The target of a style: names of parts, or WHOLE; and the shape whose style it took last, or NOTHING."""
        if self.style.value != style_of and style_of in self.style.options:
            self.style.value = style_of
        self._style_for.content = f"Click a picture: its style for **{parts}**."

    def show_shapes(self, made: Sequence[str], chosen: str) -> None:
        """The shapes that were made here, newest first, before those of the run."""
        options = (*made, *self._shapes)
        if options != tuple(self.shape.options):
            self.shape.options = options
        if self.shape.value != chosen:
            self.shape.value = chosen

    def show_health(self, health: str, warnings: Sequence[str]) -> None:
        """A line about the surface, and warnings: at the top, in place of the introduction, as nothing moves then."""
        self.health.content = f"Health: {health}"
        self._top.content = "\n\n".join(f"⚠ **{warning}**" for warning in warnings) or HELLO

    def show_cuboid(
        self, centre: np.ndarray | None, lengths: np.ndarray | None, angles: np.ndarray | None, decimals: int
    ) -> None:
        """Numbers of what is selected, lengths with so many decimals; None: there are none."""
        self._centre.show(centre, decimals)
        self._lengths.show(lengths, decimals)
        self._angles.show(angles, 2)

    def show_program(self, values: Mapping[str, float], grouped: Mapping[str, Mapping[str, str]]) -> None:
        """The program's parameters, by part and plain name; the folder is hidden if there are none."""
        self._values, self._grouped = values, grouped
        self.program.visible = bool(values)
        groups = tuple(grouped) or (NOTHING,)
        if groups != tuple(self.group.options):
            self.group.options = groups
        self._show_parameters()

    @property
    def _parameter(self) -> str:
        """The chosen parameter's own name; NOTHING without one."""
        return self._grouped.get(self.group.value, {}).get(self.parameter.value, NOTHING)

    def _show_parameters(self) -> None:
        names = tuple(self._grouped.get(self.group.value, ())) or (NOTHING,)
        if names != tuple(self.parameter.options):
            self.parameter.options = names
        self._show_value()

    def _show_value(self) -> None:
        if self._parameter in self._values:
            self._shown_parameter = self._parameter  # a number that is still being typed is for the one before
            self._value.show([self._values[self._parameter]], 4)

    def show_style(self, places: np.ndarray) -> None:
        """Coordinates of the style along the principal directions."""
        for slider, place in zip(self.directions, places):
            slider.value = float(np.clip(place, slider.min, slider.max))

    def flush(self) -> None:
        """Take the numbers that are being typed as they are."""
        for field in self._fields:
            field.flush()

    def drop(self) -> None:
        """Forget the numbers that are being typed."""
        for field in self._fields:
            field.drop()

    def _numbers(self, label: str, count: int, act: Callable[[Typed], None]) -> NumberField:
        # Without a hint: it would cover what stands above while somebody types.
        return NumberField(self._gui.add_text(label, "", disabled=True), count, act, self._guard_typed)

    @property
    def _fields(self) -> tuple[NumberField, ...]:
        return self._centre, self._lengths, self._angles, self._value

    def _on(self, handle: Any, act: Callable[[], None]) -> None:
        # Without a client the tab itself set the value.
        handle.on_update(lambda event: None if event.client is None else self._guard(act))
