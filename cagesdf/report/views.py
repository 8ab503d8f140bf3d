"""The pictures' scenes to turn and walk through: a page a grid, by viser's export, which holds all that it needs.

A picture leads to its place in the page of its grid, by the camera in the address.
"""

import io
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stdout
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import viser
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.geometry.meshes import Mesh, is_closed
from cagesdf.geometry.solid import CUBE_FACES, as_manifold, from_manifold
from cagesdf.rendering import EDGES, Scene, rgb
from cagesdf.report.grid import Grid

APART = (2.4, 3.6)  # canonical: between the middles of columns, and of rows
TOLERANCE = 2e-3  # canonical: views' surfaces are simplified by this at most
FROM = np.array([0.75, 0.9, 2.9])  # canonical: from what a picture shows to the camera
BOX_OPACITY = 0.18
SUFFIX = ".html"


def write_views(folder: Path, grids: Sequence[tuple[str, Grid]], processes: int = 1) -> list[list[list[str | None]]]:
    """Write `<name>.html` for each grid; by grid, row and column the address of a scene, relative to `folder`'s parent.

    As many `processes` write pages at once. Nothing is drawn here, and nobody is let in: the servers that viser needs
    for exports listen to this machine alone, and end with the call. Equal scenes give equal bytes.
    """
    if processes == 1:
        return [_view(folder, name, grid) for name, grid in grids]
    # Fresh interpreters: viser's servers have threads.
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(_view, [folder] * len(grids), *zip(*grids)))


def _view(folder: Path, name: str, grid: Grid) -> list[list[str | None]]:
    # viser says on standard output what it serves; here that is nothing for anybody.
    with redirect_stdout(io.StringIO()):
        return _recorded(folder, name, grid)


def _recorded(folder: Path, name: str, grid: Grid) -> list[list[str | None]]:
    # A server a page: what is taken out of one before the next scene would be recorded, in the order of a set.
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    try:
        server.scene.set_up_direction("+y")
        for i, row in enumerate(grid.scenes):
            for j, scene in enumerate(row):
                if scene is not None:
                    _add(server.scene, f"/{i}/{j}", scene, _place(i, j))
                    label = f"{grid.names[i]}, {grid.columns[j]}"
                    server.scene.add_label(f"/{i}/{j}/label", label, position=_label(i, j))
        page = server.get_scene_serializer().as_html()
    finally:
        server.stop()
    (folder / f"{name}{SUFFIX}").write_text(page, encoding="utf-8", newline="\n")
    return [
        [_address(folder.name, name, _place(i, j)) if scene is not None else None for j, scene in enumerate(row)]
        for i, row in enumerate(grid.scenes)
    ]


def _place(row: int, column: int) -> Float[ndarray, " 3"]:
    """Columns go to the right, rows away from the viewer."""
    return np.array([APART[0] * column, 0.0, -APART[1] * row])


def _label(row: int, column: int) -> tuple[float, float, float]:
    x, _, z = _place(row, column).tolist()
    return x, 1.15, z


def _address(folder: str, name: str, place: Float[ndarray, " 3"]) -> str:
    numbers = {"initialCameraPosition": place + FROM, "initialCameraLookAt": place}
    query = urlencode({key: ",".join(f"{x:.3f}" for x in value) for key, value in numbers.items()}, safe=",")
    return f"{folder}/{name}{SUFFIX}?{query}"


def _add(api: viser.SceneApi, name: str, scene: Scene, place: Float[ndarray, " 3"]) -> None:
    for i, (mesh, colour) in enumerate(zip(scene.meshes, scene.colours)):
        light = _simplified(mesh)
        api.add_mesh_simple(
            f"{name}/mesh{i}", light.vertices.astype(np.float32), light.faces.astype(np.uint32), color=rgb(colour),
            position=place, side="double",
        )  # fmt: skip
    if scene.cage is None:
        return
    for i, (cuboid, colour) in enumerate(zip(scene.cage.cuboids().values(), scene.cage_colours)):
        corners = Cage.of({"": cuboid}).corners()[0]
        api.add_mesh_simple(
            f"{name}/box{i}", corners.astype(np.float32), CUBE_FACES.astype(np.uint32), color=rgb(colour),
            opacity=BOX_OPACITY, position=place, flat_shading=True, side="double",
        )  # fmt: skip
        lines = corners[EDGES].astype(np.float32)
        api.add_line_segments(
            f"{name}/edges{i}", lines, rgb(colour), thickness=1.5, thickness_units="screen", position=place
        )


def _simplified(mesh: Mesh) -> Mesh:
    """The surface with fewer faces, nowhere further off than TOLERANCE; one that isn't closed as it is."""
    return from_manifold(as_manifold(mesh).simplify(TOLERANCE)) if is_closed(mesh) else mesh
