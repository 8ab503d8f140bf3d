"""Work folders: a run with other parameters or data, apart from the default run.

    python -m pipeline.workspace profile tiny
    python -m pipeline.workspace own --data FOLDER --name chair [--include 'Chair_*'] [--up z]

make `work/tiny` or `work/own-chair`: a DVC project of its own with

    settings.yaml     the differences from the default parameters; yours to edit, comments are kept
    params.yaml       the default parameters with those differences, made anew each time
    dvc.yaml          the same graph; for own data without its first stage
    .dvc/plots        how `dvc plots show` draws
    data/raw/chair    for own data: a link to FOLDER
    data/linked/0000  for own data: links to the folders that links in FOLDER lead to
    data/             its outputs, once `dvc repro` has run there

and print the folder. Code and environment stay the project's own.

FOLDER may be called anything. Its name is in a link and nowhere else, because DVC gives commands to a shell and
replaces ${...} in what they read. DVC doesn't look behind links within a folder, so each folder that one leads to is
linked as well, as a dependency of the same stages.
"""

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError

from pipeline.params import ParamsError, check, read_yaml

ROOT = Path(__file__).resolve().parent.parent
SETTINGS = "settings.yaml"
RAW = "data/raw/${item.category}"
Content = dict[str, Any]  # of a YAML file


def make_workspace(folder: Path, settings: Content, graph: Content) -> None:
    """Write a work folder's files and make it a DVC project, or bring it up to date.

    A settings.yaml that is there wins over `settings` and stays as it is. Raises ParamsError as `check` does, and for
    a settings.yaml that is no YAML.
    """
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / SETTINGS
    if not kept.is_file():
        _write(kept, settings, "Differences from the project's params.yaml; yours to edit.")
    settings = merged(settings, read_yaml(kept.read_bytes(), str(kept)))
    defaults = read_yaml((ROOT / "params.yaml").read_bytes(), "params.yaml")
    _write(
        folder / "params.yaml",
        merged(defaults, settings),
        "Made from the project's params.yaml and settings.yaml; edit that one.",
    )
    _write(folder / "dvc.yaml", graph, "Made from the project's dvc.yaml.")
    check(folder / "params.yaml")
    if not (folder / ".dvc").is_dir():
        dvc = [sys.executable, "-m", "dvc"]
        subprocess.run([*dvc, "init", "--quiet", "--no-scm"], cwd=folder, check=True)
        for option in ("analytics", "check_update"):
            subprocess.run([*dvc, "config", "--quiet", f"core.{option}", "false"], cwd=folder, check=True)
    shutil.copytree(ROOT / ".dvc" / "plots", folder / ".dvc" / "plots", dirs_exist_ok=True)


def merged(base: Content, changes: Content) -> Content:
    """`base` with `changes`, mapping by mapping; lists and values are replaced whole."""
    result = dict(base)
    for key, value in changes.items():
        both = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = merged(result[key], value) if both else value
    return result


def edit_settings(kept: Path, changes: Content) -> None:
    """Change a settings.yaml as `merged` does; comments and order stay, and every byte where nothing changes.

    Raises ParamsError if it is no YAML or has a key twice.
    """
    content = kept.read_bytes()
    stored = read_yaml(content, str(kept))
    if merged(stored, changes) == stored:
        return
    editor = YAML()
    editor.preserve_quotes, editor.width = True, 120
    try:
        mapping = editor.load(content)
    except MarkedYAMLError as error:
        mark = error.problem_mark
        problem = " ".join(str(error.problem).split())
        raise ParamsError(f"{kept}, line {mark.line + 1}, column {mark.column + 1}: {problem}") from error

    def change(old: Any, new: Content) -> None:
        for key, value in new.items():
            if isinstance(value, dict) and isinstance(old.get(key), dict):
                change(old[key], value)
            else:
                old[key] = value

    if mapping is None:  # nothing, or comments alone
        kept.write_bytes(content.rstrip() + b"\n" + _dumped(changes).encode("utf-8"))
        return
    change(mapping, changes)
    with kept.open("wb") as stream:
        editor.dump(mapping, stream)


def profile_settings(name: str) -> Content:
    """The differences that `profiles/<name>.yaml` lists. Raises ParamsError with the names there are."""
    path = ROOT / "profiles" / f"{name}.yaml"
    known = sorted(item.stem for item in path.parent.glob("*.yaml"))
    if name not in known:
        raise ParamsError(f"no profile {name!r}; profiles/ has {', '.join(known)}")
    return read_yaml(path.read_bytes(), str(path))


def own_graph(graph: Content, linked: int) -> Content:
    """The graph without synthesis; stages that read the shapes depend on `linked` folders behind links, too."""
    behind = [f"data/linked/{number:04d}" for number in range(linked)]
    stages = {name: dict(stage) for name, stage in graph["stages"].items() if name != "synthesize"}
    for stage in stages.values():
        if RAW in stage.get("deps", ()):
            stage["deps"] = [*stage["deps"], *behind]
    return {**graph, "stages": stages}


def link_data(folder: Path, name: str, data: Path) -> int:
    """Link `data` and the folders that links in it lead to into a work folder; returns the number of the latter.

    Raises ParamsError if `data` is no folder or holds the project itself.
    """
    if not data.is_dir():
        raise ParamsError(f"{data}: no such folder; wanted one with a folder or file per shape")
    behind = linked_folders(data)
    for target in (data.resolve(), *behind):
        if ROOT.is_relative_to(target):
            raise ParamsError(f"{data}: {target} holds the project itself; move the shapes into a folder of their own")
    _link(folder / "data" / "raw" / name, data.resolve())
    places = folder / "data" / "linked"
    for old in places.iterdir() if places.is_dir() else ():
        old.unlink()
    for number, target in enumerate(behind):
        _link(places / f"{number:04d}", target)
    return len(behind)


def linked_folders(data: Path) -> list[Path]:
    """The folders outside `data` that links in it lead to, and links in those; real paths, sorted."""
    inside = data.resolve()
    targets_outside: set[Path] = set()
    todo = [inside]
    while todo:
        for place, folders, _ in os.walk(todo.pop()):
            targets = {path.resolve() for path in (Path(place, name) for name in folders) if path.is_symlink()}
            new = {target for target in targets - targets_outside if not target.is_relative_to(inside)}
            targets_outside |= new
            todo += sorted(new)
    return sorted(targets_outside)


def _link(place: Path, target: Path) -> None:
    if _is_link(place):
        place.unlink()
    if place.exists():
        raise ParamsError(f"{place}: is no link; move it away, it is the place of a link to your shapes")
    place.parent.mkdir(parents=True, exist_ok=True)
    if sys.platform == "win32":
        import _winapi

        _winapi.CreateJunction(str(target), str(place))
    else:
        place.symlink_to(target)


def _is_link(place: Path) -> bool:
    """Whether a link lies there: a symbolic one, or Windows' junction."""
    try:
        place.readlink()
    except OSError:
        return False
    return True


def _dumped(content: Content) -> str:
    return yaml.safe_dump(content, sort_keys=False, width=120, allow_unicode=True)


def _write(path: Path, content: Content, comment: str) -> None:
    path.write_text(f"# {comment}\n{_dumped(content)}", encoding="utf-8", newline="\n")


def main(arguments: list[str]) -> Path:
    """Make the work folder that the command line asks for; returns it."""
    parser = argparse.ArgumentParser(prog="python -m pipeline.workspace")
    commands = parser.add_subparsers(dest="command", required=True)
    profile = commands.add_parser("profile", help="other parameters: profiles/<name>.yaml")
    profile.add_argument("name")
    own = commands.add_parser("own", help="your own shapes")
    own.add_argument("--data", required=True, help="a folder of shapes")
    own.add_argument("--name", required=True, help="what the category is called")
    own.add_argument("--include", help="glob over the shapes' names")
    own.add_argument("--up", choices=["y", "z"], help="up axis of the files")
    options = parser.parse_args(arguments)
    graph = read_yaml((ROOT / "dvc.yaml").read_bytes(), "dvc.yaml")
    if options.command == "profile":
        folder = ROOT / "work" / options.name
        make_workspace(folder, profile_settings(options.name), graph)
        return folder
    if not options.name.isidentifier():
        raise ParamsError(f"name {options.name!r}: wanted letters, digits and underscores, as in chair")
    if not options.data:
        raise ParamsError("data: got an empty name; wanted a folder of shapes")
    shapes = {key: getattr(options, key) for key in ("include", "up") if getattr(options, key) is not None}
    given = {"run": {"categories": [options.name]}, **({"import_shapes": shapes} if shapes else {})}
    folder = ROOT / "work" / f"own-{options.name}"
    linked = link_data(folder, options.name, Path(options.data))
    if (folder / SETTINGS).is_file():
        edit_settings(folder / SETTINGS, given)
    make_workspace(folder, merged(profile_settings("own"), given), own_graph(graph, linked))
    return folder


if __name__ == "__main__":
    try:
        print(main(sys.argv[1:]))
    except (ParamsError, OSError) as error:
        sys.exit(f"workspace: {error}")
