"""Table 3: gathered per category and method, ordered as the paper's is, and shown beside it."""

from typing import Any

import numpy as np
import pytest

from cagesdf.errors import InputError
from cagesdf.evaluation.shape_sets import FIGURES
from cagesdf.evaluation.table3 import PAPER, REAL, gather_generation, ordered, summarise_methods
from cagesdf.report import table3

ABOUT = {"version": 1, "points": 512}
SETS = {"train": 4, "validation": 2, "drawn": 8, "shapes_a_draw": 5, "noise": {"unsquared": 0.03, "squared": 0.002}}


def row(arm: str, method: str, fd: float, draw: int = 0, **others: float) -> dict:
    return {
        "arm": arm, "method": method, "draw": draw, "shapes": 5, "failed": 0.2, "recognised": 0.8,
        **dict.fromkeys(FIGURES, fd / 100), "fd": fd, **others,
    }  # fmt: skip


ROWS = [
    row("cagesdf", "dependent", 3.0, told_apart=0.4), row("cagesdf", "independent", 4.0, told_apart=0.7),
    row("deepsdf", "isotropic", 9.0, recognised=np.nan, told_apart=1.0),
    row(REAL, "drawn", 1.0), row(REAL, "drawn", 2.0, draw=1), row(REAL, "halves", 0.5, gen=np.nan),
]  # fmt: skip


def test_draws_are_averaged_and_figures_that_nobody_has_are_left_out() -> None:
    found = {(entry["arm"], entry["method"]): entry for entry in summarise_methods(ROWS)}
    assert found[REAL, "drawn"]["fd"] == {"mean": 1.5, "std": pytest.approx(0.5**0.5), "n": 2}
    assert found["cagesdf", "dependent"]["fd"] == {"mean": 3.0, "std": 0.0, "n": 1}
    assert "gen" not in found[REAL, "halves"]
    assert "recognised" not in found["deepsdf", "isotropic"]


def test_methods_are_ordered_by_the_lowest_figure_and_the_papers_stand_beside_them() -> None:
    content = gather_generation({"chair": (ROWS, {**ABOUT, "sets": SETS}), "vase": ([], {**ABOUT, "sets": SETS})})
    here = content["orders"]["chair"]["here"]
    assert here["fd"] == ["cagesdf, dependent", "cagesdf, independent", "deepsdf, isotropic"]
    assert content["orders"]["chair"]["paper"]["fd"] == ["dependent", "independent", "DeepSDF"]
    assert content["orders"]["vase"]["paper"] is None, "the paper has no vases"
    assert ordered([{"arm": "", "method": m, "fd": {"mean": f["fd"]}} for m, f in PAPER["table"].items()]) == {
        "fd": ["independent", "dependent", "DeepSDF"]
    }
    assert content["categories"]["chair"]["sets"] == SETS
    assert content["about"] == ABOUT


def test_files_that_were_measured_differently_are_refused() -> None:
    files: dict[str, tuple[list[dict[str, Any]], dict[str, Any]]] = {
        name: ([], {**ABOUT, "points": n, "sets": SETS}) for n, name in enumerate(("chair", "table"))
    }
    with pytest.raises(InputError, match="all measured alike; rerun evaluate_generation"):
        gather_generation(files)


def test_the_table_marks_the_best_method_where_there_is_one_and_never_a_reference() -> None:
    found = {"methods": summarise_methods(ROWS), "sets": SETS}
    shown = table3.table(found, PAPER["chair"])
    keys = [column.key for column in table3.COLUMNS]
    best = {key: [row.name for row in shown["arms"] if row.cells[i].best] for i, key in enumerate(keys)}
    assert best["fd"] == best["kpd"] == best["cov"] == ["cagesdf, dependent"]
    assert best["coverage"] == ["deepsdf, isotropic"]
    assert best["told_apart"] == ["cagesdf, dependent"], "40 % is nearer to a half than 70 %"
    assert best["gen"] == best["var"] == [], "more may be broken"
    assert not any(cell.best for row in shown["references"] for cell in row.cells)
    assert [row.name for row in shown["references"]] == ["drawn", "halves"]
    assert shown["references"][0].cells[keys.index("fd")].spread == "± 0.71"
    assert shown["arms"][2].cells[keys.index("recognised")].text == "–"
    assert shown["paper"][0][1][keys.index("fd")] == "489"
    assert shown["paper"][0][1][keys.index("kpd")] == "–"
    assert table3.table(None, {})["arms"] == []
