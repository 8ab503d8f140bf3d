"""`runs/<arm>/`: a trained arm with everything needed to make shapes.

weights.safetensors   the decoder's weights, float32
latents.parquet       one row a latent
cages.parquet         the cages of all steps, held-out ones too
shapes.parquet        structures and similarities
arm.json              the arm's parameters, and how many points it was trained on
log.jsonl             the course of the training
residuals.parquet     how well it fits each shape at rest (io/residuals.py)
snapshots/            <steps>.safetensors: weights and latents after that number of steps
"""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch
from safetensors.torch import save
from torch import Tensor

from cagesdf.cuboid import Sequence
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.io.metadata import Column, Layout, check_kind
from cagesdf.io.sequences import CAGES, sequence_rows, sequences_of
from cagesdf.io.weights import (
    MAX_LAYERS,
    MAX_WIDTH,
    filled,
    planned,
    read_description,
    read_tensors,
    sizes_of,
    whole,
    wholes,
)
from cagesdf.models.arms import DECODERS, make_decoder, sizes_of_decoder
from cagesdf.models.decoders import CUBOID, Decoder
from cagesdf.models.latents import SHARED, LatentTable
from cagesdf.run import Run
from cagesdf.structure.stored import read_structure

KIND = "run"
VERSION = 1
SNAPSHOTS = "snapshots"
BOUNDS = {  # of sizes that are no widths
    "layers": (1, MAX_LAYERS),
    "context_layers": (1, MAX_LAYERS),
    "octaves": (0, 64),
    "cells": (2, 256),
    "channels": (1, 64),
    "line_cells": (2, 1024),
    "line_channels": (1, 64),
    "heads": (1, 64),
}
MAX_NUMBER = 2**62  # of points
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
    """Add a run's state after a number of steps; tensors are named as `training.loop` names them."""
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
    params = arm["params"]
    decoder = _planned_decoder(folder / "arm.json", params)
    shapes = _by_id(RUN_SHAPES.read(folder / "shapes.parquet"), folder / "shapes.parquet")
    sequences = sequences_of(_checked_cages(CAGES.read(folder / "cages.parquet"), folder / "cages.parquet"))
    if sequences.keys() != shapes.keys():
        odd = min(sequences.keys() ^ shapes.keys())
        raise InputError(f"{folder}: shape {odd!r} is in cages.parquet or in shapes.parquet, wanted in both")
    latents = _read_latents(folder / "latents.parquet", params["latent_dim"], sequences)
    weights = read_tensors(folder / "weights.safetensors", sizes_of(decoder))
    return Run(
        filled(decoder, weights).to(device),
        latents.to(device).requires_grad_(False),
        sequences,
        {shape_id: read_structure(row["structure"]) for shape_id, row in shapes.items()},
        {shape_id: Similarity.from_numbers(row["similarity"]) for shape_id, row in shapes.items()},
        params,
        arm["points"],
    )


def beside(run: Path, kind: str) -> Path:
    """data/<kind>/chair for the run data/runs/chair/cagesdf."""
    place = run.resolve()
    return place.parent.parent.parent / kind / place.parent.name


def snapshots_of(folder: Path) -> tuple[int, ...]:
    """The numbers of steps after which a run has snapshots, ascending."""
    return tuple(sorted(int(path.stem) for path in (folder / SNAPSHOTS).glob("*.safetensors")))


def read_snapshot(folder: Path, steps: int, device: torch.device | str = "cpu") -> Run:
    """A run as it was after a number of steps. Raises InputError as `read_run` does."""
    run = read_run(folder, device)
    decoder = _planned_decoder(folder / "arm.json", run.params)
    sizes = {f"decoder.{name}": size for name, size in sizes_of(decoder).items()}
    sizes["latents"] = tuple(run.latents.values.shape)
    tensors = read_tensors(folder / SNAPSHOTS / f"{steps:08d}.safetensors", sizes)
    table = LatentTable(run.latents.keys, tensors.pop("latents")).to(device).requires_grad_(False)
    weights = {name.removeprefix("decoder."): tensor for name, tensor in tensors.items()}
    return replace(run, decoder=filled(decoder, weights).to(device), latents=table)


def _read_arm(path: Path) -> dict[str, Any]:
    check_kind(path.parent, path.name, "a run", "a folder that the train stage wrote, such as data/runs/chair/cagesdf")
    arm = read_description(path)
    if arm.get("kind") != KIND or arm.get("version") != VERSION:
        got = f"{arm.get('kind')!s:.60} version {arm.get('version')!s:.60}"
        raise InputError(f"{path}: holds {got}, wanted {KIND} version {VERSION}; train again")
    for name in ("params", "points"):
        if not isinstance(arm.get(name), dict):
            raise InputError(f"{path}: wanted an object {name}, got {str(arm.get(name))[:60]}; train again")
    for name in arm["points"]:
        whole(arm["points"], name, 0, MAX_NUMBER, path)
    reach = arm["params"].get("reach", 0.0)
    if not isinstance(reach, float) or not 0 <= reach < math.inf:
        raise InputError(f"{path}: wanted a reach of at least 0, got {str(reach)[:60]}")
    return arm


def _planned_decoder(path: Path, params: Mapping[str, Any]) -> Decoder:
    """The decoder that arm.json describes, without memory for its weights."""
    name = str(params.get("decoder"))[:60]
    whole(params, "latent_dim", 1, MAX_WIDTH, path)
    if name not in DECODERS:
        raise InputError(f"{path}: wanted a decoder of {', '.join(DECODERS)}, got {name}; train again")
    sizes = {size: _size(params, size, kind, path) for size, kind in sizes_of_decoder(name).items()}
    try:
        return planned(lambda: make_decoder(name, seed=0, **sizes))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _size(params: Mapping[str, Any], name: str, kind: Any, path: Path) -> int | float | tuple[int, ...]:
    """One of a decoder's sizes, of type `kind`. Raises InputError if it is none, or out of its bounds."""
    if kind is float:
        value = params.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"{path}: wanted a finite number {name}, got {value!s:.60}; train again")
        return float(value)
    if kind is not int:
        return wholes(params, name, 1, MAX_WIDTH, path)
    least, most = BOUNDS.get(name, (1, MAX_WIDTH))
    return whole(params, name, least, most, path)


def _read_latents(path: Path, dim: int, sequences: Mapping[str, Sequence]) -> LatentTable:
    rows = LATENTS.read(path)
    odd = next((row for row in rows if len(row["latent"]) != dim), None)
    if odd is not None:
        raise InputError(f"{path}, shape {odd['shape_id']}: wanted {dim} numbers in each latent")
    values = np.array([row["latent"] for row in rows], np.float32).reshape(len(rows), dim)
    if not np.isfinite(values).all():
        raise InputError(f"{path}: holds numbers that are not finite; train again")
    keys = tuple((row["shape_id"], row["step"]) for row in rows)
    for shape_id, step in keys:
        if shape_id not in sequences or not SHARED <= step < len(sequences[shape_id].cages):
            raise InputError(f"{path}: has a latent for step {step} of shape {shape_id!r}, which the run doesn't have")
    if len(set(keys)) < len(keys):
        raise InputError(f"{path}: has several latents for one step of one shape; train again")
    return LatentTable(keys, torch.from_numpy(values))


def _by_id(rows: list[dict[str, Any]], path: Path) -> dict[str, dict[str, Any]]:
    by_id = {row["shape_id"]: row for row in rows}
    if len(by_id) < len(rows):
        raise InputError(f"{path}: has {len(rows)} rows of {len(by_id)} shapes, wanted one of each")
    return by_id


def _checked_cages(rows: list[dict[str, Any]], path: Path) -> list[dict[str, Any]]:
    for row in rows:
        if len(row["cuboid"]) != CUBOID or not np.isfinite(row["cuboid"]).all():
            raise InputError(f"{path}, shape {row['shape_id']}: wanted {CUBOID} finite numbers for {row['part_id']}")
    return rows
