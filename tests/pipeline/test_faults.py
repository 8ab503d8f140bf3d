"""What happens when processes are killed, the disk is full or a file is damaged: nothing half-written is taken for
done, and the same command ends with the bytes of an undisturbed run."""

import os
import shutil
import signal
import sys
from collections.abc import Mapping
from pathlib import Path

import psutil
import pytest

from cagesdf.cage_fitting.fitted import FittedCage
from cagesdf.errors import InputError
from cagesdf.io.cuboids import read_cages
from cagesdf.io.rejected import read_rejected
from cagesdf.io.shapes import ShapeFolder
from pipeline import FitParams, SampleParams, load
from pipeline.artefact import ArtefactError, read_manifest
from stages import fit_cuboids, sample_points, train
from stages.fit_cuboids import fit_one
from tests.support import lines

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform == "win32", reason="sends POSIX signals")]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return lines.prepare(tmp_path_factory.mktemp("inputs"))


@pytest.fixture(scope="module")
def wanted(inputs: Path) -> Mapping[str, bytes]:
    """What an undisturbed run in one process writes."""
    params: SampleParams = load("sample_points", inputs / "params.yaml")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAGESDF_WORKERS", "1")
        sample_points.main(inputs / "shapes", inputs / "sequences", inputs / "undisturbed", params)
    return lines.contents(inputs / "undisturbed")


@pytest.fixture
def folder(inputs: Path, tmp_path: Path) -> Path:
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_a_killed_worker_changes_nothing(folder: Path, wanted: Mapping[str, bytes]) -> None:
    with lines.start(folder) as stage:
        lines.midway(folder, lambda: stage.poll() is None)
        workers = [
            child for child in psutil.Process(stage.pid).children() if "LokyProcess" in " ".join(child.cmdline())
        ]
        assert len(workers) == 2
        lines.kill(workers[0].pid)
        said = stage.communicate()[1]
    assert stage.returncode == 0, said
    assert "killed its process, trying again" in said
    assert lines.contents(folder / "points") == wanted


def test_a_killed_stage_leaves_nothing_that_is_taken_for_done(folder: Path, wanted: Mapping[str, bytes]) -> None:
    with lines.start(folder) as stage:
        lines.midway(folder, lambda: stage.poll() is None)
        lines.kill(stage.pid)
    assert stage.returncode == -signal.SIGKILL
    with pytest.raises(ArtefactError, match="no such folder"):
        read_manifest(folder / "points")
    with pytest.raises(ArtefactError, match="no stage finished it"):
        read_manifest(folder / "points.partial")
    with lines.start(folder) as again:
        assert again.wait() == 0
    assert lines.contents(folder / "points") == wanted
    assert not (folder / "points.partial").exists()


def test_a_full_disk_is_said_in_one_line_and_leaves_nothing(folder: Path, wanted: Mapping[str, bytes]) -> None:
    import resource

    largest = max(len(content) for name, content in wanted.items() if name.endswith(".parquet"))
    limit = largest // 2
    with lines.start(folder, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))) as stage:
        said = stage.communicate()[1].splitlines()
    assert stage.returncode == 1
    assert said[-1].startswith("sample_points: ")
    assert "File too large" in said[-1]
    assert "Traceback" not in "".join(said)
    assert not (folder / "points").exists()
    assert not (folder / "points.partial").exists()
    with lines.start(folder) as again:
        assert again.wait() == 0
    assert lines.contents(folder / "points") == wanted


def test_training_names_a_damaged_shard_and_what_to_do(
    folder: Path, wanted: Mapping[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    params = load("arms.cagesdf", folder / "params.yaml")
    paths = folder / "undisturbed", folder / "shapes", folder / "cuboids", folder / "sequences"
    shard = paths[0] / "part-0003.parquet"
    whole = shard.read_bytes()
    shard.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ArtefactError, match=r"part-0003\.parquet: is not as it was written.*rerun"):
        train.main(*paths, folder / "run", params)
    for place in (0.1, 0.5, 0.9):
        flipped = bytearray(whole)
        flipped[int(place * len(whole))] ^= 64
        shard.write_bytes(flipped)
        with pytest.raises(InputError, match=r"part-0003\.parquet: not a readable Parquet file.*rerun"):
            train.main(*paths, folder / "run", params)
    assert not (folder / "run").exists()


def fit_or_die(source: ShapeFolder, params: FitParams, shape_id: str) -> tuple[str, FittedCage]:
    """Fit, but for two shapes that crash as compiled code does."""
    if shape_id in ("s2", "s5"):
        os.kill(os.getpid(), signal.SIGSEGV)
    return fit_one(source, params, shape_id)


def test_a_shape_that_crashes_its_worker_is_rejected_with_the_reason(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    monkeypatch.setattr(fit_cuboids, "fit_one", fit_or_die)
    params: FitParams = load("fit_cuboids", folder / "params.yaml")
    fit_cuboids.main(folder / "shapes", folder / "again", params.model_copy(update={"max_rejected": 0.3}))
    assert sorted(read_cages(folder / "again")) == ["s0", "s1", "s3", "s4", "s6", "s7"]
    rejected = read_rejected(folder / "again")
    assert list(rejected) == ["s2", "s5"]
    assert all("killed its process twice" in reason for reason in rejected.values())
