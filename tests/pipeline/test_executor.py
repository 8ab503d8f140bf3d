"""The parallel map: order, rejections, errors, and generators that don't know about workers."""

import os
import signal
import time
from pathlib import Path

import pytest

from cagesdf.errors import ShapeRejected
from cagesdf.seeds import item_rng
from pipeline.errors import SettingError, WorkerError
from pipeline.executor import counter, device, item_seconds, parallel_groups, parallel_map, workers


def square(number: int) -> int:
    if number == 3:
        raise ShapeRejected("three", "test", "is not liked")
    if number == 100:
        raise OverflowError("too large")
    return number * number


def die_once(marker: str) -> str:
    """Kill this process the first time, as the kernel does when memory runs out."""
    path = Path(marker)
    if path.suffix == ".dies" and not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path.stem


def misbehave(name: str) -> str:
    """End this process, or hang, if the item's name says so."""
    if name == "SIGSEGV":
        os.kill(os.getpid(), signal.SIGSEGV)
    if name == "exit":
        os._exit(0)
    if name == "hang":
        time.sleep(1000)
    return name


def process(_: int) -> int:
    time.sleep(0.05)
    return os.getpid()


@pytest.mark.parametrize("count", ["1", "2"])
def test_results_come_in_input_order_and_rejections_apart(monkeypatch: pytest.MonkeyPatch, count: str) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", count)
    results, rejected = parallel_map(square, [5, 3, 1, 4], rejects=ShapeRejected, label="test")
    assert results == [25, 1, 16]
    assert [(r.shape_id, r.stage, r.reason) for r in rejected] == [("three", "test", "is not liked")]


@pytest.mark.parametrize("count", ["1", "2"])
def test_any_other_exception_stops_the_map(monkeypatch: pytest.MonkeyPatch, count: str) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", count)
    with pytest.raises(OverflowError, match="too large"):
        parallel_map(square, [1, 100], rejects=ShapeRejected, label="test")


def test_what_a_killed_worker_left_undone_is_done_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    items = [str(tmp_path / name) for name in ("a", "b", "c.dies", "d", "e")]
    results, _ = parallel_map(die_once, items, rejects=ShapeRejected, label="test")
    assert results == list("abcde")


def test_no_items_give_no_results() -> None:
    assert parallel_map(square, [], rejects=ShapeRejected, label="test") == ([], [])


def test_an_item_that_kills_its_process_or_hangs_is_rejected_and_the_others_go_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    monkeypatch.setenv("CAGESDF_ITEM_SECONDS", "3")
    items = ["a", "SIGSEGV", "b", "hang", "c", "exit", "d"]
    results, rejected = parallel_map(
        misbehave, items, rejects=ShapeRejected, label="test", lost=lambda item, why: ShapeRejected(item, "test", why)
    )
    assert results == list("abcd")
    assert [r.shape_id for r in rejected] == ["SIGSEGV", "hang", "exit"]
    assert all("killed its process twice" in r.reason and "3 s" in r.reason for r in rejected)


def test_an_item_that_kills_its_process_is_named_where_none_may_be_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    with pytest.raises(WorkerError, match="test: 'exit' killed its process twice"):
        parallel_map(misbehave, ["a", "exit", "b"], rejects=ShapeRejected, label="test")


def test_processes_stay_for_the_next_map(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    maps = [parallel_map(process, range(8), rejects=ShapeRejected, label="test")[0] for _ in range(2)]
    assert set(maps[1]) <= set(maps[0])
    assert os.getpid() not in maps[0]


def test_processes_that_died_between_two_maps_are_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    ids, _ = parallel_map(process, range(4), rejects=ShapeRejected, label="test")
    for pid in set(ids):
        os.kill(pid, signal.SIGKILL)
    time.sleep(0.5)  # the library may see that they are gone, or not: both must do
    results, _ = parallel_map(square, [5, 1, 4], rejects=ShapeRejected, label="test")
    assert results == [25, 1, 16]


def test_a_wrong_number_of_workers_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "two")
    with pytest.raises(SettingError, match=r"CAGESDF_WORKERS.*'two'"):
        workers()
    monkeypatch.setenv("CAGESDF_ITEM_SECONDS", "-5")
    with pytest.raises(SettingError, match=r"CAGESDF_ITEM_SECONDS.*'-5'"):
        item_seconds()


def test_an_items_generator_depends_on_seed_and_ids_alone() -> None:
    keys: list[tuple[int, tuple[str | int, ...]]] = [(1, ("a",)), (1, ("b",)), (2, ("a",)), (1, ("a", 0)), (1, ("a",))]
    draws = {tuple(item_rng(seed, *ids).random(2)) for seed, ids in keys}
    assert len(draws) == 4


def test_a_counter_shows_how_far_it_came(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with counter(100, "points", "train") as count:
        count(40, loss="nan")
        count(100, loss="0.5")
    shown = capsys.readouterr().err
    assert "train: 100%" in shown
    assert "loss=0.5" in shown


def test_the_device_is_the_one_that_the_environment_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_DEVICE", "meta")
    assert device() == "meta"
    monkeypatch.setenv("CAGESDF_DEVICE", "auto")
    assert device() in ("cpu", "cuda")
    monkeypatch.setenv("CAGESDF_DEVICE", "gpu")
    with pytest.raises(SettingError, match=r"CAGESDF_DEVICE: wanted a device such as cpu or cuda, got 'gpu'"):
        device()


@pytest.mark.parametrize("count", ["1", "2"])
def test_groups_are_done_as_one_map_and_each_is_given_when_complete(
    monkeypatch: pytest.MonkeyPatch, count: str
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", count)
    groups = [[3, 1], [], [2, -1, 5], [4]]
    outcomes = list(parallel_groups(square, groups, rejects=ShapeRejected, label="test"))
    assert sorted(number for number, _, _ in outcomes) == [0, 1, 2, 3]
    assert {number: results for number, results, _ in outcomes} == {0: [1], 1: [], 2: [4, 1, 25], 3: [16]}
    assert {number: [item.shape_id for item in rejected] for number, _, rejected in outcomes if rejected} == {
        0: ["three"]
    }
