"""Quality of fitting shapes that were not trained on, against those that were.

    python -m benchmarks.fit_codes [chair table vase] [--runs data/runs] [--arm cagesdf] [--source FOLDER]

prints a Markdown table: a row a category for its validation shapes, and with `--source` for the shapes in a folder, by
the network of the first category. Training shapes are measured at rest, as many as there are validation shapes,
with their own codes and cages. How `cagesdf fit` works was tried on the first half of the validation shapes; the
figures are of the second half. Distances are percentages of the longest side at 128 cells; seconds are processor time
of a shape on one core, from its files to its measured surface. `data/` is that of `make repro`.
"""

import argparse
import time
from collections.abc import Iterable
from pathlib import Path
from statistics import mean, median
from typing import Any

import numpy as np

from benchmarks import child
from cagesdf.api.sources import IMPORT
from cagesdf.deformation.sequences import Trilinear
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.reconstruction import score
from cagesdf.evaluation.surfaces import Measured, Truth
from cagesdf.extraction import extract, field_of
from cagesdf.formats.listing import ShapeSource, find_shapes, list_shapes, read_shape
from cagesdf.importing import import_shape
from cagesdf.inference import shapes as inference
from cagesdf.inference.shapes import MEASURE, usual_settings
from cagesdf.io.residuals import read_residuals
from cagesdf.io.runs import read_run
from cagesdf.io.shapes import read_shapes
from cagesdf.run import Run
from cagesdf.training.precision import processor

RESOLUTION = 128
HEAD = (
    "| shapes | n | trained: mean, median | one code: mean | fitted: mean, median | ratio of means, medians | "
    "≤ 1.5 × | far | seconds |\n|---|---|---|---|---|---|---|---|---|"
)


def trained_distances(run: Run, category: str, count: int) -> list[float]:
    """surface_distance of `count` training shapes."""
    shapes = read_shapes(Path("data/shapes") / category)
    ids = np.random.default_rng(0).permutation(sorted(run.sequences))[:count].tolist()
    distances = []
    for shape_id in ids:
        sequence = run.sequences[shape_id]
        field = field_of(run.decoder, run.latent(shape_id, 0), sequence.cages[0])
        truth = Truth.of(shapes.read(shape_id), sequence, 0, MEASURE["detail"], Trilinear())
        rng = np.random.default_rng(0)
        drawn = truth.drawn(MEASURE["points"], rng)
        surface = Measured(extract(field, RESOLUTION).mesh)
        distances.append(score(surface, truth, drawn, rng)["surface_distance"])
    return distances


def fitted(run: Run, known: inference.Known, source: ShapeSource) -> dict[str, Any]:
    """The report of `cagesdf fit` on one shape, with the distance for one code alone, and seconds."""
    start = time.process_time()
    settings = usual_settings()
    rng = np.random.default_rng(0)
    prepared = inference.prepare(run, import_shape(read_shape(source), **IMPORT), settings, rng)
    fit = inference.fit_code(run, known, prepared, settings.inference, 0)
    surface = inference.fitted_surface(run, fit, RESOLUTION)
    report = inference.report(fit, surface, inference.measure(fit, surface.mesh, **MEASURE, rng=rng))
    seconds = time.process_time() - start
    alone = field_of(run.decoder, fit.inferred.code, prepared.fitted.cage)
    measured = inference.measure(fit, extract(alone, RESOLUTION).mesh, **MEASURE, rng=rng)
    return {**report, "one_code": measured["surface_distance"], "seconds": seconds}


def all_fitted(run: Run, known: inference.Known, sources: Iterable[ShapeSource]) -> list[dict[str, Any]]:
    """The reports of the shapes that can be used; a line each, on the way."""
    reports = []
    for source in sources:
        try:
            reports.append(fitted(run, known, source))
        except (ShapeRejected, InputError) as error:
            print(f"- {error}", flush=True)
            continue
        one = reports[-1]
        print(f"- {one['shape_id']}: {one['surface_distance']:.3f} %, {one['verdict']}", flush=True)
    return reports


def row(name: str, trained: list[float], reports: list[dict[str, Any]]) -> str:
    """One line of the table."""
    distances = [one["surface_distance"] for one in reports]
    cells = [
        name,
        str(len(reports)),
        f"{mean(trained):.3f}, {median(trained):.3f}",
        f"{mean(one['one_code'] for one in reports):.3f}",
        f"{mean(distances):.3f}, {median(distances):.3f}",
        f"{mean(distances) / mean(trained):.2f}, {median(distances) / median(trained):.2f}",
        f"{sum(distance <= 1.5 * mean(trained) for distance in distances)} of {len(reports)}",
        f"{sum(one['far'] for one in reports)} of {len(reports)}",
        f"{mean(one['seconds'] for one in reports):.1f}",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("categories", nargs="*", default=["chair", "table", "vase"])
    parser.add_argument("--runs", type=Path, default=Path("data/runs"))
    parser.add_argument("--arm", default="cagesdf")
    parser.add_argument("--source", type=Path)
    options = parser.parse_args()
    child.to_one_core()
    rows = []
    for i, category in enumerate(options.categories):
        folder = options.runs / category / options.arm
        run = read_run(folder)
        known = inference.Known.of(run, read_residuals(folder))
        validation = [source for source in list_shapes(Path("data/raw") / category, "*") if source.split == "val"]
        trained = trained_distances(run, category, len(validation))
        reports = all_fitted(run, known, validation[len(validation) // 2 :])
        rows.append(row(f"{category}, validation", trained, reports))
        if i == 0 and options.source is not None:
            rows.append(
                row(
                    f"{options.source.name}, by {category}",
                    trained,
                    all_fitted(run, known, [*find_shapes(options.source, "*")]),
                )
            )
    print(f"On {processor()}.\n")
    print(f"\n{HEAD}\n" + "\n".join(rows))


if __name__ == "__main__":
    main()
