"""Stages side by side: both are there at once, what is up to date stays, a failure is told, a lone one has all."""

import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline import lanes

# Each waits for the other to have begun: one after the other, they would wait in vain.
MEET = """
import os, sys, time
from pathlib import Path
import slow

def main(own, other):
    Path(own + ".begun").touch()
    for _ in range(6000):
        if Path(other + ".begun").exists():
            break
        time.sleep(0.1)
    else:
        sys.exit("alone")
    Path(own).write_text(Path("raw").read_text() + os.environ["OMP_NUM_THREADS"])

if __name__ == "__main__":
    main(*sys.argv[1:])
"""
SLOW = "open('imports', 'a').write('x')"
GRAPH = {
    "stages": {
        "raw": {"cmd": "python -c \"open('raw', 'w').write('x')\"", "outs": ["raw"]},
        "train": {
            "matrix": {"arm": [["a", "b"], ["b", "a"]]},
            "cmd": "python -m stages.meet ${item.arm[0]} ${item.arm[1]}",
            "deps": ["raw", "stages/meet.py"],
            "outs": ["${item.arm[0]}"],
        },
        "after": {
            "cmd": "python -c \"import os; open('after', 'w').write(os.environ.get('OMP_NUM_THREADS', 'all'))\"",
            "deps": ["a", "b"],
            "outs": ["after"],
        },
    }
}


def make(folder: Path, script: str) -> None:
    (folder / "stages").mkdir()
    (folder / "stages" / "__init__.py").touch()
    (folder / "stages" / "meet.py").write_text(script, encoding="utf-8")
    (folder / "slow.py").write_text(SLOW, encoding="utf-8")
    (folder / "dvc.yaml").write_text(yaml.safe_dump(GRAPH), encoding="utf-8")
    subprocess.run([sys.executable, "-m", "dvc", "init", "--quiet", "--no-scm"], cwd=folder, check=True)


def run(folder: Path) -> "subprocess.CompletedProcess[str]":
    env = os.environ | {"CAGESDF_WORKERS": "2", "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    env.pop("OMP_NUM_THREADS", None)
    command = [sys.executable, "-m", "pipeline.lanes"]
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_stages_run_at_once_after_what_they_need_and_only_when_something_changed(tmp_path: Path) -> None:
    make(tmp_path, MEET)
    first = run(tmp_path)
    assert first.returncode == 0, first.stderr
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text() == "x1"
    assert (tmp_path / "after").read_text() == "all"
    assert first.stdout.count("Running stage") == 4
    assert (tmp_path / "imports").read_text() == "x", "by the process that both are forks of"
    again = run(tmp_path)
    assert (again.returncode, again.stdout) == (0, "")
    (tmp_path / "a").unlink()
    (tmp_path / "dvc.lock").unlink()  # as a run leaves it that was killed before its end
    resumed = run(tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    assert (tmp_path / "a").read_text() == "x1"
    assert re.findall("Running stage '(.*)'", resumed.stdout) == ["raw"], "the others come out of DVC's run cache"


@pytest.mark.slow
def test_one_that_fails_is_named_and_nothing_that_needs_it_begins(tmp_path: Path) -> None:
    lines = ("import sys", "if __name__ == '__main__':", " if sys.argv[1] == 'b': sys.exit('no')", " open('a', 'w')")
    make(tmp_path, "\n".join(lines))
    done = run(tmp_path)
    assert done.returncode == 1
    assert re.search("failed: train@arm1", done.stderr)
    assert not (tmp_path / "after").exists()
    lock = yaml.safe_load((tmp_path / "dvc.lock").read_text())
    assert set(lock["stages"]) == {"raw", "train@arm0"}, "what succeeded is recorded"


@pytest.mark.slow
def test_what_always_counts_as_changed_runs_each_time_and_what_follows_only_after_a_change(
    tmp_path: Path,
) -> None:
    make(tmp_path, MEET)
    look = {"cmd": "python -c \"open('code', 'w').write(open('source').read())\"", "outs": ["code"]}
    use = {"cmd": "python -c \"open('use', 'a').write('x')\"", "deps": ["code"], "outs": [{"use": {"persist": True}}]}
    graph = {"stages": {"look": {**look, "always_changed": True}, "use": use}}
    (tmp_path / "dvc.yaml").write_text(yaml.safe_dump(graph), encoding="utf-8")
    used = []
    for text in ("a", "a", "b"):
        (tmp_path / "source").write_text(text)
        done = run(tmp_path)
        assert done.returncode == 0, done.stderr
        used.append(((tmp_path / "code").read_text(), (tmp_path / "use").read_text()))
    assert used == [("a", "x"), ("a", "x"), ("b", "xx")]
    (tmp_path / "source").unlink()
    failed = run(tmp_path)
    assert failed.returncode == 1
    assert "failed: " in failed.stderr
    assert "look" in failed.stderr


def test_the_lock_file_gets_what_was_done_even_if_all_ends_early_and_loses_stages_that_are_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tmp_path, MEET)
    monkeypatch.chdir(tmp_path)
    Path("dvc.lock").write_text("schema: '2.0'\nstages:\n  gone:\n    cmd: x\n  raw:\n    cmd: old\n")
    with pytest.raises(KeyboardInterrupt), lanes.lock_file() as entries:
        entries["raw"] = {"cmd": "new"}
        raise KeyboardInterrupt
    assert yaml.safe_load(Path("dvc.lock").read_text()) == {"schema": "2.0", "stages": {"raw": {"cmd": "new"}}}


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("python -m stages.train a 'b c'", ["train", "a", "b c"]),
        ("python -m stages.train", ["train"]),
        ("python -m pipeline.library data", []),
        ("python stages/train.py", []),
        ("true", []),
    ],
)
def test_a_stage_and_its_arguments_are_read_off_a_command(command: str, words: list[str]) -> None:
    assert lanes.words_of(command) == words


def test_what_follows_from_a_change_is_stale() -> None:
    stages = {"a": set(), "b": {"a"}, "c": {"b"}, "d": set()}
    assert lanes.stale(stages, {"b"}) == {"b": set(), "c": {"b"}}
    assert lanes.stale(stages, set()) == {}


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
@settings(max_examples=20, deadline=None)
def test_no_stage_begins_before_those_it_reads_from_and_no_more_than_asked_at_once(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"s{i}" for i in range(12)]
    stages = {name: {other for other in names[:i] if rng.random() < 0.25} for i, name in enumerate(names)}
    ended: set[str] = set()
    running: set[int] = set()
    lock = threading.Lock()

    def call(address: str, lane: int, shared: int) -> bool:
        with lock:
            assert stages[address] <= ended
            assert lane not in running
            assert lane in range(count)
            running.add(lane)
            assert len(running) <= shared <= count
        time.sleep(0.0005)  # others may begin meanwhile
        with lock:
            running.remove(lane)
            ended.add(address)
        return True

    assert dict(lanes.side_by_side(stages, count, call)) == dict.fromkeys(names, True)


def test_nothing_begins_after_a_failure() -> None:
    seen: list[str] = []

    def call(address: str, lane: int, shared: int) -> bool:
        seen.append(address)
        return address != "b"

    stages = {"a": set(), "b": set(), "c": set(), "d": {"a"}}
    assert list(lanes.side_by_side(stages, 1, call)) == [("a", True), ("b", False)]
    assert seen == ["a", "b"]
