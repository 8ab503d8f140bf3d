"""The plan before a run: counts are exact, times are the measurement's, scaled."""

from functools import partial
from itertools import count
from pathlib import Path

import pytest
import yaml

from cagesdf.io.points import CHUNK
from pipeline.cost import Counts
from pipeline.errors import PipelineError
from pipeline.params import check
from pipeline.planning import (
    SHAPES,
    UNMEASURED,
    Estimate,
    Measured,
    cost_of,
    data,
    duration,
    estimate,
    measure,
    plan,
    profile_content,
    reduced,
    shared,
)
from stages.train import measured_trainings

ROOT = Path(__file__).parents[2]


def sections(tmp_path: Path, profile: str | None) -> dict:
    path = tmp_path / "asked.yaml"
    path.write_text(yaml.safe_dump(profile_content(profile)), encoding="utf-8")
    return check(path)


@pytest.mark.parametrize(
    ("profile", "expected"),
    [
        (None, Counts(32 + 8, 32, 32 * 4, 32 * 4 * 6000, 6 + 3 * 2, 16 * 2 + 3 * 3 + 2 * 6)),
        ("tiny", Counts(16 + 2, 16, 16 * 4, 16 * 4 * 1800, 2 + 1 * 2, 3 * 2 + 1 * 3 + 2 * 6)),
        ("paper", Counts(2000, 1900, 7600, 7600 * 275_000, 1900 + 3 * 2, 16 * 2 + 3 * 3 + 2 * 6)),
    ],
)
def test_counts_are_those_that_the_parameters_ask_for(profile: str | None, expected: Counts, tmp_path: Path) -> None:
    assert Counts.of(sections(tmp_path, profile)) == expected


def found(stage: str, seconds: float, items: int = SHAPES, arm: str = "") -> Measured:
    return Measured(stage, "chair", arm, seconds, items, 1_000_000, 300_000_000)


def only(tmp_path: Path, *some: Measured, processes: int = 1) -> Estimate:
    [row] = estimate(list(some), sections(tmp_path, None), 1, processes)
    return row


def test_times_are_those_measured_in_proportion_to_what_there_is_to_do(tmp_path: Path) -> None:
    assert only(tmp_path, found("synthesize", 3.0)).seconds == pytest.approx(3.0 / 2 * 40)
    assert only(tmp_path, found("deform_sequences", 3.0)).seconds == pytest.approx(3.0 / 2 * 32)
    assert only(tmp_path, found("sample_points", 8.0, 8)).seconds == pytest.approx(8.0 / (2 * 4) * 128)
    training = only(tmp_path, found("train", 2.0, 20 * 64 * CHUNK, "cagesdf"))
    assert training.seconds == pytest.approx(2.0 / 20 * sections(tmp_path, None)["arms.cagesdf"].steps)
    # Surfaces are measured with 64 cells, and have 128.
    assert only(tmp_path, found("extract_meshes", 6.0, 4, "cagesdf")).seconds == pytest.approx(6.0 / 4 * 12 * 4)
    # One shape, after each of two snapshots and at the end.
    assert only(tmp_path, found("evaluate_progress", 6.0, 1)).seconds == pytest.approx(6.0 / 1 * 3)
    assert only(tmp_path, found("evaluate_edits", 6.0, 12, "cagesdf")).seconds == pytest.approx(6.0 / 12 * 53)
    # Two methods, of each of which two shapes are measured, with 64 cells instead of 96.
    finer = (96 / 64) ** 2
    assert only(tmp_path, found("generate", 2.0, 4, "cagesdf")).seconds == pytest.approx(2.0 / 4 * 16 * 2 * finer)
    assert only(tmp_path, found("generate", 2.0, 2, "deepsdf")).seconds == pytest.approx(2.0 / 2 * 16 * finer)
    # DeepSDF has no latent for held-out steps.
    assert only(tmp_path, found("extract_meshes", 2.0, 1, "deepsdf")).seconds == pytest.approx(2.0 * 6 * 4)


def test_workers_share_what_is_mapped_over_and_nothing_else(tmp_path: Path) -> None:
    for stage, share in (("fit_cuboids", 4), ("sample_points", 4), ("synthesize", 4), ("match_targets", 1)):
        alone = only(tmp_path, found(stage, 2.0))
        assert only(tmp_path, found(stage, 2.0), processes=4).seconds == pytest.approx(alone.seconds / share)


def test_every_stage_declares_what_it_costs_and_one_that_does_not_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = yaml.safe_load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
    for stage in graph.keys() - {*UNMEASURED}:
        assert cost_of(stage).unit.endswith("s")
    monkeypatch.delattr("stages.fit_cuboids.COST")
    with pytest.raises(PipelineError, match=r"stages/fit_cuboids.py: declares no COST"):
        cost_of("fit_cuboids")


def test_what_is_measured_is_less_than_the_run_and_something(tmp_path: Path) -> None:
    for profile in (None, "tiny", "paper"):
        content = profile_content(profile)
        whole, small = sections(tmp_path, profile), check_small(tmp_path, content)
        graph = yaml.safe_load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
        for stage in graph.keys() - {*UNMEASURED}:
            for arm in content["run"]["generators"] if "arm" in graph[stage].get("matrix", {}) else [""]:
                cost = cost_of(stage)
                assert 0 < cost.items(small, arm) <= cost.items(whole, arm), stage


def check_small(tmp_path: Path, content: dict) -> dict:
    path = tmp_path / "small.yaml"
    path.write_text(yaml.safe_dump(reduced(content)), encoding="utf-8")
    return check(path)


def test_the_stages_that_workers_do_not_share_are_the_two_that_map_over_nothing_and_have_no_arms() -> None:
    graph = yaml.safe_load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
    assert {stage for stage in graph if stage not in ("library", "report") and not shared(stage)} == {
        "match_targets", "train_programs",
    }  # fmt: skip


def test_disk_grows_with_the_items_and_categories_add_up(tmp_path: Path) -> None:
    one, two = only(tmp_path, found("fit_cuboids", 1.0)), only(tmp_path, *[found("fit_cuboids", 1.0)] * 2)
    assert one.size == 20 * 1_000_000
    assert (two.size, two.items, two.seconds) == (2 * one.size, 2 * one.items, 2 * one.seconds)


def test_a_network_is_measured_in_one_category_and_counted_in_all(tmp_path: Path) -> None:
    asked = sections(tmp_path, None)
    item = [found("train", 2.0, 320, "cagesdf")]
    one, three = (estimate(item, asked, categories, 1)[0] for categories in (1, 3))
    assert (three.seconds, three.items, three.size) == (3 * one.seconds, 3 * one.items, 3 * one.size)
    small, large = asked["arms.cagesdf"], sections(tmp_path, "paper")["arms.deepsdf"]
    (first, some), (_, fewer) = map(measured_trainings, (small, large))
    assert first.steps == 1
    assert some.steps > fewer.steps >= 9


@pytest.mark.slow
def test_a_plan_measures_the_stages_themselves_and_a_slower_clock_gives_a_slower_run(tmp_path: Path) -> None:
    content, asked = profile_content("tiny"), sections(tmp_path, "tiny")
    totals = []
    for tick in (10.0, 30.0):
        folder = tmp_path / str(tick)
        folder.mkdir()
        measured = measure(content, folder, partial(next, map(tick.__mul__, count())))
        rows = estimate(measured, asked, 1, 1)
        assert [row.stage for row in rows][:2] == ["synthesize", "import_shapes"]
        # Each run takes a tick by this clock; of trainings the difference of two counts, which is none.
        assert {item.seconds for item in measured if item.stage != "train"} == {tick}
        assert {item.items for item in measured if item.stage == "train"} == {
            (measured_trainings(asked["arms.cagesdf"])[1].steps - 1) * 16 * CHUNK
        }
        totals.append(sum(row.seconds for row in rows))
    assert totals[1] == pytest.approx(3 * totals[0])


@pytest.mark.slow
def test_the_plan_says_that_it_is_an_estimate_and_from_what(tmp_path: Path) -> None:
    text = "\n".join(plan("tiny", tmp_path))
    assert "An estimate from" in text
    assert "18 shapes in 1 categories, 64 deformed training shapes, 115,200 points" in text


@pytest.mark.parametrize(
    ("seconds", "text"), [(3.14, "3.1 s"), (99, "99 s"), (600, "10 min"), (7200, "2.0 h"), (1e6, "11.6 days")]
)
def test_durations_are_told_in_fitting_units(seconds: float, text: str) -> None:
    assert duration(seconds) == text
    assert (data(2_345_678), data(3.21e9)) == ("2 MB", "3.2 GB")
