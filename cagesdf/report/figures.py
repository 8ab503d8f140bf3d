"""Contents of the page's tables: edits, arms, the paper's figures, and how numbers are written."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from cagesdf.evaluation.metrics import OF_KEY

Figures = Mapping[str, Mapping[str, Any]]  # metric → mean, std, n
Table = Mapping[str, Mapping[str, Figures]]  # category → arm → figures


@dataclass(frozen=True)
class EditColumn:
    """One column of the table of edits."""

    kind: str  # of trials
    figure: str  # of theirs
    statistic: str  # of the figure
    title: str
    higher: bool  # whether more is better
    definition: str


EDITS = (
    EditColumn(
        "swap", "gain", "median", "swap gain", True,
        "cuboids of one shape, style of another, neither of which was trained on together: 1 − d(swap, truth) / "
        "d(unchanged, truth), both on the detail of the parts whose style changed. The truth is built by the recipe. "
        "Median over swaps; small: the quartiles.",
    ),
    EditColumn(
        "warp", "gain", "median", "as taught", True,
        "the same against the other shape's parts warped into the cuboids, which is what deformation sequences teach.",
    ),
    EditColumn("swap", "gain", "positive", "gain > 0", True, "share of the swaps that come nearer to the truth."),
    EditColumn("swap", "distance_detail", "median", "swap, %", False, "d(swap, truth), median, % of the longest side."),
    EditColumn(
        "mix", "gain", "median", "mix gain", True,
        "the gain of swaps, but the parts of one label alone take the other shape’s style. The truth is the recipe’s.",
    ),
    EditColumn("mix_warp", "gain", "median", "mix, as taught", True, "the same against those parts, warped."),
    EditColumn(
        "mix_keep", "gain", "median", "details kept", True,
        "mix gain where details keep the size that they have in the other shape (details: keep), against the recipe.",
    ),
    EditColumn("rest", "distance", "mean", "rest, %", False, "distance to the true surface without any edit."),
    EditColumn(
        "local", "distance", "mean", "one cuboid, %", False,
        "the same after one cuboid was resized or moved. The truth is the box-warp by construction.",
    ),
    EditColumn(
        "beyond", "distance", "mean", "beyond, %", False,
        "the same at t = −0.25 and 1.25 of deformation sequences. The truth is the box-warp by construction.",
    ),
    EditColumn(
        "bent", "distance", "mean", "bent, %", False,
        "the same where cuboids share vertices, so that no part's deformation is affine; the network is given the "
        "cuboids refitted to the deformed parts.",
    ),
    EditColumn(
        "all", "refit", "mean", "refit gap, %", False,
        "share of a cuboid's length that its part's surface leaves free at an end which the true surface reaches. "
        "An empty mesh overshoots nothing, but has 100 % here.",
    ),
    EditColumn("all", "overshoot", "max", "overshoot, %", False, "largest distance of a vertex outside all cuboids."),
    EditColumn(
        "local", "moved_mean", "mean", "locality, %", False,
        "how far the surface of cuboids moved that touch the edited one neither before nor after; small: the farthest.",
    ),
    EditColumn(
        "rest", "symmetry", "mean", "asymmetry, %", False,
        "mean distance to the mirror image, of shapes whose cuboids are mirror images of each other.",
    ),
)  # fmt: skip
NIL = 1e-9  # smaller figures are rounding errors
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

# In the order they are shown; others follow by name.
ARMS = {
    "cagesdf": "parts' codes by a transformer over the cage; a logit from planes and lines in each cuboid",
    "cagesdf_global": "the paper's network: points in the shape's frame only",
    "cagesdf_keep": "cagesdf, trained on sequences in which details keep their size",
    "cagesdf_noaug": "cagesdf, trained on rest shapes only",
    "cagesdf_global_noaug": "the paper's network, trained on rest shapes only",
    "cagesdf_distance": "cagesdf, distances in place of the logit",
    "cagesdf_plain": "cagesdf_distance, codes of parts that don't see each other",
    "cagesdf_relations": "cagesdf_distance, attention that knows how cuboids relate",
    "deepsdf": "the baseline: one latent code a shape, no cuboids",
    "deepsdf_sine": "the baseline, given sine features of the points",
}
REFERENCES = {
    "cage": "no network: the cuboids themselves",
    "ground_truth": "the true surface, sampled a second time: the noise floor",
}
EDIT_REFERENCES = {
    "unchanged": "no network: the shape as it was before the edit",
    "box_warp": "no network: the parts of the style deformed into the cuboids; of sequences this is the truth itself",
    "keep_warp": "no network: the same, but details of the style keep their size",
    "ground_truth": "the true surface",
}
NOT_EDITED = "has no cuboids: an edit leaves its shape as it was, at a gain of 0"

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
    names = set(arms) - set(REFERENCES) - set(EDIT_REFERENCES)
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
        higher = OF_KEY[metric].higher
        choose = max if higher else min
        best.append(choose(means) if ranked and higher is not None and len(set(means)) > 1 else None)
    return [
        Row(
            arm,
            known.get(arm, ""),
            tuple(_cell(item, metric, top) for item, (_, metric), top in zip(line, columns, best)),
        )
        for arm, line in values.items()
        if any(line)
    ]


def edit_columns(arms: Mapping[str, Any]) -> list[EditColumn]:
    """Columns of the table of edits that some arm has a figure for: own data has no swaps."""
    return [column for column in EDITS if any(column.figure in kinds.get(column.kind, {}) for kinds in arms.values())]


def edit_rows(arms: Mapping[str, Any], names: Iterable[str], ranked: bool) -> list[Row]:
    """One row a name, one cell for each of `edit_columns`; arms without any figure say why."""
    names, columns = [name for name in names if name in arms], edit_columns(arms)
    values = {name: [arms[name].get(column.kind, {}).get(column.figure) for column in columns] for name in names}
    best = []
    for i, column in enumerate(columns):
        means = [line[i][column.statistic] for line in values.values() if line[i]]
        choose = max if column.higher else min
        best.append(choose(means) if ranked and len(set(means)) > 1 else None)
    known = {**ARMS, **EDIT_REFERENCES}
    return [
        Row(
            name,
            known.get(name, "") if any(values[name]) else NOT_EDITED,
            tuple(_edit_cell(item, column, top) for item, column, top in zip(values[name], columns, best)),
        )
        for name in names
    ]


def _edit_cell(item: Mapping[str, Any] | None, column: EditColumn, best: float | None) -> Cell:
    if not item:
        return Cell("–")
    value = item[column.statistic]
    if column.statistic == "positive":
        return Cell(f"{value:.0%}", best=value == best)
    spreads = {
        "gain": lambda: f"{item['q25']:.2f} to {item['q75']:.2f}",
        "moved_mean": lambda: f"at most {figure(item['max'], digits=2)}",
    }
    spread = spreads[column.figure]() if column.figure in spreads else ""
    return Cell(figure(value), spread, value == best)


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
