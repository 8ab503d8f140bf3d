"""`scores/`: one row a (arm, shape, step, seed)."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from cagesdf.evaluation.metrics import METRICS
from cagesdf.io.metadata import Column, Layout, read_block

KIND = "scores"
SEEN = {
    "own cuboids": ", the true parts having followed their own cuboids alone",
    "detail": ", of the detail alone; NaN where there is none",
}
MEANINGS = {
    key: metric.meaning + (f", {metric.unit}" if metric.unit else "") + SEEN.get(variant, "")
    for metric in METRICS
    for key, variant in metric.variants.items()
}
SCORES = Layout(
    "scores",
    3,
    (
        Column("arm", pa.string(), "what gave the surface"),
        Column("shape_id", pa.string(), "the source"),
        Column("step", pa.int32(), "of its sequence; 0 is the rest shape"),
        Column("held_out", pa.bool_(), "the step was kept from training"),
        Column("seed", pa.int32(), "of the sampled points"),
        *(Column(name, pa.float64(), meaning) for name, meaning in MEANINGS.items()),
        Column("detail_share", pa.float64(), "share of the true surface that is detail: away from the cage's surface"),
    ),
)


def write_scores(folder: Path, rows: Iterable[Mapping[str, Any]], definitions: Mapping[str, Any]) -> None:
    """Write rows, sorted, and what their figures mean."""
    ordered = sorted(map(dict, rows), key=lambda row: (row["arm"], row["shape_id"], row["step"], row["seed"]))
    SCORES.write(folder / "scores.parquet", ordered, definitions=dict(definitions))


def read_scores(folder: Path) -> tuple[dict[str, list[dict[str, Any]]], dict[str, Any]]:
    """Rows by arm, and what their figures mean."""
    path = folder / "scores.parquet"
    by_arm: dict[str, list[dict[str, Any]]] = {}
    for row in SCORES.read(path):
        by_arm.setdefault(row["arm"], []).append(row)
    return by_arm, read_block(SCORES.open(path).schema_arrow, path)["definitions"]
