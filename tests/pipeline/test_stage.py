"""From a command line to a stage: paths in order, its own parameters, one line for what is wrong."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
STAGE = '''"""A stage of the tests."""
from pathlib import Path
from pipeline import MatchParams, run_stage

class Answer(ValueError):
    pass

def main(name: str, source: Path, params: MatchParams) -> None:
    if name == "bad":
        raise Answer("what came, what was wanted")
    if name == "defect":
        raise ValueError("an index nobody thought of")
    print(type(name).__name__, type(source).__name__, params.unmatched)

if __name__ == "__main__":
    run_stage(main, Answer)
'''


def run(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    (folder / "match_targets.py").write_text(STAGE, encoding="utf-8")
    return subprocess.run(
        [sys.executable, "match_targets.py", *arguments],
        cwd=folder, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
    )  # fmt: skip


def test_a_stage_gets_its_arguments_and_the_section_of_its_name(tmp_path: Path) -> None:
    (tmp_path / "params.yaml").write_bytes((ROOT / "params.yaml").read_bytes())
    assert run(tmp_path, "chair", "folder").stdout.split() == ["str", type(tmp_path).__name__, "drop"]


def test_a_defect_keeps_its_traceback(tmp_path: Path) -> None:
    (tmp_path / "params.yaml").write_bytes((ROOT / "params.yaml").read_bytes())
    defect = run(tmp_path, "defect", "folder")
    assert defect.returncode == 1
    assert "Traceback" in defect.stderr
    assert defect.stderr.endswith("ValueError: an index nobody thought of\n")


def test_what_is_wrong_is_one_line_and_status_one_unless_a_traceback_is_asked_for(tmp_path: Path) -> None:
    missing = run(tmp_path, "chair", "folder")
    assert (missing.returncode, missing.stderr.count("\n")) == (1, 1)
    assert "params.yaml: can't be read" in missing.stderr
    (tmp_path / "params.yaml").write_bytes((ROOT / "params.yaml").read_bytes())
    bad = run(tmp_path, "bad", "folder")
    assert (bad.returncode, bad.stderr) == (1, "match_targets: what came, what was wanted\n")
    assert "Traceback" in run(tmp_path, "bad", "folder", CAGESDF_TRACEBACK="1").stderr
    assert "no section 'arms.x'" in run(tmp_path, "chair", "folder", "--params", "arms.x").stderr
