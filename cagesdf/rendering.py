"""Pictures of meshes and cages, without a display.

VTK draws off screen through EGL or OSMesa. Where neither is installed it may crash rather than
fail, so it runs in a process of its own; matplotlib draws when that process can't.
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from loky import ProcessPoolExecutor
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.geometry.meshes import Mesh, face_normals
from cagesdf.geometry.solid import CUBE_FACES

CLAY = "#d8c3ab"
PART_COLOURS = (
    "#4c78a8", "#e8863b", "#5aa469", "#c95d63", "#8e6bb0", "#d9b23c", "#4fa8a8", "#c77ba8", "#8a7a66", "#7d8b99",
)  # fmt: skip

# VTK's windows that draw without a display on Linux, in the order tried; elsewhere VTK's own choice does.
WINDOWS: tuple[str, ...] = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow") if sys.platform == "linux" else ("",)

# The camera's axes in the canonical frame, by rows: right, up, towards the viewer. Parallel
# projection, seen from the front, a third to the right and a little from above.
_AZIMUTH, _ELEVATION = np.radians(33.0), np.radians(22.0)
_TOWARDS = np.array([np.sin(_AZIMUTH) * np.cos(_ELEVATION), np.sin(_ELEVATION), np.cos(_AZIMUTH) * np.cos(_ELEVATION)])
_RIGHT = np.array([np.cos(_AZIMUTH), 0.0, -np.sin(_AZIMUTH)])
CAMERA = np.stack([_RIGHT, np.cross(_TOWARDS, _RIGHT), _TOWARDS])

# Lights shine from these directions, in the camera's axes, with these strengths.
LIGHTS = (((-0.35, 0.9, 0.4), 0.62), ((0.85, 0.15, 0.5), 0.28), ((-0.5, -0.1, 1.0), 0.5))
AMBIENT = 0.18
MARGIN = 1.06
CREASE = 35.0  # degrees; edges sharper than this are drawn sharp
SUPERSAMPLING = 2
BOX_ALPHA = 0.35
LINE_WIDTH = 0.003  # of the picture's side

Image = UInt8[ndarray, "size size 4"]  # red, green, blue, alpha; rows from the top
Pixels = Float[ndarray, "size size 3"]  # red, green, blue, 0 to 255; rows from the top

# The twelve edges of a cuboid over CORNER_ORDER: pairs of corners that differ in one coordinate.
EDGES = np.array([[a, a + bit] for bit in (4, 2, 1) for a in range(8) if not a & bit])


def rgb(colour: str) -> tuple[int, int, int]:
    """#rrggbb as numbers up to 255."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


@dataclass(frozen=True, eq=False)
class Scene:
    """The contents of one picture: surfaces, and a cage around them or alone."""

    meshes: tuple[Mesh, ...] = ()  # canonical, outwards
    colours: tuple[str, ...] = ()  # one a mesh, #rrggbb
    cage: Cage | None = None  # drawn as translucent boxes with crisp edges
    cage_colours: tuple[str, ...] = ()  # one a cuboid, #rrggbb

    def __post_init__(self) -> None:
        if len(self.meshes) != len(self.colours) or len(self.cage or ()) != len(self.cage_colours):
            raise ValueError(
                f"a scene of {len(self.meshes)} meshes and {len(self.cage or ())} cuboids needs as many colours, "
                f"got {len(self.colours)} and {len(self.cage_colours)}"
            )

    def points(self) -> Float[ndarray, "n 3"]:
        """Everything that must be in the picture, canonical."""
        corners = self.cage.corners().reshape(-1, 3) if self.cage is not None else np.zeros((0, 3))
        return np.concatenate([*(mesh.vertices for mesh in self.meshes), corners])


@dataclass(frozen=True, eq=False)
class View:
    """The square of the camera's plane that a picture shows."""

    centre: Float[ndarray, " 3"]  # right, up, towards: camera axes, canonical units
    half: float  # half the square's side, canonical units
    depth: float  # everything is nearer than this to the centre, canonical units

    @staticmethod
    def around(scenes: Sequence[Scene]) -> "View":
        """The smallest view that holds all scenes; the unit cube's if they are empty."""
        points = np.concatenate([np.zeros((0, 3)), *(scene.points() for scene in scenes)]) @ CAMERA.T
        if len(points) == 0:
            return View(np.zeros(3), 1.0, 2.0)
        low, high = points.min(0), points.max(0)
        half = max(float((high - low)[:2].max()) / 2, 1e-6)
        return View((low + high) / 2, MARGIN * half, max(float(high[2] - low[2]), half))


def render_rows(rows: Sequence[Sequence[Scene]], size: int, processes: int = 1) -> tuple[list[list[Image]], str]:
    """Pictures of rows of scenes, `size` pixels square, and the name of the renderer.

    All pictures of a row have the same camera and scale. The background is transparent. VTK is
    started once in each process; "matplotlib" draws if it can't be.
    """
    work = [(scene, view) for row in rows for view in [View.around(row)] for scene in row]
    images, drawn_by = _render_all(work, size, processes)
    ends = np.cumsum([len(row) for row in rows])
    return [images[end - len(row) : end] for row, end in zip(rows, ends)], drawn_by


def side_by_side(pictures: Sequence[Image], columns: int) -> UInt8[ndarray, "height width 3"]:
    """Pictures of one size as one, in rows of `columns`, on white. At least one picture."""
    size = len(pictures[0])
    page = np.full((-(-len(pictures) // columns) * size, min(columns, len(pictures)) * size, 3), 255, np.uint8)
    for i, picture in enumerate(pictures):
        top, left = (size * place for place in divmod(i, columns))
        alpha = picture[..., 3:] / 255
        blended = picture[..., :3] * alpha + 255 * (1 - alpha)
        page[top : top + size, left : left + size] = blended.round().astype(np.uint8)
    return page


def _render_all(work: list[tuple[Scene, View]], size: int, processes: int) -> tuple[list[Image], str]:
    for window in WINDOWS if work else ():
        # A fresh interpreter: VTK reads its variables once, and forking threads is unsafe. loky's doesn't run a user's
        # script again, as the standard library's would.
        try:
            with ProcessPoolExecutor(processes, initializer=_choose, initargs=(window,)) as pool:
                images = list(pool.map(draw_with_vtk, *zip(*work), [size] * len(work)))
        except (RuntimeError, ImportError):  # a crash is a BrokenProcessPool, which is a RuntimeError
            continue
        # A driver that draws nothing, rather than crash, leaves every picture empty.
        if any(image[..., 3].any() for image in images) or all(len(scene.points()) == 0 for scene, _ in work):
            return images, window or "VTK"
    return [draw_with_matplotlib(scene, view, size) for scene, view in work], "matplotlib"


def _choose(window: str) -> None:
    """Make this process's VTK draw into `window`, and keep its complaints to itself."""
    if window:
        os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = window
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def draw_with_vtk(scene: Scene, view: View, size: int) -> Image:
    """One picture by VTK. Call it in a process that may crash; `render_rows` does."""
    import pyvista

    occluded = bool(scene.meshes) and scene.cage is None
    plotter = _plotter(size, occluded)
    plotter.clear_actors()
    material = {"ambient": AMBIENT, "specular": 0.1, "specular_power": 18}
    for mesh, colour in zip(scene.meshes, scene.colours):
        if len(mesh.faces):
            surface = pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.faces.astype(int))
            # Faces are turned alike: making sure of that takes as long as the rest.
            smooth = surface.compute_normals(
                cell_normals=False, split_vertices=True, feature_angle=CREASE, consistent_normals=False
            )
            plotter.add_mesh(smooth, color=colour, interpolation="Phong", render=False, **material)
    for corners, colour in _boxes(scene):
        faces = pyvista.PolyData.from_regular_faces(corners, CUBE_FACES.astype(int))
        plotter.add_mesh(faces, color=colour, opacity=BOX_ALPHA, culling="back", ambient=0.35, render=False)
        lines = pyvista.PolyData(corners, lines=np.insert(EDGES, 0, 2, axis=1).ravel())
        width = LINE_WIDTH * SUPERSAMPLING * size
        plotter.add_mesh(lines, color=colour, line_width=width, lighting=False, render=False)
    _look(plotter.camera, view)
    return _unblend(*_photographs(plotter, opaque=scene.cage is None))


@cache
def _plotter(size: int, occluded: bool) -> Any:
    """A window with lights, kept for all pictures of this process: a new one takes as long as a picture.

    `occluded` darkens what other faces keep the light from.
    """
    import pyvista

    plotter: Any = pyvista.Plotter(off_screen=True, window_size=[SUPERSAMPLING * size] * 2, lighting="none")
    for direction, strength in LIGHTS:
        light = pyvista.Light(position=np.array(direction) @ CAMERA, intensity=strength)
        light.positional = False
        plotter.add_light(light)
    if occluded:
        plotter.disable_anti_aliasing()  # takes a quarter of the time, and changes nothing where faces are darkened
        plotter.enable_ssao(radius=0.16, bias=0.012, kernel_size=32, blur=True)
    return plotter


def _photographs(plotter: Any, opaque: bool) -> tuple[Pixels, Pixels]:
    """The picture on black and on white (0 to 255)."""
    if opaque:
        plotter.render()
        image = np.array(plotter.screenshot(return_img=True, transparent_background=True), dtype=np.float32)
        alpha = image[..., 3:] / 255
        on_black = _shrink(image[..., :3] * alpha)
        return on_black, on_black + 255 * (1 - _shrink(alpha))
    # VTK writes no alpha for translucent faces, so it has to draw twice.
    on_black, on_white = (_photograph(plotter, background) for background in ("black", "white"))
    return on_black, on_white


def _photograph(plotter: Any, background: str) -> Pixels:
    plotter.set_background(background)
    plotter.render()
    return _shrink(np.array(plotter.screenshot(return_img=True), dtype=np.float32))


def _boxes(scene: Scene) -> list[tuple[Float[ndarray, "8 3"], str]]:
    """Corners and colour of each cuboid, the farthest first; a hair larger than the parts they bound."""
    if scene.cage is None:
        return []
    cage = replace(scene.cage, size=scene.cage.size + 4e-3)
    return [(cage.corners()[i], scene.cage_colours[i]) for i in np.argsort(cage.centre @ CAMERA[2], kind="stable")]


def _look(camera: Any, view: View) -> None:
    camera.parallel_projection = True
    camera.parallel_scale = view.half
    camera.focal_point = view.centre @ CAMERA
    camera.position = view.centre @ CAMERA + 4 * view.depth * CAMERA[2]
    camera.up = CAMERA[1]
    camera.clipping_range = (0.5 * view.depth, 8 * view.depth)


def _shrink(image: Float[ndarray, "h w channels"]) -> Float[ndarray, "size size channels"]:
    """Average blocks of pixels."""
    total = np.zeros((len(image) // SUPERSAMPLING, image.shape[1] // SUPERSAMPLING, image.shape[2]), np.float32)
    for i, j in np.ndindex(SUPERSAMPLING, SUPERSAMPLING):  # NumPy's mean over two axes at once takes nine times as long
        total += image[i::SUPERSAMPLING, j::SUPERSAMPLING]
    return total / SUPERSAMPLING**2


def _unblend(on_black: Pixels, on_white: Pixels) -> Image:
    """The colour and alpha that look like these two over black and over white (0 to 255)."""
    alpha = 1 - (on_white - on_black).mean(axis=-1, keepdims=True).clip(0, 255) / 255
    colour = on_black / np.maximum(alpha, 1 / 255)
    return np.concatenate([colour, 255 * alpha], axis=-1).round().clip(0, 255).astype(np.uint8)


def draw_with_matplotlib(scene: Scene, view: View, size: int) -> Image:
    """One picture by matplotlib: flat shading, the farthest triangle first.

    Which of two triangles hides the other is decided by their centres, so large ones are divided
    first; where parts cut each other the seam stays a little ragged.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.figure import Figure

    canvas = FigureCanvasAgg(Figure(figsize=(size / 100, size / 100), dpi=100, facecolor="none"))
    axes = canvas.figure.add_axes((0, 0, 1, 1), frameon=False, xticks=[], yticks=[])
    for i, centre in enumerate(view.centre[:2]):
        (axes.set_xlim, axes.set_ylim)[i](centre - view.half, centre + view.half)
    meshes = [(mesh, _shares(colour)) for mesh, colour in zip(scene.meshes, scene.colours) if len(mesh.faces)]
    if meshes:
        shaded = [_divided(*_shaded(mesh, shares), longest=view.half / 12) for mesh, shares in meshes]
        triangles, colours = map(np.concatenate, zip(*shaded))
        far_first = np.argsort(triangles[..., 2].mean(axis=1), kind="stable")
        flat: Any = triangles[far_first, :, :2]
        colours = colours[far_first]
        # Outlines in the same colour close the seams that antialiasing leaves between triangles.
        axes.add_collection(PolyCollection(flat, facecolors=colours, edgecolors=colours, lw=0.7))
    for corners, colour in _boxes(scene):
        flat = _shaded(Mesh(corners, CUBE_FACES), _shares(colour))[0][..., :2]
        axes.add_collection(PolyCollection(flat, facecolors=colour, lw=0, alpha=BOX_ALPHA))
        lines = (corners @ CAMERA.T)[EDGES][..., :2]
        axes.add_collection(LineCollection(lines, colors=colour, lw=LINE_WIDTH * size * 0.72))
    canvas.draw()
    return np.array(canvas.buffer_rgba())


def _shares(colour: str) -> Float[ndarray, " 3"]:
    return np.array(rgb(colour)) / 255


def _shaded(mesh: Mesh, shares: Float[ndarray, " 3"]) -> tuple[Float[ndarray, "f 3 3"], Float[ndarray, "f 3"]]:
    """The triangles that face the viewer, in camera axes, and their colours under LIGHTS."""
    normals = face_normals(mesh) @ CAMERA.T
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    triangles = mesh.corners() @ CAMERA.T
    seen = normals[:, 2] > 0
    light = AMBIENT + sum(
        strength * (normals[seen] @ (np.array(direction) / np.linalg.norm(direction))).clip(0)
        for direction, strength in LIGHTS
    )
    return triangles[seen], (shares * light[:, None]).clip(0, 1)


def _divided(
    triangles: Float[ndarray, "f 3 3"], colours: Float[ndarray, "f 3"], longest: float
) -> tuple[Float[ndarray, "g 3 3"], Float[ndarray, "g 3"]]:
    """The triangles cut in half across their longest edge until none is longer than `longest`."""
    done: list[tuple[ndarray, ndarray]] = []
    while len(triangles):
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        first = edges.argmax(axis=1)
        # Turn each triangle so that its longest edge comes first.
        a, b, c = np.take_along_axis(triangles, (first[:, None, None] + np.arange(3)[:, None]) % 3, 1).swapaxes(0, 1)
        long = edges.max(axis=1) > longest
        done.append((triangles[~long], colours[~long]))
        middle = (a + b) / 2
        halves = [np.stack([a, middle, c], axis=1)[long], np.stack([middle, b, c], axis=1)[long]]
        triangles, colours = np.concatenate(halves), np.concatenate([colours[long]] * 2)
    return np.concatenate([t for t, _ in done]), np.concatenate([c for _, c in done])
