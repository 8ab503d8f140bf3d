"""One HTML page with style, tables, curves and pictures in it. Pictures lead to views in 3-D, files of their own."""

import base64
import io
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image as Pillow

from cagesdf.evaluation.metrics import METRICS, OF_KEY
from cagesdf.rendering import Image, render_rows
from cagesdf.report import figures, table3
from cagesdf.report.chart import Curve, log_chart
from cagesdf.report.grid import Grid
from cagesdf.report.views import write_views

# Fields of `Category` with pictures, in the page's order.
GRIDS = ("fitting", "comparison", "sequence", "swaps", "mixes", "generated", "failures")


@dataclass(frozen=True, eq=False)
class Category:
    """The page's pictures and curves of one category."""

    name: str
    passed: int  # shapes whose parts were closed as they came
    repaired: int  # shapes of which a part had to be made closed
    rejected: Mapping[str, str]  # reasons by shape id
    bounding: Mapping[str, float]  # see io.cuboids.read_bounding
    fitting: Grid  # (cuboids as given, fitted) × shapes
    comparison: Grid  # shapes × (cuboids, ground truth, arms)
    sequence: Grid  # (ground truth, arms) × steps of one deformation
    swaps: Grid  # swaps × (cuboids of, style of, arms, ground truth)
    mixes: Grid  # mixes × (shape, style of, mixed, the same with details kept, ground truth)
    generated: Grid  # (generated shapes, nearest training shapes) of each method × ranks of their distance
    failures: Grid  # methods × (farthest, most pieces)
    losses: Mapping[str, Curve]  # by arm


def write_page(
    path: Path, tables: Mapping[str, Any], categories: Sequence[Category], size: int, processes: int
) -> None:
    """Write the page for the tables of `evaluation.tables` and these categories, and `views/` beside it.

    Pictures are `size` pixels square, drawn by this number of `processes`. Missing categories and arms are left out.
    """
    named = [(f"{category.name}-{kind}", getattr(category, kind)) for category in categories for kind in GRIDS]
    grids = [grid for _, grid in named]
    pictures, drawn_by = _draw(grids, size, processes)
    views = path.parent / "views"
    views.mkdir()
    addresses = write_views(views, named, processes)
    with ThreadPoolExecutor(processes) as pool:
        urls = [list(pool.map(_data_url, grid_pictures)) for grid_pictures in pictures]
    filled = iter([_filled(*each) for each in zip(grids, urls, addresses)])
    names = [category.name for category in categories]
    environment = Environment(
        loader=PackageLoader("cagesdf.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("page.html.j2").render(
        names=names,
        about=tables["about"],
        reconstruction=_summary(tables["table1"], names),
        held_out=_summary(tables["table2"], names),
        paper_reconstruction=[
            (name, [figures.figure(values[c]) if c in values else "–" for c in names])
            for name, values in figures.PAPER_RECONSTRUCTION.items()
        ],
        paper_held_out=[(name, figures.figure(value)) for name, value in figures.PAPER_HELD_OUT.items()],
        metrics=METRICS,
        edits_columns=figures.EDITS,
        generation_columns=table3.COLUMNS,
        generation=_generation(tables["table3"], names),
        sections=[
            {
                "category": category,
                "tables": [_details(tables[key], category.name) for key in ("table1", "table2")],
                **{kind: next(filled) for kind in GRIDS},
                "edits": _edits(tables["edits"]["categories"].get(category.name, {})),
                "chart": log_chart(
                    {arm: category.losses[arm] for arm in figures.in_order(category.losses)}, "loss by training step"
                ),
                "progress": _progress(tables["progress"]["categories"].get(category.name, {})),
            }
            for category in categories
        ],
        drawn_by=drawn_by,
    )
    path.write_text(page, encoding="utf-8", newline="\n")


def _summary(table: figures.Table, names: Sequence[str]) -> dict[str, list[figures.Row]]:
    """The three figures a category that stand beside the paper's."""
    metrics = ("surface_distance", "surface_distance_detail", "cd_deepsdf")
    columns = [(name, metric) for name in names for metric in metrics]
    arms = figures.in_order(arm for category in table.values() for arm in category)
    return {
        "arms": figures.rows(table, arms, columns, ranked=True),
        "references": figures.rows(table, figures.REFERENCES, columns, ranked=False),
    }


def _details(table: figures.Table, name: str) -> dict[str, Any]:
    """All figures of one category."""
    arms = table.get(name, {})
    present = {metric for line in arms.values() for metric in line}
    shown = {key: variant for metric in METRICS for key, variant in metric.variants.items() if key in present}
    columns = [(name, key) for key in shown]
    return {
        "columns": [(OF_KEY[key], variant) for key, variant in shown.items()],
        "arms": figures.rows(table, figures.in_order(arms), columns, ranked=True),
        "references": figures.rows(table, figures.REFERENCES, columns, ranked=False),
        "count": max((figure["n"] for line in arms.values() for figure in line.values()), default=0),
    }


def _edits(arms: Mapping[str, Any]) -> dict[str, Any]:
    """The table of one category's edits."""
    return {
        "columns": figures.edit_columns(arms),
        "arms": figures.edit_rows(arms, figures.in_order(arms), ranked=True),
        "references": figures.edit_rows(arms, figures.EDIT_REFERENCES, ranked=False),
    }


def _generation(content: Mapping[str, Any], names: Sequence[str]) -> list[dict[str, Any]]:
    """Table 3 of each category that has shapes in it, with the orders of methods here and in the paper."""
    return [
        {
            "name": name,
            "table": table3.table(content["categories"][name], content["paper"].get(name, {})),
            "orders": content["orders"][name],
        }
        for name in names
        if name in content["categories"] and content["categories"][name]["methods"]
    ]


def _progress(arms: Mapping[str, Any]) -> dict[str, Any]:
    """The curves of one category's trainings, and the arms that have no held-out steps."""
    curves = {
        arm: [(row["points"] / 1e6, row["surface_distance"]) for row in arms[arm]] for arm in figures.in_order(arms)
    }
    rest = [arm for arm in curves if not all(row["held_out"] for row in arms[arm])]
    return {"chart": log_chart(curves, "surface distance by millions of points trained on"), "rest": rest}


def _draw(grids: Sequence[Grid], size: int, processes: int) -> tuple[list[list[Image]], str]:
    scenes = [[scene for row in grid.scenes for scene in row if scene is not None] for grid in grids]
    return render_rows(scenes, size, processes)


def _filled(grid: Grid, urls: Sequence[str], addresses: Sequence[Sequence[str | None]]) -> dict[str, Any]:
    """A grid with a picture's data URL and its view's address, or None, in place of each scene."""
    left = iter(urls)
    cells = [[address and (next(left), address) for address in row] for row in addresses]
    return {"columns": list(zip(grid.columns, grid.held_out)), "rows": list(zip(grid.names, cells))}


def _data_url(image: Image) -> str:
    file = io.BytesIO()
    Pillow.fromarray(image).save(file, "WEBP", quality=88, method=4, exact=False)
    return "data:image/webp;base64," + base64.b64encode(file.getvalue()).decode("ascii")
