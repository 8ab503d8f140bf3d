"""The stages from shapes to points as a user runs them: processes of their own, in a folder with a params.yaml."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import yaml

from pipeline import DeformParams, FitParams, MatchParams, load
from stages import deform_sequences, fit_cuboids, match_targets
from tests.support import toy

ROOT = Path(__file__).parents[2]
SHAPES = [toy.stool(f"s{i}", width=1 + 0.04 * i, lean=0.1 + 0.03 * i) for i in range(8)]
ARGUMENTS = ("shapes", "sequences", "points")


def prepare(folder: Path) -> Path:
    """All that `sample_points` reads, for eight stools in eight shards."""
    shapes, cuboids, matches = toy.write_shapes_artefact(folder / "shapes", SHAPES), folder / "cuboids", folder / "m"
    sections = yaml.safe_load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    sections["sample_points"] |= {"shards": len(SHAPES), "max_rejected": 0.5}
    (folder / "params.yaml").write_text(yaml.safe_dump(sections), encoding="utf-8")
    fit: FitParams = load("fit_cuboids", folder / "params.yaml")
    match: MatchParams = load("match_targets", folder / "params.yaml")
    deform: DeformParams = load("deform_sequences", folder / "params.yaml")
    fit_cuboids.main(shapes, cuboids, fit)
    match_targets.main(shapes, cuboids, matches, match)
    deform_sequences.main(shapes, cuboids, matches, folder / "sequences", deform)
    return folder


def start(folder: Path, preexec_fn: Callable[[], None] | None = None) -> subprocess.Popen[str]:
    """`sample_points` in a process of its own, with two workers."""
    return subprocess.Popen(
        [sys.executable, "-m", "stages.sample_points", *ARGUMENTS], cwd=folder, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "CAGESDF_WORKERS": "2"}, preexec_fn=preexec_fn,
    )  # fmt: skip


def midway(folder: Path, alive: Callable[[], bool]) -> None:
    """Wait until the first shard is written; the others take some more seconds."""
    while not (folder / "points.partial" / "shape-0000.parquet").exists():
        assert alive()
        time.sleep(0.01)


def contents(folder: Path) -> Mapping[str, bytes]:
    """The bytes of each file below a folder."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def kill(pid: int) -> None:
    """As the kernel does where memory runs out."""
    os.kill(pid, signal.SIGKILL)
