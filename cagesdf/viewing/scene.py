"""What one tab shows: the surface, coloured by part, translucent cuboids, a gizmo and handles on what is selected."""

from collections.abc import Callable, Mapping, Sequence
from colorsys import hsv_to_rgb
from itertools import count
from typing import Any

import numpy as np
import viser
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.editing.links import linked, mirrors, repeats
from cagesdf.editing.state import State
from cagesdf.meshes import Mesh, compact
from cagesdf.rendering import CLAY, EDGES, PART_COLOURS, rgb
from cagesdf.viewing.picking import along

Colour = tuple[int, int, int]

SELECTED: Colour = (255, 0, 200)  # of outlines and handles; no part has it
BOX_OPACITY = 0.13
EDGE_WIDTH, OUTLINE_WIDTH = 1.5, 4.0  # pixels
GOLDEN = (5**0.5 - 1) / 2  # of a turn: hues so far apart don't come near each other again for long
GIZMO_SIZE, HANDLE_RADIUS, CLEAR = 0.24, 0.024, 0.3  # canonical; handles are CLEAR from the gizmo's middle at least
ROOM = 1.05  # around what is framed
BESIDE = 1.6  # canonical: from the surface to the true one beside it

Click = Callable[[tuple[str, ...], bool], None]  # cuboids under the mouse, nearest first; with shift
Move = Callable[[str, Float[ndarray, " 3"], Float[ndarray, "3 3"]], None]  # phase, centre, axes by rows
Pull = Callable[[str, int, int, float], None]  # phase, axis, side (-1 or 1), how far outwards


def part_colours(state: State) -> dict[str, Colour]:
    """A colour a part; those that mirror or repeat each other share it, and those of one label."""
    links = [mirrors(state), repeats(state)]
    labels = state.structure.labels()
    colours: dict[str, Colour] = {}
    number = count()
    for part in state.cage.part_ids:
        if part in colours:
            continue
        alike = {part}
        while True:
            words = {labels[each] for each in alike} - {""}
            more = {*linked(sorted(alike), links), *(each for each in labels if labels[each] in words)}
            if more == alike:
                break
            alike = more
        colours |= dict.fromkeys(alike, _colour(next(number)))
    return colours


def _colour(number: int) -> Colour:
    """The palette's, and when it ends softer ones around the wheel."""
    if number < len(PART_COLOURS):
        return rgb(PART_COLOURS[number])
    red, green, blue = hsv_to_rgb(number * GOLDEN % 1, 0.35, 0.9)
    return round(255 * red), round(255 * green), round(255 * blue)


def quaternion(axes: Float[ndarray, "3 3"]) -> Float[ndarray, " 4"]:
    """Of a frame whose axes are the rows: w, x, y, z."""
    return np.roll(Rotation.from_matrix(axes.T).as_quat(), 1)


def axes_of(wxyz: Float[ndarray, " 4"]) -> Float[ndarray, "3 3"]:
    """The rows of that frame; undoes `quaternion`."""
    return Rotation.from_quat(np.roll(wxyz, -1)).as_matrix().T


def handle_place(cuboid: Cuboid, axis: int, side: int) -> Float[ndarray, " 3"]:
    """Where the handle of a face is: on it, or as far out as the gizmo needs."""
    return cuboid.centre + side * max(cuboid.size[axis] / 2 + HANDLE_RADIUS, CLEAR) * cuboid.axes[axis]


def framed(cage: Cage, towards: Float[ndarray, " 3"], fov: float) -> tuple[Float[ndarray, " 3"], Float[ndarray, " 3"]]:
    """From where, in a direction, a camera sees a cage as large as may be, and the point that it looks at.

    `fov` is the angle that the view takes upright, in radians.
    """
    corners = cage.corners().reshape(-1, 3)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    radius = np.linalg.norm(corners - middle, axis=1).max()
    return middle + ROOM * radius / np.sin(fov / 2) * towards / np.linalg.norm(towards), middle


class Stage:
    """The 3-D scene of one client. Frame: canonical, y up."""

    def __init__(self, client: viser.ClientHandle, click: Click, move: Move, pull: Pull) -> None:
        """`click` is called for clicks, `move` and `pull` while gizmo and handles are dragged."""
        self._client, self._scene = client, client.scene
        self._click, self._move, self._pull = click, move, pull
        self._boxes: dict[str, Any] = {}
        # Of boxes and gizmos: a node that had the name of an earlier one would begin with its pose.
        self._numbers = count()
        self._cage: Cage | None = None  # as shown; None while hidden
        self._pieces: list[Any] = []
        self._handles: dict[tuple[int, int], Any] = {}
        self._gizmo: Any = None
        self._truth: Any = None
        self._scene.set_up_direction("+y")
        # Clicks are those of the whole scene: boxes that listened would keep the mouse from a gizmo behind them.
        self._scene.on_click()(lambda event: self._clicked(event, more=False))
        self._scene.on_click(modifier="shift")(lambda event: self._clicked(event, more=True))
        self._ground = self._scene.add_grid(
            "/ground", 4.0, 4.0, plane="xz", cell_size=0.2, section_size=1.0, cell_color=(236, 235, 232),
            section_color=(222, 220, 214), fade_distance=6.0,
        )  # fmt: skip

    def show_ground(self, cage: Cage) -> None:
        """The ground, where a cage stands."""
        self._ground.position = (0.0, float(cage.corners()[:, :, 1].min()) - 2e-3, 0.0)

    def frame(self, cage: Cage) -> None:
        """The camera so far away that a cage fills the view, in the direction that it looks in."""
        camera = self._client.camera
        position, look_at = framed(cage, np.asarray(camera.position) - np.asarray(camera.look_at), camera.fov)
        with self._client.atomic():
            camera.position, camera.look_at = position, look_at

    def show_surface(self, mesh: Mesh, state: State) -> None:
        """A surface cut into its parts."""
        cage, colours = state.cage, part_colours(state)
        owner, _ = cage.assign(mesh.corners().mean(axis=1)) if len(mesh.faces) else (np.zeros(0, int), None)
        with self._client.atomic():
            for piece in self._pieces:
                piece.remove()
            self._pieces = [
                self._scene.add_mesh_simple(
                    f"/surface/{i}",
                    own.vertices.astype(np.float32),
                    own.faces.astype(np.uint32),
                    color=colours[cage.part_ids[i]],
                )
                for i in np.unique(owner).tolist()
                if len((own := compact(Mesh(mesh.vertices, mesh.faces[owner == i]))).faces)
            ]

    def show_cage(self, state: State, selected: Sequence[str], shown: bool) -> None:
        """The cuboids; those of the same parts are moved, others are made anew. Selected ones have an outline."""
        cage, colours = state.cage, part_colours(state)
        self._cage = cage if shown else None
        with self._client.atomic():
            if tuple(self._boxes) != cage.part_ids:
                for box in self._boxes.values():
                    box.remove()
                self._boxes = {part: self._box(cage[part]) for part in cage.part_ids}
            for part, box in self._boxes.items():
                cuboid = cage[part]
                box.position, box.wxyz, box.dimensions = cuboid.centre, quaternion(cuboid.axes), tuple(cuboid.size)
                box.color, box.opacity, box.visible = colours[part], BOX_OPACITY, shown
            chosen = [part in selected for part in cage.part_ids]
            own = [colours[part] for part in cage.part_ids]
            self._show_edges("/edges", cage.corners(), own, EDGE_WIDTH, shown)
            outlines = cage.corners()[chosen]
            self._show_edges("/outlines", outlines, [SELECTED] * len(outlines), OUTLINE_WIDTH, shown and any(chosen))

    def _box(self, cuboid: Cuboid) -> Any:
        return self._scene.add_box(f"/cuboids/{next(self._numbers)}", dimensions=tuple(cuboid.size), cast_shadow=False)

    def _clicked(self, event: viser.SceneClickEvent, more: bool) -> None:
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        if self._cage is not None and not self._on_handle(origin, direction):
            self._click(along(self._cage, origin, direction), more)

    def _on_handle(self, origin: Float[ndarray, " 3"], direction: Float[ndarray, " 3"]) -> bool:
        """Whether a ray meets a handle; what is grabbed isn't clicked."""
        ways = [np.asarray(handle.position) - origin for handle in self._handles.values()]
        return any(np.linalg.norm(np.cross(way, direction)) <= HANDLE_RADIUS for way in ways)

    def _show_edges(
        self, name: str, corners: Float[ndarray, "p 8 3"], colours: Sequence[Colour], width: float, shown: bool
    ) -> None:
        if not shown:
            self._scene.remove_by_name(name)
            return
        lines = corners[:, EDGES].reshape(-1, 2, 3)
        own = np.repeat(np.array(colours, np.uint8).reshape(-1, 3), len(EDGES), axis=0)
        self._scene.add_line_segments(
            name,
            lines.astype(np.float32),
            np.repeat(own[:, None], 2, axis=1),
            thickness=width,
            thickness_units="screen",
        )

    def show_gizmo(self, centre: Float[ndarray, " 3"] | None, axes: Float[ndarray, "3 3"]) -> None:
        """The gizmo there; nowhere with None."""
        if centre is None:
            if self._gizmo is not None:
                self._gizmo.remove()
                self._gizmo = None
            return
        if self._gizmo is None:
            self._gizmo = self._scene.add_transform_controls(
                f"/gizmo/{next(self._numbers)}", GIZMO_SIZE, depth_test=False, line_width=3.0
            )

            # Callbacks that are coroutines are called in order.
            async def dragged(event: viser.TransformControlsEvent) -> None:
                self._move(event.phase, np.asarray(event.target.position), axes_of(np.asarray(event.target.wxyz)))

            self._gizmo.on_update(dragged)
        self._gizmo.position, self._gizmo.wxyz = centre, quaternion(axes)

    def show_handles(self, cuboid: Cuboid | None) -> None:
        """A handle on each face of a cuboid; none with None."""
        if cuboid is None:
            for handle in self._handles.values():
                handle.remove()
            self._handles = {}
            return
        with self._client.atomic():
            for axis in range(3):
                for side in (-1, 1):
                    if (axis, side) not in self._handles:
                        self._handles[axis, side] = self._handle(axis, side)
                    self._handles[axis, side].position = handle_place(cuboid, axis, side)
        self._handled = cuboid

    def _handle(self, axis: int, side: int) -> Any:
        handle = self._scene.add_icosphere(
            f"/handles/{'xyz'[axis]}{'+' if side > 0 else '-'}", HANDLE_RADIUS, SELECTED, cast_shadow=False
        )
        grabbed: dict[str, ndarray] = {}

        async def dragged(event: Any) -> None:
            there = np.asarray(event.end_position)
            if event.phase == "start":
                grabbed["from"], grabbed["along"] = np.asarray(event.start_position), side * self._handled.axes[axis]
            self._pull(event.phase, axis, side, float((there - grabbed["from"]) @ grabbed["along"]))

        handle.on_drag(dragged)
        return handle

    def show_truth(self, mesh: Mesh | None, opacity: float) -> None:
        """The true surface beside; not there with None or opacity 0."""
        if self._truth is not None:
            self._truth.remove()
            self._truth = None
        if mesh is not None and opacity > 0:
            self._truth = self._scene.add_mesh_simple(
                "/truth", mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32), color=rgb(CLAY),
                opacity=opacity if opacity < 1 else None, position=(BESIDE, 0.0, 0.0),
            )  # fmt: skip


def label_of(names: Mapping[str, str], parts: Sequence[str]) -> str:
    """What is selected, in words."""
    return ", ".join(names[part] for part in parts) or "nothing"
