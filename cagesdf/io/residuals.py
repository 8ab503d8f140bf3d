"""`residuals.parquet` of a run: how well it fits each of its shapes, against which new shapes are judged."""

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa

from cagesdf.io.metadata import Column, Layout

RESIDUALS = Layout(
    "residuals",
    1,
    (
        Column("shape_id", pa.string(), "a shape that was trained on"),
        Column("residual", pa.float64(), "mean |sdf error| at rest over training points, in the decoder's unit"),
    ),
)


def write_residuals(folder: Path, residuals: Mapping[str, float]) -> None:
    """Write residuals by shape id into an existing run."""
    rows = [{"shape_id": shape_id, "residual": value} for shape_id, value in sorted(residuals.items())]
    RESIDUALS.write(folder / "residuals.parquet", rows)


def read_residuals(folder: Path) -> dict[str, float]:
    """Residuals by shape id. Raises InputError for a run without them."""
    return {row["shape_id"]: row["residual"] for row in RESIDUALS.read(folder / "residuals.parquet")}
