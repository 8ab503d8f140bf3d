"""`cuboids/`: the cuboids that bound the parts, and the programs that some of them follow from.

cuboids.parquet   one row a part
programs.parquet  one row a shape whose structure is a program
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa

from cagesdf.cage_fitting.fitted import FittedCage
from cagesdf.cuboid import Cage
from cagesdf.io.metadata import Column, Layout
from cagesdf.structure.assembly import Assembly

KIND = "cuboids"
CUBOIDS = Layout(
    "cuboids",
    2,
    (
        Column("shape_id", pa.string(), "unique in its category"),
        Column("part_id", pa.string(), "unique in its shape, in the structure's order"),
        Column("centre", pa.list_(pa.float64()), "canonical"),
        Column("axes", pa.list_(pa.float64()), "three unit axes by rows, right-handed, canonical"),
        Column("size", pa.list_(pa.float64()), "full lengths along the axes, canonical units"),
        Column("overshoot", pa.float64(), "largest signed distance of the part's surface to its cuboid, ≤ 0 bounds"),
        Column("outside_before", pa.float64(), "share of the part's surface outside its cuboid before the fit"),
        Column("outside", pa.float64(), "the same after it"),
        Column("volume_ratio", pa.float64(), "volume over that of the part's minimum-volume box"),
        Column("bounded", pa.bool_(), "false: the program has no numbers with which the cuboid bounds the part"),
    ),
    {"frame": "canonical"},
)
PROGRAMS = Layout(
    "programs",
    2,
    (
        Column("shape_id", pa.string(), "unique in its category"),
        Column("structure", pa.string(), "fitted program and its placement as JSON, canonical frame"),
        Column("loss_before", pa.float64(), "the appendix's, program's unit: of the program as given"),
        Column("loss", pa.float64(), "at its minimum, before the cuboids were made to bound their parts"),
    ),
    {"frame": "canonical"},
)


def write_cuboids(folder: Path, fitted: Mapping[str, FittedCage]) -> None:
    """Write cages, the quality of their fit, and the programs among them, by shape id."""
    CUBOIDS.write(
        folder / "cuboids.parquet",
        [
            {
                "shape_id": shape_id,
                "part_id": part_id,
                "centre": fit.cage.centre[i],
                "axes": fit.cage.axes[i].ravel(),
                "size": fit.cage.size[i],
                **{
                    name: getattr(fit, name)[i].item()
                    for name in ("overshoot", "outside_before", "outside", "volume_ratio", "bounded")
                },
            }
            for shape_id, fit in sorted(fitted.items())
            for i, part_id in enumerate(fit.cage.part_ids)
        ],
    )
    PROGRAMS.write(
        folder / "programs.parquet",
        [
            {
                "shape_id": shape_id,
                "structure": fit.assembly.to_json(),
                "loss_before": fit.loss_before,
                "loss": fit.loss,
            }
            for shape_id, fit in sorted(fitted.items())
            if fit.assembly is not None
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


def read_assemblies(folder: Path) -> dict[str, Assembly]:
    """Fitted programs by shape id; shapes whose cuboids are free have none."""
    rows = PROGRAMS.read(folder / "programs.parquet")
    return {row["shape_id"]: Assembly.from_json(row["structure"]) for row in rows}


def read_bounding(folder: Path) -> dict[str, float]:
    """Quality of all cuboids: means over parts, the number of parts, and the number of unbounded ones."""
    rows = CUBOIDS.read(folder / "cuboids.parquet")
    means = {
        name: float(np.mean([row[name] for row in rows])) for name in ("outside_before", "outside", "volume_ratio")
    }
    return {**means, "parts": len(rows), "unbounded": sum(not row["bounded"] for row in rows)}
