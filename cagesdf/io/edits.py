"""`edits/`: the arms' results in the trials.

edits.parquet     one row an arm and trial
surfaces.parquet  the surfaces of swaps and mixes, a row group each
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cagesdf.errors import InputError
from cagesdf.geometry.meshes import Mesh
from cagesdf.io.metadata import COMPRESSION, Column, Layout, read_block

KIND = "edits"
PERCENT = "% of the longest side of the true bounding box"
MEANINGS = {
    "distance": f"mean exact distance to the other surface, mean of both directions, {PERCENT}",
    "distance_detail": "the same of the detail of the parts whose style changed; NaN where there is none",
    "gain": "1 - distance_detail / that of the unchanged shape; NaN but for swaps and mixes",
    "refit": "mean % of a cuboid's length that its part leaves free at an end which the true surface reaches",
    "overshoot": f"largest distance of a vertex outside all cuboids, {PERCENT}",
    "symmetry": f"mean distance to the mirror image, {PERCENT}; NaN but for symmetric cages at rest",
    "moved_mean": f"mean distance that the surface of untouched cuboids moved, {PERCENT}; NaN but for local edits",
    "moved_max": "the largest of these distances",
}
EDITS = Layout(
    "edits",
    1,
    (
        Column("arm", pa.string(), "what gave the surface"),
        Column("trial_id", pa.string(), "of the trials that it was tried on"),
        Column(
            "kind", pa.string(), "rest, local, beyond, bent, swap, warp, mix, mix_warp or mix_keep: see docs/metrics.md"
        ),
        Column("shape_id", pa.string(), "whose cuboids these are, or were before they moved"),
        Column("style_of", pa.string(), "whose latent a network is given"),
        *(Column(name, pa.float64(), meaning) for name, meaning in MEANINGS.items()),
    ),
)
SURFACES = Layout(
    "edit_surfaces",
    2,
    (
        Column("arm", pa.string(), "what gave the surface"),
        Column("trial_id", pa.string(), "the swap"),
        Column("vertices", pa.list_(pa.float32()), "x, y, z of each vertex in turn"),
        Column("faces", pa.list_(pa.int32()), "three vertex indices of each face in turn, outwards"),
    ),
    {"frame": "canonical"},
)


def write_edits(path: Path, rows: Iterable[Mapping[str, Any]], definitions: Mapping[str, Any]) -> None:
    """Write rows, sorted, and what their figures mean, as one file."""
    EDITS.write(
        path, sorted(map(dict, rows), key=lambda row: (row["arm"], row["trial_id"])), definitions=dict(definitions)
    )


def read_edits(path: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows of one file, and what their figures mean."""
    return EDITS.read(path), read_block(EDITS.open(path).schema_arrow, path)["definitions"]


def write_edit_surfaces(folder: Path, surfaces: Mapping[tuple[str, str], Mesh]) -> None:
    """Write surfaces by arm and trial, sorted; positions are rounded to float32."""
    with pq.ParquetWriter(folder / "surfaces.parquet", SURFACES.schema(), **COMPRESSION) as writer:
        for (arm, trial_id), mesh in sorted(surfaces.items()):
            row = {
                "arm": arm,
                "trial_id": trial_id,
                "vertices": mesh.vertices.astype(np.float32).ravel(),
                "faces": mesh.faces.ravel(),
            }
            writer.write_table(SURFACES.table([row]))


def read_edit_surface(folder: Path, arm: str, trial_id: str) -> Mesh:
    """An arm's surface in one swap. Raises InputError if there is none."""
    file = SURFACES.open(folder / "surfaces.parquet")
    keys = file.read(columns=["arm", "trial_id"]).to_pylist()
    key = {"arm": arm, "trial_id": trial_id}
    if key not in keys:
        raise InputError(f"{folder}: has no surface of {arm} in {trial_id!r}; rerun evaluate_edits")
    table = file.read_row_group(keys.index(key))
    vertices, faces = (table[name][0].values.to_numpy() for name in ("vertices", "faces"))
    return Mesh(vertices.reshape(-1, 3).astype(np.float64), faces.reshape(-1, 3))
