"""`scores/`: one row a (arm, shape, step, seed)."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from cagesdf.evaluation.reconstruction import OWN
from cagesdf.io.metadata import Column, Layout, read_block

KIND = "scores"
PERCENT = "% of the longest side of the true bounding box"
MEANINGS = {
    "surface_distance": f"mean exact distance to the other surface, mean of both directions, {PERCENT}",
    "accuracy": f"the same from the predicted surface to the true one, {PERCENT}",
    "completeness": f"the same from the true surface to the predicted one, {PERCENT}",
    "cd_deepsdf": "mean squared distance to the nearest sampled point, sum of both directions, canonical units squared",
    "cd_l1": "mean distance to the nearest sampled point, mean of both directions, canonical units",
    "f1": "harmonic mean of the shares of points within 1 % of the longest side of the other surface",
    "f2": "the same within 2 %",
    "nc": "mean |cosine| between normals at nearest points, mean of both directions",
    "nc_signed": "the same with its sign",
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
        Column("iou", pa.float64(), "volume of the intersection over volume of the union"),
        Column("closed", pa.float64(), "1 if the surface has no hole and one orientation"),
        Column("same_components", pa.float64(), "1 if it has as many closed pieces as the true one"),
        Column("same_genus", pa.float64(), "1 if it has as many handles as the true one"),
        *(
            Column(own, pa.float64(), f"{name}, the true parts having followed their own cuboids alone")
            for name, own in OWN.items()
        ),
        *(
            Column(f"{name}_detail", pa.float64(), f"{name} of the detail alone; NaN where there is none")
            for name in MEANINGS
        ),
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
