"""Pictures of generated shapes, chosen by a rule."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cagesdf.evaluation.table3 import name_of
from cagesdf.geometry.meshes import join
from cagesdf.io.generated_shapes import GeneratedFolder, read_generated
from cagesdf.io.generation_scores import read_nearest
from cagesdf.io.shapes import ShapeFolder
from cagesdf.rendering import CLAY, Scene
from cagesdf.report.figures import in_order
from cagesdf.report.grid import Grid
from cagesdf.report.selection import spread


def strip(source: ShapeFolder, generated: Mapping[str, GeneratedFolder], generation: Path, count: int) -> Grid:
    """Two rows a method: generated shapes from near to far, and the training shape that each is nearest to.

    `count` of each method, at evenly spaced ranks of the distance to the nearest training shape.
    """
    names, scenes = [], []
    for (arm, method), rows in _by_method(generated, generation).items():
        chosen = spread(sorted(rows, key=lambda row: row["distance"]), count)
        blank = (None,) * (count - len(chosen))
        shown = [generated[arm].surface(method, row["shape_id"]) for row in chosen]
        copies = [join([part.mesh for part in source.read(row["nearest"]).parts]) for row in chosen]
        scenes += [(*(Scene((mesh,), (CLAY,)) for mesh in meshes), *blank) for meshes in (shown, copies)]
        names += [name_of(arm, method), "nearest training shapes"]
    columns = tuple(f"rank {(i + 0.5) / count:.0%}" for i in range(count)) if names else ()
    return Grid(columns, (False,) * len(columns), tuple(names), tuple(scenes))


def failures(generated: Mapping[str, GeneratedFolder], generation: Path) -> Grid:
    """One row a method: the shape farthest from the training shapes, and the one of most pieces."""
    names, scenes = [], []
    for (arm, method), rows in _by_method(generated, generation).items():
        pieces = {row["shape_id"]: generated[arm].rows[method, row["shape_id"]]["components"] for row in rows}
        farthest = max(rows, key=lambda row: row["distance"])["shape_id"]
        scattered = max(pieces, key=lambda shape_id: pieces[shape_id])
        meshes = [generated[arm].surface(method, shape_id) for shape_id in (farthest, scattered)]
        scenes.append(tuple(Scene((mesh,), (CLAY,)) for mesh in meshes))
        names.append(f"{name_of(arm, method)}: up to {pieces[scattered]} pieces")
    columns = ("farthest", "most pieces") if names else ()
    return Grid(columns, (False,) * len(columns), tuple(names), tuple(scenes))


def opened(folders: Mapping[str, Path]) -> dict[str, GeneratedFolder]:
    """The generated shapes of each arm, in the order that arms are shown in."""
    return {arm: read_generated(folders[arm]) for arm in in_order(folders)}


def _by_method(
    generated: Mapping[str, GeneratedFolder], generation: Path
) -> dict[tuple[str, str], list[dict[str, Any]]]:
    """Shapes with a surface by arm and method, arms in order; methods without any are left out."""
    shapes: dict[tuple[str, str], list[dict[str, Any]]] = {}
    rows = [row for row in read_nearest(generation) if row["nearest"]]
    for arm in generated:
        for row in rows:
            if row["arm"] == arm:
                shapes.setdefault((arm, row["method"]), []).append(row)
    return shapes
