"""`programs/`: a trained generator of structures and cages, and the shapes it was trained on.

generator.json        its class, its sizes, and how good it is
weights.safetensors   the autoencoder's weights, float32, where it writes programs
known.parquet         one row a training shape: what a sample is compared with to be new
log.jsonl             the course of the training; empty where nothing was trained
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import safetensors
import torch
from safetensors.torch import load_file, save

from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.generation.checks import Figures
from cagesdf.generation.generator import Generator
from cagesdf.generation.novelty import Known
from cagesdf.generation.program_vae import ProgramVAE
from cagesdf.generation.programs import ProgramGenerator
from cagesdf.generation.proportions import ProportionGenerator, families
from cagesdf.io.metadata import Column, Layout
from cagesdf.structure.base import Structure
from cagesdf.structure.stored import read_structure

KIND = "programs"
VERSION = 1
MAX_WIDTH = 4096
GENERATOR, WEIGHTS, LOG = "generator.json", "weights.safetensors", "log.jsonl"
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


@dataclass(frozen=True, eq=False)
class TrainedGenerator:
    """A generator and what it was trained on."""

    generator: Generator
    structures: Mapping[str, Structure]  # by shape id
    cages: Mapping[str, Cage]  # by shape id, canonical

    def known(self) -> Known:
        """What samples are compared with."""
        return Known(self.structures, self.cages)


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
        folder / "known.parquet",
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
    missing, damaged or don't belong together.
    """
    content = _read_json(folder / GENERATOR)
    rows = KNOWN.read(folder / "known.parquet")
    structures = {row["shape_id"]: read_structure(row["structure"]) for row in rows}
    cages = {row["shape_id"]: _cage(row, folder) for row in rows}
    if not structures:
        raise InputError(f"{folder / 'known.parquet'}: has no shapes; run train_programs again")
    reach = content.get("reach")
    if not isinstance(reach, float) or not 0 < reach < math.inf:
        raise InputError(f"{folder / GENERATOR}: wanted a positive reach, got {reach!r}; run train_programs again")
    generator: Generator
    if content.get("generator") == ProgramGenerator.__name__:
        generator = ProgramGenerator(_read_model(folder, content.get("width"), content.get("code")), reach)
    elif content.get("generator") == ProportionGenerator.__name__:
        generator = ProportionGenerator(families(structures, cages), reach)
    else:
        names = f"{ProgramGenerator.__name__} or {ProportionGenerator.__name__}"
        raise InputError(f"{folder / GENERATOR}: holds {content.get('generator')!r}, wanted {names}")
    return TrainedGenerator(generator, structures, cages)


def _read_json(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(f"{path}: no such file; wanted a folder that the train_programs stage wrote")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is damaged ({error}); run train_programs again") from error
    if not isinstance(content, dict) or content.get("kind") != KIND or content.get("version") != VERSION:
        raise InputError(f"{path}: wanted {KIND} version {VERSION}, got {str(content)[:60]}; run train_programs again")
    return content


def _cage(row: Mapping[str, Any], folder: Path) -> Cage:
    vectors, part_ids = np.array(row["cuboids"], np.float64), tuple(row["part_ids"])
    if vectors.size != 15 * len(part_ids) or not part_ids or not np.isfinite(vectors).all():
        wanted = f"wanted 15 finite numbers for each of {len(part_ids)} parts"
        raise InputError(f"{folder / 'known.parquet'}, shape {row['shape_id']}: {wanted}, got {vectors.size}")
    return Cage.from_vectors(part_ids, vectors.reshape(-1, 15))


def _read_model(folder: Path, width: Any, code: Any) -> ProgramVAE:
    path = folder / WEIGHTS
    if not all(isinstance(size, int) and 1 <= size <= MAX_WIDTH for size in (width, code)):
        wanted = f"wanted width and code from 1 to {MAX_WIDTH}, got {width!r} and {code!r}"
        raise InputError(f"{folder / GENERATOR}: {wanted}; run train_programs again")
    if not path.is_file():
        raise InputError(f"{path}: no such file; run train_programs again")
    model = ProgramVAE.drawn(width, code, seed=0)
    try:
        weights = load_file(path)
        model.load_state_dict(weights)
    except (safetensors.SafetensorError, RuntimeError) as error:
        wanted = f"doesn't hold weights of width {width} and code {code}"
        raise InputError(f"{path}: {wanted} ({error}); run train_programs again") from error
    if not all(torch.isfinite(tensor).all() for tensor in weights.values()):
        raise InputError(f"{path}: holds numbers that aren't finite; run train_programs again")
    return model.eval().requires_grad_(False)


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")
