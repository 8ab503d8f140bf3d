"""The stages of edits, on vases: what they draw, measure and write, the same each time, and refuse."""

import filecmp
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from cagesdf.cuboid import Cage, Sequence
from cagesdf.deformation.sequences import aligned_cage, interpolated_cage
from cagesdf.errors import InputError
from cagesdf.evaluation.tables import gather_edits
from cagesdf.evaluation.trials import MIXES, STYLED
from cagesdf.geometry.meshes import is_closed
from cagesdf.importing import import_shape
from cagesdf.io.edits import read_edit_surface, read_edits
from cagesdf.io.runs import write_run
from cagesdf.io.sequences import write_sequences
from cagesdf.io.shapes import write_shapes
from cagesdf.io.trials import read_trials
from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import SHARED, LatentTable
from cagesdf.run import Run
from cagesdf.shape import RawShape, Shape
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.synthesis.dataset import build, cage_of, draw, draw_recipes
from cagesdf.synthesis.recipe import Recipe
from pipeline import EditsParams, Params, TrialsParams, artefact
from pipeline.artefact import ArtefactError
from stages import evaluate_edits, make_trials

PARAMS = Params(format=1)
TRIALS = TrialsParams(
    format=1, swaps=2, mixes=2, shapes=2, local=2, resize=(0.8, 1.25), move=(0.03, 0.1), beyond=(-0.25, 1.25, 40.0),
    blend=0.1, points=500, detail=0.005, seed=7,
)  # fmt: skip
SIZES: dict[str, Any] = {"width": 16, "layers": 2, "latent_dim": 4, "mapping": (8,), "octaves": 1}
SIZES |= {
    "code_dim": 4,
    "cells": 4,
    "channels": 2,
    "line_cells": 4,
    "line_channels": 1,
    "context": 8,
    "context_layers": 1,
    "heads": 2,
}
ARMS = {
    "cagesdf": {"decoder": "OccupancyDecoder", "latents": "source"},
    "cagesdf_global": {"decoder": "CageDecoder", "latents": "source"},
    "deepsdf": {"decoder": "DeepSdfDecoder", "latents": "deformed"},
}
EDITS = EditsParams(format=1, resolution=32, loose="keep", arms=tuple(ARMS))
# Three of one family, each with a cage and a style of its own.
RECIPES = [r for r in draw_recipes("vase", 38, 0, np.random.default_rng(2)) if r.family == "bottle" and not r.same_cage]
RECIPES = [recipe for recipe in RECIPES if not recipe.same_style][:3]


def imported(recipe: Recipe) -> Shape:
    raw = RawShape(recipe.shape_id, "train", tuple(build(recipe, recipe)), draw(recipe).structure)
    return import_shape(raw, "y", 1e-5, 10**6, 100, 1e-4)


def sequence(shape: Shape, recipe: Recipe, target: Shape, towards: Recipe) -> Sequence:
    """Towards another shape's cage, and far beyond that through nothing."""
    first, last = (cage_of(r).transformed(s.similarity) for r, s in ((recipe, shape), (towards, target)))
    last = aligned_cage(first, last, tuple((part_id, part_id) for part_id in first.part_ids))
    cages: tuple[Cage, ...] = (first, interpolated_cage(first, last, 0.5), last)
    return Sequence(recipe.shape_id, towards.shape_id, np.array([0, 0.5, 1]), (False, True, False), cages)


def trained(arm: str, shapes: list[Shape], sequences: list[Sequence]) -> Run:
    """An arm whose network says -0.05 everywhere, nearly: a filled cage."""
    decoder = make_decoder(ARMS[arm]["decoder"], **SIZES, seed=0).eval()
    with torch.no_grad():
        for parameter in decoder.parameters():
            parameter.mul_(0.1)
        list(decoder.parameters())[-1].fill_(-0.05)
    steps = (SHARED,) if ARMS[arm]["latents"] == "source" else (0, 2)
    latents = LatentTable.drawn(tuple((shape.shape_id, step) for shape in shapes for step in steps), 4, 0.1, seed=0)
    structures = {shape.shape_id: PartHierarchy.from_json(shape.structure.to_json()) for shape in shapes}
    similarities = {shape.shape_id: shape.similarity for shape in shapes}
    cages = {item.shape_id: item for item in sequences}
    return Run(decoder, latents, cages, structures, similarities, {**ARMS[arm], **SIZES}, {})


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    shapes = [imported(recipe) for recipe in RECIPES]
    turns = list(zip(shapes, RECIPES, shapes[1:] + shapes[:1], RECIPES[1:] + RECIPES[:1]))
    sequences = [sequence(*turn) for turn in turns]
    for recipe in RECIPES:
        (folder / "raw" / recipe.shape_id).mkdir(parents=True)
        (folder / "raw" / recipe.shape_id / "recipe.json").write_text(recipe.to_json(), encoding="utf-8")
    with artefact.write("shapes", folder / "shapes", inputs={}, params=PARAMS) as out:
        write_shapes(out, shapes)
    with artefact.write("sequences", folder / "sequences", inputs={}, params=PARAMS) as out:
        write_sequences(out, sequences, {s.shape_id: np.zeros((3, len(s.cages[0]))) for s in sequences})
    for arm in ARMS:
        with artefact.write("run", folder / "runs" / arm, inputs={}, params=PARAMS) as out:
            write_run(out, trained(arm, shapes, sequences), [])
    return folder


def run(inputs: Path, out: Path) -> Path:
    make_trials.main(inputs / "raw", inputs / "shapes", inputs / "sequences", out / "trials", TRIALS)
    evaluate_edits.main(inputs / "runs", out / "trials", out / "edits", EDITS)
    return out


@pytest.fixture(scope="module")
def done(inputs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAGESDF_WORKERS", "1")
        return run(inputs, tmp_path_factory.mktemp("one"))


def test_there_are_as_many_trials_of_each_kind_as_the_parameters_ask_for(done: Path) -> None:
    trials = read_trials(done / "trials")
    counts = trials.counts()
    assert {kind: counts[kind] for kind in ("rest", "local", "bent", *STYLED)} == {
        "rest": 2, "local": 4, "bent": 2, **dict.fromkeys(STYLED, 2),
    }  # fmt: skip
    assert counts["beyond"] + counts["left_out"] == 2 * 3
    assert counts["left_out"] > 0
    for trial_id in trials.rows:
        trial = trials.read(trial_id)
        assert trial.trial_id == trial_id
        assert is_closed(trial.truth)
        assert len(trial.changed) == len(trial.truth.faces)
    with pytest.raises(InputError, match="has no trial 'swap/x/y'"):
        trials.read("swap/x/y")


def test_swaps_are_of_styles_that_no_sequence_brought_to_the_cage(done: Path) -> None:
    ids = [recipe.shape_id for recipe in RECIPES]
    brought = set(zip(ids[1:] + ids[:1], ids))
    rows = read_trials(done / "trials").rows.values()
    assert not brought & {(row["shape_id"], row["style_of"]) for row in rows if row["kind"] == "swap"}


def test_references_stand_where_they_must(done: Path) -> None:
    rows, about = read_edits(done / "trials" / "references.parquet")
    assert about["points"] == 500
    for row in rows:
        if row["arm"] == "ground_truth":
            assert (row["kind"], row["distance"]) == ("rest", pytest.approx(0, abs=1e-6))
        if row["kind"] in STYLED and row["arm"] == "unchanged":
            assert row["gain"] == 0
        if row["arm"] == "keep_warp":
            assert row["kind"] in ("swap", "mix_keep"), "what is taught by default, warp, stretches details"
        if row["arm"] == "box_warp":
            assert row["kind"] in ("swap", "mix", "bent"), "of all others it is the truth"
            assert row["distance"] > 0.01


def test_an_arm_has_a_row_a_trial_and_one_without_cuboids_has_none(done: Path) -> None:
    rows, about = read_edits(done / "edits" / "edits.parquet")
    trials = read_trials(done / "trials")
    of_arm = {arm: [row["trial_id"] for row in rows if row["arm"] == arm] for arm in ARMS}
    whole = [trial_id for trial_id, row in trials.rows.items() if row["kind"] not in MIXES]
    assert of_arm == {"cagesdf": sorted(trials.rows), "cagesdf_global": sorted(whole), "deepsdf": []}
    assert about == trials.definitions
    for row in rows:
        assert row["refit"] < 20, "it fills its cuboids"
        assert np.isnan(row["gain"]) == (row["kind"] not in STYLED)
    files = [(rows, about), read_edits(done / "trials" / "references.parquet")]
    table = gather_edits({"vase": files}, {"vase": ARMS})["categories"]["vase"]
    assert sorted(table) == sorted([*ARMS, "box_warp", "ground_truth", "keep_warp", "unchanged"])
    assert table["deepsdf"] == {}
    assert table["cagesdf"]["all"]["refit"]["n"] == len(trials.rows)


def test_surfaces_of_swaps_are_kept(done: Path) -> None:
    for row in read_trials(done / "trials").rows.values():
        if row["kind"] in ("swap", "mix", "mix_keep"):
            assert is_closed(read_edit_surface(done / "edits", "cagesdf", row["trial_id"]))
    with pytest.raises(InputError, match="has no surface of cagesdf in 'rest"):
        read_edit_surface(done / "edits", "cagesdf", f"rest/{RECIPES[0].shape_id}")


@pytest.mark.slow
def test_the_same_inputs_give_the_same_bytes_in_any_number_of_processes(
    inputs: Path, done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    again = run(inputs, tmp_path)
    for path in sorted(done.rglob("*")):
        if path.is_file():
            assert filecmp.cmp(path, again / path.relative_to(done), shallow=False), path


def test_shapes_from_elsewhere_have_all_trials_but_swaps_and_mixes(inputs: Path, tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    params = TRIALS.model_copy(update={"shapes": 1, "local": 1})
    make_trials.main(tmp_path / "raw", inputs / "shapes", inputs / "sequences", tmp_path / "trials", params)
    assert {row["kind"] for row in read_trials(tmp_path / "trials").rows.values()} == {
        "rest", "local", "beyond", "bent",
    }  # fmt: skip


def test_only_the_arms_that_are_run_are_edited_whatever_else_lies_there(
    inputs: Path, done: Path, tmp_path: Path
) -> None:
    params = EDITS.model_copy(update={"arms": ("deepsdf",)})
    evaluate_edits.main(inputs / "runs", done / "trials", tmp_path / "edits", params)
    assert read_edits(tmp_path / "edits" / "edits.parquet")[0] == []


def test_a_run_in_the_place_of_trials_is_refused(inputs: Path, tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match="wanted 'trials'"):
        evaluate_edits.main(inputs / "runs", inputs / "runs" / "cagesdf", tmp_path / "out", EDITS)
