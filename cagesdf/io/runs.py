"""`runs/<arm>/`: a trained arm, with all that is needed to make shapes with it.

weights.safetensors   the decoder's weights, float32
latents.parquet       one row a latent
cages.parquet         the cages of all steps, held-out ones too
shapes.parquet        structures and similarities
arm.json              the arm's parameters, and how many points it was trained on
log.jsonl             the course of the training
residuals.parquet     how well it fits each shape at rest (io/residuals.py)
snapshots/            <steps>.safetensors: weights and latents after so many steps
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import safetensors
import torch
from jaxtyping import Float
from safetensors.torch import load_file, save
from torch import Tensor

from cagesdf.cuboid import Sequence
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.io.metadata import Column, Layout
from cagesdf.io.sequences import CAGES, sequence_rows, sequences_of
from cagesdf.models.arms import make_decoder
from cagesdf.models.decoders import Decoder
from cagesdf.models.latents import LatentTable
from cagesdf.structure.base import Structure
from cagesdf.structure.stored import read_structure

KIND = "run"
VERSION = 1
SNAPSHOTS = "snapshots"
LATENTS = Layout(
    "latents",
    1,
    (
        Column("shape_id", pa.string(), "the source shape"),
        Column("step", pa.int32(), "step of its sequence; -1: shared by all of them"),
        Column("latent", pa.list_(pa.float32()), "the latent's numbers"),
    ),
)
RUN_SHAPES = Layout(
    "run_shapes",
    2,
    (
        Column("shape_id", pa.string(), "unique in its category"),
        Column("similarity", pa.list_(pa.float64()), "raw → canonical: scale, rotation by rows, translation"),
        Column(
            "structure",
            pa.string(),
            "JSON: a part hierarchy as StructureNet's, or a program and its placement; canonical",
        ),
    ),
    {"frame": "canonical"},
)


@dataclass(frozen=True, eq=False)
class Run:
    """A trained arm and the shapes it was trained on."""

    decoder: Decoder  # in eval mode, its parameters without gradients
    latents: LatentTable
    sequences: Mapping[str, Sequence]  # by shape id, held-out steps too
    structures: Mapping[str, Structure]  # by shape id
    similarities: Mapping[str, Similarity]  # by shape id, raw → canonical
    params: Mapping[str, Any]  # the arm's section of params.yaml
    points: Mapping[str, int]  # how many points were "sampled", and "used" (by points_of, reach, steps_of)

    def latent(self, shape_id: str, step: int) -> Float[Tensor, " d"]:
        """The latent of one step of one shape. Raises InputError if it has none."""
        return self.latents.values[self.latents.row(shape_id, step)].detach()

    def steps(self, shape_id: str) -> tuple[int, ...]:
        """The steps of a shape that have a latent: all, or those trained on where each has its own."""
        return tuple(s for s in range(len(self.sequences[shape_id].cages)) if self.latents.has(shape_id, s))


def write_run(folder: Path, run: Run, log: list[dict[str, int | float]]) -> None:
    """Write a run's files into an existing folder."""
    weights = {name: tensor.detach().cpu().contiguous() for name, tensor in run.decoder.state_dict().items()}
    (folder / "weights.safetensors").write_bytes(save(weights))
    numbers = run.latents.values.detach().cpu().numpy()
    LATENTS.write(
        folder / "latents.parquet",
        [{"shape_id": key[0], "step": key[1], "latent": row} for key, row in zip(run.latents.keys, numbers)],
    )
    CAGES.write(folder / "cages.parquet", sequence_rows(run.sequences.values()))
    RUN_SHAPES.write(
        folder / "shapes.parquet",
        [
            {
                "shape_id": shape_id,
                "similarity": run.similarities[shape_id].to_numbers(),
                "structure": run.structures[shape_id].to_json(),
            }
            for shape_id in sorted(run.sequences)
        ],
    )
    arm = {"kind": KIND, "version": VERSION, "params": dict(run.params), "points": dict(run.points)}
    _write_text(folder / "arm.json", json.dumps(arm, indent=1, sort_keys=True) + "\n")
    _write_text(folder / "log.jsonl", "".join(json.dumps(row) + "\n" for row in log))


def write_snapshot(folder: Path, steps: int, tensors: Mapping[str, Tensor]) -> None:
    """Add to a run what it was after so many steps; tensors are named as `training.loop` names them."""
    path = folder / SNAPSHOTS / f"{steps:08d}.safetensors"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(save({name: tensor.cpu().contiguous() for name, tensor in tensors.items()}))


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")


def read_run(folder: Path, device: torch.device | str = "cpu") -> Run:
    """A run with its decoder and latents on `device`.

    Raises InputError, with the file's name, for a folder that isn't a run, a run of another
    version, and files that are missing, damaged or don't belong together.
    """
    arm = _read_arm(folder / "arm.json")
    rows = LATENTS.read(folder / "latents.parquet")
    shapes = {row["shape_id"]: row for row in RUN_SHAPES.read(folder / "shapes.parquet")}
    values = np.array([row["latent"] for row in rows], np.float32)
    if values.shape != (len(rows), arm["params"]["latent_dim"]):
        raise InputError(f"{folder / 'latents.parquet'}: wanted {arm['params']['latent_dim']} numbers in each latent")
    latents = LatentTable(tuple((row["shape_id"], row["step"]) for row in rows), torch.from_numpy(values))
    return Run(
        _read_decoder(folder / "weights.safetensors", arm["params"]).to(device),
        latents.to(device).requires_grad_(False),
        sequences_of(CAGES.read(folder / "cages.parquet")),
        {shape_id: read_structure(row["structure"]) for shape_id, row in shapes.items()},
        {shape_id: Similarity.from_numbers(row["similarity"]) for shape_id, row in shapes.items()},
        arm["params"],
        arm["points"],
    )


def snapshots_of(folder: Path) -> tuple[int, ...]:
    """After how many steps a run has snapshots, ascending."""
    return tuple(sorted(int(path.stem) for path in (folder / SNAPSHOTS).glob("*.safetensors")))


def read_snapshot(folder: Path, steps: int, device: torch.device | str = "cpu") -> Run:
    """A run as it was after so many steps. Raises InputError as `read_run` does."""
    run = read_run(folder, device)
    path = folder / SNAPSHOTS / f"{steps:08d}.safetensors"
    tensors = _load_tensors(path)
    latents = tensors.pop("latents", None)
    if latents is None or latents.shape != run.latents.values.shape:
        raise InputError(f"{path}: doesn't hold the latents of latents.parquet; train again")
    weights = {name.removeprefix("decoder."): tensor for name, tensor in tensors.items()}
    decoder = _loaded(run.decoder, weights, path)
    table = LatentTable(run.latents.keys, latents).to(device).requires_grad_(False)
    return replace(run, decoder=decoder, latents=table)


def _read_arm(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(f"{path}: no such file; wanted a folder that the train stage wrote")
    try:
        arm = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is damaged ({error}); train again") from error
    if not isinstance(arm, dict) or arm.get("kind") != KIND or arm.get("version") != VERSION:
        what = f"{arm.get('kind')} version {arm.get('version')}" if isinstance(arm, dict) else type(arm).__name__
        raise InputError(f"{path}: holds {what}, wanted {KIND} version {VERSION}; train again")
    return arm


def _read_decoder(path: Path, params: Mapping[str, Any]) -> Decoder:
    sizes = {name: params[name] for name in ("width", "layers", "latent_dim", "mapping", "octaves")}
    return _loaded(make_decoder(params["decoder"], **sizes, seed=0), _load_tensors(path), path)


def _loaded(decoder: Decoder, weights: Mapping[str, Tensor], path: Path) -> Decoder:
    try:
        decoder.load_state_dict(weights)
    except RuntimeError as error:
        raise InputError(f"{path}: doesn't hold the weights that arm.json describes ({error}); train again") from error
    return decoder.eval().requires_grad_(False)


def _load_tensors(path: Path) -> dict[str, Tensor]:
    if not path.is_file():
        raise InputError(f"{path}: no such file; train again")
    try:
        return load_file(path)
    except safetensors.SafetensorError as error:
        raise InputError(f"{path}: is damaged ({error}); train again") from error
