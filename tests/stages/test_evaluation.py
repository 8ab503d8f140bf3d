"""The stages from a trained arm to scores, on stools: what they write, the same each time, and refuse."""

import filecmp
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from cagesdf.cuboid import Cage, Cuboid, Sequence
from cagesdf.deformation.sequences import interpolated_cage
from cagesdf.evaluation.metrics import OF_KEY
from cagesdf.evaluation.tables import gather_tables
from cagesdf.geometry.meshes import is_closed
from cagesdf.io.meshes import read_surfaces
from cagesdf.io.progress import read_progress
from cagesdf.io.runs import write_run, write_snapshot
from cagesdf.io.scores import read_scores
from cagesdf.io.sequences import write_sequences
from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import SHARED, LatentTable
from cagesdf.run import Run
from cagesdf.shape import Shape
from cagesdf.structure.hierarchy import PartHierarchy
from pipeline import EvaluateParams, ExtractParams, Params, ProgressParams, artefact
from pipeline.artefact import ArtefactError
from stages import evaluate, evaluate_progress, extract_meshes
from tests.support import toy

EXTRACT = ExtractParams(format=1, resolution=32, sources=2, held_out=1, loose="keep", seed=5)
SHAPES = [toy.stool("a"), toy.stool("b", width=1.3, height=0.6), toy.stool("c", lean=0.3)]
SIZES: dict[str, Any] = {"width": 16, "layers": 2, "latent_dim": 4, "mapping": (8,), "octaves": 1}
ARMS = {
    "cagesdf": {"decoder": "CageDecoder", "latents": "source"},
    "deepsdf": {"decoder": "DeepSdfDecoder", "latents": "deformed"},
    "nothing": {"decoder": "CageDecoder", "latents": "source"},
}
EVALUATE = EvaluateParams(format=1, points=500, detail=0.005, seeds=(0, 1), arms=tuple(ARMS))
PROGRESS = ProgressParams(format=1, resolution=24, shapes=2, points=300, detail=0.005, seed=8, arms=tuple(ARMS))


def sequence(shape: Shape) -> Sequence:
    """Three steps towards a cage half as wide again; the middle one held out."""
    rest = Cage.of(
        {
            part.part_id: Cuboid(
                (part.mesh.vertices.max(0) + part.mesh.vertices.min(0)) / 2, np.eye(3), np.ptp(part.mesh.vertices, 0)
            )
            for part in shape.parts
        }
    )
    target = Cage(rest.part_ids, rest.centre * [1.5, 1, 1], rest.axes, rest.size * [1.5, 1, 1])
    cages = (rest, interpolated_cage(rest, target, 0.5), target)
    return Sequence(shape.shape_id, None, np.array([0, 0.5, 1]), (False, True, False), cages)


def trained(arm: str, sequences: dict[str, Sequence]) -> Run:
    """An arm whose network says -0.05, 0 or 0.05 everywhere, nearly: a filled cage, blobs or nothing."""
    decoder = make_decoder(ARMS[arm]["decoder"], **SIZES, seed=0).eval()
    with torch.no_grad():
        for parameter in decoder.parameters():
            parameter.mul_(0.1)
        list(decoder.parameters())[-1].fill_(0.05 if arm == "nothing" else -0.05)
    steps = (SHARED,) if ARMS[arm]["latents"] == "source" else (0, 2)
    keys = tuple((shape_id, step) for shape_id in sequences for step in steps)
    structures = {shape.shape_id: PartHierarchy.from_json(shape.structure.to_json()) for shape in SHAPES}
    similarities = {shape.shape_id: shape.similarity for shape in SHAPES}
    latents = LatentTable.drawn(keys, 4, 0.1, seed=0)
    return Run(
        decoder,
        latents,
        sequences,
        structures,
        similarities,
        {**ARMS[arm], **SIZES, "steps": 40, "batch_chunks": 2},
        {},
    )


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    toy.write_shapes_artefact(folder / "shapes", SHAPES)
    sequences = {shape.shape_id: sequence(shape) for shape in SHAPES}
    with artefact.write("sequences", folder / "sequences", inputs={}, params=Params(format=1)) as out:
        nowhere = {shape_id: np.zeros((3, len(item.cages[0]))) for shape_id, item in sequences.items()}
        write_sequences(out, sequences.values(), nowhere)
    for arm in ARMS:
        with artefact.write("run", folder / "runs" / arm, inputs={}, params=Params(format=1)) as out:
            write_run(out, trained(arm, sequences), [])
            # After ten steps all arms said that nothing is there.
            decoder = trained(arm, sequences).decoder
            with torch.no_grad():
                list(decoder.parameters())[-1].fill_(0.05)
            weights = {f"decoder.{name}": tensor for name, tensor in decoder.state_dict().items()}
            write_snapshot(out, 10, {**weights, "latents": trained(arm, sequences).latents.values.detach()})
    return folder


def run(inputs: Path, out: Path) -> Path:
    shapes, sequences = inputs / "shapes", inputs / "sequences"
    for arm in ARMS:
        extract_meshes.main(inputs / "runs" / arm, out / "meshes" / arm, EXTRACT)
    evaluate.main(out / "meshes", shapes, sequences, out / "scores", EVALUATE)
    return out


@pytest.fixture(scope="module")
def done(inputs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAGESDF_WORKERS", "1")
        return run(inputs, tmp_path_factory.mktemp("one"))


def test_every_surface_is_closed_or_empty_and_every_arm_has_the_same_source_shapes(done: Path) -> None:
    keys = {}
    for arm in ARMS:
        folder = read_surfaces(done / "meshes" / arm)
        keys[arm] = list(folder.rows)
        assert all(is_closed(surface.mesh) != (arm == "nothing") for surface in folder)
    assert keys["cagesdf"] == keys["nothing"]
    assert [step for _, step in keys["cagesdf"]].count(0) == 2
    assert [step for _, step in keys["cagesdf"]].count(1) == 1
    assert keys["deepsdf"] == [key for key in keys["cagesdf"] if key[1] == 0]


def test_progress_is_measured_at_snapshots_and_at_the_end(inputs: Path, tmp_path: Path) -> None:
    for workers in ("1", "2"):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("CAGESDF_WORKERS", workers)
            evaluate_progress.main(
                inputs / "runs", inputs / "shapes", inputs / "sequences", tmp_path / workers, PROGRESS
            )
    assert (
        filecmp.cmpfiles(tmp_path / "1", tmp_path / "2", ["progress.parquet", "manifest.json"], shallow=False)[1] == []
    )
    rows, about = read_progress(tmp_path / "1")
    assert about["resolution"] == 24
    # Two groups of 64 points a step; held-out steps, but where each deformed shape has a latent of its own.
    assert {row["points"] for row in rows} == {10 * 2 * 64, 40 * 2 * 64}
    assert {(row["arm"], row["held_out"]) for row in rows} == {("cagesdf", True), ("deepsdf", False), ("nothing", True)}
    worst = {(row["arm"], row["points"]) for row in rows if row["surface_distance"] == pytest.approx(100)}
    assert worst == {("cagesdf", 1280), ("deepsdf", 1280), ("nothing", 1280), ("nothing", 5120)}
    assert len(rows) == 3 * 2 * 2


def test_references_are_measured_on_the_steps_that_are_extracted(done: Path) -> None:
    rows, _ = read_scores(done / "scores")
    keys = [(row["shape_id"], row["step"], row["seed"]) for row in rows["cagesdf"]]
    assert len(keys) == 3 * 2
    for name in ("cage", "ground_truth"):
        assert [(row["shape_id"], row["step"], row["seed"]) for row in rows[name]] == keys


def test_tables_have_every_arm_and_references_and_the_cage_between_floor_and_failure(done: Path) -> None:
    tables = gather_tables({"stool": read_scores(done / "scores")})
    assert list(tables["table1"]["stool"]) == ["cage", "cagesdf", "deepsdf", "ground_truth", "nothing"]
    assert list(tables["table2"]["stool"]) == ["cage", "cagesdf", "ground_truth", "nothing"]
    assert tables["about"]["points"] == 500
    for table in ("table1", "table2"):
        arms = tables[table]["stool"]
        assert set(arms["cage"]) == set(OF_KEY)
        distance = {arm: figures["surface_distance"]["mean"] for arm, figures in arms.items()}
        assert distance["ground_truth"] < 1e-6 < distance["cage"] < 5
        assert distance["nothing"] == pytest.approx(100)
        # The network fills its cage, so that the surface is the cage's but for the grid.
        assert distance["cagesdf"] == pytest.approx(distance["cage"], abs=1.5)
        assert arms["nothing"]["closed"]["mean"] == 0


def test_the_same_inputs_give_the_same_bytes_with_two_workers(
    done: Path, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    again = run(inputs, tmp_path)
    files = sorted(path.relative_to(done) for path in done.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    assert filecmp.cmpfiles(done, again, list(map(str, files)), shallow=False)[1:] == ([], [])


def test_inputs_of_another_kind_are_refused(done: Path, inputs: Path, tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match="wanted 'run'"):
        extract_meshes.main(inputs / "shapes", tmp_path / "meshes", EXTRACT)
    with pytest.raises(ArtefactError, match=r"cagesdf: holds 'run', wanted 'meshes'"):
        evaluate.main(inputs / "runs", inputs / "shapes", inputs / "sequences", tmp_path / "scores", EVALUATE)
    assert not list(tmp_path.iterdir())


def test_only_the_arms_that_are_run_are_measured_whatever_else_lies_there(
    inputs: Path, done: Path, tmp_path: Path
) -> None:
    one = {"arms": ("cagesdf",)}
    edited = tmp_path / "left"
    for name in ("runs", "meshes"):
        (edited / name / "old").mkdir(parents=True)
        (edited / name / "old" / artefact.MANIFEST).write_text("{", encoding="utf-8")
    (edited / "runs" / "cagesdf").symlink_to(inputs / "runs" / "cagesdf")
    (edited / "meshes" / "cagesdf").symlink_to(done / "meshes" / "cagesdf")
    measured = edited / "meshes", inputs / "shapes", inputs / "sequences"
    evaluate.main(*measured, tmp_path / "scores", EVALUATE.model_copy(update=one))
    assert set(read_scores(tmp_path / "scores")[0]) == {"cage", "cagesdf", "ground_truth"}
    evaluate_progress.main(
        edited / "runs", inputs / "shapes", inputs / "sequences", tmp_path / "progress", PROGRESS.model_copy(update=one)
    )
    assert {row["arm"] for row in read_progress(tmp_path / "progress")[0]} == {"cagesdf"}


def test_an_arm_that_is_run_but_has_no_surfaces_is_named(inputs: Path, done: Path, tmp_path: Path) -> None:
    params = EVALUATE.model_copy(update={"arms": ("cagesdf", "renamed")})
    with pytest.raises(ArtefactError, match=r"renamed: no such folder; run the stage"):
        evaluate.main(done / "meshes", inputs / "shapes", inputs / "sequences", tmp_path / "scores", params)
