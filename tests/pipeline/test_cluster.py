"""The same stages on a Dask cluster of two worker processes: same bytes, also where one is killed."""

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Thread

import pytest
from distributed import Client, LocalCluster

from cagesdf.errors import ShapeRejected
from pipeline import SampleParams, load, parallel_map, processes
from pipeline.errors import WorkerError
from stages import import_shapes, sample_points, synthesize
from tests.support import lines

pytestmark = pytest.mark.slow
PATIENCE = 600.0  # seconds; only what is broken takes them


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A scheduler, and two workers of one thread, each with a nanny that starts it again."""
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def cluster(address: str, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("CAGESDF_DASK", address)
    return address


def kill_first_worker(address: str, folder: Path, running: Thread) -> None:
    """SIGKILL it as soon as the first shard is written."""
    with Client(address, set_as_default=False) as client:
        pids = client.run(os.getpid)
        lines.midway(folder, running.is_alive)
        lines.kill(min(pids.values()))


@pytest.mark.skipif(sys.platform == "win32", reason="sends POSIX signals")
def test_a_stage_whose_worker_is_killed_writes_what_one_process_writes(
    cluster: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # the workers are elsewhere
    folder = Path()
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("CAGESDF_DASK")
        patch.setenv("CAGESDF_WORKERS", "1")
        lines.prepare(folder)
        params: SampleParams = load("sample_points")
        sample_points.main(Path("shapes"), Path("sequences"), Path("wanted"), params)
    stage = Thread(target=sample_points.main, args=(Path("shapes"), Path("sequences"), Path("points"), params))
    stage.start()
    kill_first_worker(cluster, folder, stage)
    assert stage.is_alive()
    stage.join(PATIENCE)
    assert not stage.is_alive()
    assert lines.contents(folder / "points") == lines.contents(folder / "wanted")


def test_workers_write_below_the_stages_folder_and_read_from_there(
    cluster: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    synthesis = load("synthesize", lines.ROOT / "params.yaml").model_copy(update={"train": 3, "val": 1})
    importing = load("import_shapes", lines.ROOT / "params.yaml")
    for where in ("cluster", "here"):
        synthesize.main("vase", Path(where, "raw"), synthesis)
        import_shapes.main(Path(where, "raw"), Path(where, "shapes"), importing)
        monkeypatch.delenv("CAGESDF_DASK", raising=False)
        monkeypatch.setenv("CAGESDF_WORKERS", "1")
    assert lines.contents(Path("cluster")) == lines.contents(Path("here"))


def shout_or_die(name: str) -> str:
    if name == "poison":
        os._exit(1)
    if name == "bad":
        raise OverflowError("too large")
    return name.upper()


def test_an_item_that_kills_every_worker_is_rejected_and_the_others_go_on(cluster: str) -> None:
    results, rejected = parallel_map(
        shout_or_die, ["a", "poison", "b", "c"], rejects=ShapeRejected, label="test",
        lost=lambda item, why: ShapeRejected(item, "test", why),
    )  # fmt: skip
    assert results == list("ABC")
    assert [(item.shape_id, item.reason.split(":")[0]) for item in rejected] == [("poison", "killed its process twice")]


def test_any_other_exception_stops_the_map(cluster: str) -> None:
    with pytest.raises(OverflowError, match="too large"):
        parallel_map(shout_or_die, ["a", "bad"], rejects=ShapeRejected, label="test")


def test_workers_with_other_code_are_refused(cluster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "code_digest", lambda: "edited since")
    with pytest.raises(WorkerError, match=r"started with other code.*restart the workers"):
        parallel_map(shout_or_die, ["a"], rejects=ShapeRejected, label="test")


def test_a_folder_that_workers_do_not_see_is_named(cluster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "cwd", lambda: Path("/nowhere/project"))
    with pytest.raises(WorkerError, match=r"/nowhere/project.*shared file system"):
        parallel_map(shout_or_die, ["a"], rejects=ShapeRejected, label="test")


def test_an_address_without_a_cluster_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_DASK", "tcp://127.0.0.1:1")
    monkeypatch.setattr(processes, "WORKER", 1)
    with pytest.raises(WorkerError, match=r"CAGESDF_DASK=tcp://127\.0\.0\.1:1: no scheduler"):
        parallel_map(shout_or_die, ["a"], rejects=ShapeRejected, label="test")


def begin(marker: Path) -> None:
    """Tell that it began, and never end."""
    marker.touch()
    while True:
        time.sleep(1)


def test_a_stage_whose_workers_are_all_gone_stops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster:
        monkeypatch.setenv("CAGESDF_DASK", cluster.scheduler_address)

        def remove_workers() -> None:
            while not (tmp_path / "begun").exists():
                time.sleep(0.05)
            monkeypatch.setattr(processes, "WORKER", 1)  # not before: on a busy machine a cluster takes a while
            cluster.scale(0)

        gone = Thread(target=remove_workers, daemon=True)
        gone.start()
        with pytest.raises(WorkerError, match=r"no worker for 1 s; start workers"):
            parallel_map(begin, [tmp_path / "begun"], rejects=ShapeRejected, label="test")
        gone.join()


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_DASK", "tcp://127.0.0.1:1")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(WorkerError, match=r"pip install 'cagesdf\[dask\]'"):
        parallel_map(shout_or_die, ["a"], rejects=ShapeRejected, label="test")
