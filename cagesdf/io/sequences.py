"""`sequences/`: the cages of every step, one row a (shape, step, part)."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa

from cagesdf.cuboid import Cage, Sequence
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


def write_sequences(folder: Path, sequences: Iterable[Sequence], outside: Mapping[str, np.ndarray]) -> None:
    """Write sequences, and by shape id the (step, part) share of vertices outside their own cuboid."""
    SEQUENCES.write(
        folder / "sequences.parquet",
        [
            {
                "shape_id": sequence.shape_id,
                "target_id": sequence.target_id or "",
                "step": step,
                "t": float(sequence.t[step]),
                "held_out": sequence.held_out[step],
                "part_id": part_id,
                "cuboid": cage.vectors()[i],
                "outside": float(outside[sequence.shape_id][step, i]),
            }
            for sequence in sorted(sequences, key=lambda sequence: sequence.shape_id)
            for step, cage in enumerate(sequence.cages)
            for i, part_id in enumerate(cage.part_ids)
        ],
    )


def read_sequences(folder: Path) -> dict[str, Sequence]:
    """Sequences by shape id of their source."""
    grouped: dict[str, dict[int, list[dict]]] = {}
    for row in SEQUENCES.read(folder / "sequences.parquet"):
        grouped.setdefault(row["shape_id"], {}).setdefault(row["step"], []).append(row)
    return {shape_id: _sequence(shape_id, list(steps.values())) for shape_id, steps in grouped.items()}


def _sequence(shape_id: str, steps: list[list[dict]]) -> Sequence:
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
