"""Tables 1 and 2 from rows."""

import math
from typing import Any

import pytest

from cagesdf.errors import InputError
from cagesdf.evaluation.edits import FIGURES
from cagesdf.evaluation.metrics import OF_KEY
from cagesdf.evaluation.tables import gather_edits, gather_progress, gather_tables

ABOUT = {"version": 1, "seeds": [0, 1]}


def row(shape_id: str, step: int, seed: int, value: float, **others: float) -> dict:
    return (
        {"shape_id": shape_id, "step": step, "held_out": step == 2, "seed": seed}
        | dict.fromkeys(OF_KEY, value)
        | others
    )


def test_seeds_are_averaged_and_the_spread_is_over_shapes() -> None:
    rows = [row("a", 0, 0, 1.0), row("a", 0, 1, 3.0), row("b", 0, 0, 5.0), row("b", 0, 1, 7.0)]
    tables = gather_tables({"chair": ({"cagesdf": rows}, ABOUT)})
    assert tables["table1"]["chair"]["cagesdf"]["cd_l1"] == {
        "mean": 4.0,
        "std": pytest.approx(math.sqrt(8)),
        "min": 2.0,
        "max": 6.0,
        "n": 2,
    }
    assert set(tables["table1"]["chair"]["cagesdf"]) == set(OF_KEY)
    assert tables["about"] == ABOUT


def test_source_shapes_and_held_out_steps_go_to_their_own_table() -> None:
    vases = {
        "cagesdf": [row("a", 0, 0, 1.0), row("a", 2, 0, 2.0), row("b", 2, 0, 4.0)],
        "deepsdf": [row("a", 0, 0, 9.0)],
        "cage": [row("a", 0, 0, 7.0)],
        "ground_truth": [row("a", 2, 0, 0.5)],
    }
    tables = gather_tables({"vase": (vases, ABOUT), "chair": ({"deepsdf": vases["deepsdf"]}, ABOUT)})
    assert list(tables["table1"]) == ["chair", "vase"]
    assert {arm: figures["f1"]["mean"] for arm, figures in tables["table1"]["vase"].items()} == {
        "cage": 7.0, "cagesdf": 1.0, "deepsdf": 9.0,
    }  # fmt: skip
    assert {arm: figures["f1"] for arm, figures in tables["table2"]["vase"].items()} == {
        "cagesdf": {"mean": 3.0, "std": pytest.approx(math.sqrt(2)), "min": 2.0, "max": 4.0, "n": 2},
        "ground_truth": {"mean": 0.5, "std": 0.0, "min": 0.5, "max": 0.5, "n": 1},
    }
    assert tables["table2"]["chair"] == {}


def test_shapes_without_detail_are_left_out_of_its_figures_alone() -> None:
    nan = float("nan")
    rows = [row("a", 0, 0, 1.0, nc_detail=nan), row("b", 0, 0, 3.0), row("c", 0, 0, 5.0, nc_detail=nan)]
    figures = gather_tables({"chair": ({"x": rows}, ABOUT)})["table1"]["chair"]["x"]
    assert figures["nc"]["n"] == 3
    assert figures["nc_detail"] == {"mean": 3.0, "std": 0.0, "min": 3.0, "max": 3.0, "n": 1}
    figures = gather_tables({"chair": ({"x": rows[:1]}, ABOUT)})["table1"]["chair"]["x"]
    assert figures["nc_detail"] == {"mean": None, "std": None, "min": None, "max": None, "n": 0}


def test_figures_that_were_measured_in_other_ways_are_not_put_side_by_side() -> None:
    rows = {"x": [row("a", 0, 0, 1.0)]}
    with pytest.raises(InputError, match="measured alike"):
        gather_tables({"chair": (rows, ABOUT), "vase": (rows, {**ABOUT, "version": 2})})
    with pytest.raises(InputError, match="measured alike"):
        gather_tables({})


def edit(trial: str, kind: str, **figures: float) -> dict[str, Any]:
    return {"arm": "cagesdf", "trial_id": trial, "kind": kind} | dict.fromkeys(FIGURES, math.nan) | figures


def test_edits_are_told_by_kind_with_quartiles_and_the_share_of_gains() -> None:
    gains = [-1.0, 0.0, 0.25, 0.5, 1.0]
    rows = [edit(f"swap/{i}", "swap", gain=gain, refit=2.0) for i, gain in enumerate(gains)]
    rows.append(edit("rest/a", "rest", refit=8.0, distance=0.5))
    table = gather_edits({"chair": [(rows, ABOUT)]}, {"chair": []})
    assert table["about"] == ABOUT
    kinds = table["categories"]["chair"]["cagesdf"]
    assert kinds["swap"]["gain"] == {
        "median": 0.25, "q25": 0.0, "q75": 0.5, "mean": pytest.approx(0.15), "max": 1.0, "positive": 0.6, "n": 5,
    }  # fmt: skip
    assert kinds["all"] == {
        "refit": {"median": 2.0, "q25": 2.0, "q75": 2.0, "mean": 3.0, "max": 8.0, "n": 6},
    }  # fmt: skip
    assert set(kinds["rest"]) == {"distance", "refit"}


def test_an_arm_that_cannot_be_edited_stands_in_the_table_without_figures() -> None:
    files = [([edit("rest/a", "rest", refit=0.0) | {"arm": "box_warp"}], ABOUT)]
    table = gather_edits({"chair": files}, {"chair": ["deepsdf"]})["categories"]["chair"]
    assert table["deepsdf"] == {}
    assert sorted(table) == ["box_warp", "deepsdf"]
    assert gather_edits({}, {}) == {"about": {}, "categories": {}}


def test_edits_that_were_measured_in_other_ways_are_not_put_side_by_side() -> None:
    with pytest.raises(InputError, match="measured alike"):
        gather_edits({"chair": [([], ABOUT), ([], {**ABOUT, "version": 2})]}, {"chair": []})


def course(arm: str, points: int, distance: float) -> dict[str, object]:
    figures = {"surface_distance": distance, "cd_deepsdf": 0.5, "nc_signed": 0.75}
    return {"arm": arm, "points": points, "shape_id": "a", "step": 2, "held_out": arm != "late", **figures}


def test_along_a_training_the_points_are_told_and_shapes_are_averaged() -> None:
    rows = [course("early", 100, 1.0), course("early", 100, 2.0), course("early", 300, 0.5), course("late", 100, 4.0)]
    table = gather_progress({"chair": (rows, {"points": 5})})
    assert table["about"] == {"points": 5}
    early, late = table["categories"]["chair"]["early"], table["categories"]["chair"]["late"]
    assert [(row["points"], row["held_out"], row["surface_distance"]) for row in early] == [
        (100, True, 1.5), (300, True, 0.5),
    ]  # fmt: skip
    assert [(row["points"], row["held_out"], row["surface_distance"]) for row in late] == [(100, False, 4.0)]


def test_courses_that_were_measured_otherwise_are_refused() -> None:
    rows = [course("early", 100, 1.0)]
    with pytest.raises(InputError, match="rerun evaluate_progress"):
        gather_progress({"chair": (rows, {"points": 5}), "table": (rows, {"points": 6})})
