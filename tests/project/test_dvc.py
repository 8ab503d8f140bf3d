"""The graph: every stage depends on the library files it truly uses, and every parameter loads."""

import hashlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline import library
from pipeline.params import LISTS, SECTIONS, check
from pipeline.workspace import merged
from stages import report

ROOT = Path(__file__).parents[2]
GRAPH: dict[str, Any] = yaml.safe_load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
STAGES = sorted(path.stem for path in (ROOT / "stages").glob("*.py") if path.stem != "__init__")


def test_the_code_is_looked_at_each_time() -> None:
    assert GRAPH["library"]["always_changed"]
    assert GRAPH["library"]["outs"] == ["data/library"]


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_depends_on_its_list_of_library_files(stage: str) -> None:
    assert f"data/library/{stage}.txt" in GRAPH[stage]["deps"]


def test_a_list_names_what_a_stage_imports_and_nothing_else(tmp_path: Path) -> None:
    library.main(tmp_path / "library")
    listed = {path.stem: path.read_text(encoding="utf-8") for path in (tmp_path / "library").iterdir()}
    assert sorted(listed) == STAGES
    assert "stages/match_targets.py" in listed["match_targets"]
    assert "cagesdf/deformation/matching.py" in listed["match_targets"]
    assert "cagesdf/structure/executor.py" in listed["match_targets"], "through stored and assembly"
    assert "cagesdf/models" not in listed["match_targets"]
    assert "cagesdf/report/page.html.j2" in listed["report"]
    for line in listed["report"].splitlines():
        digest, name = line.split("  ")
        assert digest == hashlib.md5((ROOT / name).read_bytes()).hexdigest()


def test_importing_a_stage_loads_no_file_that_its_list_lacks() -> None:
    """In one process, which loads the project's modules anew for each stage, and the libraries once."""
    script = (
        "import sys; from importlib import import_module\n"
        "for stage in sys.argv[1:]:\n"
        "    for name in [n for n in sys.modules if n.split('.')[0] in ('cagesdf', 'pipeline', 'stages')]:\n"
        "        del sys.modules[name]\n"
        "    import_module('stages.' + stage)\n"
        "    files = [getattr(module, '__file__', None) or '' for module in [*sys.modules.values()]]\n"
        f"    print(stage, *(f for f in files if f.startswith({str(ROOT / 'cagesdf')!r})), sep='|')\n"
    )
    command = [sys.executable, "-c", script, *STAGES]
    completed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = {stage: files for stage, *files in (line.split("|") for line in completed.stdout.splitlines())}
    assert [*loaded] == STAGES
    for stage, files in loaded.items():
        names = {Path(file).relative_to(ROOT).as_posix() for file in files if Path(file).name != "__init__.py"}
        assert len(names) > 5
        assert names <= set(library.used(ROOT / "stages" / f"{stage}.py"))


def test_every_stage_file_has_a_stage_and_the_other_way_round() -> None:
    assert sorted(GRAPH) == sorted([*STAGES, "library"])


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_lists_the_format_and_its_own_parameters(stage: str) -> None:
    own = {"train": {"train", "arms.${item.arm}"}}.get(stage, {stage})
    shared = {f"run.{name}" for name in LISTS if name in SECTIONS[stage].model_fields}
    assert {*GRAPH[stage]["params"]} == own | shared | {"format"}


@pytest.mark.parametrize("stage", STAGES)
def test_a_command_runs_its_own_stage_on_paths_that_are_deps_and_outs(stage: str) -> None:
    words = GRAPH[stage]["cmd"].split()
    assert words[:3] == ["python", "-m", f"stages.{stage}"]
    paths = [word for word in words[3:] if word.startswith("data/")]
    entries = [*GRAPH[stage].get("outs", []), *GRAPH[stage].get("metrics", [])]
    outs = [next(iter(entry)) if isinstance(entry, dict) else entry for entry in entries]
    deps = {dep for dep in GRAPH[stage]["deps"] if not dep.startswith("data/library")}
    if stage == "report":  # it is given data/ and reads these folders
        folders = {f"data/{folder}" for folder in (*report.OF_CATEGORY, *report.OF_ARM)}
        assert (deps, words[3]) == (folders, "data")
        deps = set()
    assert set(paths) == deps | set(outs)


@pytest.mark.slow
def test_a_report_that_fails_costs_neither_the_metrics_nor_the_page_of_the_last_one(tmp_path: Path) -> None:
    """DVC deletes what a stage writes before it runs, but for what persists."""
    report = {**GRAPH["report"], "cmd": f"{sys.executable} report.py", "deps": ["report.py"], "params": []}
    files = ["data/metrics/tables.json", "data/report/index.html"]
    (tmp_path / "dvc.yaml").write_text(yaml.safe_dump({"stages": {"report": report}}), encoding="utf-8")
    works = f"import os\nfor path in {files}:\n    os.makedirs(os.path.dirname(path))\n    open(path, 'w').close()"
    (tmp_path / "report.py").write_text(works, encoding="utf-8")

    def dvc(*arguments: str) -> int:
        command = [sys.executable, "-m", "dvc", *arguments]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, check=False).returncode

    assert [dvc("init", "--no-scm"), dvc("repro")] == [0, 0]
    (tmp_path / "report.py").write_text("raise SystemExit(1)", encoding="utf-8")
    assert dvc("repro") != 0
    assert all((tmp_path / file).is_file() for file in files)


@pytest.mark.parametrize("file", ["params.yaml", *sorted(f"profiles/{p.name}" for p in (ROOT / "profiles").glob("*"))])
def test_parameter_files_load_with_every_section_and_arm(file: str, tmp_path: Path) -> None:
    params = yaml.safe_load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    if file != "params.yaml":
        params = merged(params, yaml.safe_load((ROOT / file).read_text(encoding="utf-8")))
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params), encoding="utf-8")
    sections = check(tmp_path / "params.yaml")
    assert set(SECTIONS) <= set(sections)
    assert {f"arms.{arm}" for arm in params["run"]["arms"]} <= set(sections)
