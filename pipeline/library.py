"""Which library files each stage uses, with their digests: what stages depend on in `dvc.yaml`.

python -m pipeline.library data/library

writes <stage>.txt, a line a file. DVC runs a stage again if its own list has changed, that is, if a file has
that it imports, directly or through others.
"""

import ast
import hashlib
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGES = ("cagesdf", "stages")


def main(out: Path) -> None:
    """Write the lists of all stages, whole or not at all."""
    partial = out.with_name(out.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    for script in stage_files():
        lines = [f"{hashlib.md5(path.read_bytes()).hexdigest()}  {name}\n" for name, path in used(script).items()]
        (partial / f"{script.stem}.txt").write_text("".join(lines), encoding="utf-8", newline="\n")
    shutil.rmtree(out, ignore_errors=True)
    partial.rename(out)


def stage_files() -> list[Path]:
    """The files of all stages, sorted."""
    return sorted(path for path in (ROOT / "stages").glob("*.py") if path.stem != "__init__")


def used(script: Path) -> dict[str, Path]:
    """A stage's file and the files that it imports, by sorted name; what lies beside them and is no code, too."""
    seen: set[Path] = {script}
    todo = [script]
    while todo:
        for name in _imported(todo.pop()):
            file = _file(name)
            if file is not None and file not in seen:
                seen.add(file)
                todo.append(file)
    folders = {path.parent for path in seen if path.parent.parent != ROOT}
    beside = {path for folder in folders for path in folder.iterdir() if path.is_file() and path.suffix != ".py"}
    return {path.relative_to(ROOT).as_posix(): path for path in sorted(seen | beside)}


def _imported(path: Path) -> Iterator[str]:
    """Every dotted name that a file imports, at any depth."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _file(name: str) -> Path | None:
    """The file of one of our modules; None for others, and for names inside a module."""
    if name.split(".")[0] not in PACKAGES:
        return None
    path = ROOT.joinpath(*name.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return file if file.is_file() else None


if __name__ == "__main__":
    main(Path(sys.argv[1]))
