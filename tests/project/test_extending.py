"""docs/extending.md: its changes and its code, made and run in a copy of the repository."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
COPIED = ("cagesdf", "pipeline", "stages", "params.yaml", "dvc.yaml", "pyproject.toml")
BLOCK = re.compile(r"^```(python|diff)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def applied(text: str, hunk: str) -> str:
    """A file's text after one hunk of a diff, whose lines must stand there once."""
    lines = hunk.splitlines(keepends=True)
    before, after = ("".join(line[1:] for line in lines if line[0] in (" ", sign)) for sign in "-+")
    assert f"\n{text}".count(f"\n{before}") == 1, f"wanted once:\n{before}"
    return f"\n{text}".replace(f"\n{before}", f"\n{after}")[1:]


def change(folder: Path, diff: str) -> None:
    """Make the changes of a diff: `--- file`, then hunks, each after a line @@."""
    head, *hunks = diff.split("@@\n")
    path = folder / head.removeprefix("--- ").strip()
    for hunk in hunks:
        path.write_text(applied(path.read_text(encoding="utf-8"), hunk), encoding="utf-8")


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The repository with all changes of the page, and the page's code to run there."""
    folder = tmp_path_factory.mktemp("copy")
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, folder / name)
    code = []
    for kind, text in BLOCK.findall(PAGE):
        if kind == "diff":
            change(folder, text)
        elif text.startswith("# ") and "/" in text.splitlines()[0]:
            first, rest = text.split("\n", 1)
            path = folder / first.removeprefix("# ")
            assert not path.exists(), f"{path} is there already"
            path.write_text(rest, encoding="utf-8")
        else:
            code.append(text)
    return folder, "\n".join(code)


def test_the_code_of_the_page_runs_after_the_changes_of_the_page(copy: tuple[Path, str]) -> None:
    folder, code = copy
    assert code.count("assert ") > 10
    (folder / "page.py").write_text(code, encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "page.py"], cwd=folder, env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr[-3000:]


def test_the_page_registers_each_thing_in_one_file_of_the_library(copy: tuple[Path, str]) -> None:
    diffs = [text for kind, text in BLOCK.findall(PAGE) if kind == "diff"]
    changed = [name for text in diffs for name in re.findall(r"\A--- (\S+)", text)]
    assert [name for name in changed if name.startswith("cagesdf/")] == [
        "cagesdf/models/arms.py",
        "cagesdf/evaluation/metrics.py",
        "cagesdf/editing/script.py",
        "cagesdf/editing/operations.py",
        "cagesdf/api/shapes.py",
        "cagesdf/formats/parts_folder.py",
        "cagesdf/sampling/shapes.py",
    ]


@pytest.mark.parametrize(
    ("arm", "message"),
    [
        ("{decoder: EllipsoidDecoder, spread: 1}", "arms.ellipsoids.ellipsoids: field required"),
        ("{decoder: EllipsoidDecoder, ellipsoids: 0, spread: 1}", "wanted a whole number of at least 1, got 0"),
        ("{decoder: EllipsoidDecoder, ellipsoids: 3, spread: .nan}", "spread: wanted a finite number, got nan"),
        ("{decoder: EllipsoidDecoder, ellipsoids: 3, spread: wide}", "spread: wanted a finite number, got 'wide'"),
        ("{decoder: EllipsoidDecoder, ellipsoids: 3, spread: 1, balls: 1}", "balls: extra inputs are not permitted"),
        ("{decoder: BallDecoder}", "no decoder 'BallDecoder'; there are TriplaneDecoder"),
        ("{ellipsoids: 3}", "ellipsoids.ellipsoids: extra inputs are not permitted"),
    ],
)
def test_an_arm_that_does_not_fit_its_decoder_is_refused_before_anything_runs(
    arm: str, message: str, copy: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pipeline import decoders, params

    folder, _ = copy
    monkeypatch.setattr(decoders, "MODELS", folder / "cagesdf" / "models")
    monkeypatch.setattr(params, "decoder_sizes", decoders.decoder_sizes.__wrapped__)
    text = (ROOT / "params.yaml").read_text(encoding="utf-8")
    path = tmp_path / "params.yaml"
    path.write_text(text.replace("arms: #", f"arms:\n  ellipsoids: {arm}\n  #"), encoding="utf-8")
    with pytest.raises(params.ParamsError, match=re.escape(message)):
        params.check(path)


def test_a_hunk_whose_lines_are_not_there_fails() -> None:
    assert applied("a\nb\nc\n", " a\n-b\n+d\n") == "a\nd\nc\n"
    for hunk in (" x\n+d\n", " a\n c\n"):
        with pytest.raises(AssertionError, match="wanted once"):
            applied("a\nb\nc\na\nb\n", hunk)
