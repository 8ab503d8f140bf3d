"""The train stage: every arm trains, repeats, resumes, and says what it used."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from cagesdf.cage_fitting.fitted import FittedCage
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.io.cuboids import write_cuboids
from cagesdf.io.points import shard_path, write_shard
from cagesdf.io.runs import read_run
from cagesdf.io.sequences import write_sequences
from cagesdf.shape import AlignedPart
from cagesdf.structure.assembly import Assembly
from cagesdf.training.batches import Batches, MemoryBatches
from cagesdf.training.points import StreamedBatches
from pipeline import Params, TrainParams, artefact, load
from stages.sample_points import KINDS
from stages.train import main
from tests.support import programs, spheres, toy

ROOT = Path(__file__).parents[2]
SMALL = {
    **spheres.SIZES,
    "steps": 12,
    "batch_chunks": 4,
    "checkpoint_every": 4,
}


def arm(name: str, **changes: object) -> TrainParams:
    params = load(f"arms.{name}", ROOT / "params.yaml")
    return params.model_copy(update={**SMALL, **changes})


Inputs = tuple[Path, Path, Path, Path]  # points, shapes, cuboids, sequences


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Checkpoints go to the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CAGESDF_DEVICE", "cpu")


@pytest.fixture
def inputs(tmp_path: Path) -> Inputs:
    params = Params(format=1)
    names = sorted(spheres.RADII)
    shapes = [toy.stool(name) for name in names]
    toy.write_shapes_artefact(tmp_path / "shapes", shapes)
    paths: Inputs = tmp_path / "points", tmp_path / "shapes", tmp_path / "cuboids", tmp_path / "sequences"
    with artefact.write("cuboids", paths[2], inputs={}, params=params) as folder:
        write_cuboids(folder, {})
    with artefact.write("sequences", paths[3], inputs={}, params=params) as folder:
        write_sequences(folder, spheres.sequences().values(), {name: np.zeros((2, 1)) for name in names})
    with artefact.write("points", paths[0], inputs={}, params=params) as folder:
        write_points(folder, (30, 20, 80, 70))
    return paths


def write_points(folder: Path, counts: tuple[int, ...]) -> None:
    """Points of the spheres as shapes, and of the spheres as parts: these differ in their seed alone."""
    for seed, of in enumerate(KINDS):
        chunks = spheres.chunks(counts, reach=0.8, seed=seed)
        write_shard(shard_path(folder, of, 0), [chunks], np.random.default_rng(0))


ARMS = yaml.safe_load((ROOT / "params.yaml").read_text(encoding="utf-8"))["run"]["arms"]


@pytest.mark.parametrize("name", ARMS)
def test_every_arm_trains_and_its_run_can_be_read(name: str, inputs: Inputs, tmp_path: Path) -> None:
    main(*inputs, out=tmp_path / name, params=arm(name))
    run = read_run(tmp_path / name)
    assert run.params["decoder"] == type(run.decoder).__name__ == arm(name).decoder
    assert sorted(run.sequences) == ["large", "small"]
    assert len(run.latents) == (4 if arm(name).latents == "deformed" else 2)
    assert run.points["sampled"] == 200 * 64
    assert (run.points["used"] == run.points["sampled"]) == (
        run.decoder.trains_on != "cage" and arm(name).steps_of == "all"
    )
    assert not list(Path("checkpoints").glob("*/*"))


@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("cagesdf_noaug", "around each part, of source shapes"),
        ("cagesdf_global_noaug", "inside their cuboid or within 0.02, of source shapes"),
        ("deepsdf", "in the whole cube, of all training steps"),
    ],
)
def test_the_stage_says_which_points_it_trained_on(
    name: str, where: str, inputs: Inputs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(*inputs, out=tmp_path / "run", params=arm(name))
    used = read_run(tmp_path / "run").points["used"]
    assert f"run: {used:,} of 12,800 points, those {where}; in memory" in capsys.readouterr().out


@pytest.mark.parametrize(("memory", "way"), [("1G", MemoryBatches), ("1K", StreamedBatches)])
def test_an_interrupted_stage_leaves_no_output_and_resumed_gives_the_same_bytes(
    memory: str,
    way: type[Batches],
    inputs: Inputs,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("CAGESDF_MEMORY", memory)
    main(*inputs, out=tmp_path / "whole", params=arm("cagesdf"))
    order = way.at

    def interrupted(self: Batches, step: int) -> object:
        if step == 9:
            raise KeyboardInterrupt
        return order(self, step)

    with monkeypatch.context() as patch:
        patch.setattr(way, "at", interrupted)
        with pytest.raises(KeyboardInterrupt):
            main(*inputs, out=tmp_path / "run", params=arm("cagesdf"))
    assert not (tmp_path / "run").exists()
    assert len(list(Path("checkpoints").glob("*/training.safetensors"))) == 1
    steps: list[int] = []

    def noted(self: Batches, step: int) -> object:
        steps.append(step)
        return order(self, step)

    with monkeypatch.context() as patch:
        patch.setattr(way, "at", noted)
        main(*inputs, out=tmp_path / "run", params=arm("cagesdf"))
    assert steps == [8, 9, 10, 11]
    for path in sorted((tmp_path / "whole").iterdir()):
        assert path.read_bytes() == (tmp_path / "run" / path.name).read_bytes(), path.name


def test_streaming_trains_on_as_many_points_and_says_so(
    inputs: Inputs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    main(*inputs, out=tmp_path / "loaded", params=arm("deepsdf"))
    monkeypatch.setenv("CAGESDF_MEMORY", "1K")
    main(*inputs, out=tmp_path / "streamed", params=arm("deepsdf"))
    runs = [read_run(tmp_path / name) for name in ("loaded", "streamed")]
    assert runs[0].points == runs[1].points
    assert runs[0].latents.keys == runs[1].latents.keys
    assert "streamed, as memory is limited" in capsys.readouterr().out


def test_a_checkpoint_of_other_parameters_inputs_or_way_of_reading_is_not_taken_up(
    inputs: Inputs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def kept(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("stages.train.write_run", kept)
        for change, memory in (({}, "1G"), ({"seed": 9}, "1G"), ({}, "1K")):
            patch.setenv("CAGESDF_MEMORY", memory)
            with pytest.raises(KeyboardInterrupt):
                main(*inputs, out=tmp_path / "run", params=arm("cagesdf", **change))
        with artefact.write("points", inputs[0], inputs={}, params=Params(format=1)) as folder:
            write_points(folder, (70, 70, 70, 70))
        with pytest.raises(KeyboardInterrupt):
            main(*inputs, out=tmp_path / "run", params=arm("cagesdf"))
    assert len(list(Path("checkpoints").iterdir())) == 4


def test_a_shape_whose_cuboids_follow_from_a_program_has_it_as_it_was_fitted_and_labelled(
    inputs: Inputs, tmp_path: Path
) -> None:
    """Its structure as it was read is that of the program before it was fitted."""
    place = Similarity(2.0, np.eye(3), np.zeros(3))
    given, fitted = (Assembly(program, place) for program in (programs.CHAIR, programs.scaled(programs.CHAIR, 1.1)))
    alignment = (AlignedPart("seat", "3", "board", (), (), 1.0),)
    shutil.rmtree(inputs[1])
    shapes = [replace(toy.stool("large"), structure=given, alignment=alignment), toy.stool("small")]
    toy.write_shapes_artefact(inputs[1], shapes)
    nothing = np.zeros(len(fitted.parts()))
    fit = FittedCage(fitted.cage(), fitted, nothing, nothing, nothing, nothing, 0.0, 0.0)
    shutil.rmtree(inputs[2])
    with artefact.write("cuboids", inputs[2], inputs={}, params=Params(format=1)) as folder:
        write_cuboids(folder, {"large": fit})
    main(*inputs, out=tmp_path / "run", params=arm("cagesdf"))
    structures = read_run(tmp_path / "run").structures
    assert structures["large"].to_json() == fitted.labelled({"seat": "board"}).to_json()
    assert structures["small"].to_json() == shapes[1].structure.to_json()


def test_inputs_of_the_wrong_kind_and_points_without_cages_are_refused_by_name(inputs: Inputs, tmp_path: Path) -> None:
    points, shapes, cuboids, sequences = inputs
    with pytest.raises(artefact.ArtefactError, match="holds 'shapes', wanted 'points'"):
        main(shapes, shapes, cuboids, sequences, out=tmp_path / "run", params=arm("cagesdf"))
    shutil.rmtree(sequences)
    only = [spheres.sequences()["large"]]
    with artefact.write("sequences", sequences, inputs={}, params=Params(format=1)) as folder:
        write_sequences(folder, only, {"large": np.zeros((2, 1))})
    with pytest.raises(InputError, match=r"shape small.*no cage"):
        main(points, shapes, cuboids, sequences, out=tmp_path / "run", params=arm("cagesdf"))
