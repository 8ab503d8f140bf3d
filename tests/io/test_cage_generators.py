"""Generators: self-contained, read back as they were, refused by name where they are not whole."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save

from cagesdf.cage_generation.generator import Generator
from cagesdf.cage_generation.program_vae import ProgramVAE
from cagesdf.cage_generation.programs import ProgramGenerator
from cagesdf.cage_generation.proportions import ProportionGenerator, families
from cagesdf.cage_generation.trained import TrainedGenerator
from cagesdf.errors import InputError
from cagesdf.io.cage_generators import KNOWN, read_generator, write_generator
from pipeline import Params, artefact
from tests.support.generators import jars, on_programs

LOG = [{"step": 1, "loss": 2.5}]
FIGURES: dict[str, int | float] = {"valid": 3}


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
        ({"width": 1_000_000}, "wanted width from 1 to"),
        ({"code": 0}, "wanted code from 1 to"),
        ({"width": True}, "wanted width from 1 to"),
        ({"width": 17}, r"doesn't hold the weights that are described.*, wanted \[.*17"),
        ({"code": 4}, r"doesn't hold the weights that are described.*, wanted \[.*4"),
        ({"figures": {"rebuilt": 3}}, "has 2 shapes, generator.json says that 3 were trained on"),
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
    with pytest.raises(InputError, match="not finite"):
        read_generator(folder)


def respelled(folder: Path, change: Callable[[list[dict]], object]) -> None:
    """Known shapes with a change, as if a stage had written them so."""
    rows = KNOWN.read(folder / "known.parquet")
    change(rows)
    KNOWN.write(folder / "known.parquet", rows)


def mirrored(rows: list[dict]) -> None:
    cuboids = np.array(rows[0]["cuboids"]).reshape(-1, 15)
    cuboids[0, 3:6] *= -1
    rows[0]["cuboids"] = cuboids.ravel()


def flat(rows: list[dict]) -> None:
    rows[0]["cuboids"] = [*rows[0]["cuboids"][:14], 0.0, *rows[0]["cuboids"][15:]]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rows: rows.append(rows[0]), "has 3 rows of 2 shapes, wanted one of each"),
        (lambda rows: rows.clear(), "has no shapes"),
        (lambda rows: rows[0].update(part_ids=["ghost", *rows[0]["part_ids"][1:]]), "for each part of its structure"),
        (lambda rows: rows[0].update(part_ids=rows[0]["part_ids"][::-1]), "for each part of its structure"),
        (lambda rows: rows[1].update(structure=rows[0]["structure"]), "shape b: wanted a cuboid for each part"),
        (lambda rows: rows[0].update(cuboids=rows[0]["cuboids"][15:]), "15 finite numbers for each of"),
        (lambda rows: rows[0].update(cuboids=[np.nan, *rows[0]["cuboids"][1:]]), "15 finite numbers for each of"),
        (flat, "lengths above 0"),
        (mirrored, "right-handed unit axes"),
        (lambda rows: rows[0].update(cuboids=[0.5, *rows[0]["cuboids"][1:]]), "the cuboids that its program makes"),
        (lambda rows: rows[0].update(structure="{"), "structure: no JSON"),
    ],
)
def test_known_shapes_that_contradict_themselves_are_refused(folder: Path, change: Callable, said: str) -> None:
    respelled(folder, change)
    with pytest.raises(InputError, match=said):
        read_generator(folder)


def test_a_generator_trained_on_another_number_of_shapes_than_it_knows_is_refused(tmp_path: Path) -> None:
    write_generator(tmp_path, on_programs(), LOG, {"rebuilt": 2})
    read_generator(tmp_path)
    respelled(tmp_path, lambda rows: rows.pop())
    with pytest.raises(InputError, match=r"has 1 shapes, generator\.json says that 2 were trained on"):
        read_generator(tmp_path)


@pytest.mark.parametrize("name", ["known.parquet", "weights.safetensors", "generator.json"])
def test_files_that_are_not_those_of_the_manifest_are_refused(name: str, tmp_path: Path) -> None:
    for place, seed in (("one", 1), ("two", 2)):
        trained = on_programs()
        structures = {f"{key}{seed}": value for key, value in trained.structures.items()}
        cages = {f"{key}{seed}": value for key, value in trained.cages.items()}
        generator = ProgramGenerator(ProgramVAE.drawn(16, 5, seed), 1.0 + seed)
        with artefact.write("programs", tmp_path / place, inputs={}, params=Params(format=1)) as out:
            write_generator(out, TrainedGenerator(generator, structures, cages), LOG, FIGURES)
        read_generator(tmp_path / place)
    (tmp_path / "one" / name).write_bytes((tmp_path / "two" / name).read_bytes())
    with pytest.raises(InputError, match=f"{name}: is not the file that manifest.json is about"):
        read_generator(tmp_path / "one")
