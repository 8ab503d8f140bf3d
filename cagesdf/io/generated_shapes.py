"""`generated/<arm>/`: new shapes of a trained arm by each method of drawing codes.

index.parquet     one row a shape: what it was made from, and what was checked
surfaces.parquet  its surface, a row group each, in the index's order
points.parquet    points on its surface, for sets to be compared; none where there is no surface
"""

from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float32
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.geometry.meshes import Mesh, is_closed
from cagesdf.io.metadata import COMPRESSION, Column, Layout, read_block
from cagesdf.shape_generation.generated import BROKEN, EMPTY, OK, GeneratedShape
from cagesdf.structure.base import Structure
from cagesdf.structure.stored import read_structure

KIND = "generated"
KEYS = (
    Column("method", pa.string(), "how its code was drawn: independent, dependent, by_part or isotropic"),
    Column("shape_id", pa.string(), "unique in its method; methods of an arm share the cages of equal ids"),
)
INDEX = Layout(
    "generated",
    3,
    (
        *KEYS,
        Column("seed", pa.int64(), "that it was drawn with"),
        Column("draw", pa.int32(), "number of the draw that its cage is of, those without a valid cage counted too"),
        Column("structure", pa.string(), "JSON: a placed program, or a part hierarchy; empty without cuboids"),
        Column("part_ids", pa.list_(pa.string()), "in the structure's order"),
        Column("cuboids", pa.list_(pa.float64()), "of each part in turn: centre (3), axes by rows (9), lengths (3)"),
        Column("floating", pa.int32(), "cuboids that were drawn attached to nothing, and left out"),
        Column("latent", pa.list_(pa.float32()), "the code"),
        Column("other_parts", pa.list_(pa.string()), "ids of parts that have other codes"),
        Column("other_latents", pa.list_(pa.float32()), "those, one after the other"),
        Column("effective", pa.float64(), "1 / sum of the squared weights that its code's kernel was drawn by"),
        Column("status", pa.string(), f"{OK}; {EMPTY}: the network says outside everywhere; {BROKEN}: and why"),
        Column("vertices", pa.int32(), "number of vertices"),
        Column("faces", pa.int32(), "number of faces"),
        Column("closed", pa.bool_(), "no hole, one orientation; false if there is no face"),
        Column("components", pa.int32(), "pieces that hang together"),
        Column("clipped", pa.float64(), "share of the vertices where the cage cut off what the network wanted"),
        Column("evaluations", pa.int64(), "points given to the network"),
        Column("rooted", pa.bool_(), "its cuboids hang together down to the ground; false without cuboids"),
        Column("stable", pa.bool_(), "and don't fall over (static_stability.py); false without cuboids"),
    ),
    {"frame": "canonical"},
)  # fmt: skip
SURFACES = Layout(
    "generated_surfaces",
    1,
    (
        *KEYS,
        Column("vertices", pa.list_(pa.float32()), "x, y, z of each vertex in turn"),
        Column("faces", pa.list_(pa.int32()), "three vertex indices of each face in turn, outwards"),
    ),
    {"frame": "canonical"},
)
POINTS = Layout(
    "generated_points",
    1,
    (*KEYS, Column("points", pa.list_(pa.float32()), "x, y, z of each point in turn, uniform on the surface")),
    {"frame": "canonical"},
)


def index_row(shape: GeneratedShape) -> dict[str, Any]:
    """A shape's row of the index."""
    return {
        "method": shape.method,
        "shape_id": shape.shape_id,
        "seed": shape.seed,
        "draw": shape.draw,
        "structure": shape.structure.to_json() if shape.structure is not None else "",
        "part_ids": list(shape.cage.part_ids),
        "cuboids": shape.cage.vectors().ravel(),
        "floating": shape.floating,
        "latent": shape.latent,
        "other_parts": [*shape.part_latents],
        "other_latents": [number for latent in shape.part_latents.values() for number in latent.tolist()],
        "effective": shape.effective,
        "status": shape.status,
        "vertices": len(shape.mesh.vertices),
        "faces": len(shape.mesh.faces),
        "closed": is_closed(shape.mesh),
        "components": shape.components,
        "clipped": shape.clipped,
        "evaluations": shape.evaluations,
        "rooted": shape.rooted,
        "stable": shape.stable,
    }


def write_generated(folder: Path, shapes: Iterable[GeneratedShape], about: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Write shapes as they come, in that order; `about` holds facts about all of them, for JSON. Returns the index."""
    rows: list[dict[str, Any]] = []
    with (
        pq.ParquetWriter(folder / "surfaces.parquet", SURFACES.schema(), **COMPRESSION) as surfaces,
        pq.ParquetWriter(folder / "points.parquet", POINTS.schema(), **COMPRESSION) as points,
    ):
        for shape in shapes:
            key = {"method": shape.method, "shape_id": shape.shape_id}
            vertices = shape.mesh.vertices.astype(np.float32).ravel()
            surfaces.write_table(SURFACES.table([{**key, "vertices": vertices, "faces": shape.mesh.faces.ravel()}]))
            points.write_table(POINTS.table([{**key, "points": shape.points.ravel()}]))
            rows.append(index_row(shape))
    INDEX.write(folder / "index.parquet", rows, about=dict(about))
    return rows


class GeneratedFolder:
    """The new shapes of an artefact; cheap to send to another process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder}

    @cached_property
    def rows(self) -> dict[tuple[str, str], dict[str, Any]]:
        """Rows of the index by method and shape id, in the order in which they were written."""
        return {(row["method"], row["shape_id"]): row for row in INDEX.read(self.folder / "index.parquet")}

    @property
    def about(self) -> dict[str, Any]:
        """Facts about all shapes together, such as the methods of the draw."""
        path = self.folder / "index.parquet"
        return read_block(INDEX.open(path).schema_arrow, path)["about"]

    @property
    def methods(self) -> tuple[str, ...]:
        """The methods by which codes were drawn; those without a shape come last."""
        return tuple(dict.fromkeys([*(method for method, _ in self.rows), *self.about.get("methods", ())]))

    def cage(self, method: str, shape_id: str) -> Cage:
        """The cuboids of one shape; none where the arm knows none. Raises InputError if there is no such shape."""
        row = self._row(method, shape_id)
        return Cage.from_vectors(tuple(row["part_ids"]), np.array(row["cuboids"]).reshape(-1, 15))

    def structure(self, method: str, shape_id: str) -> Structure | None:
        """The structure of one shape, None where the arm knows no cuboids. Raises InputError if there is no such."""
        text = self._row(method, shape_id)["structure"]
        return read_structure(text) if text else None

    def ids(self, method: str) -> tuple[str, ...]:
        """Ids of a method's shapes, in the index's order."""
        return tuple(shape_id for name, shape_id in self.rows if name == method)

    def points(self, method: str) -> dict[str, Float32[ndarray, "n 3"]]:
        """Points on the surfaces of a method's shapes, by shape id, in the index's order; none without a surface.

        Raises InputError if they aren't those of the index's shapes.
        """
        path = self.folder / "points.parquet"
        table = POINTS.open(path).read()
        columns = (table[column] for column in ("method", "shape_id", "points"))
        by_id = {
            str(shape_id): points.values.to_numpy().reshape(-1, 3)
            for name, shape_id, points in zip(*columns)
            if str(name) == method
        }
        ids = self.ids(method)
        if by_id.keys() != {*ids}:
            odd = min(by_id.keys() ^ {*ids})
            raise InputError(f"{path}: shape {odd!r} of method {method!r} is in it or in index.parquet, wanted in both")
        return {shape_id: by_id[shape_id] for shape_id in ids}

    def surface(self, method: str, shape_id: str) -> Mesh:
        """The surface of one shape, without faces where it has none. Raises InputError if there is no such shape."""
        self._row(method, shape_id)
        file = SURFACES.open(self.folder / "surfaces.parquet")
        table = file.read_row_group(list(self.rows).index((method, shape_id)))
        vertices, faces = (table[name][0].values.to_numpy() for name in ("vertices", "faces"))
        return Mesh(vertices.reshape(-1, 3).astype(np.float64), faces.reshape(-1, 3))

    def _row(self, method: str, shape_id: str) -> dict[str, Any]:
        if (method, shape_id) not in self.rows:
            raise InputError(f"{self.folder}: has no shape {shape_id!r} of method {method!r}; rerun generate")
        return self.rows[method, shape_id]


def read_generated(folder: Path) -> GeneratedFolder:
    """Open `generated/` for reading."""
    return GeneratedFolder(folder)
