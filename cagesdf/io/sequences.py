"""`sequences/`: the cages of every step, and the warps by which surfaces follow them.

sequences.parquet  one row a (shape, step, part)
warps.parquet      the same, only where surfaces don't follow their cuboids alone
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from cagesdf.cuboid import Cage, Sequence
from cagesdf.deformation.sequences import KeptDetails, Transfer, Trilinear
from cagesdf.geometry.resizing import AxisWarp
from cagesdf.io.metadata import Column, Layout

KIND = "sequences"
SEQUENCES = Layout(
    "sequences",
    1,
    (
        Column("shape_id", pa.string(), "the source"),
        Column("target_id", pa.string(), "the shape deformed towards; empty where the whole cage was scaled"),
        Column("step", pa.int32(), "0 is the rest shape"),
        Column("t", pa.float64(), "from source (0) to target (1)"),
        Column("held_out", pa.bool_(), "kept from training"),
        Column("part_id", pa.string(), "in the structure's order"),
        Column("cuboid", pa.list_(pa.float64()), "centre (3), axes by rows (9), full lengths (3), canonical"),
        Column("outside", pa.float64(), "share of the part's vertices that averaging puts outside their own cuboid"),
    ),
    {"frame": "canonical"},
)
CAGES = Layout("cages", 1, SEQUENCES.columns[:-1], SEQUENCES.facts)  # the columns that a run stores

WARPS = Layout(
    "warps",
    1,
    (
        Column("shape_id", pa.string(), "the source"),
        Column("step", pa.int32(), "0 is the rest shape"),
        Column("part_id", pa.string(), "in the structure's order"),
        Column("knots", pa.list_(pa.float64()), "for each axis: where borders of even bins of [-1/2, 1/2] go"),
    ),
    {"frame": "unit"},
)


def write_sequences(folder: Path, sequences: Iterable[Sequence], outside: Mapping[str, np.ndarray]) -> None:
    """Write sequences, and by shape id the (step, part) share of vertices outside their own cuboid."""
    sequences = sorted(sequences, key=lambda sequence: sequence.shape_id)
    shares = [float(share) for sequence in sequences for share in outside[sequence.shape_id].ravel()]
    rows = zip(sequence_rows(sequences), shares, strict=True)
    SEQUENCES.write(folder / "sequences.parquet", [{**row, "outside": share} for row, share in rows])


def write_transfers(folder: Path, sequences: Iterable[Sequence], transfers: Mapping[str, Transfer]) -> None:
    """Write the warps of sequences by shape id; nothing, not even a file, where there are none."""
    rows = [
        {"shape_id": sequence.shape_id, "step": step, "part_id": part_id, "knots": warp.knots.ravel()}
        for sequence in sorted(sequences, key=lambda sequence: sequence.shape_id)
        for step, warps in enumerate(transfers[sequence.shape_id].warps)
        for part_id, warp in zip(sequence.cages[0].part_ids, warps, strict=True)
    ]
    if rows:
        WARPS.write(folder / "warps.parquet", rows)


def read_transfers(folder: Path, sequences: Iterable[str]) -> dict[str, Transfer]:
    """Transfers, which make the surfaces of these sequences follow their cages, by shape id."""
    path = folder / "warps.parquet"
    warps: dict[str, dict[int, list[AxisWarp]]] = {}
    for row in WARPS.read(path) if path.is_file() else []:
        warp = AxisWarp(np.array(row["knots"]).reshape(3, -1))
        warps.setdefault(row["shape_id"], {}).setdefault(row["step"], []).append(warp)
    return {
        shape_id: KeptDetails(tuple(map(tuple, warps[shape_id].values()))) if shape_id in warps else Trilinear()
        for shape_id in sequences
    }


def read_sequences(folder: Path) -> dict[str, Sequence]:
    """Sequences by shape id of their source."""
    return sequences_of(SEQUENCES.read(folder / "sequences.parquet"))


def sequence_rows(sequences: Iterable[Sequence]) -> list[dict[str, Any]]:
    """The columns of CAGES, one row a (shape, step, part), shapes sorted by id."""
    return [
        {
            "shape_id": sequence.shape_id,
            "target_id": sequence.target_id or "",
            "step": step,
            "t": float(sequence.t[step]),
            "held_out": sequence.held_out[step],
            "part_id": part_id,
            "cuboid": vector,
        }
        for sequence in sorted(sequences, key=lambda sequence: sequence.shape_id)
        for step, cage in enumerate(sequence.cages)
        for part_id, vector in zip(cage.part_ids, cage.vectors())
    ]


def sequences_of(rows: Iterable[Mapping[str, Any]]) -> dict[str, Sequence]:
    """Undo `sequence_rows`: sequences by shape id of their source."""
    grouped: dict[str, dict[int, list[Mapping[str, Any]]]] = {}
    for row in rows:
        grouped.setdefault(row["shape_id"], {}).setdefault(row["step"], []).append(row)
    return {shape_id: _sequence(shape_id, list(steps.values())) for shape_id, steps in grouped.items()}


def _sequence(shape_id: str, steps: list[list[Mapping[str, Any]]]) -> Sequence:
    return Sequence(
        shape_id,
        steps[0][0]["target_id"] or None,
        np.array([rows[0]["t"] for rows in steps]),
        tuple(rows[0]["held_out"] for rows in steps),
        tuple(
            Cage.from_vectors(tuple(row["part_id"] for row in rows), np.array([row["cuboid"] for row in rows]))
            for rows in steps
        ),
    )
