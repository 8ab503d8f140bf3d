"""Generators: self-contained, read back as they were, refused by name where they are not whole."""

import json
from pathlib import Path

import numpy as np
import programs
import pytest
import torch
from safetensors.torch import load_file, save
from test_generation_proportions import jars

from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.generation.generator import Generator
from cagesdf.generation.program_vae import ProgramVAE
from cagesdf.generation.programs import ProgramGenerator
from cagesdf.generation.proportions import ProportionGenerator, families
from cagesdf.io.generators import TrainedGenerator, read_generator, write_generator
from cagesdf.structure.assembly import Assembly

LOG = [{"step": 1, "loss": 2.5}]
FIGURES = {"valid": 3}


def on_programs() -> TrainedGenerator:
    place = Similarity(1.2, np.eye(3), np.zeros(3))
    structures = {"a": Assembly(programs.CHAIR, place), "b": Assembly(programs.GROWN, place)}
    cages = {name: assembly.cage() for name, assembly in structures.items()}
    return TrainedGenerator(ProgramGenerator(ProgramVAE.drawn(16, 5, 1), 1.1), structures, cages)


def on_cages() -> TrainedGenerator:
    structures, cages = jars(4)
    return TrainedGenerator(ProportionGenerator(families(structures, cages), 1.1), structures, cages)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_generator(tmp_path, on_programs(), LOG, FIGURES)
    return tmp_path


def drawn(generator: Generator) -> list[str]:
    samples = generator.sample(np.random.default_rng(0), 30, 1.0)
    return [item.structure.to_json() for item in samples.kept] + [str(samples.failures)]


@pytest.mark.parametrize("make", [on_programs, on_cages])
def test_what_is_read_back_draws_the_same_and_knows_the_same(make, tmp_path: Path) -> None:
    trained = make()
    write_generator(tmp_path, trained, LOG, FIGURES)
    again = read_generator(tmp_path)
    assert drawn(again.generator) == drawn(trained.generator)
    for name, structure in trained.structures.items():
        assert again.structures[name].signature() == structure.signature()
        assert again.known().nearest(structure, trained.cages[name]) == (name, pytest.approx(0, abs=1e-9))


def test_the_same_generator_gives_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    write_generator(other, read_generator(folder), LOG, FIGURES)
    for path in other.iterdir():
        assert path.read_bytes() == (folder / path.name).read_bytes()


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"kind": "run"}, "wanted programs version 1"),
        ({"version": 2}, "wanted programs version 1"),
        ({"reach": -1.0}, "wanted a positive reach"),
        ({"reach": float("nan")}, "wanted a positive reach"),
        ({"width": 1_000_000}, "wanted width and code from 1 to"),
        ({"code": 0}, "wanted width and code from 1 to"),
        ({"width": 17}, "doesn't hold weights of width 17"),
        ({"code": 4}, "and code 4"),
        ({"generator": "Oracle"}, "holds 'Oracle'"),
    ],
)
def test_a_description_that_is_none_is_refused_by_name(folder: Path, change: dict, wanted: str) -> None:
    path = folder / "generator.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(InputError, match=wanted):
        read_generator(folder)


@pytest.mark.parametrize("name", ["generator.json", "weights.safetensors", "known.parquet"])
def test_files_that_are_missing_or_damaged_are_refused_by_name(folder: Path, name: str) -> None:
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        read_generator(folder)
    (folder / name).unlink()
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        read_generator(folder)


def test_weights_that_are_not_finite_are_refused(folder: Path) -> None:
    weights = load_file(folder / "weights.safetensors")
    next(iter(weights.values())).view(-1)[0] = torch.nan
    (folder / "weights.safetensors").write_bytes(save(weights))
    with pytest.raises(InputError, match="aren't finite"):
        read_generator(folder)
