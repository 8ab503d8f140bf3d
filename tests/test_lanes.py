"""Stages side by side: both are there at once, what is up to date stays, and a failure is told."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from pipeline import lanes

# Each waits for the other to have begun: one after the other, they would wait in vain.
MEET = """
import os, sys, time
from pathlib import Path
own, other = sys.argv[1:]
Path(own + ".begun").touch()
for _ in range(600):
    if Path(other + ".begun").exists():
        break
    time.sleep(0.1)
else:
    sys.exit("alone")
Path(own).write_text(Path("raw").read_text() + os.environ["OMP_NUM_THREADS"])
"""
GRAPH = {
    "stages": {
        "raw": {"cmd": "python -c \"open('raw', 'w').write('x')\"", "outs": ["raw"]},
        "train": {
            "matrix": {"arm": [["a", "b"], ["b", "a"]]},
            "cmd": "python meet.py ${item.arm[0]} ${item.arm[1]}",
            "deps": ["raw", "meet.py"],
            "outs": ["${item.arm[0]}"],
        },
        "after": {"cmd": "python -c \"open('after', 'w')\"", "deps": ["a", "b"], "outs": ["after"]},
    }
}


def make(folder: Path, script: str) -> None:
    (folder / "meet.py").write_text(script, encoding="utf-8")
    (folder / "dvc.yaml").write_text(yaml.safe_dump(GRAPH), encoding="utf-8")
    subprocess.run([sys.executable, "-m", "dvc", "init", "--quiet", "--no-scm"], cwd=folder, check=True)


def run(folder: Path, *names: str) -> "subprocess.CompletedProcess[str]":
    env = os.environ | {"CAGESDF_WORKERS": "2", "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    command = [sys.executable, "-m", "pipeline.lanes", *names]
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_instances_run_at_once_after_what_they_need_and_only_when_something_changed(tmp_path: Path) -> None:
    make(tmp_path, MEET)
    first = run(tmp_path, "train")
    assert first.returncode == 0, first.stderr
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text() == "x1"
    assert not (tmp_path / "after").exists()
    again = run(tmp_path, "train")
    assert (again.returncode, again.stdout) == (0, "")


@pytest.mark.slow
def test_one_that_fails_is_named(tmp_path: Path) -> None:
    make(tmp_path, "import sys\nif sys.argv[1] == 'b': sys.exit('no')\nopen('a', 'w')")
    done = run(tmp_path, "train")
    assert done.returncode == 1
    assert "failed: train@" in done.stderr
    missing = run(tmp_path, "trian")
    assert missing.returncode != 0
    assert "dvc.yaml has no stage 'trian'" in missing.stderr


def test_nothing_begins_after_a_failure_and_lanes_are_shared() -> None:
    seen: list[tuple[str, int]] = []

    def call(address: str, lane: int, count: int) -> bool:
        time.sleep(0.01)
        seen.append((address, lane))
        return address != "b"

    assert lanes.side_by_side(list("abcdef"), 1, call, "test") == ["b"]
    assert [address for address, _ in seen] == ["a", "b"]
    seen.clear()
    assert lanes.side_by_side(list("acdefg"), 3, call, "test") == []
    assert sorted(address for address, _ in seen) == list("acdefg")
    assert {lane for _, lane in seen} == {0, 1, 2}
