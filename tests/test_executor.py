"""The parallel map: order, rejections, errors, and generators that don't know about workers."""

import os
import signal
from pathlib import Path

import pytest

from cagesdf.errors import ShapeRejected
from pipeline.executor import counter, device, item_rng, parallel_map, workers


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


def test_a_wrong_number_of_workers_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "two")
    with pytest.raises(ValueError, match=r"CAGESDF_WORKERS.*'two'"):
        workers()


def test_an_items_generator_depends_on_seed_and_ids_alone() -> None:
    draws = {tuple(item_rng(*key).random(2)) for key in [(1, "a"), (1, "b"), (2, "a"), (1, "a", 0), (1, "a")]}
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
