"""One browser tab: each action becomes an operation of the script, and the resulting state is shown."""

import hashlib
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import PurePosixPath
from typing import Any

import numpy as np
import viser
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.editing.document import Document
from cagesdf.editing.health import Health
from cagesdf.editing.parts import parameters, part_names
from cagesdf.editing.script import Blend, Delete, Mix, Operation, Set, Style, Swap, dump
from cagesdf.editing.state import State
from cagesdf.extraction import Extraction
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh
from cagesdf.parts.changing import Dissection
from cagesdf.shape_generation.surfaces import of_program
from cagesdf.structure.base import Structure
from cagesdf.viewing import files
from cagesdf.viewing.angles import AXES, angles_of
from cagesdf.viewing.colours import Colour, part_colours
from cagesdf.viewing.dissecting import Desk, PartsPage
from cagesdf.viewing.drafts import Draft, Entry, Page
from cagesdf.viewing.drawing import in_new_style, new_shape
from cagesdf.viewing.fields import Typed
from cagesdf.viewing.framing import VIEWS
from cagesdf.viewing.gallery import Gallery
from cagesdf.viewing.hand import Hand, decimals_of, gizmo_frame, on_top, only
from cagesdf.viewing.jobs import Jobs, Progress, Stand
from cagesdf.viewing.keys import KEYS, card
from cagesdf.viewing.leaving import ask_before_leaving
from cagesdf.viewing.opening import Opened
from cagesdf.viewing.panel import NOTHING, WHOLE, Actions, Panel
from cagesdf.viewing.parameters import grouped
from cagesdf.viewing.partlist import PartList
from cagesdf.viewing.refusals import saying
from cagesdf.viewing.scene import BESIDE, LOOKS, TOOLS, Stage, label_of
from cagesdf.viewing.selection import Selection
from cagesdf.viewing.shelf import Shelf
from cagesdf.viewing.sliding import Control
from cagesdf.viewing.uploads import Taken, Upload
from cagesdf.viewing.worker import FINE_CELLS, Made, Worker
from cagesdf.viewing.workspace import Workspace

PATIENCE = 1.0  # seconds; progress of shorter work isn't shown


class Tab:
    """The state of one visitor. Callbacks may come from several threads; each waits for the one before."""

    def __init__(
        self,
        client: viser.ClientHandle,
        runs: Mapping[str, Opened],
        run: str,
        open_run: Callable[[str], None],
        pool: ThreadPoolExecutor,
        rng: np.random.Generator,
        page: Page,
    ) -> None:
        """A tab for the run of that name; `open_run` is called for a tab with another one in its place."""
        opened = runs[run]
        self._client, self._opened, self._rng, self._run, self._page = client, opened, rng, run, page
        self._lock = threading.RLock()
        self._coloured: tuple[Structure, dict[str, Colour]] | None = None
        self._made: Made | None = None
        self._previewed: State | None = None  # of a drag, last
        self._caged: State | None = None  # whose cuboids are shown
        self._fine_since = time.monotonic()  # the fine surface is being made
        self._asks = False  # whether the page asks before it is left
        self._offered: list[tuple[tuple[int, str], Draft]] = []  # as shown
        shelf = Shelf(self._fresh, frozenset(opened.session.run.sequences), self._keep)
        self._space = Workspace(shelf, opened.session.styles, opened.first)
        self._grounded: Structure | None = None  # whose ground is shown
        self._jobs = Jobs(self._show_stand, self._answered, self._refuse)
        self._problem: Any = None  # the notification of the last one
        self._card: Any = None  # of keys, the last one that was shown
        self._stage = Stage(client, self._click, self._moved, self._pulled)
        self._panel = Panel(
            client,
            Actions(
                open_shape=self._open,
                restore=self._restore,
                forget=self._forget,
                undo=lambda: self._after(self._space.undo),
                redo=lambda: self._after(self._space.redo),
                reset=lambda: self._after(self._space.reset),
                place=self._place,
                lengths=self._lengths,
                angles=self._angles,
                redraw=self._redraw,
                compare=self._compare,
                look=self._look,
                darken=self._darken,
                view=self._view,
                help=self._help,
                open_run=open_run,
                set_parameter=self._set,
                restyle=self._restyle,
                more_shapes=lambda: self._gallery.show_more_shapes(),
                more_styles=lambda: self._gallery.show_more_styles(self._space.state),
                cancel=self._cancel,
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
            tuple(runs),
            run,
            sorted(opened.session.run.sequences),
            [(round(float(low), 2), round(float(high), 2)) for low, high in opened.styles.ends],
            opened.generator is not None,
            self._guarded,
            self._answered,
        )
        self._gallery = Gallery(opened, self._panel)
        self._parts = PartList(
            client,
            self._pick,
            lambda part: self._show_or_hide(self._space.selection.blink(part)),
            self._act,
            self._guarded,
        )
        with self._panel.found:
            desk = Desk(
                self._space,
                self._become,
                self._jobs.start,
                self._give,
                self._stage.show_plane,
            )
            self._found = PartsPage(client.gui, desk, opened.importer, self._guarded)
        self._bind_keys()
        self._panel.shape.value = opened.first
        self._worker = Worker(opened.session, pool, self._show, self._tell, self._refuse)
        self._stage.frame(self._space.state.cage, "Perspective")
        self._show_document()
        self._gallery.show_ends(self._space.document.shape_id)
        self._gallery.show_more_shapes()
        self.offer()

    def _bind_keys(self) -> None:
        actions: dict[str, Callable[[], None]] = {
            **{tool.lower(): partial(self._take_tool, tool) for tool in TOOLS},
            **{view.lower(): partial(self._view, view) for view in VIEWS},
            "undo": lambda: self._after(self._space.undo),
            "redo": lambda: self._after(self._space.redo),
            "nothing": self._escape,
            "everything": lambda: self._select(self._space.selection.of(self._space.state.cage.part_ids)),
            "duplicate": partial(self._act, "Duplicate"),
            "delete": partial(self._act, "Delete"),
            "hide": partial(self._act, "Hide"),
            "show": partial(self._act, "Show all"),
            "frame": self._frame_selection,
            "look": self._next_look,
            "cuboids": self._toggle_cuboids,
            "help": self._help,
        }
        for word, keys in KEYS.items():
            for key in keys:
                label = key.does if key is keys[0] else f"{key.does} ({key})"
                command = self._client.gui.add_command(label, hotkey=key.key, modifier=key.held)
                command.on_trigger(partial(lambda act, _: self._guarded(act), actions[word]))

    def close(self) -> None:
        """Free what the tab holds."""
        self._jobs.cancel()
        self._panel.drop()
        self._gallery.close()
        self._opened.thumbnails.forget(id(self))
        self._worker.close()
        self._stage.close()

    # The view and the panel

    def _show(self, made: Made) -> None:
        if self._space.unfitted is not None:
            return
        self._made = made
        mesh, state = made.extraction.mesh, made.state
        with self._client.atomic():  # a frame for cuboids and surface
            if state is not self._caged and state in (self._space.state, self._previewed):
                self._show_cage(state)
            self._show_surface(made)
        mark = hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()[:8]
        self._panel.mark.value = f"{made.cells} cells, {mark}"
        self._panel.surface.value = f"{made.cells} cells, {len(mesh.faces):,} faces"
        self._say(f"{made.cells} cells in {made.seconds:.2f} s")
        if made.cells == FINE_CELLS:
            health = Health.of(made.extraction, state, made.cells)
            self._panel.show_health(f"{health}{self._nearness(mesh)}", health.warnings())
        else:
            self._fine_since = time.monotonic()

    def _show_surface(self, made: Made) -> None:
        self._stage.show_surface(made.extraction, made.state.cage, *self._appearance(made.state))

    def _tell(self, done: float | None) -> None:
        """Show the progress of the fine surface, if it takes long."""
        if not self._jobs.running and (done is None or time.monotonic() - self._fine_since > PATIENCE):
            self._panel.show_work(None if done is None else "fine surface", done or 0.0)

    def _show_stand(self, stand: Stand | None) -> None:
        self._panel.show_work(None if stand is None else stand.job, 0.0 if stand is None else stand.done)
        self._say("ready" if stand is None else f"{stand} …")

    def _cancel(self) -> None:
        """Cancel the job in the background, or the fine surface."""
        what = self._jobs.cancel()
        if what is None:
            self._worker.rest()
        self._say(f"{what or 'fine surface'}: cancelled")

    def _nearness(self, mesh: Mesh) -> str:
        """Mean distance of a canonical surface from that of the file that the shape comes from, in words."""
        if self._space.upload is None or not len(mesh.faces):
            return ""
        mean = SurfaceDistance(self._space.upload.truth).unsigned(mesh.vertices).mean()
        distance = mean / self._space.state.similarity.scale
        return f"; {distance:.2g} file units from the file's surface on average"

    def _say(self, text: str) -> None:
        self._panel.status.value = text

    def _guarded(self, act: Callable[[], None]) -> None:
        """Call an action under the lock, after the numbers that are being typed are taken as they are."""
        with self._lock:
            self._answered(self._panel.flush)
            self._answered(act)

    def _answered(self, act: Callable[[], None]) -> None:
        """Call an action under the lock. Its errors are shown, and nothing has changed then."""
        with self._lock, saying(self._refuse):
            act()

    def _refuse(self, text: str) -> None:
        """Show an error, until it is dismissed, or something else succeeds or fails."""
        self._dismiss()
        self._problem = self._client.add_notification("Not done", text, color="red")
        self._redraw()

    def _dismiss(self) -> None:
        """Take the last error away."""
        with suppress(Exception):  # the visitor may have dismissed it
            if self._problem is not None:
                self._problem.remove()
        self._problem = None

    def _colours(self, state: State) -> dict[str, Colour]:
        if self._coloured is None or self._coloured[0] is not state.structure:
            self._coloured = state.structure, part_colours(state)
        return self._coloured[1]

    def _appearance(self, state: State) -> tuple[dict[str, Colour], frozenset[str], str]:
        """Colours of the parts, those that are hidden, and the look."""
        return self._colours(state), self._space.selection.hidden, self._panel.look.value

    def _show_handles(self, state: State) -> None:
        pulled = self._panel.tool.value == "Resize" and not self._space.held_back
        self._stage.show_handles(self._space.one(state) if pulled else None)

    def _show_cage(self, state: State) -> None:
        self._caged = state
        self._stage.show_cage(state.cage, self._colours(state), self._space.selection, bool(self._panel.shown.value))

    def _look(self) -> None:
        """Show the surface in the look that is chosen, without the parts that are hidden."""
        if self._made is None or self._space.unfitted is not None:
            self._stage.show_look(*self._appearance(self._space.state))
        else:
            self._show_surface(self._made)

    def _redraw(self, state: State | None = None) -> None:
        """Show cuboids, gizmo and numbers: of the document, or of a state during a drag."""
        state = state or self._space.state
        self._show_cage(state)
        centre, axes = gizmo_frame(state, self._space.selection.parts)
        tool = self._panel.tool.value
        self._stage.show_gizmo(None if self._space.held_back else centre, axes, tool)
        self._show_handles(state)
        one = self._space.one(state)
        self._parts.show(state, self._colours(state), self._space.selection)
        unit = state.similarity
        self._panel.show_cuboid(
            None if centre is None else unit.to_raw(centre[None])[0],
            None if one is None else one.size[[state.own_axis(axis)[0] for axis in AXES]] / unit.scale,
            None if one is None else angles_of(state, one),
            decimals_of(state),
        )
        placed = state.structure.placed_program()
        values = {} if placed is None else parameters(placed[0])
        self._panel.show_program(values, grouped(state.structure, values))
        self._panel.show_style(self._opened.styles.places(state.latent))
        self._panel.show_shapes(self._space.shelf.made, self._space.document.name)
        self._panel.show_target(self._target or WHOLE, self._taken_style)
        self._gallery.show_styles(state)
        upload = self._space.upload
        truth = self._opened.truth(self._space.document.name) if upload is None else upload.truth
        self._panel.truth.visible = truth is not None
        self._stage.show_truth(truth, self._panel.truth.value)
        self._found.show()

    # Selection

    def _click(self, parts: tuple[str, ...], more: bool) -> None:
        self._guarded(lambda: self._select(self._space.selection.clicked(parts, more)))

    def _pick(self, parts: tuple[str, ...], more: bool) -> None:
        self._select(self._space.selection.listed(parts, more))

    def _select(self, selection: Selection) -> None:
        self._space.selection = selection
        self._redraw()
        self._say(f"selected: {label_of(part_names(self._space.state.structure), selection.parts)}")

    @property
    def _hand(self) -> Hand:
        return self._held(self._space.state)

    def _held(self, state: State) -> Hand:
        return self._space.hand(state, self._followers)

    def _show_or_hide(self, selection: Selection) -> None:
        """Show a selection that hides other parts than the one before."""
        self._space.selection = selection
        self._look()
        self._redraw()
        hidden = [part for part in self._space.state.cage.part_ids if part in selection.hidden]
        names = label_of(part_names(self._space.state.structure), hidden)
        self._say(f"hidden, but exported: {names}" if hidden else "all parts are shown")

    def _lock_or_free(self) -> None:
        self._space.selection = self._space.selection.lock_or_free()
        self._redraw()

    # Tools, views and looks

    def _take_tool(self, tool: str) -> None:
        self._panel.tool.value = tool
        self._redraw()

    def _view(self, view: str) -> None:
        self._stage.frame(self._space.state.cage, view)

    def _compare(self) -> None:
        """The true surface beside the other, and both in view."""
        self._redraw()
        cage = self._space.state.cage
        beside = {f"{part} beside": replace(own, centre=own.centre + BESIDE) for part, own in cage.cuboids().items()}
        self._stage.frame(Cage.of({**cage.cuboids(), **(beside if self._panel.truth.value > 0 else {})}))

    def _frame_selection(self) -> None:
        cage = self._space.state.cage
        self._stage.frame(only(cage, self._space.selection.parts) if self._space.selection.parts else cage)

    def _next_look(self) -> None:
        self._panel.look.value = LOOKS[(LOOKS.index(self._panel.look.value) + 1) % len(LOOKS)]
        self._look()

    def _darken(self) -> None:
        self._panel.theme(self._panel.dark.value)
        self._stage.show_dark(self._panel.dark.value)

    def _toggle_cuboids(self) -> None:
        self._panel.shown.value = not self._panel.shown.value
        self._redraw()

    def _help(self) -> None:
        """Show the card of keys, or put it away."""
        if self._card_is_shown:
            self._card.close()
            return
        self._card = self._client.gui.add_modal("Keys")
        with self._card:
            self._client.gui.add_markdown(card())
            self._client.gui.add_button("Close").on_click(lambda _: self._card.close())

    @property
    def _card_is_shown(self) -> bool:
        return self._card is not None and not self._card.closed

    def _escape(self) -> None:
        """Put the card of keys away, or select nothing."""
        if self._card_is_shown:
            self._card.close()
        else:
            self._select(self._space.selection.of(()))

    # Parts that come and go

    def _act(self, word: str) -> None:
        """The action of a button of the list."""
        actions = {
            "Hide": lambda: self._show_or_hide(self._space.selection.hide()),
            "Lock": self._lock_or_free,
            "Show all": lambda: self._show_or_hide(self._space.selection.show_all()),
            "Duplicate": self._duplicate,
            "One more": self._one_more,
            "Split": lambda: self._add(self._hand.split()),
            "Delete": self._delete,
            "Add": lambda: self._add(on_top(self._space.state)),
        }
        actions[word]()

    def _delete(self) -> None:
        """Delete what is selected, and nothing else: what mirrors it stays."""
        names = self._space.names
        self._do(Delete(part=self._space.pattern, mirror=False))
        self._say(f"deleted: {names}")

    def _duplicate(self) -> None:
        self._add(self._hand.duplicate())
        self._panel.repeat.value = False
        self._say(f"{self._space.names}: copied; repeated parts don't follow now")

    def _one_more(self) -> None:
        """One more part in the row of the selected one."""
        self._space.one_more(self._hand)
        self._show_document()
        self._say(f"{self._space.names}: one more, and all of the row stand evenly")

    # Operations

    def _do(self, operation: Operation, control: Control = ()) -> None:
        """Do an operation; one of the same control replaces the one before."""
        self._space.do(operation, control)
        self._show_document()

    def _slide(self, control: Control, operations: Callable[[State], Iterable[Operation]]) -> None:
        """Do what a control says of the state before it began to change."""
        self._space.slide(control, operations)
        self._show_document()

    def _add(self, operation: Operation) -> None:
        """Do an operation that adds parts, which are selected then."""
        self._space.add(operation)
        self._show_document()

    def _become(self, document: Document) -> None:
        self._after(lambda: self._space.become(document))

    def _after(self, act: Callable[[], None]) -> None:
        """Change the open document, and show it."""
        act()
        self._show_document()

    def _show_document(self) -> None:
        """Show the open document, and have its surface made."""
        document = self._space.document
        self._dismiss()
        if document.state.structure is not self._grounded:
            self._grounded = document.state.structure
            self._stage.show_ground(document.state.cage)
        self._redraw()
        if self._space.unfitted is not None:
            self._show_parts(self._space.unfitted)
            return
        self._panel.surface.value, self._panel.mark.value = "being made", ""
        self._say(f"{document.name}: its surface is being made")
        self._worker.want(document.state)

    def _show_parts(self, dissection: Dissection) -> None:
        """The mesh itself, in its parts."""
        self._made = None
        self._worker.rest()
        solids = {part.name: part.mesh for part in dissection.result.parts}
        self._stage.show_parts(solids, *self._appearance(self._space.state))
        self._panel.surface.value, self._panel.mark.value = "the mesh itself, in its parts", ""
        self._panel.show_health("of the network's surface, once it is fitted again", ())
        self._say(f"{self._space.document.name}: {len(solids)} parts, not fitted yet")

    def _preview(self, operation: Operation) -> None:
        """Show the result of an operation while a hand is still dragging: the cuboids with their surface."""
        self._previewed = self._space.tried(operation)
        if self._panel.tool.value == "Resize":
            self._show_handles(self._previewed)
        self._worker.want(self._previewed)

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
        self._answered(lambda: self._drag(phase, self._hand.dragged(centre, axes, bool(self._panel.snap.value))))

    def _pulled(self, phase: str, axis: int, side: int, distance: float) -> None:
        """A face was dragged outwards by a canonical distance."""
        self._answered(lambda: self._drag(phase, self._hand.pulled(axis, side, distance)))

    @property
    def _mirror(self) -> bool:
        return bool(self._panel.mirror.value)

    @property
    def _repeat(self) -> bool:
        return bool(self._panel.repeat.value)

    @property
    def _followers(self) -> dict[str, Any]:
        """The operation's fields about parts that follow."""
        attach, details = bool(self._panel.attach.value), self._panel.details.value
        return {"mirror": self._mirror, "repeat": self._repeat, "attach": attach, "details": details}

    def _place(self, centre: Typed) -> None:
        self._slide(("centre", self._space.selection.parts), lambda state: [self._held(state).placed(centre)])

    def _lengths(self, lengths: Typed) -> None:
        self._slide(("lengths", self._space.selection.parts), lambda state: self._held(state).resized(lengths))

    def _angles(self, angles: Typed) -> None:
        self._slide(("angles", self._space.selection.parts), lambda state: self._held(state).turned(angles))

    def _set(self, parameter: str, value: float | None) -> None:
        if parameter != NOTHING and value is not None:
            self._do(Set(parameter=parameter, value=value, details=self._panel.details.value), ("set", parameter))

    # Style

    @property
    def _taken_style(self) -> str:
        """The shape whose style the last operation took for the target; NOTHING for another operation."""
        done = self._space.document.done
        match done[-1] if done else None:
            case Mix(part=part, style_of=style_of) if self._target and part == "|".join(self._target.split(", ")):
                return style_of
            case Blend(style_of=style_of) | Swap(style_of=style_of) if not self._target:
                return style_of
        return NOTHING

    @property
    def _target(self) -> str:
        """Names of the parts that a style is for; empty for the whole shape."""
        return self._space.names if self._opened.session.styles.by_part else ""

    def _restyle(self, shape_id: str, weight: float) -> None:
        if shape_id == NOTHING:
            return
        if self._target:
            follow = {"mirror": self._mirror, "repeat": self._repeat, "details": self._panel.details.value}
            mix = Mix(part=self._space.pattern, style_of=shape_id, weight=weight, **follow)
            self._do(mix, ("mix", self._space.selection.parts, shape_id))
        else:
            self._do(Blend(style_of=shape_id, weight=weight), ("blend", shape_id))

    def _direct(self, direction: int, place: float) -> None:
        state = self._space.state
        code = self._opened.styles.moved(state.latent, direction, place)
        residuals = {
            part: tuple(state.residuals[seen].tolist())
            for part in state.cage.part_ids
            if (seen := state.seen_as(part)) in state.residuals
        }
        self._do(Style(code=tuple(code.tolist()), residuals=residuals or None), ("direct",))

    def _surprise(self, temperature: float) -> None:
        """A new style, drawn until the surface holds."""
        self._space.check_fitted()
        document, rng = self._space.document, self._rng.spawn(1)[0]

        def work(progress: Progress) -> Callable[[], None]:
            drawn = in_new_style(self._opened, document, rng, temperature, progress)
            return lambda: self._do(drawn.script[-1])

        self._jobs.start("New style", work)

    # Shapes

    def _fresh(self, shape_id: str) -> Document:
        return Document.opened(shape_id, self._opened.session.opened(shape_id))

    def _open(self, name: str) -> None:
        self._take(self._space.shelf.take(name))

    def _take(self, document: Document) -> None:
        """Open another document."""
        self._panel.show_health("of the surface, once it is made", ())
        self._after(lambda: self._space.open(document))
        self._stage.frame(document.state.cage, "Perspective")
        self._gallery.show_ends(document.shape_id)

    def _remember(self, document: Document, upload: Upload | None) -> None:
        """A shape that was made here: in the list, with a thumbnail, and open."""
        self._show_made(self._space.shelf.add(document, upload))

    def _show_made(self, document: Document) -> None:
        self._take(document)
        made = self._space.shelf.made
        self._panel.made.show(made)
        states = {(id(self), name): partial(self._first_state, name) for name in made}
        self._opened.thumbnails.want(
            id(self), states, lambda key, picture: self._panel.made.put(key[1], picture), urgent=True
        )

    def _first_state(self, name: str) -> State:
        return self._space.shelf.first(name).state

    def _generate(self, temperature: float) -> None:
        """A new shape in a new style, drawn until its surface holds."""
        start, rng = self._space.document.reset(), self._rng.spawn(1)[0]

        def work(progress: Progress) -> Callable[[], None]:
            drawn = new_shape(self._opened, start, rng, temperature, progress)
            return lambda: self._remember(drawn.named("new"), None)

        self._jobs.start("New shape", work)

    # Work that outlives the page

    def _keep(self, entry: Entry) -> None:
        self._page.keep(self._run, entry)
        self._ask()

    def _ask(self) -> None:
        """Have the page ask before it is left, if something would be lost."""
        if self._space.shelf.unsaved != self._asks:
            self._asks = self._space.shelf.unsaved
            ask_before_leaving(self._client, self._asks)

    def offer(self) -> None:
        """Offer the drafts of this browser's pages that are closed."""
        self._offered = list(self._page.offered(self._run).items())
        self._panel.show_drafts([draft.in_words(time.time()) for _, draft in self._offered])

    def _restore(self, number: int) -> None:
        key, draft = self._offered[number]
        document = self._space.shelf.restore(draft, self._opened.session.styles)
        self._page.drop(key)
        self._show_made(document)
        self.offer()

    def _forget(self) -> None:
        for key, _ in self._offered:
            self._page.drop(key)
        self.offer()

    # Files

    def _save(self) -> None:
        name = f"{self._space.document.name}.json"
        self._client.send_file_download(name, dump(self._space.document.script).encode(), save_immediately=True)
        self._saved()

    def _saved(self) -> None:
        self._space.shelf.save(self._space.document.name)
        self._ask()

    def _load(self, name: str, content: bytes) -> None:
        with files.script_called(name):
            script = files.script_of(name, content)
            document = self._fresh(self._space.document.shape_id).continued(script, self._opened.session.styles)
        self._space.shelf.take(document.name)
        self._after(lambda: self._space.replace(document))
        self._say(f"{name}: {len(script)} operations on {document.shape_id}; one undo leads back")

    def _export(self, ending: str) -> None:
        self._write(f"{self._space.document.name}.{ending}", ending, files.exported)

    def _export_cuboids(self, ending: str) -> None:
        self._write(f"{self._space.document.name}-cuboids.{ending}", ending, files.exported_boxes)

    def _write(self, name: str, ending: str, content_of: Callable[[Extraction, State, str], bytes]) -> None:
        """Download a file that equals the one of `cagesdf edit`."""
        self._space.check_fitted()
        state, made = self._space.state, self._made

        def work(progress: Progress) -> Callable[[], None]:
            if made is not None and made.state is state and made.cells == FINE_CELLS:
                extraction = made.extraction
            else:
                live = self._opened.session.live(FINE_CELLS)
                extraction = live.surface(state, progress.each("fine surface"))
            progress("writing", 0.9)
            content = content_of(extraction, state, ending)
            return lambda: self._download(name, content)

        self._jobs.start(name, work)

    def _download(self, name: str, content: bytes) -> None:
        self._give(name, content)
        self._saved()

    def _give(self, name: str, content: bytes) -> None:
        self._client.send_file_download(name, content, save_immediately=True)
        self._say(f"{name}: {len(content):,} bytes")

    def _upload_parts(self, name: str, content: bytes) -> None:
        start, styles, importer = self._space.document.reset(), self._opened.session.styles, self._opened.importer

        def work(progress: Progress) -> Callable[[], None]:
            progress("reading")
            raw = importer.read(name, content)
            taken = importer.take(raw, name, progress)
            build, style = taken.operations()
            document = start.then(build, styles).then(style, styles).named(PurePosixPath(name).stem)
            return partial(self._uploaded, document, Upload(name, raw, taken.truth, taken.origin), taken)

        self._jobs.start(name, work)

    def _uploaded(self, document: Document, upload: Upload, taken: Taken) -> None:
        self._remember(document, upload)
        whose = f" {taken.origin.parts} (see Found parts)" if upload.raw.whole else ""
        self._client.add_notification(upload.file, f"{len(document.state.cage)} cuboids{whose}; {taken.verdict}")

    def _upload_program(self, name: str, content: bytes) -> None:
        program = of_program(files.program_of(name, content), self._opened.session.run)
        document = self._space.document.reset().then(self._opened.build(program), self._opened.session.styles)
        self._remember(document.named(PurePosixPath(name).stem), None)
