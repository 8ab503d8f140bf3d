"""Tables 1 and 2 from rows."""

import math

import pytest

from cagesdf.errors import InputError
from cagesdf.evaluation.reconstruction import METRICS
from cagesdf.evaluation.tables import gather_tables

ABOUT = {"version": 1, "seeds": [0, 1]}


def row(shape_id: str, step: int, seed: int, value: float, **others: float) -> dict:
    return (
        {"shape_id": shape_id, "step": step, "held_out": step == 2, "seed": seed}
        | dict.fromkeys(METRICS, value)
        | others
    )


def test_seeds_are_averaged_and_the_spread_is_over_shapes() -> None:
    rows = [row("a", 0, 0, 1.0), row("a", 0, 1, 3.0), row("b", 0, 0, 5.0), row("b", 0, 1, 7.0)]
    tables = gather_tables({"chair": [({"cagesdf": rows}, ABOUT)]})
    assert tables["table1"]["chair"]["cagesdf"]["cd_l1"] == {"mean": 4.0, "std": pytest.approx(math.sqrt(8)), "n": 2}
    assert set(tables["table1"]["chair"]["cagesdf"]) == set(METRICS)
    assert tables["about"] == ABOUT


def test_source_shapes_and_held_out_steps_go_to_their_own_table() -> None:
    files = [
        ({"cagesdf": [row("a", 0, 0, 1.0), row("a", 2, 0, 2.0), row("b", 2, 0, 4.0)]}, ABOUT),
        ({"deepsdf": [row("a", 0, 0, 9.0)]}, ABOUT),
        ({"cage": [row("a", 0, 0, 7.0)], "ground_truth": [row("a", 2, 0, 0.5)]}, ABOUT),
    ]
    tables = gather_tables({"vase": files, "chair": files[1:2]})
    assert list(tables["table1"]) == ["chair", "vase"]
    assert {arm: figures["f1"]["mean"] for arm, figures in tables["table1"]["vase"].items()} == {
        "cage": 7.0, "cagesdf": 1.0, "deepsdf": 9.0,
    }  # fmt: skip
    assert {arm: figures["f1"] for arm, figures in tables["table2"]["vase"].items()} == {
        "cagesdf": {"mean": 3.0, "std": pytest.approx(math.sqrt(2)), "n": 2},
        "ground_truth": {"mean": 0.5, "std": 0.0, "n": 1},
    }
    assert tables["table2"]["chair"] == {}


def test_shapes_without_detail_are_left_out_of_its_figures_alone() -> None:
    nan = float("nan")
    rows = [row("a", 0, 0, 1.0, nc_detail=nan), row("b", 0, 0, 3.0), row("c", 0, 0, 5.0, nc_detail=nan)]
    figures = gather_tables({"chair": [({"x": rows}, ABOUT)]})["table1"]["chair"]["x"]
    assert figures["nc"]["n"] == 3
    assert figures["nc_detail"] == {"mean": 3.0, "std": 0.0, "n": 1}
    figures = gather_tables({"chair": [({"x": rows[:1]}, ABOUT)]})["table1"]["chair"]["x"]
    assert figures["nc_detail"] == {"mean": None, "std": None, "n": 0}


def test_figures_that_were_measured_in_other_ways_are_not_put_side_by_side() -> None:
    files = [({"x": [row("a", 0, 0, 1.0)]}, ABOUT), ({"y": [row("a", 0, 0, 1.0)]}, {**ABOUT, "version": 2})]
    with pytest.raises(InputError, match="measured alike"):
        gather_tables({"chair": files})
    with pytest.raises(InputError, match="measured alike"):
        gather_tables({"chair": []})
