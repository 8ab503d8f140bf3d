"""`programs/`: a trained generator of structures and cages, and the shapes it was trained on.

generator.json        its class, its sizes, and how good it is
weights.safetensors   the autoencoder's weights, float32, where it writes programs
known.parquet         one row a training shape, for the novelty of samples
log.jsonl             the course of the training; empty where nothing was trained
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from safetensors.torch import save

from cagesdf.cage_generation.checks import Figures
from cagesdf.cage_generation.generator import Generator
from cagesdf.cage_generation.program_vae import ProgramVAE
from cagesdf.cage_generation.programs import ProgramGenerator
from cagesdf.cage_generation.proportions import ProportionGenerator, families
from cagesdf.cage_generation.trained import TrainedGenerator
from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.io.metadata import Column, Layout, check_kind
from cagesdf.io.weights import (
    MAX_WIDTH,
    filled,
    planned,
    positive,
    read_description,
    read_tensors,
    sizes_of,
    whole,
)
from cagesdf.structure.base import Structure
from cagesdf.structure.stored import read_structure

KIND = "programs"
VERSION = 1
GENERATOR, WEIGHTS, LOG, SHAPES = "generator.json", "weights.safetensors", "log.jsonl", "known.parquet"
MANIFEST = "manifest.json"  # of the whole folder, where a stage wrote it: it has each file's digest
PROPER = 1e-6  # tolerance of a known cuboid's axes as a rotation, and of its numbers against its program's
KNOWN = Layout(
    "known_structures",
    1,
    (
        Column("shape_id", pa.string(), "unique in its category"),
        Column("structure", pa.string(), "JSON: a program and its placement, or a part hierarchy; canonical"),
        Column("part_ids", pa.list_(pa.string()), "in the structure's order"),
        Column("cuboids", pa.list_(pa.float64()), "of each part in turn: centre (3), axes by rows (9), lengths (3)"),
    ),
    {"frame": "canonical"},
)


def write_generator(
    folder: Path, trained: TrainedGenerator, log: Sequence[Mapping[str, int | float]], figures: Figures
) -> None:
    """Write a generator's files into an existing folder."""
    content: dict[str, Any] = {"kind": KIND, "version": VERSION, "figures": figures}
    match trained.generator:
        case ProgramGenerator(model, reach):
            content |= {
                "generator": ProgramGenerator.__name__,
                "width": model.width,
                "code": model.code,
                "reach": reach,
            }
            weights = {name: tensor.detach().cpu().contiguous() for name, tensor in model.state_dict().items()}
            (folder / WEIGHTS).write_bytes(save(weights))
        case ProportionGenerator(_, reach):
            content |= {"generator": ProportionGenerator.__name__, "reach": reach}
        case other:
            raise TypeError(f"there is no file format for {type(other).__name__}")
    KNOWN.write(
        folder / SHAPES,
        [
            {
                "shape_id": shape_id,
                "structure": structure.to_json(),
                "part_ids": list(trained.cages[shape_id].part_ids),
                "cuboids": trained.cages[shape_id].vectors().ravel(),
            }
            for shape_id, structure in sorted(trained.structures.items())
        ],
    )
    _write_text(folder / GENERATOR, json.dumps(content, indent=1, sort_keys=True) + "\n")
    _write_text(folder / LOG, "".join(json.dumps(row) + "\n" for row in log))


def read_generator(folder: Path) -> TrainedGenerator:
    """A generator, on the CPU, ready to sample.

    Raises InputError, with the file's name, for a folder that isn't one, another version, and files that are
    missing, damaged or don't belong together: shapes that are there twice, or not as many as were trained on, parts
    without a cuboid and cuboids without a part, cuboids that are none or not those of their program, and files that
    aren't as the manifest has them.
    """
    check_kind(
        folder, GENERATOR, "a generator", "a folder that the train_programs stage wrote, such as data/programs/chair"
    )
    path = folder / GENERATOR
    content = read_description(path)
    if content.get("kind") != KIND or content.get("version") != VERSION:
        raise InputError(f"{path}: wanted {KIND} version {VERSION}, got {str(content)[:60]}; run train_programs again")
    rows = KNOWN.read(folder / SHAPES)
    structures = {row["shape_id"]: read_structure(row["structure"]) for row in rows}
    _check_count(folder, content, len(structures), len(rows))
    cages = {row["shape_id"]: _cage(row, structures[row["shape_id"]], folder) for row in rows}
    _check_digests(folder)
    reach = positive(content, "reach", path)
    generator: Generator
    if content.get("generator") == ProgramGenerator.__name__:
        generator = ProgramGenerator(_read_model(folder, content), reach)
    elif content.get("generator") == ProportionGenerator.__name__:
        generator = ProportionGenerator(families(structures, cages), reach)
    else:
        names = f"{ProgramGenerator.__name__} or {ProportionGenerator.__name__}"
        raise InputError(f"{path}: holds {str(content.get('generator'))[:60]!r}, wanted {names}")
    return TrainedGenerator(generator, structures, cages)


def _check_count(folder: Path, content: Mapping[str, Any], shapes: int, rows: int) -> None:
    if not shapes:
        raise InputError(f"{folder / SHAPES}: has no shapes; run train_programs again")
    if rows != shapes:
        raise InputError(f"{folder / SHAPES}: has {rows} rows of {shapes} shapes, wanted one of each")
    figures = content.get("figures")
    if not isinstance(figures, dict):
        raise InputError(f"{folder / GENERATOR}: wanted an object figures, got {str(figures)[:60]}")
    if figures.get("rebuilt", shapes) != shapes:
        wanted = f"{GENERATOR} says that {str(figures['rebuilt'])[:60]} were trained on"
        raise InputError(f"{folder / SHAPES}: has {shapes} shapes, {wanted}; run train_programs again")


def _cage(row: Mapping[str, Any], structure: Structure, folder: Path) -> Cage:
    def fail(wanted: str) -> InputError:
        return InputError(f"{folder / SHAPES}, shape {row['shape_id']}: wanted {wanted}; run train_programs again")

    vectors, part_ids = np.array(row["cuboids"], np.float64), tuple(row["part_ids"])
    if vectors.size != 15 * len(part_ids) or not part_ids or not np.isfinite(vectors).all():
        raise fail(f"15 finite numbers for each of {len(part_ids)} parts, got {vectors.size}")
    if part_ids != structure.parts():
        odd = sorted({*part_ids} ^ {*structure.parts()})
        raise fail(f"a cuboid for each part of its structure, in order; {odd[:1] or 'the order'} differs")
    cage = Cage.from_vectors(part_ids, vectors.reshape(-1, 15))
    turned = np.abs(cage.axes @ cage.axes.mT - np.eye(3)).max() > PROPER or (np.linalg.det(cage.axes) < 0).any()
    if turned or (cage.size <= 0).any():
        raise fail("cuboids with right-handed unit axes and lengths above 0")
    if structure.placed_program() is not None and np.abs(structure.cage().vectors() - cage.vectors()).max() > PROPER:
        raise fail("the cuboids that its program makes")
    return cage


def _check_digests(folder: Path) -> None:
    """Compare the files with those that the manifest is about, if there is one."""
    if not (folder / MANIFEST).is_file():
        return
    files = read_description(folder / MANIFEST).get("files")
    for name in (GENERATOR, SHAPES, WEIGHTS):
        entry = files.get(name) if isinstance(files, dict) else None
        wanted = entry.get("sha256") if isinstance(entry, dict) else None
        path = folder / name
        if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() != wanted:
            raise InputError(f"{path}: is not the file that {MANIFEST} is about; run train_programs again")


def _read_model(folder: Path, content: Mapping[str, Any]) -> ProgramVAE:
    width, code = (whole(content, name, 1, MAX_WIDTH, folder / GENERATOR) for name in ("width", "code"))
    model = planned(lambda: ProgramVAE.drawn(width, code, seed=0))
    return filled(model, read_tensors(folder / WEIGHTS, sizes_of(model)))


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")
