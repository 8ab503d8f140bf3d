"""Work folders: other parameters or data beside the default run, and nothing of the user's lost."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from pipeline import workspace
from pipeline.params import ParamsError, check


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with the real parameters and graph, whose work folder is ours to fill."""
    for name in ("params.yaml", "dvc.yaml"):
        (tmp_path / name).write_bytes((workspace.ROOT / name).read_bytes())
    (tmp_path / "profiles").mkdir()
    for path in (workspace.ROOT / "profiles").glob("*.yaml"):
        (tmp_path / "profiles" / path.name).write_bytes(path.read_bytes())
    monkeypatch.setattr(workspace, "ROOT", tmp_path)
    return tmp_path


def read(path: Path) -> dict:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def test_a_profile_is_the_default_parameters_with_its_differences(root: Path) -> None:
    folder = workspace.main(["profile", "tiny"])
    assert folder == root / "work" / "tiny"
    check(folder / "params.yaml")
    params, defaults = read(folder / "params.yaml"), read(root / "params.yaml")
    assert params["train"]["steps"] == read(root / "profiles" / "tiny.yaml")["train"]["steps"]
    assert params["match_targets"] == defaults["match_targets"]
    assert (folder / params["run"]["code"]).resolve() == root
    assert read(folder / "dvc.yaml") == read(root / "dvc.yaml")


def test_settings_that_were_edited_survive_and_win(root: Path) -> None:
    folder = workspace.main(["profile", "tiny"])
    (folder / "settings.yaml").write_text("train: {steps: 7}\n", encoding="utf-8")
    workspace.main(["profile", "tiny"])
    params = read(folder / "params.yaml")
    assert params["train"]["steps"] == 7
    assert params["train"]["width"] == read(root / "profiles" / "tiny.yaml")["train"]["width"]


def test_own_data_takes_the_place_of_synthesis(root: Path) -> None:
    data = root / "my shapes"
    data.mkdir()
    folder = workspace.main(["own", "--data", str(data), "--name", "stool", "--include", "A*", "--up", "z"])
    assert folder.name == "own-stool"
    params, graph = read(folder / "params.yaml"), read(folder / "dvc.yaml")["stages"]
    assert params["run"]["categories"] == ["stool"]
    assert (params["import_shapes"]["include"], params["import_shapes"]["up"]) == ("A*", "z")
    assert "synthesize" not in graph
    assert data.as_posix() in graph["import_shapes"]["deps"]
    assert f'"{data.as_posix()}"' in graph["import_shapes"]["cmd"]


def test_what_is_missing_or_misspelt_is_one_line_that_tells_what_there_is(root: Path) -> None:
    with pytest.raises(ParamsError, match="no profile 'tiney'; profiles/ has demo, own, paper, tiny"):
        workspace.main(["profile", "tiney"])
    with pytest.raises(ParamsError, match="no such folder"):
        workspace.main(["own", "--data", str(root / "nowhere"), "--name", "chair"])
    with pytest.raises(ParamsError, match=r"'\.\./x'"):
        workspace.main(["own", "--data", str(root), "--name", "../x"])


def test_dvc_accepts_the_folder(root: Path) -> None:
    folder = workspace.main(["profile", "tiny"])
    listed = subprocess.run(
        [sys.executable, "-m", "dvc", "stage", "list", "--name-only"],
        cwd=folder, capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    assert "train@chair-cagesdf" in listed
    assert "train@table-cagesdf" not in listed


def test_merging_replaces_values_and_lists_whole_and_changes_neither_side() -> None:
    base, changes = {"a": {"b": 1, "c": [1, 2]}, "d": 3}, {"a": {"c": [9]}, "e": 4}
    assert workspace.merged(base, changes) == {"a": {"b": 1, "c": [9]}, "d": 3, "e": 4}
    assert base == {"a": {"b": 1, "c": [1, 2]}, "d": 3}
