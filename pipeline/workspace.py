"""Work folders: a run with other parameters or data, apart from the default run.

    python -m pipeline.workspace profile tiny
    python -m pipeline.workspace own --data FOLDER --name chair [--include 'Chair_*'] [--up z]

make `work/tiny` or `work/own-chair`: a DVC project of its own with

    settings.yaml  the differences from the default parameters; yours to edit, never overwritten
    params.yaml    the default parameters with those differences, made anew each time
    dvc.yaml       the same graph; for own data without its first stage
    data/          its outputs, once `dvc repro` has run there

and print the folder. Code and environment stay the project's own.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

from pipeline.params import ParamsError, check

ROOT = Path(__file__).resolve().parent.parent
RAW = "data/raw/${item.category}"


def make_workspace(folder: Path, settings: dict[str, Any], graph: dict[str, Any]) -> None:
    """Write a work folder's files and make it a DVC project, or bring it up to date.

    Settings that the folder already has win over `settings`. Raises ParamsError as `check` does.
    """
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / "settings.yaml"
    if kept.is_file():
        settings = merged(settings, yaml.safe_load(kept.read_text(encoding="utf-8")) or {})
    defaults = yaml.safe_load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    code = Path(os.path.relpath(ROOT, folder)).as_posix()
    params = merged(merged(defaults, settings), {"run": {"code": code}})
    _write(kept, settings, "Differences from the project's params.yaml; yours to edit.")
    _write(folder / "params.yaml", params, "Made from the project's params.yaml and settings.yaml; edit that one.")
    _write(folder / "dvc.yaml", graph, "Made from the project's dvc.yaml.")
    check(folder / "params.yaml")
    if not (folder / ".dvc").is_dir():
        dvc = [sys.executable, "-m", "dvc"]
        subprocess.run([*dvc, "init", "--quiet", "--no-scm"], cwd=folder, check=True)
        for option in ("analytics", "check_update"):
            subprocess.run([*dvc, "config", "--quiet", f"core.{option}", "false"], cwd=folder, check=True)


def merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`base` with `changes`, mapping by mapping; lists and values are replaced whole."""
    result = dict(base)
    for key, value in changes.items():
        both = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = merged(result[key], value) if both else value
    return result


def profile_settings(name: str) -> dict[str, Any]:
    """The differences that `profiles/<name>.yaml` lists. Raises ParamsError with the names there are."""
    path = ROOT / "profiles" / f"{name}.yaml"
    known = sorted(item.stem for item in path.parent.glob("*.yaml"))
    if name not in known:
        raise ParamsError(f"no profile {name!r}; profiles/ has {', '.join(known)}")
    return yaml.safe_load(path.read_text(encoding="utf-8")) or {}


def own_graph(graph: dict[str, Any], data: Path) -> dict[str, Any]:
    """The graph without synthesis, reading `data` where it read the synthesized shapes."""

    def replace(item: Any) -> Any:
        if isinstance(item, dict):
            return {key: replace(value) for key, value in item.items()}
        if isinstance(item, list):
            return [replace(value) for value in item]
        return item.replace(RAW, data.resolve().as_posix()) if isinstance(item, str) else item

    return {"stages": {name: replace(stage) for name, stage in graph["stages"].items() if name != "synthesize"}}


def _write(path: Path, content: dict[str, Any], comment: str) -> None:
    text = yaml.safe_dump(content, sort_keys=False, width=120, allow_unicode=True)
    path.write_text(f"# {comment}\n{text}", encoding="utf-8", newline="\n")


def main(arguments: list[str]) -> Path:
    """Make the work folder that the command line asks for; returns it."""
    parser = argparse.ArgumentParser(prog="python -m pipeline.workspace")
    commands = parser.add_subparsers(dest="command", required=True)
    profile = commands.add_parser("profile", help="other parameters: profiles/<name>.yaml")
    profile.add_argument("name")
    own = commands.add_parser("own", help="your own shapes")
    own.add_argument("--data", type=Path, required=True, help="a folder of shapes")
    own.add_argument("--name", required=True, help="what the category is called")
    own.add_argument("--include", help="glob over the shapes' names")
    own.add_argument("--up", choices=["y", "z"], help="up axis of the files")
    options = parser.parse_args(arguments)
    graph = yaml.safe_load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))
    if options.command == "profile":
        folder = ROOT / "work" / options.name
        make_workspace(folder, profile_settings(options.name), graph)
        return folder
    if not options.data.is_dir():
        raise ParamsError(f"{options.data}: no such folder; wanted one with a folder or file per shape")
    if not options.name.isidentifier():
        raise ParamsError(f"name {options.name!r}: wanted letters, digits and underscores, as in chair")
    given = {key: getattr(options, key) for key in ("include", "up") if getattr(options, key) is not None}
    settings = merged(profile_settings("own"), {"run": {"categories": [options.name]}, "import_shapes": given})
    folder = ROOT / "work" / f"own-{options.name}"
    make_workspace(folder, settings, own_graph(graph, options.data))
    return folder


if __name__ == "__main__":
    try:
        print(main(sys.argv[1:]))
    except (ParamsError, OSError) as error:
        sys.exit(f"workspace: {error}")
