"""One browser tab: what is done there becomes an operation of the script, what the script leads to is shown."""

import hashlib
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import viser
from jaxtyping import Float, Float32
from numpy import ndarray
from scipy.spatial.transform import Rotation as Turn

from cagesdf.cuboid import Cage
from cagesdf.editing.document import Document
from cagesdf.editing.operations import SMALLEST
from cagesdf.editing.parts import parameters, part_names, select
from cagesdf.editing.script import (
    Axis,
    Blend,
    Build,
    Delete,
    Duplicate,
    End,
    Frame,
    Mix,
    Move,
    Operation,
    Resize,
    Rotate,
    Set,
    Split,
    Style,
    dump,
)
from cagesdf.editing.session import Session
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.extraction import Extraction
from cagesdf.frames import Similarity
from cagesdf.generating import draw_cages, of_program
from cagesdf.generation.generator import Generated, Generator
from cagesdf.meshes import Mesh
from cagesdf.rendering import CLAY, Scene, render_rows, side_by_side
from cagesdf.structure.base import Structure
from cagesdf.viewing import files
from cagesdf.viewing.panel import NOTHING, Actions, Panel
from cagesdf.viewing.picking import clicked
from cagesdf.viewing.refusals import saying
from cagesdf.viewing.scene import Stage, label_of
from cagesdf.viewing.snapping import snapped
from cagesdf.viewing.styles import StyleSpace
from cagesdf.viewing.worker import FINE, Made, Worker

AXES: tuple[Axis, ...] = ("x", "y", "z")
DRAWS = 4  # for a new shape
PICTURE = 220  # pixels along a side of a thumbnail


Truths = Callable[[str], Mesh | None]  # the parts of a shape, canonical, as one mesh; None where it isn't known


@dataclass(frozen=True, eq=False)
class Taken:
    """A shape from files, as the network has it."""

    structure: Structure  # with cuboids, canonical
    latent: Float32[ndarray, " d"]
    similarity: Similarity  # raw → canonical
    verdict: str  # whether it is like those that the network was trained on


@dataclass(frozen=True, eq=False)
class Opened:
    """A run that tabs share; nothing of it changes."""

    session: Session
    styles: StyleSpace
    generator: Generator | None
    truth: Truths
    take: Callable[[Path], Taken]  # raises InputError
    first: str  # id of the shape that a tab begins with


class Tab:
    """The state of one visitor. Callbacks may come from several threads; each waits for the one before."""

    def __init__(
        self, client: viser.ClientHandle, opened: Opened, pool: ThreadPoolExecutor, rng: np.random.Generator
    ) -> None:
        self._client, self._opened, self._rng = client, opened, rng
        self._lock = threading.RLock()
        self._selected: tuple[str, ...] = ()
        self._made: Made | None = None
        self._number = 0  # of generated shapes
        self._sliding: tuple[object, ...] = ()  # the control whose last operation is replaced while it moves on
        self._document = self._fresh(opened.first)
        self._stage = Stage(client, self._click, self._moved, self._pulled)
        self._panel = Panel(
            client,
            Actions(
                open_shape=self._open,
                undo=self._undo,
                redo=self._redo,
                reset=self._reset,
                select=self._choose,
                place=self._place,
                lengths=self._lengths,
                turn=self._turn,
                escape=lambda: self._select(()),
                frame=self._look,
                duplicate=self._duplicate,
                delete=self._delete,
                split=self._split,
                redraw=self._redraw,
                set_parameter=self._set,
                blend=self._blend,
                mix=self._mix,
                direct=self._direct,
                surprise=self._surprise,
                generate=self._generate,
                save=self._save,
                load=self._load,
                export=self._export,
                export_cuboids=self._export_cuboids,
                upload_program=self._upload_program,
                upload_parts=self._upload_parts,
            ),
            sorted(opened.session.run.sequences),
            len(opened.styles.directions),
            opened.session.styles.by_part,
            opened.generator is not None,
            opened.truth(opened.first) is not None,
            self._guarded,
        )
        self._panel.shape.value = opened.first
        self._worker = Worker(opened.session, pool, self._show, self._complain)
        self._stage.show_ground(self._document.state.cage)
        self._redraw()
        self._worker.want(self._document.state)

    def close(self) -> None:
        """Free what the tab holds."""
        self._worker.close()

    # What is shown

    def _show(self, made: Made) -> None:
        self._made = made
        mesh, state = made.found.mesh, made.state
        self._stage.show_surface(mesh, state)
        mark = hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()[:8]
        self._panel.surface.value = f"{made.cells} cells, {len(mesh.faces):,} faces, {mark}"
        self._say(f"surface of {made.cells} cells in {made.seconds:.2f} s, {made.found.asked:,} points asked")

    def _say(self, text: str) -> None:
        self._panel.status.value = text

    def _guarded(self, act: Callable[[], None]) -> None:
        """Do something; what is wrong with it is said in the status line, and nothing has changed then."""
        with self._lock, saying(self._refuse):
            act()

    def _complain(self, text: str) -> None:
        """What went wrong stays to be read until it is dismissed."""
        self._say(text)
        self._client.add_notification("Not done", text, color="red")

    def _refuse(self, text: str) -> None:
        self._complain(text)
        self._redraw()

    def _redraw(self, state: State | None = None) -> None:
        """Cuboids, gizmo and numbers: of the document, or of a state on the way."""
        state = state or self._document.state
        names = part_names(state.structure)
        self._selected = tuple(part for part in self._selected if part in names)
        shown = self._panel.shown.value
        self._stage.show_cage(state, self._selected, shown)
        centre, axes = self._frame(state)
        self._stage.show_gizmo(centre if shown else None, axes)
        one = state.cage[self._selected[0]] if len(self._selected) == 1 else None
        self._stage.show_handles(one if shown else None)
        groups = [label for label, count in Counter(state.structure.labels().values()).items() if label and count > 1]
        self._panel.show_parts([*names.values(), *groups], label_of(names, self._selected) if one is not None else None)
        unit = state.similarity
        self._panel.show_cuboid(
            len(self._selected),
            None if one is None else unit.to_raw(one.centre[None])[0],
            None if one is None else one.size / unit.scale,
        )
        placed = state.structure.placed_program()
        self._panel.show_program({} if placed is None else parameters(placed[0]))
        self._panel.show_style(self._opened.styles.places(state.latent))
        self._stage.show_truth(self._opened.truth(self._document.shape_id), self._panel.truth.value)

    def _frame(self, state: State) -> tuple[Float[ndarray, " 3"] | None, Float[ndarray, "3 3"]]:
        """Where the gizmo is, and its axes: the cuboid's own, or the user's around several."""
        if len(self._selected) == 1:
            return state.cage[self._selected[0]].centre, state.cage[self._selected[0]].axes
        corners = _only(state.cage, self._selected).corners().reshape(-1, 3)
        middle = (corners.min(axis=0) + corners.max(axis=0)) / 2 if len(corners) else None
        return middle, state.similarity.rotation.T

    # Selection

    def _click(self, parts: tuple[str, ...], more: bool) -> None:
        self._guarded(lambda: self._select(clicked(parts, self._selected, more)))

    def _choose(self, name: str) -> None:
        self._select(() if name == NOTHING else select(self._document.state.structure, name))

    def _select(self, parts: tuple[str, ...]) -> None:
        self._selected = parts
        self._redraw()
        self._say(f"selected: {label_of(part_names(self._document.state.structure), parts)}")

    @property
    def _pattern(self) -> str:
        names = part_names(self._document.state.structure)
        return "|".join(names[part] for part in self._selected)

    @property
    def _one(self) -> str:
        if len(self._selected) != 1:
            raise InputError(f"wanted one cuboid selected, not {len(self._selected)}")
        return self._selected[0]

    # Operations

    def _do(self, operation: Operation, control: tuple[object, ...] = ()) -> None:
        """Go on with an operation; one of the same control takes the place of the one before."""
        again = bool(control) and control == self._sliding
        step = self._document.instead if again else self._document.then
        self._become(step(operation, self._opened.session.styles), control)

    def _become(self, document: Document, control: tuple[object, ...] = ()) -> None:
        if document.state.structure is not self._document.state.structure:
            self._stage.show_ground(document.state.cage)
        self._document, self._sliding = document, control
        self._redraw()
        self._worker.want(document.state)

    def _preview(self, operation: Operation) -> None:
        """Show where an operation leads that isn't finished yet."""
        state = self._document.then(operation, self._opened.session.styles).state
        self._stage.show_cage(state, self._selected, shown=True)
        if len(self._selected) == 1:
            self._stage.show_handles(state.cage[self._selected[0]])
        self._worker.want(state)

    def _drag(self, phase: str, operation: Operation | None) -> None:
        """An operation while a hand drags: shown, and done at the end."""
        if operation is None:
            return
        if phase == "end":
            self._do(operation)
        elif phase == "update":
            self._preview(operation)

    def _moved(self, phase: str, centre: Float[ndarray, " 3"], axes: Float[ndarray, "3 3"]) -> None:
        """The gizmo was dragged."""
        self._guarded(lambda: self._drag(phase, self._motion(centre, axes)))

    def _motion(self, centre: Float[ndarray, " 3"], axes: Float[ndarray, "3 3"]) -> Operation | None:
        """What leads the gizmo from where it was to here: a turn about one axis, or a move."""
        state = self._document.state
        before, own = self._frame(state)
        if before is None:
            return None
        turn = _turned(own, axes)
        if turn is not None:
            row, degrees = turn
            if len(self._selected) == 1:
                axis, sign = _named(state, row)
                return Rotate(
                    part=self._pattern, axis=axis, angle=sign * degrees, mirror=self._mirror, repeat=self._repeat
                )
            return Rotate(
                part=self._pattern,
                axis=AXES[row],
                angle=degrees,
                frame="shape",
                mirror=self._mirror,
                repeat=self._repeat,
            )
        way = centre - before
        if not way.any():
            return None
        if self._panel.snap.value:
            others = _only(state.cage, [part for part in state.cage.part_ids if part not in self._selected])
            own_parts = _only(state.cage, self._selected)
            there = Cage(own_parts.part_ids, own_parts.centre + way, own_parts.axes, own_parts.size)
            way = way + snapped(there, others) * (np.abs(way) > 1e-9)
        return self._move(way)

    def _move(self, way: Float[ndarray, " 3"]) -> Operation:
        x, y, z = (self._document.state.similarity.rotation.T @ way / self._document.state.similarity.scale).tolist()
        return Move(part=self._pattern, by=(x, y, z), mirror=self._mirror, repeat=self._repeat)

    def _pulled(self, phase: str, axis: int, side: int, way: float) -> None:
        """A face was dragged outwards by `way`, canonical."""

        def act() -> None:
            state = self._document.state
            length = float(state.cage[self._one].size[axis])
            name, sign = _named(state, axis)
            factor = float(np.clip((length + way) / length, 0.02, 50))
            keep: End = "low" if side * sign > 0 else "high"
            self._drag(
                phase,
                Resize(
                    part=self._pattern, axis=name, factor=factor, keep=keep, mirror=self._mirror, repeat=self._repeat
                ),
            )

        self._guarded(act)

    @property
    def _mirror(self) -> bool:
        return bool(self._panel.mirror.value)

    @property
    def _repeat(self) -> bool:
        return bool(self._panel.repeat.value)

    def _place(self, centre: tuple[float, float, float]) -> None:
        state = self._document.state
        there = state.similarity.to_canonical(np.array([centre]))[0]
        self._do(self._move(there - state.cage[self._one].centre), ("centre", self._selected))

    def _lengths(self, lengths: tuple[float, float, float]) -> None:
        state = self._document.state
        if min(lengths) < SMALLEST / state.similarity.scale:
            raise InputError(f"lengths are at least {SMALLEST / state.similarity.scale:.3g}")
        factors = np.array(lengths) * state.similarity.scale / state.cage[self._one].size
        for row in np.flatnonzero(np.abs(factors - 1) > 1e-4).tolist():
            axis, _ = _named(state, row)
            self._do(
                Resize(
                    part=self._pattern, axis=axis, factor=float(factors[row]), mirror=self._mirror, repeat=self._repeat
                )
            )

    def _turn(self, degrees: tuple[float, float, float]) -> None:
        frame: Frame = "cuboid" if len(self._selected) == 1 else "shape"
        for axis, angle in zip(AXES, degrees):
            if angle:
                turn = Rotate(
                    part=self._pattern, axis=axis, angle=angle, frame=frame, mirror=self._mirror, repeat=self._repeat
                )
                self._do(turn)

    def _duplicate(self) -> None:
        """Copies beside what is selected, which are selected then."""
        state = self._document.state
        self._some()
        corners = _only(state.cage, self._selected).corners().reshape(-1, 3)
        way = np.ptp(corners @ state.similarity.rotation, axis=0)[0] / state.similarity.scale
        self._do(Duplicate(part=self._pattern, by=(float(way), 0.0, 0.0), mirror=self._mirror))
        self._select(tuple(part for part in self._document.state.cage.part_ids if part not in state.cage.part_ids))

    def _delete(self) -> None:
        self._some()
        self._do(Delete(part=self._pattern, mirror=self._mirror))

    def _split(self) -> None:
        """Across the longest axis of the first cuboid selected."""
        self._some()
        state = self._document.state
        axis, _ = _named(state, int(state.cage[self._selected[0]].size.argmax()))
        self._do(Split(part=self._pattern, axis=axis, mirror=self._mirror))

    def _some(self) -> None:
        if not self._selected:
            raise InputError("no part is selected; click one first")

    def _look(self) -> None:
        cage = self._document.state.cage
        self._stage.frame(_only(cage, self._selected) if self._selected else cage)

    def _set(self, parameter: str, value: float) -> None:
        if parameter != NOTHING:
            self._do(Set(parameter=parameter, value=value), ("set", parameter))

    def _blend(self, shape_id: str, weight: float) -> None:
        if shape_id != NOTHING:
            self._do(Blend(style_of=shape_id, weight=weight), ("blend", shape_id))

    def _mix(self, shape_id: str, weight: float) -> None:
        if shape_id == NOTHING:
            return
        if not self._selected:
            raise InputError("no part is selected; click those that are to take the style")
        mix = Mix(part=self._pattern, style_of=shape_id, weight=weight, mirror=self._mirror, repeat=self._repeat)
        self._do(mix, ("mix", self._selected, shape_id))

    def _direct(self, direction: int, place: float) -> None:
        code = self._opened.styles.moved(self._document.state.latent, direction, place)
        self._do(Style(code=tuple(code.tolist())), ("direct",))

    def _surprise(self, temperature: float) -> None:
        code = self._opened.styles.drawn(self._rng, temperature)
        self._do(Style(code=tuple(code.tolist())))

    # Shapes

    def _fresh(self, shape_id: str) -> Document:
        return Document.opened(shape_id, self._opened.session.opened(shape_id))

    def _open(self, shape_id: str) -> None:
        self._selected = ()
        self._become(self._fresh(shape_id))
        self._look()

    def _undo(self) -> None:
        self._become(self._document.undone(self._opened.session.styles))

    def _redo(self) -> None:
        self._become(self._document.redone(self._opened.session.styles))

    def _reset(self) -> None:
        self._become(self._document.reset())

    def _generate(self, temperature: float) -> None:
        if self._opened.generator is None:
            raise InputError("this run has no generator of new cuboids")
        self._draw(self._opened.generator, temperature)
        self._surprise(1.0)
        self._number += 1
        document, state = self._document, self._document.state
        colours = (CLAY,) * len(state.cage)
        [pictures], _ = render_rows([[Scene(cage=state.cage, cage_colours=colours)]], PICTURE)
        self._panel.add_made(side_by_side(pictures, 1), f"Take shape {self._number}", lambda: self._become(document))

    def _draw(self, generator: Generator, temperature: float) -> None:
        """Go on with the first new structure that can be edited: a cuboid may be too thin for it."""
        found = draw_cages(generator, self._rng, DRAWS, temperature)
        reasons = [*found.failures]
        for generated in found.kept:
            try:
                return self._build(generated)
            except InputError as error:
                reasons.append(str(error))
        raise InputError(f"no draw gave a shape to edit: {'; '.join(reasons)}; lower the temperature")

    def _build(self, generated: Generated) -> None:
        structure = generated.structure
        if structure.placed_program() is None:
            structure = structure.with_cuboids(generated.cage.cuboids())
        self._selected = ()
        self._do(Build(structure=structure.to_json()))

    # Files

    def _save(self) -> None:
        name = f"{self._document.shape_id}.json"
        self._client.send_file_download(name, dump(self._document.script).encode(), save_immediately=True)

    def _load(self, name: str, content: bytes) -> None:
        script = files.script_of(name, content)
        self._become(self._document.reset().continued(script, self._opened.session.styles))
        self._say(f"{name}: {len(script)} operations on {self._document.shape_id}")

    def _export(self, ending: str) -> None:
        content = files.exported(self._fine(), self._document.state, ending)
        self._download(f"{self._document.shape_id}.{ending}", content)

    def _export_cuboids(self, ending: str) -> None:
        content = files.exported_boxes(self._fine(), self._document.state, ending)
        self._download(f"{self._document.shape_id}-cuboids.{ending}", content)

    def _fine(self) -> Extraction:
        """What `cagesdf edit` gives, canonical."""
        state, made = self._document.state, self._made
        if made is None or made.state is not state or made.cells != FINE:
            return self._opened.session.live(FINE).surface(state)
        return made.found

    def _download(self, name: str, content: bytes) -> None:
        self._client.send_file_download(name, content, save_immediately=True)
        self._say(f"{name}: {len(content):,} bytes")

    def _upload_parts(self, name: str, content: bytes) -> None:
        self._say(f"{name}: fitting cuboids, and the style that explains it best")
        with TemporaryDirectory() as folder:
            try:
                taken = self._opened.take(files.meshes_of(name, content, Path(folder)))
            except InputError as error:
                raise InputError(str(error).replace(f"{folder}/", "").replace(folder, name)) from error
        styles = self._opened.session.styles
        build = Build(structure=taken.structure.to_json(), frame=tuple(taken.similarity.to_numbers()))
        document = self._document.then(build, styles).then(Style(code=tuple(taken.latent.tolist())), styles)
        self._selected = ()
        self._become(document)
        self._client.add_notification(name, f"{len(self._document.state.cage)} cuboids; {taken.verdict}")

    def _upload_program(self, name: str, content: bytes) -> None:
        self._build(of_program(files.program_of(name, content), self._opened.session.run))
        self._say(f"{name}: {len(self._document.state.cage)} cuboids")


def _only(cage: Cage, parts: Sequence[str]) -> Cage:
    return Cage.of({part: cage[part] for part in parts})


def _turned(before: Float[ndarray, "3 3"], after: Float[ndarray, "3 3"]) -> tuple[int, float] | None:
    """About which of its axes a frame has turned most, and by how many degrees; None if it hasn't."""
    vector = Turn.from_matrix(before @ after.T).as_rotvec(degrees=True)
    row = int(np.abs(vector).argmax())
    return (row, float(vector[row])) if abs(vector[row]) > 1e-3 else None


def _named(state: State, row: int) -> tuple[Axis, float]:
    """The user's axis that one of the cuboids' axes is named after, and 1 or -1: which way along it."""
    for axis in AXES:
        own, sign = state.own_axis(axis)
        if own == row:
            return axis, sign
    raise AssertionError(f"no axis is named {row}")
