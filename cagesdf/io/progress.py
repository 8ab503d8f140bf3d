"""`progress/`: the quality of arms along their training, one row per (arm, snapshot, shape)."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from cagesdf.evaluation.metrics import PROGRESS as METRICS
from cagesdf.io.metadata import Column, Layout, read_block
from cagesdf.io.scores import MEANINGS

KIND = "progress"
PROGRESS = Layout(
    "progress",
    1,
    (
        Column("arm", pa.string(), "what gave the surface"),
        Column("points", pa.int64(), "trained on until then, repeated ones again"),
        Column("shape_id", pa.string(), "the source"),
        Column("step", pa.int32(), "of its sequence; 0 is the rest shape"),
        Column("held_out", pa.bool_(), "the step was kept from training"),
        *(Column(name, pa.float64(), MEANINGS[name]) for name in METRICS),
    ),
)


def write_progress(folder: Path, rows: Iterable[Mapping[str, Any]], definitions: Mapping[str, Any]) -> None:
    """Write rows, sorted, and how they were measured."""
    ordered = sorted(map(dict, rows), key=lambda row: (row["arm"], row["points"], row["shape_id"]))
    PROGRESS.write(folder / "progress.parquet", ordered, definitions=dict(definitions))


def read_progress(folder: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows, and how they were measured."""
    path = folder / "progress.parquet"
    return PROGRESS.read(path), read_block(PROGRESS.open(path).schema_arrow, path)["definitions"]
