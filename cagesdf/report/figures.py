"""What stands in the page's tables: metrics, arms, the paper's figures, and how numbers are written."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

Figures = Mapping[str, Mapping[str, Any]]  # metric → mean, std, n
Table = Mapping[str, Mapping[str, Figures]]  # category → arm → figures


@dataclass(frozen=True)
class Metric:
    """One column of figures."""

    key: str  # in the tables; with `_detail`: over the true surface that leaves its cage
    title: str
    higher: bool  # whether more is better
    definition: str


METRICS = (
    Metric(
        "surface_distance", "distance, %", False,
        "mean exact distance from points on either surface to the other, the mean of both directions, in % of the "
        "longest side of the true shape's bounding box. Zero is perfect.",
    ),
    Metric(
        "cd_deepsdf", "Chamfer", False,
        "as DeepSDF and the paper have it: mean squared distance to the nearest sampled point, both directions summed. "
        "Sampling alone makes it larger than zero; the true surface against itself shows how much.",
    ),
    Metric(
        "cd_l1", "Chamfer-L1", False,
        "mean distance to the nearest sampled point, not squared, mean of both directions.",
    ),
    Metric("f1", "F 1 %", True, "F-score: harmonic mean of the shares of points nearer than 1 % of the longest side."),
    Metric("f2", "F 2 %", True, "the same with 2 %."),
    Metric("nc", "normals", True, "normal consistency: mean |cosine| between the normals of nearest points."),
    Metric("nc_signed", "normals, signed", True, "the same with the sign: inside-out surfaces count as wrong."),
    Metric("iou", "IoU", True, "volume of the intersection over volume of the union."),
    Metric("closed", "closed", True, "share of the surfaces without holes, consistently oriented."),
)  # fmt: skip
NIL = 1e-9  # smaller figures are rounding errors
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
METRIC = {metric.key: metric for metric in METRICS}

# In the order they are shown; others follow by name.
ARMS = {
    "cagesdf": "cuboid network that also sees each point in its cuboid's frame",
    "cagesdf_global": "the paper's network: points in the shape's frame only",
    "cagesdf_noaug": "cagesdf, trained on rest shapes only",
    "cagesdf_global_noaug": "the paper's network, trained on rest shapes only",
    "deepsdf": "the baseline: one latent code a shape, no cuboids",
    "deepsdf_sine": "the baseline, given sine features of the points",
}
REFERENCES = {
    "cage": "no network: the cuboids themselves",
    "ground_truth": "the true surface, sampled a second time: the noise floor",
}

# Chamfer distances of the paper: Table 1 by category, Table 2 over all.
PAPER_RECONSTRUCTION = {
    "DeepSDF": {"chair": 0.000845, "table": 0.0259, "vase": 0.0228},
    "CageSDF": {"chair": 0.000447, "table": 0.0247, "vase": 0.0135},
}
PAPER_HELD_OUT = {"CageSDF, with augmentation": 0.000617, "CageSDF, without augmentation": 0.00274}


@dataclass(frozen=True)
class Cell:
    """One figure as it is shown."""

    text: str
    spread: str = ""  # standard deviation, "" if unknown
    best: bool = False  # of the arms in its column


@dataclass(frozen=True)
class Row:
    """One arm's line of a table."""

    name: str
    explanation: str
    cells: tuple[Cell, ...]


def in_order(arms: Iterable[str]) -> list[str]:
    """Arms as they are shown: known ones first, references left out."""
    names = set(arms) - set(REFERENCES)
    return [name for name in ARMS if name in names] + sorted(names - set(ARMS))


def rows(table: Table, arms: Iterable[str], columns: Iterable[tuple[str, str]], ranked: bool) -> list[Row]:
    """One row an arm, one cell for each (category, metric) of `columns`.

    `ranked` marks the best figure of each column. An arm without any figure has no row.
    """
    columns = list(columns)
    known = {**ARMS, **REFERENCES}
    values = {arm: [table.get(category, {}).get(arm, {}).get(metric) for category, metric in columns] for arm in arms}
    best = []
    for i, (_, metric) in enumerate(columns):
        items = [line[i] for line in values.values()]
        means = [item["mean"] for item in items if item and item["mean"] is not None]
        choose = max if METRIC[metric.removesuffix("_detail")].higher else min
        best.append(choose(means) if means and ranked and len(values) > 1 else None)
    return [
        Row(
            arm,
            known.get(arm, ""),
            tuple(_cell(item, metric, top) for item, (_, metric), top in zip(line, columns, best)),
        )
        for arm, line in values.items()
        if any(line)
    ]


def _cell(item: Mapping[str, Any] | None, metric: str, best: float | None) -> Cell:
    if not item or item["mean"] is None:
        return Cell("–")
    spread = item.get("std")
    if metric == "closed":
        return Cell(f"{item['mean']:.0%}", best=item["mean"] == best)
    return Cell(figure(item["mean"]), figure(spread, digits=2) if spread is not None else "", item["mean"] == best)


def figure(value: float, digits: int = 3) -> str:
    """A number with this many significant digits; a power of ten where zeros would be counted."""
    if not math.isfinite(value):
        return "∞" if value > 0 else "–"
    if abs(value) < NIL:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if -5 <= power <= 5:
        return f"{value:.{max(digits - 1 - power, 0)}f}"
    return f"{mantissa}·10{str(power).translate(SUPERSCRIPTS)}"
