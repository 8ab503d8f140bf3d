"""`shapes/`: closed part meshes, structures and similarities.

shapes.parquet     one row a shape
parts.parquet      one row a part, one row group a shape, in the order of shapes.parquet
alignment.parquet  one row a part of a shape with a program: which meshes it is
origins.parquet    one row a shape, if parts of any were found: whose parts they are, and why
"""

from collections.abc import Iterable, Iterator
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh
from cagesdf.io.metadata import COMPRESSION, Column, Layout, check_kind
from cagesdf.shape import GIVEN, AlignedPart, Audit, Origin, Part, Repair, Shape
from cagesdf.structure.base import Structure
from cagesdf.structure.stored import read_structure

KIND = "shapes"
REPAIR = tuple(field.name for field in fields(Repair))  # columns of parts.parquet, by the same names
SHAPES = Layout(
    "shapes",
    3,
    (
        Column("shape_id", pa.string(), "unique in its category"),
        Column("split", pa.string(), "train or val"),
        Column("status", pa.string(), "passed or repaired"),
        Column("parts", pa.int32(), "number of parts"),
        Column("faces", pa.int32(), "faces of all parts together"),
        Column("audit_clear", pa.int32(), "points at which rays through the faces as read agree on the side"),
        Column("audit_differ", pa.int32(), "of these, points that the closed parts' union puts on the other side"),
        Column("inside", pa.float64(), "share of the shape's axis-aligned box that is inside the union"),
        Column("inside_outlier", pa.float64(), "robust z-score of the logarithm of `inside` among all shapes here"),
        Column("similarity", pa.list_(pa.float64()), "raw → canonical: scale, rotation by rows, translation"),
        Column(
            "structure",
            pa.string(),
            "JSON: a part hierarchy as StructureNet's, or a program and its placement; canonical",
        ),
    ),
    {"frame": "canonical"},
)
PARTS = Layout(
    "parts",
    3,
    (
        Column("shape_id", pa.string(), "the shape it belongs to"),
        Column("part_id", pa.string(), "unique in its shape"),
        Column("label", pa.string(), "semantic name, empty if there is none"),
        Column("method", pa.string(), "last step of the repair that closed it: none, flipped, merged, ..."),
        Column("faces_before", pa.int32(), "faces as read"),
        Column("faces_after", pa.int32(), "faces of the closed mesh"),
        Column("volume", pa.float64(), "of the closed mesh, cubic canonical units"),
        Column("inside", pa.float64(), "share of the part's axis-aligned box that is inside the closed mesh"),
        Column("dropped", pa.int32(), "pieces left out: sheets that the rest represents, specks"),
        Column("plates", pa.int32(), "sheets that were given a thickness"),
        Column("lost", pa.float64(), "share of the area as read that lies outside the closed mesh, over 0.002 from it"),
        Column("vertices", pa.list_(pa.float64()), "x, y, z of each vertex in turn, canonical units"),
        Column("faces", pa.list_(pa.int32()), "three vertex indices of each face in turn, outwards"),
    ),
    {"frame": "canonical"},
)
ALIGNMENT = Layout(
    "alignment",
    1,
    (
        Column("shape_id", pa.string(), "the shape it belongs to"),
        Column("part_id", pa.string(), "a leaf of the shape's program"),
        Column("node_id", pa.string(), "node of the part tree that it was matched to, empty if none was"),
        Column("label", pa.string(), "that node's"),
        Column("objs", pa.list_(pa.string()), "names of the node's meshes"),
        Column("leftovers", pa.list_(pa.string()), "names of further meshes that lie in its cuboid"),
        Column("iou", pa.float64(), "of the leaf's cuboid and the node's box along its axes, both padded"),
    ),
)

ORIGINS = Layout(
    "origins",
    1,
    (
        Column("shape_id", pa.string(), "whose parts these are"),
        Column("parts", pa.string(), "given by its files, found in its surface, or written in a file beside it"),
        Column("reason", pa.string(), "why"),
        Column("components", pa.int32(), "connected solids that parts were found in; 0 where they were given"),
        Column("boxes", pa.float64(), "volume of all cuboids over the shape's; 0 where parts were given"),
    ),
)


def write_shapes(folder: Path, shapes: Iterable[Shape]) -> None:
    """Write all shapes, sorted by id."""
    shapes = sorted(shapes, key=lambda shape: shape.shape_id)
    SHAPES.write(
        folder / "shapes.parquet",
        [
            {
                "shape_id": shape.shape_id,
                "split": shape.split,
                "status": shape.status,
                "parts": len(shape.parts),
                "faces": sum(len(part.mesh.faces) for part in shape.parts),
                "audit_clear": shape.audit.clear,
                "audit_differ": shape.audit.differ,
                "inside": shape.audit.inside,
                "inside_outlier": shape.audit.outlier,
                "similarity": shape.similarity.to_numbers(),
                "structure": shape.structure.to_json(),
            }
            for shape in shapes
        ],
    )
    with pq.ParquetWriter(folder / "parts.parquet", PARTS.schema(), **COMPRESSION) as writer:
        for shape in shapes:
            writer.write_table(PARTS.table([_part_row(shape.shape_id, part) for part in shape.parts]))
    ALIGNMENT.write(
        folder / "alignment.parquet",
        [{"shape_id": shape.shape_id, **vars(part)} for shape in shapes for part in shape.alignment],
    )

    if any(shape.origin != GIVEN for shape in shapes):
        ORIGINS.write(
            folder / "origins.parquet", [{"shape_id": shape.shape_id, **vars(shape.origin)} for shape in shapes]
        )


def _part_row(shape_id: str, part: Part) -> dict[str, Any]:
    return {
        "shape_id": shape_id,
        "part_id": part.part_id,
        "label": part.label,
        **{name: getattr(part.repair, name) for name in REPAIR},
        "vertices": part.mesh.vertices.ravel(),
        "faces": part.mesh.faces.ravel(),
    }


class ShapeFolder:
    """The shapes of an artefact, read one at a time; cheap to send to another process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def _rows(self) -> dict[str, dict[str, Any]]:
        return {row["shape_id"]: row for row in SHAPES.read(self.folder / "shapes.parquet")}

    @cached_property
    def _parts(self) -> pq.ParquetFile:
        return PARTS.open(self.folder / "parts.parquet")

    @cached_property
    def _alignments(self) -> dict[str, tuple[AlignedPart, ...]]:
        by_shape: dict[str, tuple[AlignedPart, ...]] = {}
        for row in ALIGNMENT.read(self.folder / "alignment.parquet"):
            shape_id, objs, leftovers = row.pop("shape_id"), tuple(row.pop("objs")), tuple(row.pop("leftovers"))
            by_shape[shape_id] = (*by_shape.get(shape_id, ()), AlignedPart(**row, objs=objs, leftovers=leftovers))
        return by_shape

    @cached_property
    def _origins(self) -> dict[str, Origin]:
        path = self.folder / "origins.parquet"
        return {row.pop("shape_id"): Origin(**row) for row in ORIGINS.read(path)} if path.is_file() else {}

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder}

    @property
    def ids(self) -> tuple[str, ...]:
        """All shape ids, sorted."""
        return tuple(self._rows)

    def ids_of(self, split: str) -> tuple[str, ...]:
        """Ids of the shapes of one split, sorted."""
        return tuple(shape_id for shape_id, row in self._rows.items() if row["split"] == split)

    def structure(self, shape_id: str) -> Structure:
        """The structure of one shape, without reading its meshes."""
        return read_structure(self._row(shape_id)["structure"])

    def alignment(self, shape_id: str) -> tuple[AlignedPart, ...]:
        """Parts matched to the leaves of a shape's program, without reading meshes; empty without a program."""
        return self._alignments.get(shape_id, ())

    def similarity(self, shape_id: str) -> Similarity:
        """The similarity of one shape, without reading its meshes."""
        return Similarity.from_numbers(self._row(shape_id)["similarity"])

    def _row(self, shape_id: str) -> dict[str, Any]:
        if shape_id not in self._rows:
            raise InputError(f"{self.folder}: has no shape {shape_id!r}; it holds {', '.join(self.ids[:8])} ...")
        return self._rows[shape_id]

    def read(self, shape_id: str) -> Shape:
        """One shape. Raises InputError if there is none of that id."""
        row = self._row(shape_id)
        table = self._parts.read_row_group(self.ids.index(shape_id))
        numbers = {name: [item.values.to_numpy() for item in table[name]] for name in ("vertices", "faces")}
        parts = tuple(
            Part(
                part["part_id"],
                part["label"],
                Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3)),
                Repair(**{name: part[name] for name in REPAIR}),
            )
            for part, vertices, faces in zip(
                table.drop_columns(["vertices", "faces"]).to_pylist(), numbers["vertices"], numbers["faces"]
            )
        )
        return Shape(
            shape_id,
            row["split"],
            parts,
            self.structure(shape_id),
            self.similarity(shape_id),
            self.alignment(shape_id),
            Audit(row["audit_clear"], row["audit_differ"], row["inside"], row["inside_outlier"]),
            self._origins.get(shape_id, GIVEN),
        )

    def __len__(self) -> int:
        return len(self.ids)

    def __iter__(self) -> Iterator[Shape]:
        return map(self.read, self.ids)


def read_shapes(folder: Path) -> ShapeFolder:
    """Open `shapes/` for reading, a shape at a time. Raises InputError for a folder of another kind."""
    wanted = "a folder that the import_shapes stage wrote, such as data/shapes/chair"
    check_kind(folder, "shapes.parquet", "a folder of shapes", wanted)
    return ShapeFolder(folder)
