"""What DVC shows of a run is in its tables."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from cagesdf.report.summary import progress_rows, summary

ROOT = Path(__file__).parents[2]


def block(**means: float) -> dict[str, dict[str, float]]:
    return {name: {"mean": value, "median": 2 * value} for name, value in means.items()}


TABLES = {
    "table1": {"chair": {"cagesdf": block(surface_distance=0.1), "deepsdf": block(surface_distance=2.0)}},
    "table2": {"chair": {"cagesdf": block(surface_distance=0.2)}},
    "edits": {"categories": {"chair": {"cagesdf": {"warp": block(gain=0.4), "swap": {}}}}},
    "progress": {
        "categories": {"chair": {"cagesdf": [{"held_out": True, "points": 8, "surface_distance": 0.3, "nc": 1.0}]}}
    },
}


def test_a_summary_has_means_of_distances_and_medians_of_gains_and_leaves_out_what_was_not_measured() -> None:
    assert summary(TABLES) == {
        "chair": {"cagesdf": {"source": 0.1, "held_out": 0.2, "gain_warp": 0.8}, "deepsdf": {"source": 2.0}}
    }


def test_a_curve_has_a_row_for_each_of_its_points() -> None:
    assert progress_rows(TABLES) == [
        {"category": "chair", "arm": "cagesdf", "held_out": True, "points": 8, "surface_distance": 0.3}
    ]


@pytest.mark.parametrize("what", ["metrics", "plots"])
def test_dvc_shows_the_committed_figures(what: str, tmp_path: Path) -> None:
    arguments = ["show", "--json"] if what == "metrics" else ["show", "--json", "--out", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-m", "dvc", what, *arguments], cwd=ROOT, capture_output=True, text=True, check=True
    )
    expected = summary(json.loads((ROOT / "data/metrics/tables.json").read_text(encoding="utf-8")))
    if what == "metrics":
        (shown,) = (entry["data"] for entry in json.loads(done.stdout)[""]["data"].values())
        assert shown == expected
    else:
        [plot] = json.loads(done.stdout)["data"]["data/metrics/progress.json"]
        encoding = plot["content"]["spec"]["encoding"]
        assert {key: encoding[key]["field"] for key in ("x", "y", "color", "strokeDash")} == {
            "x": "points", "y": "surface_distance", "color": "arm", "strokeDash": "rev",
        }  # fmt: skip
        assert {row["arm"] for row in plot["content"]["data"]["values"]} <= set(next(iter(expected.values())))
