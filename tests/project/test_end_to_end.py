"""The whole graph as a user runs it, at the smallest size: `make repro PROFILE=tiny`, `make own`."""

import json
import os
import subprocess
import sys
from contextlib import chdir
from pathlib import Path

import manifold3d
import numpy as np
import pytest
import yaml
from dvc.repo import Repo

from cagesdf.geometry.solid import from_manifold
from pipeline import lanes, workspace

BIN = Path(sys.executable).parent
GRAPH = yaml.safe_load((workspace.ROOT / "dvc.yaml").read_text(encoding="utf-8"))


def repro(folder: Path) -> str:
    """Run the graph as `make repro` does, on one core; the output."""
    return run(folder, "pipeline.lanes")


def dvc_repro(folder: Path) -> str:
    """Run it with DVC alone; the output."""
    return run(folder, "dvc", "repro")


def run(folder: Path, *command: str) -> str:
    environment = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}", "CAGESDF_WORKERS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    return done.stdout


def stages_run(output: str) -> set[str]:
    return {line.split("'")[1] for line in output.splitlines() if line.startswith("Running stage")}


@pytest.mark.slow
def test_the_pipeline_runs_then_is_up_to_date_then_only_what_depends_on_a_change_is_stale(tmp_path: Path) -> None:
    folder = tmp_path / "tiny"
    workspace.make_workspace(folder, workspace.profile_settings("tiny"), GRAPH)
    first = stages_run(repro(folder))
    assert {"synthesize@chair", "train@chair-cagesdf", "evaluate@chair", "report"} <= first

    tables = json.loads((folder / "data/metrics/tables.json").read_text(encoding="utf-8"))
    for arm in ("cagesdf", "deepsdf", "cage", "ground_truth"):
        figures = tables["table1"]["chair"][arm]["surface_distance"]
        assert figures["n"] == 2
        assert np.isfinite(figures["mean"])
    assert "deepsdf" not in tables["table2"]["chair"]
    assert tables["table2"]["chair"]["cagesdf"]["surface_distance"]["n"] == 2
    page = (folder / "data/report/index.html").read_text(encoding="utf-8")
    assert "chair" in page
    assert not list(folder.rglob("*.partial"))

    assert stages_run(dvc_repro(folder)) == {"library"}, "it looks at the code each time, and finds it as it was"

    of_all_arms = {
        "evaluate@chair", "evaluate_edits@chair", "evaluate_progress@chair", "evaluate_generation@chair", "report",
    }  # fmt: skip
    change(folder, {"arms": {"deepsdf": {"learning_rate": 2e-3}}})
    with chdir(folder), Repo() as repo:
        reads, changed = lanes.graph(repo)
        assert set(lanes.stale(reads, changed - {"library"})) == of_all_arms | {
            "train@chair-deepsdf", "extract_meshes@chair-deepsdf", "generate@chair-deepsdf",
        }  # fmt: skip

    change(folder, {"run": {"arms": ["cagesdf"], "generators": ["cagesdf"]}})
    assert stages_run(dvc_repro(folder)) - {"library"} == of_all_arms, (
        "what deepsdf left is there, and no longer looked at"
    )
    fewer = json.loads((folder / "data/metrics/tables.json").read_text(encoding="utf-8"))
    assert set(fewer["table1"]["chair"]) == {"cagesdf", "cage", "ground_truth"}
    assert fewer["table1"]["chair"]["cagesdf"] == tables["table1"]["chair"]["cagesdf"]
    assert {entry["arm"] for entry in fewer["table3"]["categories"]["chair"]["methods"]} <= {"cagesdf", "real"}


def change(folder: Path, settings: dict) -> None:
    """What a user does: other settings, and the work folder made anew."""
    path = folder / "settings.yaml"
    merged = workspace.merged(yaml.safe_load(path.read_text(encoding="utf-8")), settings)
    path.write_text(yaml.safe_dump(merged), encoding="utf-8")
    workspace.make_workspace(folder, {}, GRAPH)


def write_stool(folder: Path, rng: np.random.Generator) -> None:
    """A seat and four legs, one OBJ each, z up, in millimetres."""
    folder.mkdir(parents=True)
    width, depth, height = rng.uniform([300, 300, 400], [500, 400, 700])
    seat = manifold3d.Manifold.cube([width, depth, 40.0]).translate([0, 0, height])
    leg = manifold3d.Manifold.cylinder(height + 5, 20.0, 15.0, 16)
    legs = [leg.translate([x, y, 0]) for x in (30, width - 30) for y in (30, depth - 30)]
    for i, solid in enumerate([seat, *legs]):
        mesh = from_manifold(solid.refine_to_length(80.0))
        lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
        (folder / f"{i:02d}.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.mark.slow
def test_a_folder_of_part_meshes_without_partners_goes_all_the_way(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for i in range(3):
        write_stool(tmp_path / "stools" / f"stool_{i}", rng)
    (tmp_path / "stools" / "broken").mkdir()
    (tmp_path / "stools" / "broken" / "00.obj").write_text("v 0 0\n", encoding="utf-8")
    tiny = {name: values for name, values in workspace.profile_settings("tiny").items() if name != "run"}
    settings = workspace.merged(workspace.profile_settings("own"), tiny)
    settings = workspace.merged(settings, {"run": {"categories": ["stool"]}, "import_shapes": {"up": "z"}})
    folder = tmp_path / "own"
    linked = workspace.link_data(folder, "stool", tmp_path / "stools")
    workspace.make_workspace(folder, settings, workspace.own_graph(GRAPH, linked))
    output = repro(folder)
    assert "train@stool-cagesdf" in stages_run(output)
    assert "broken" in output, "the summary names what was rejected"

    out = tmp_path / "out.ply"
    subprocess.run(
        [BIN / "cagesdf", "extract", folder / "data/runs/stool/cagesdf", "stool_1", out, "--resolution", "48"],
        check=True,
    )
    assert out.stat().st_size > 1000
