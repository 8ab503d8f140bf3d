"""Pictures of shapes, and in a notebook a table of the cuboids beside them."""

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

from PIL import Image

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import InputError
from cagesdf.geometry.meshes import Mesh
from cagesdf.io.files import check_folder, replacing
from cagesdf.rendering import CLAY, PART_COLOURS, Scene, render_rows, side_by_side

PREVIEW = 64  # cells of the surface in a picture
SIDE = 240  # pixels
SHOWN = 8  # shapes of a run that are drawn
COLUMNS = 4  # pictures in a row
ENDINGS = (".png", ".jpg")
LARGEST = 4096  # pixels along each side of a picture


def shape_html(title: str, cage: Cage, cuboids: Mapping[str, Cuboid], surface: Mesh) -> str:
    """A picture of a cage and its surface, both canonical, and a table of the cuboids in the files' frame and unit."""
    scenes = [_cage_scene(cage), Scene((surface,), (CLAY,))] if len(cage) else [Scene((surface,), (CLAY,))]
    rows = [(name, _numbers(cuboid.centre), _numbers(cuboid.size)) for name, cuboid in cuboids.items()]
    return _page(title, scenes, ("part", "centre x, y, z", "lengths x, y, z"), rows)


def write_picture(path: Path, surface: Mesh, size: int) -> None:
    """A picture of a canonical surface on white, `size` pixels square.

    Raises InputError for another ending than ENDINGS, a size out of bounds and a folder that isn't there.
    """
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"{path}: wanted a name that ends in {' or '.join(ENDINGS)}")
    if not 16 <= size <= LARGEST:
        raise InputError(f"size: wanted 16 to {LARGEST} pixels, got {size}")
    check_folder(path)
    [[picture]], _ = render_rows([[Scene((surface,), (CLAY,))]], size)
    with replacing(path) as partial:
        Image.fromarray(side_by_side([picture], 1)).save(partial)


def run_html(title: str, cages: Mapping[str, Cage]) -> str:
    """Pictures of a run's first shapes, canonical, and a table of all."""
    scenes = [_cage_scene(cage) for cage in [*cages.values()][:SHOWN] if len(cage)]
    rows = [(shape_id, str(len(cage))) for shape_id, cage in cages.items()]
    return _page(title, scenes, ("shape", "parts"), rows)


def _cage_scene(cage: Cage) -> Scene:
    return Scene(cage=cage, cage_colours=tuple(PART_COLOURS[i % len(PART_COLOURS)] for i in range(len(cage))))


def _numbers(numbers: Iterable[float]) -> str:
    return ", ".join(f"{number:.4g}" for number in numbers)


def _page(title: str, scenes: Sequence[Scene], head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    table = [f"<tr>{_cells('th', head)}</tr>", *(f"<tr>{_cells('td', row)}</tr>" for row in rows)]
    return f"<p><b>{escape(title)}</b></p>{_picture(scenes)}<table>{''.join(table)}</table>"


def _cells(tag: str, texts: Iterable[str]) -> str:
    return "".join(f"<{tag}>{escape(text)}</{tag}>" for text in texts)


def _picture(scenes: Sequence[Scene]) -> str:
    if not scenes:
        return ""
    [pictures], _ = render_rows([scenes], SIDE)
    content = io.BytesIO()
    Image.fromarray(side_by_side(pictures, COLUMNS)).save(content, "png")
    return f'<img src="data:image/png;base64,{base64.b64encode(content.getvalue()).decode()}">'
