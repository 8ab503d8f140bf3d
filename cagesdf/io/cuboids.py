"""`cuboids/`: one row a part."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa

from cagesdf.cuboid import Cage
from cagesdf.io.metadata import Column, Layout

KIND = "cuboids"
CUBOIDS = Layout(
    "cuboids",
    1,
    (
        Column("shape_id", pa.string(), "unique in its category"),
        Column("part_id", pa.string(), "unique in its shape, in the structure's order"),
        Column("centre", pa.list_(pa.float64()), "canonical"),
        Column("axes", pa.list_(pa.float64()), "three unit axes by rows, right-handed, canonical"),
        Column("size", pa.list_(pa.float64()), "full lengths along the axes, canonical units"),
        Column("overshoot", pa.float64(), "largest signed distance of the part's surface to its cuboid, ≤ 0 bounds"),
    ),
    {"frame": "canonical"},
)


def write_cuboids(folder: Path, cages: Mapping[str, tuple[Cage, np.ndarray]]) -> None:
    """Write cages and the overshoot of each of their cuboids, by shape id."""
    CUBOIDS.write(
        folder / "cuboids.parquet",
        [
            {
                "shape_id": shape_id,
                "part_id": part_id,
                "centre": cage.centre[i],
                "axes": cage.axes[i].ravel(),
                "size": cage.size[i],
                "overshoot": float(overshoot[i]),
            }
            for shape_id, (cage, overshoot) in sorted(cages.items())
            for i, part_id in enumerate(cage.part_ids)
        ],
    )


def read_cages(folder: Path) -> dict[str, Cage]:
    """Cages by shape id."""
    grouped: dict[str, list[dict]] = {}
    for row in CUBOIDS.read(folder / "cuboids.parquet"):
        grouped.setdefault(row["shape_id"], []).append(row)
    return {
        shape_id: Cage(
            tuple(row["part_id"] for row in rows),
            np.array([row["centre"] for row in rows]),
            np.array([row["axes"] for row in rows]).reshape(-1, 3, 3),
            np.array([row["size"] for row in rows]),
        )
        for shape_id, rows in grouped.items()
    }
