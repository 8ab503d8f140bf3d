"""Contents of the page's Table 3: figures of generated shapes, and the paper's."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cagesdf.evaluation.table3 import REAL, REFERENCES, name_of
from cagesdf.report.figures import ARMS, Cell, Row, figure, in_order

Methods = Sequence[Mapping[str, Any]]  # of one category: arm, method, shapes, and figures with mean, std, n


@dataclass(frozen=True)
class Column:
    """One column of Table 3."""

    key: str
    title: str
    arrow: str  # ↑ or ↓ as in the paper and its sources
    best: float | None  # the value that the best is nearest to; None: no method is marked
    definition: str


COLUMNS = (
    Column(
        "fd", "FD", "↓", 0.0,
        "Fréchet distance between generated shapes and references in the features of a classifier (PointNet): means "
        "and covariances are compared. Small sets of one kind are apart too; the floor shows how far.",
    ),
    Column(
        "kpd", "KPD", "↓", float("-inf"),
        "the same features compared with a cubic kernel; unbiased, so that its mean is 0 for sets of one kind, however "
        "small, and a figure may lie below 0.",
    ),
    Column(
        "gen", "Gen", "↑", None,
        "mean Chamfer distance of a generated shape to the nearest training shape: half the sum of both directions, "
        "not squared; small: squared and summed. More is new, or broken: FD tells which, so none is marked.",
    ),
    Column(
        "cov", "Cov", "↓", 0.0,
        "mean Chamfer distance of a reference to the nearest generated shape; small: squared and summed, which is "
        "PointFlow’s MMD.",
    ),
    Column(
        "var", "Var", "↑", None,
        "mean Chamfer distance of a generated shape to the nearest other one; small: squared. As with Gen, broken "
        "shapes have more.",
    ),
    Column(
        "coverage", "COV", "↑", float("inf"),
        "PointFlow’s: share of as many references that are the nearest to a generated shape.",
    ),
    Column(
        "told_apart", "1-NNA", "→ 50 %", 0.5,
        "PointFlow’s: share of generated shapes and as many references whose nearest other shape is of their own set. "
        "50 %: they can’t be told apart.",
    ),
    Column("recognised", "recognised", "↑", float("inf"), "share that the classifier takes for the category."),
    Column(
        "failed", "failed", "↓", 0.0,
        "share without a surface. Such a shape counts as points at the origin in FD, KPD and Cov, as 0 in Gen and Var; "
        "it covers nothing and is told apart.",
    ),
)  # fmt: skip
SHARES = ("coverage", "told_apart", "recognised", "failed")
METHODS = {
    "isotropic": "codes from an isotropic Gaussian",
    "independent": "new cuboids, codes drawn independently of them (⊥)",
    "dependent": "new cuboids, codes drawn by the likeness of theirs",
    "by_part": "the same, from shapes that have parts like theirs",
}


def table(category: Mapping[str, Any] | None, paper: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """Rows of one category's Table 3: methods, references, the paper's."""
    methods = category["methods"] if category else []
    of_arm = {(entry["arm"], entry["method"]): entry for entry in methods}
    made = [key for arm in in_order({arm for arm, _ in of_arm} - {REAL}) for key in of_arm if key[0] == arm]
    return {
        "sets": category["sets"] if category else {},
        "arms": _rows([of_arm[key] for key in made]),
        "references": [_row(of_arm[key], key[1], text, {}) for key, text in REFERENCES.items() if key in of_arm],
        "paper": [
            (name, [figure(line[column.key]) if column.key in line else "–" for column in COLUMNS])
            for name, line in paper.items()
        ],
    }


def _rows(methods: Methods) -> list[Row]:
    best = {}
    for column in COLUMNS:
        means = [entry[column.key]["mean"] for entry in methods if column.key in entry]
        if column.best is not None and len(set(means)) > 1:
            best[column.key] = _nearest(means, column.best)
    explained = [
        (entry, ARMS.get(entry["arm"], ""), METHODS.get(entry["method"], ""), _shapes(entry)) for entry in methods
    ]
    return [
        _row(entry, name_of(entry["arm"], entry["method"]), "; ".join(filter(None, texts)), best)
        for entry, *texts in explained
    ]


def _shapes(entry: Mapping[str, Any]) -> str:
    """How many shapes a method made, and whether none has a surface."""
    count = entry["shapes"]
    if count == 0:
        return "no shapes: no draw was valid"
    text = "1 shape" if count == 1 else f"{count:,} shapes"
    return f"{text}, none with a surface" if entry["failed"]["mean"] == 1 else text


def _nearest(means: Sequence[float], to: float) -> float:
    if abs(to) == float("inf"):
        return max(means) if to > 0 else min(means)
    return min(means, key=lambda mean: abs(mean - to))


def _row(entry: Mapping[str, Any], name: str, explanation: str, best: Mapping[str, float]) -> Row:
    return Row(name, explanation, tuple(_cell(entry, column.key, best.get(column.key)) for column in COLUMNS))


def _cell(entry: Mapping[str, Any], key: str, best: float | None) -> Cell:
    if key not in entry:
        return Cell("–")
    mean, std, n = (entry[key][name] for name in ("mean", "std", "n"))
    if key in SHARES:
        return Cell(f"{mean:.0%}", f"± {std:.0%}" if n > 1 else "", mean == best)
    squared = entry.get(f"{key}_squared")
    small = f"± {figure(std, digits=2)}" if n > 1 else figure(squared["mean"], digits=2) if squared else ""
    return Cell(figure(mean), small, mean == best)
