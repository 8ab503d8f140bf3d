"""The scene of one tab: the surface, coloured by part, translucent cuboids, a gizmo or handles on the selection."""

import threading
from collections.abc import Callable, Mapping, Sequence, Set
from itertools import count
from typing import Any

import numpy as np
import viser
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.extraction import Extraction, face_owners
from cagesdf.geometry.meshes import Mesh, compact
from cagesdf.rendering import CLAY, EDGES, rgb
from cagesdf.viewing.colours import AXES, SELECTED, Colour
from cagesdf.viewing.framing import VIEWS, camera_for, world_per_pixel
from cagesdf.viewing.picking import along
from cagesdf.viewing.selection import Selection

BOX_OPACITY, PLANE_OPACITY = 0.1, 0.4
EDGE_WIDTH, OUTLINE_WIDTH = 1.5, 4.0  # pixels
GIZMO_PIXELS, HANDLE_PIXELS = 90, 8  # an arrow's length and a handle's radius on the screen
BESIDE = (1.6, 0.0, 0.0)  # canonical: from the surface to the true one beside it
# Lines between cells and sections of the ground, on a light page and a dark one.
GROUND: dict[bool, tuple[Colour, Colour]] = {
    False: ((236, 235, 232), (222, 220, 214)),
    True: ((42, 42, 44), (58, 58, 62)),
}
# Light of the sky (its colour, the ground's) and of lamps (colour, intensity, where from). viser's own, an environment
# and shadows, takes five times as long to draw where there is no graphics card.
SKY, FLOOR, SKY_INTENSITY = (255, 255, 255), (112, 112, 120), 2.0
LAMPS = (((255, 250, 242), 2.1, (1.5, 3.6, 3.4)), ((235, 240, 255), 0.8, (-4.0, 1.5, 1.0)))
TOOLS = ("Move", "Turn", "Resize")
LOOKS = ("Parts", "Clay", "Wireframe")

Click = Callable[[tuple[str, ...], bool], None]  # cuboids under the mouse, nearest first; with shift
Move = Callable[[str, Float[ndarray, " 3"], Float[ndarray, "3 3"]], None]  # phase, centre, axes by rows
Pull = Callable[[str, int, int, float], None]  # phase, axis, side (-1 or 1), how far outwards


def quaternion(axes: Float[ndarray, "3 3"]) -> Float[ndarray, " 4"]:
    """Quaternion (w, x, y, z) of a frame whose axes are the rows."""
    return np.roll(Rotation.from_matrix(axes.T).as_quat(), 1)


def axes_of(wxyz: Float[ndarray, " 4"]) -> Float[ndarray, "3 3"]:
    """The rows of that frame; undoes `quaternion`."""
    return Rotation.from_quat(np.roll(wxyz, -1)).as_matrix().T


def handle_place(cuboid: Cuboid, axis: int, side: int) -> Float[ndarray, " 3"]:
    """The middle of a face, where its handle is."""
    return cuboid.centre + side * cuboid.size[axis] / 2 * cuboid.axes[axis]


class Stage:
    """The 3-D scene of one client. Frame: canonical, y up."""

    def __init__(self, client: viser.ClientHandle, click: Click, move: Move, pull: Pull) -> None:
        """`click` is called for clicks, `move` and `pull` while gizmo and handles are dragged."""
        self._client, self._scene = client, client.scene
        self._click, self._move, self._pull = click, move, pull
        self._boxes: dict[str, Any] = {}
        self._numbers = count()  # of boxes and gizmos: a node with an earlier one's name would begin with its pose
        self._cage: Cage | None = None  # cuboids that can be clicked
        self._pieces: dict[str, tuple[Mesh, Any]] = {}  # the surface, cut by part: its meshes and nodes, by part id
        self._handles: dict[tuple[int, int], Any] = {}
        self._following = threading.Lock()  # guards nodes that follow the camera, in its event loop
        # The cage that the camera was placed for, the view's width over its height then, and the camera's last
        # positions: a page may report an older one than the newest.
        self._framed: tuple[Cage, float] | None = None
        self._places: tuple[Float[ndarray, " 3"], ...] = (np.array(client.camera.position),)
        self._gizmo: Any = None
        self._tool = ""  # the gizmo's
        self._edges: Any = None
        self._outline: Any = None
        self._truth: Any = None
        self._plane: Any = None
        self._scene.set_up_direction("+y")
        self._light()
        # Clicks are those of the whole scene: boxes that listened would keep the mouse from a gizmo behind them.
        self._scene.on_click()(lambda event: self._clicked(event, more=False))
        self._scene.on_click(modifier="shift")(lambda event: self._clicked(event, more=True))
        cells, sections = GROUND[False]
        self._ground = self._scene.add_grid(
            "/ground", 4.0, 4.0, plane="xz", cell_size=0.2, section_size=1.0, cell_color=cells,
            section_color=sections, fade_distance=6.0,
        )  # fmt: skip

        async def looked(_: Any) -> None:
            self._fit()
            self._resize()

        client.camera.on_update(looked)

    def _light(self) -> None:
        self._scene.configure_environment_map(None)
        self._scene.configure_default_lights(enabled=False)
        self._scene.add_light_hemisphere(
            "/lights/sky", sky_color=SKY, ground_color=FLOOR, intensity=SKY_INTENSITY, position=(0.0, 1.0, 0.0)
        )
        for number, (colour, intensity, position) in enumerate(LAMPS):
            self._scene.add_light_directional(f"/lights/{number}", color=colour, intensity=intensity, position=position)

    def close(self) -> None:
        """Follow the camera no more; viser keeps its callbacks as long as the page is there."""
        with self._following:
            self._framed, self._gizmo, self._handles = None, None, {}

    # Camera

    def frame(self, cage: Cage, view: str | None = None) -> None:
        """Look at a cage so that it fills the view: from one of VIEWS, or from where the camera is."""
        camera = self._client.camera
        direction = np.array(VIEWS[view]) if view else camera.position - camera.look_at
        position, target = camera_for(cage, direction, camera.fov, camera.aspect)
        self._framed, self._places = (cage, camera.aspect), (*self._places[-1:], position)
        with self._client.atomic():
            camera.position = position  # viser takes what is looked at along
            camera.look_at = target

    def _fit(self) -> None:
        """Frame the cage again where the view has another shape, until somebody looks from elsewhere."""
        if self._framed is None:
            return
        cage, aspect = self._framed
        camera = self._client.camera
        if not any(np.allclose(camera.position, place, atol=1e-3) for place in self._places):
            self._framed = None
        elif abs(camera.aspect / aspect - 1) > 0.01:
            self.frame(cage)

    def _pixel(self, point: Float[ndarray, " 3"]) -> float:
        """A pixel's length at a place."""
        camera = self._client.camera
        return world_per_pixel(float(np.linalg.norm(camera.position - point)), camera.fov, camera.image_height)

    def _resize(self) -> None:
        """Keep the size of gizmo and handles on the screen."""
        with self._following:
            sizes = [(handle, HANDLE_PIXELS) for handle in self._handles.values()]
            if self._gizmo is not None:
                sizes.append((self._gizmo, GIZMO_PIXELS))
            for node, pixels in sizes:
                scale = pixels * self._pixel(np.asarray(node.position))
                if abs(node.scale - scale) > 0.02 * scale:
                    node.scale = scale

    # Nodes

    def show_dark(self, dark: bool) -> None:
        """The ground's lines for a dark page or a light one."""
        self._ground.cell_color, self._ground.section_color = GROUND[dark]

    def show_ground(self, cage: Cage) -> None:
        """The ground, where a cage stands."""
        self._ground.position = (0.0, float(cage.corners()[:, :, 1].min()) - 2e-3, 0.0)

    def show_surface(
        self, surface: Extraction, cage: Cage, colours: Mapping[str, Colour], hidden: Set[str], look: str
    ) -> None:
        """A surface cut into its parts, in one of LOOKS; while some are hidden, the others as closed parts."""
        if hidden & surface.parts.keys():
            self.show_parts(surface.parts, colours, hidden, look)
            return
        mesh = surface.mesh
        owners = face_owners(mesh, surface.parts, cage)
        patches = {
            cage.part_ids[i]: compact(Mesh(mesh.vertices, mesh.faces[owners == i])) for i in np.unique(owners).tolist()
        }
        self.show_parts(patches, colours, hidden, look)

    def show_parts(
        self, meshes: Mapping[str, Mesh], colours: Mapping[str, Colour], hidden: Set[str], look: str
    ) -> None:
        """A mesh for each part in the surface's place, in one of LOOKS; those that are the same aren't sent again."""
        with self._client.atomic():
            before, self._pieces = self._pieces, {}
            for part, mesh in meshes.items():
                if part in before and _equal(before[part][0], mesh):
                    self._pieces[part] = before.pop(part)
                elif len(mesh.faces):
                    colour = rgb(CLAY) if look == "Clay" else colours[part]
                    self._pieces[part] = mesh, self._piece(mesh, colour, look == "Wireframe", part not in hidden)
            for _, piece in before.values():
                piece.remove()
            self.show_look(colours, hidden, look)

    def _piece(self, mesh: Mesh, colour: Colour, wireframe: bool, visible: bool) -> Any:
        name, vertices = f"/surface/{next(self._numbers)}", mesh.vertices.astype(np.float32)
        faces = mesh.faces.astype(np.uint32)
        return self._scene.add_mesh_simple(name, vertices, faces, color=colour, wireframe=wireframe, visible=visible)

    def show_look(self, colours: Mapping[str, Colour], hidden: Set[str], look: str) -> None:
        """The same surface in another of LOOKS, or with other parts hidden."""
        with self._client.atomic():
            for part, (_, piece) in self._pieces.items():
                piece.color = rgb(CLAY) if look == "Clay" else colours.get(part, rgb(CLAY))
                piece.wireframe, piece.visible = look == "Wireframe", part not in hidden

    def show_cage(self, cage: Cage, colours: Mapping[str, Colour], selection: Selection, shown: bool) -> None:
        """The cuboids: moved while the parts are the same, otherwise made anew. Selecting changes outlines alone."""
        free = [part for part in cage.part_ids if part not in selection.hidden]
        self._cage = Cage.of({part: cage[part] for part in free if part not in selection.locked})
        with self._client.atomic():
            if tuple(self._boxes) != cage.part_ids:
                for box in self._boxes.values():
                    box.remove()
                self._boxes = {part: self._box(cage[part]) for part in cage.part_ids}
            for part, box in self._boxes.items():
                cuboid = cage[part]
                box.position, box.wxyz, box.dimensions = cuboid.centre, quaternion(cuboid.axes), tuple(cuboid.size)
                box.color, box.opacity, box.visible = colours[part], BOX_OPACITY, shown and part in free
            edged = free if shown else []
            part_colours = np.array([colours[part] for part in edged], np.uint8).reshape(-1, 3)
            self._edges = self._lines("/edges", cage, edged, part_colours, EDGE_WIDTH)
            outlined = [part for part in selection.parts if part in cage.part_ids]
            pink = np.tile(np.array(SELECTED, np.uint8), (len(outlined), 1))
            self._outline = self._lines("/outline", cage, outlined, pink, OUTLINE_WIDTH)

    def _lines(self, name: str, cage: Cage, parts: Sequence[str], colours: ndarray, width: float) -> Any:
        """The edges of some cuboids; a node without any stays out of sight."""
        corners = Cage.of({part: cage[part] for part in parts}).corners() if parts else np.zeros((1, 8, 3))
        colours = colours if parts else np.zeros((1, 3), np.uint8)
        return self._scene.add_line_segments(
            name,
            corners[:, EDGES].reshape(-1, 2, 3).astype(np.float32),
            np.repeat(np.repeat(colours, len(EDGES), axis=0)[:, None], 2, axis=1),
            thickness=width,
            thickness_units="screen",
            visible=bool(parts),
        )

    def _box(self, cuboid: Cuboid) -> Any:
        return self._scene.add_box(f"/cuboids/{next(self._numbers)}", dimensions=tuple(cuboid.size), cast_shadow=False)

    def _clicked(self, event: viser.SceneClickEvent, more: bool) -> None:
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        if self._cage is not None and not self._on_handle(origin, direction):
            self._click(along(self._cage, origin, direction), more)

    def _on_handle(self, origin: Float[ndarray, " 3"], direction: Float[ndarray, " 3"]) -> bool:
        """Whether a ray meets a handle: grabbing one is no click."""
        handles = [(np.asarray(handle.position) - origin, handle.scale) for handle in self._handles.values()]
        return any(np.linalg.norm(np.cross(offset, direction)) <= radius for offset, radius in handles)

    def show_gizmo(self, centre: Float[ndarray, " 3"] | None, axes: Float[ndarray, "3 3"], tool: str) -> None:
        """The gizmo there, with arrows or rings; nowhere with None, and where faces are pulled instead."""
        if centre is None or tool not in ("Move", "Turn"):
            self._remove_gizmo()
            return
        if self._tool != tool:
            self._remove_gizmo()
        if self._gizmo is None:
            self._tool = tool
            self._gizmo = self._scene.add_transform_controls(
                f"/gizmo/{next(self._numbers)}",
                GIZMO_PIXELS * self._pixel(centre),
                depth_test=False,
                line_width=3.0,
                disable_rotations=tool == "Move",
                disable_axes=tool == "Turn",
                disable_sliders=tool == "Turn",
            )

            # Callbacks that are coroutines are called in order.
            async def dragged(event: viser.TransformControlsEvent) -> None:
                self._move(event.phase, np.asarray(event.target.position), axes_of(np.asarray(event.target.wxyz)))

            self._gizmo.on_update(dragged)
        self._gizmo.position, self._gizmo.wxyz = centre, quaternion(axes)
        self._resize()

    def _remove_gizmo(self) -> None:
        with self._following:
            if self._gizmo is not None:
                self._gizmo.remove()
                self._gizmo, self._tool = None, ""

    def show_handles(self, cuboid: Cuboid | None) -> None:
        """A handle on each face of a cuboid, in its axis's colour; none with None."""
        if cuboid is None:
            with self._following:
                for handle in self._handles.values():
                    handle.remove()
                self._handles = {}
            return
        self._handled = cuboid
        with self._client.atomic():
            with self._following:
                for axis in range(3):
                    for side in (-1, 1):
                        if (axis, side) not in self._handles:
                            self._handles[axis, side] = self._handle(axis, side)
                        self._handles[axis, side].position = handle_place(cuboid, axis, side)
            self._resize()

    def _handle(self, axis: int, side: int) -> Any:
        name = f"/handles/{next(self._numbers)}{'xyz'[axis]}{'+' if side > 0 else '-'}"
        handle = self._scene.add_icosphere(name, 1.0, AXES[axis], scale=0.02, cast_shadow=False)
        grabbed: dict[str, ndarray] = {}

        async def dragged(event: Any) -> None:
            end = np.asarray(event.end_position)
            if event.phase == "start":
                grabbed["from"], grabbed["along"] = np.asarray(event.start_position), side * self._handled.axes[axis]
            self._pull(event.phase, axis, side, float((end - grabbed["from"]) @ grabbed["along"]))

        handle.on_drag(dragged)
        return handle

    def show_plane(self, corners: Float[ndarray, "4 3"] | None) -> None:
        """A rectangle, in the colour of what is selected; nothing with None."""
        if self._plane is not None:
            self._plane.remove()
            self._plane = None
        if corners is not None:
            self._plane = self._scene.add_mesh_simple(
                "/plane", corners.astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.uint32), color=SELECTED,
                opacity=PLANE_OPACITY, side="double", cast_shadow=False,
            )  # fmt: skip

    def show_truth(self, mesh: Mesh | None, opacity: float) -> None:
        """The true surface beside; not there with None or opacity 0."""
        if self._truth is not None:
            self._truth.remove()
            self._truth = None
        if mesh is not None and opacity > 0:
            self._truth = self._scene.add_mesh_simple(
                "/truth", mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32), color=rgb(CLAY),
                opacity=opacity if opacity < 1 else None, position=BESIDE,
            )  # fmt: skip


def label_of(names: Mapping[str, str], parts: Sequence[str]) -> str:
    """Names of selected parts as one text."""
    return ", ".join(names[part] for part in parts) or "nothing"


def _equal(one: Mesh, other: Mesh) -> bool:
    return np.array_equal(one.vertices, other.vertices) and np.array_equal(one.faces, other.faces)
