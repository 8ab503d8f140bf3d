"""The train_programs stage: programs or proportions, from training shapes only, the same bytes each time."""

import json
from pathlib import Path

import numpy as np
import pytest

from cagesdf.cage_fitting.fitted import FittedCage
from cagesdf.cage_generation.programs import ProgramGenerator
from cagesdf.cage_generation.proportions import ProportionGenerator
from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.io.cage_generators import read_generator
from cagesdf.io.cuboids import write_cuboids
from cagesdf.io.rejected import read_rejected
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.parsing import parse
from pipeline import Params, TrainProgramsParams, artefact, load
from stages.train_programs import main
from tests.support import programs, toy

ROOT = Path(__file__).parents[2]
TOO_LARGE = (
    "Assembly A {\nbbox = Cuboid(1, 1, 1, True)\na = Cuboid(20, 1, 1, True)\nattach(a, bbox, 0, 0, 0, 0, 0, 0)\n}"
)


def small(**changes: object) -> TrainProgramsParams:
    params = load("train_programs", ROOT / "params.yaml")
    return params.model_copy(update={"width": 16, "code": 4, "steps": 4, "batch": 2, "samples": 6, **changes})


def fitted(cage: Cage, assembly: Assembly | None) -> FittedCage:
    zeros = np.zeros(len(cage))
    return FittedCage(cage, assembly, zeros, zeros, zeros, zeros + 1, 0.0, 0.0)


def write(folder: Path, cages: dict[str, FittedCage], held_out: tuple[str, ...] = ()) -> tuple[Path, Path]:
    shapes = [toy.stool(name, split="val" if name in held_out else "train") for name in cages]
    toy.write_shapes_artefact(folder / "shapes", shapes)
    with artefact.write("cuboids", folder / "cuboids", inputs={}, params=Params(format=1)) as out:
        write_cuboids(out, cages)
    return folder / "shapes", folder / "cuboids"


def of_program(program) -> FittedCage:
    assembly = Assembly(program, Similarity(1.0, np.eye(3), np.zeros(3)))
    return fitted(assembly.cage(), assembly)


@pytest.fixture
def with_programs(tmp_path: Path) -> tuple[Path, Path]:
    texts = {"a": programs.CHAIR, "b": programs.GROWN, "c": programs.mirrored(programs.CHAIR)}
    return write(tmp_path, {name: of_program(program) for name, program in texts.items()}, held_out=("c",))


def test_programs_make_a_program_generator_from_training_shapes_only(
    with_programs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    main(*with_programs, tmp_path / "out", small())
    trained = read_generator(tmp_path / "out")
    assert isinstance(trained.generator, ProgramGenerator)
    assert sorted(trained.structures) == ["a", "b"]
    log = [json.loads(line) for line in (tmp_path / "out" / "log.jsonl").read_text().splitlines()]
    assert log[-1]["step"] == 4
    said = capsys.readouterr().out
    figures = json.loads((tmp_path / "out" / "generator.json").read_text())["figures"]
    assert "of 2 rebuilt with their structure" in said
    assert f"of 6 samples {figures['valid']} valid" in said
    assert figures["drawn"] == 6


def test_cages_without_programs_make_a_proportion_generator(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cages = {}
    for name in ("a", "b", "c"):
        shape = toy.stool(name)
        parts = [part.part_id for part in shape.parts]
        sizes = rng.uniform(0.5, 0.6, (len(parts), 3))
        centres = rng.uniform(-0.1, 0.1, (len(parts), 3))
        cages[name] = fitted(Cage(tuple(parts), centres, np.tile(np.eye(3), (len(parts), 1, 1)), sizes), None)
    main(*write(tmp_path, cages), tmp_path / "out", small())
    trained = read_generator(tmp_path / "out")
    assert isinstance(trained.generator, ProportionGenerator)
    assert len(trained.generator.sample(np.random.default_rng(0), 5, 1.0).kept) == 5


def test_the_same_inputs_give_the_same_bytes(with_programs: tuple[Path, Path], tmp_path: Path) -> None:
    for name in ("one", "two"):
        main(*with_programs, tmp_path / name, small())
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes(), path.name


def test_a_program_without_rows_is_rejected_by_name_and_too_many_stop_the_stage(tmp_path: Path) -> None:
    items = {"a": of_program(programs.CHAIR), "b": of_program(programs.GROWN), "large": of_program(parse(TOO_LARGE))}
    inputs = write(tmp_path, items)
    main(*inputs, tmp_path / "out", small(max_rejected=0.5))
    assert "wanted numbers from" in read_rejected(tmp_path / "out")["large"]
    assert sorted(read_generator(tmp_path / "out").structures) == ["a", "b"]
    with pytest.raises(InputError, match="1 of 3 shapes rejected"):
        main(*inputs, tmp_path / "other", small(max_rejected=0.1))
    assert not (tmp_path / "other").exists()
