"""`clouds/`: training and reference shapes of a category as points on their surfaces.

clouds.parquet  one row a shape
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.evaluation.clouds import Clouds
from cagesdf.io.metadata import Column, Layout

KIND = "clouds"
SETS = ("train", "reference")
CLOUDS = Layout(
    "clouds",
    1,
    (
        Column("set", pa.string(), "train: trained on; reference: seen in no training"),
        Column("shape_id", pa.string(), "unique in its set"),
        Column("label", pa.string(), "category and family of the recipe, empty where there is none"),
        Column("points", pa.list_(pa.float32()), "x, y, z of points uniform by area on the outer surface"),
    ),
    {"frame": "canonical"},
)


def write_clouds(folder: Path, sets: Mapping[str, Clouds]) -> None:
    """Write the clouds of each of SETS."""
    rows = [
        {"set": name, "shape_id": shape_id, "label": label, "points": points.ravel()}
        for name in SETS
        for shape_id, label, points in zip(sets[name].ids, sets[name].labels, sets[name].points)
    ]
    CLOUDS.write(folder / "clouds.parquet", rows)


def read_clouds(folder: Path) -> dict[str, Clouds]:
    """The clouds of each of SETS. Raises InputError if they don't have the same number of points."""
    path = folder / "clouds.parquet"
    table = CLOUDS.open(path).read()
    points = cloud_array(table["points"], path)
    keys = table.select(["set", "shape_id", "label"]).to_pylist()
    return {name: _clouds(keys, points, name) for name in SETS}


def _clouds(keys: list[dict[str, str]], points: Float[ndarray, "n p 3"], name: str) -> Clouds:
    rows = [i for i, key in enumerate(keys) if key["set"] == name]
    return Clouds(tuple(keys[i]["shape_id"] for i in rows), tuple(keys[i]["label"] for i in rows), points[rows])


def cloud_array(column: pa.ChunkedArray, path: Path) -> Float[ndarray, "n p 3"]:
    """A column of points as one array, float32. Raises InputError if its rows differ in their numbers of points."""
    lengths = {len(item) for item in column}
    if len(lengths) > 1 or any(length % 3 for length in lengths):
        raise InputError(f"{path}: wanted as many points of three numbers in each row, got {sorted(lengths)} numbers")
    values = np.asarray(column.combine_chunks().values.to_numpy(), np.float32)
    return values.reshape(len(column), -1, 3) if len(column) else np.zeros((0, 0, 3), np.float32)
