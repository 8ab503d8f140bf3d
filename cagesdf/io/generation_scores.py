"""`generation/`: how near generated shapes come to the references.

generation.parquet  one row a (arm, method, draw of references)
nearest.parquet     one row a generated shape: the training shape it is nearest to
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from cagesdf.io.metadata import Column, Layout, read_block

KIND = "generation"
MEANINGS = {
    "fd": "Fréchet distance of the features to the references'; biased: see the rows of arm real",
    "kpd": "squared maximum mean discrepancy of the features to the references', unbiased",
    "gen": "mean Chamfer distance to the nearest training shape, unsquared; a failed shape has 0",
    "cov": "mean Chamfer distance of a reference to the nearest generated shape, unsquared",
    "var": "mean Chamfer distance to the nearest other generated shape, unsquared; a failed shape has 0",
    "gen_squared": "gen of squared Chamfer distances",
    "cov_squared": "cov of squared Chamfer distances: PointFlow's MMD",
    "var_squared": "var of squared Chamfer distances",
    "coverage": "PointFlow's COV: share of as many references that are nearest to a generated shape; mean over draws",
    "told_apart": "PointFlow's 1-NNA: share of shapes whose nearest is of their own set; mean over draws",
    "recognised": "share of the shapes that the classifier takes for their category; NaN where it doesn't know it",
}
GENERATION = Layout(
    "generation",
    1,
    (
        Column("arm", pa.string(), "whose network made the shapes; real: none did"),
        Column("method", pa.string(), "how latents were drawn; of arm real, which shapes these are"),
        Column("draw", pa.int32(), "of the shapes, where several sets of them were drawn"),
        Column("shapes", pa.int32(), "how many, failed ones too"),
        Column("failed", pa.float64(), "share of them that have no surface"),
        *(Column(name, pa.float64(), meaning) for name, meaning in MEANINGS.items()),
    ),
)
NEAREST = Layout(
    "nearest",
    1,
    (
        Column("arm", pa.string(), "whose network made the shape"),
        Column("method", pa.string(), "how its latent was drawn"),
        Column("shape_id", pa.string(), "of the shape"),
        Column("nearest", pa.string(), "id of the nearest training shape, empty for a failed shape"),
        Column("distance", pa.float64(), "to it: unsquared Chamfer, canonical units; infinite for a failed shape"),
    ),
)


def write_generation(
    folder: Path,
    rows: Iterable[Mapping[str, Any]],
    nearest: Iterable[Mapping[str, Any]],
    definitions: Mapping[str, Any],
) -> None:
    """Write rows, sorted, and how they were measured."""
    ordered = sorted(map(dict, rows), key=lambda row: (row["arm"], row["method"], row["draw"]))
    GENERATION.write(folder / "generation.parquet", ordered, definitions=dict(definitions))
    NEAREST.write(
        folder / "nearest.parquet",
        sorted(map(dict, nearest), key=lambda row: (row["arm"], row["method"], row["shape_id"])),
    )


def read_generation(folder: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows, and how they were measured."""
    path = folder / "generation.parquet"
    return GENERATION.read(path), read_block(GENERATION.open(path).schema_arrow, path)["definitions"]


def read_nearest(folder: Path) -> list[dict[str, Any]]:
    """The nearest training shape of each generated one, sorted by arm, method and id."""
    return NEAREST.read(folder / "nearest.parquet")
