"""The graph: every stage names the library files it truly uses, and every parameter loads."""

import ast
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.params import SECTIONS, check
from pipeline.workspace import merged

ROOT = Path(__file__).parent.parent
GRAPH: dict[str, Any] = yaml.safe_load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
STAGES = sorted(path.stem for path in (ROOT / "stages").glob("*.py") if path.stem != "__init__")


def module_file(name: str) -> Path | None:
    """The file of a module of cagesdf, by dotted name; None for a name inside a module."""
    path = ROOT / Path(*name.split("."))
    if (path / "__init__.py").is_file():
        return path / "__init__.py"
    return path.with_suffix(".py") if path.with_suffix(".py").is_file() else None


def followed(path: Path) -> set[Path]:
    """The library files that a file imports, directly or through others."""
    seen: set[Path] = set()
    todo = [path]
    while todo:
        for node in ast.walk(ast.parse(todo.pop().read_text(encoding="utf-8"))):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)]
            for name in names:
                file = module_file(name) if name.startswith("cagesdf") else None
                if file is not None and file not in seen:
                    seen.add(file)
                    todo.append(file)
    return {file for file in seen if file.name != "__init__.py"}


def listed(stage: str) -> set[Path]:
    return {ROOT / dep.removeprefix("${run.code}/") for dep in GRAPH[stage]["deps"] if dep.startswith("${run.code}/")}


@pytest.mark.parametrize("stage", STAGES)
def test_deps_are_the_library_files_that_the_stage_imports(stage: str) -> None:
    script = ROOT / "stages" / f"{stage}.py"
    wanted = followed(script) | {script}
    code = {path for path in listed(stage) if path.suffix == ".py"}
    assert {str(path.relative_to(ROOT)) for path in wanted - code} == set(), "not listed"
    assert {str(path.relative_to(ROOT)) for path in code - wanted} == set(), "listed, not imported"


def test_every_stage_file_has_a_stage_and_the_other_way_round() -> None:
    assert sorted(GRAPH) == STAGES


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_lists_the_format_and_its_own_parameters(stage: str) -> None:
    params = {entry.split(".")[0] for entry in GRAPH[stage]["params"]}
    own = {"train": {"train", "arms"}, "evaluate_references": {"evaluate", "extract_meshes"}}.get(stage, {stage})
    assert own <= {*SECTIONS, "arms"}
    assert params == own | {"format"}


@pytest.mark.parametrize("stage", STAGES)
def test_a_command_runs_its_own_stage_on_paths_that_are_deps_and_outs(stage: str) -> None:
    words = GRAPH[stage]["cmd"].replace('"', "").split()
    assert words[:3] == ["python", "-m", f"stages.{stage}"]
    paths = [word for word in words[3:] if word.startswith("data/")]
    entries = [*GRAPH[stage].get("outs", []), *GRAPH[stage].get("metrics", [])]
    outs = [next(iter(entry)) if isinstance(entry, dict) else entry for entry in entries]
    deps = [dep for dep in GRAPH[stage]["deps"] if not dep.startswith("${run.code}")]
    assert set(paths) == set(deps) | set(outs)


@pytest.mark.parametrize("file", ["params.yaml", *sorted(f"profiles/{p.name}" for p in (ROOT / "profiles").glob("*"))])
def test_parameter_files_load_with_every_section_and_arm(file: str, tmp_path: Path) -> None:
    params = yaml.safe_load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    if file != "params.yaml":
        params = merged(params, yaml.safe_load((ROOT / file).read_text(encoding="utf-8")))
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params), encoding="utf-8")
    sections = check(tmp_path / "params.yaml")
    assert set(SECTIONS) <= set(sections)
    assert {f"arms.{arm}" for arm in params["run"]["arms"]} <= set(sections)
