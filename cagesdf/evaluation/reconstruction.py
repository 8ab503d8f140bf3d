"""Distance of a surface from the true one (§4.1, §4.2): the definitions of docs/metrics.md."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from cagesdf.evaluation.metrics import POINT_METRICS, SURFACE_METRICS
from cagesdf.evaluation.surfaces import Direction, Drawn, Measured, Truth, directions, nowhere

VERSION = 4  # of the definitions; raised when one changes
OWN = tuple(
    metric.key for metric in POINT_METRICS if metric.own_cuboids
)  # metrics against parts that followed their cuboids


def score(predicted: Measured | None, truth: Truth, drawn: Drawn, rng: np.random.Generator) -> dict[str, float]:
    """METRICS of a predicted surface but for those of OWN's truth, and `detail_share` of the true one.

    Draws an equal number of points on the predicted surface as `drawn` has of the true one. `None` is a surface without
    faces: it gets the worst values. Detail is NaN where the true surface has none.
    """
    lost = nowhere(truth.side)
    forth, back = (lost, lost) if predicted is None else directions(predicted, truth, drawn, rng)
    return {
        **compare(forth, back, truth.side),
        **{
            metric.key: metric.worst if predicted is None else metric.of(predicted, truth) for metric in SURFACE_METRICS
        },
        **_of_detail(forth, back, truth.side, drawn.detail),
        "detail_share": float(drawn.detail.mean()),
    }


def point_figures(predicted: Measured | None, truth: Truth, drawn: Drawn, rng: np.random.Generator) -> dict[str, float]:
    """The metrics of `score` that are means over points of the whole surface, which are quick to get."""
    lost = nowhere(truth.side)
    both = (lost, lost) if predicted is None else directions(predicted, truth, drawn, rng)
    return compare(*both, truth.side)


def own_figures(predicted: Measured | None, truth: Truth, drawn: Drawn, rng: np.random.Generator) -> dict[str, float]:
    """OWN of a predicted surface; `truth` is of parts that followed their own cuboids. `None` as in `score`."""
    return as_own(point_figures(predicted, truth, drawn, rng))


def as_own(figures: Mapping[str, float]) -> dict[str, float]:
    """OWN where both truths are the same: at rest, where no cuboid has moved."""
    return {f"{key}_own": figures[key] for key in OWN}


def compare(forth: Direction, back: Direction, side: float) -> dict[str, float]:
    """Point metrics from the two directions: `forth` from the true surface, `back` from the predicted one."""
    return {metric.key: metric.of(forth, back, side) for metric in POINT_METRICS}


def definitions(points: int, detail: float, seeds: tuple[int, ...]) -> dict[str, Any]:
    """Meaning of the figures, for the metadata of every file of metrics."""
    return {
        "version": VERSION,
        "definitions": "docs/metrics.md",
        "points": points,
        "detail": detail,
        "seeds": list(seeds),
        "normalisation": "percentages are of the longest side of the true shape's bounding box; cd_deepsdf is "
        "squared and cd_l1 plain canonical units (radius of the shape's bounding sphere at rest)",
        "empty_surface": "counted with distances of one longest side, nc_signed -1 and 0 for all else",
        "noise_floor": "the arm ground_truth: the true surface, sampled a second time",
    }


def _of_detail(forth: Direction, back: Direction, side: float, detail: Bool[ndarray, " n"]) -> dict[str, float]:
    """Point metrics of detail alone: true points that are detail, predicted points whose nearest true point is."""
    if not detail.any():
        return {f"{metric.key}_detail": float("nan") for metric in POINT_METRICS}
    back = back.only(back.detail) if back.detail.any() else nowhere(side)
    return {f"{key}_detail": value for key, value in compare(forth.only(forth.detail), back, side).items()}
