"""`meshes/`: extracted surfaces, one .ply file each, and an index.

<shape_id>-<step>.ply   canonical frame; binary little endian, float32 positions
index.parquet           one row a surface, sorted, with the similarity that leads to the user's frame
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pyarrow as pa

from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh, is_closed
from cagesdf.io.metadata import Column, Layout

KIND = "meshes"
INDEX = Layout(
    "meshes",
    2,
    (
        Column("shape_id", pa.string(), "the source"),
        Column("step", pa.int32(), "of its sequence; 0 is the rest shape"),
        Column("held_out", pa.bool_(), "the step was kept from training"),
        Column("file", pa.string(), "name in this folder"),
        Column("vertices", pa.int32(), "number of vertices"),
        Column("faces", pa.int32(), "number of faces; 0: the network says outside everywhere"),
        Column("closed", pa.bool_(), "no hole, one orientation; false if there is no face"),
        Column("clipped", pa.float64(), "share of the vertices where the cage cut off what the network wanted"),
        Column("evaluations", pa.int64(), "points given to the network"),
        Column("components", pa.int32(), "pieces that hang together"),
        Column("dropped", pa.int32(), "further pieces that were left out"),
        Column("overshoot", pa.float64(), "how far the surface leaves the cuboids, in cells"),
        Column("similarity", pa.list_(pa.float64()), "raw → canonical: scale, rotation by rows, translation"),
    ),
    {"frame": "canonical"},
)
HEADER = (
    "ply\nformat binary_little_endian 1.0\n"
    "element vertex {vertices}\nproperty {kind} x\nproperty {kind} y\nproperty {kind} z\n"
    "element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
)
# PLY's names of the number types of positions.
KINDS: dict[str, np.dtype[Any]] = {"float": np.dtype("<f4"), "double": np.dtype("<f8")}
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


@dataclass(frozen=True, eq=False)
class Surface:
    """One extracted surface."""

    shape_id: str  # the source
    step: int  # of its sequence
    held_out: bool  # the step was kept from training
    mesh: Mesh  # canonical; closed, or without faces
    clipped: float  # share of the vertices where the cage cut the network's surface off
    evaluations: int  # points at which the network was evaluated
    similarity: Similarity  # raw → canonical
    components: int = 1  # connected components
    dropped: int = 0  # further components that were left out
    overshoot: float = 0.0  # distance by which it leaves the cuboids, in cells

    def in_raw(self) -> Mesh:
        """The mesh in the frame and unit of the user's files."""
        return self.mesh.with_vertices(self.similarity.to_raw(self.mesh.vertices))


def write_surfaces(folder: Path, surfaces: Iterable[Surface]) -> None:
    """Write surfaces as they come, and the index, sorted.

    Raises ValueError if one that has faces isn't closed, naming it.
    """
    rows = []
    for surface in surfaces:
        closed = is_closed(surface.mesh)
        if len(surface.mesh.faces) and not closed:
            raise ValueError(
                f"shape {surface.shape_id}, step {surface.step}: the surface of {len(surface.mesh.faces)} faces "
                "is not closed; this is an error of the extraction, please report it"
            )
        file = f"{quote(surface.shape_id, safe='')}-{surface.step}.ply"
        write_ply(folder / file, surface.mesh)
        rows.append(
            {
                "shape_id": surface.shape_id,
                "step": surface.step,
                "held_out": surface.held_out,
                "file": file,
                "vertices": len(surface.mesh.vertices),
                "faces": len(surface.mesh.faces),
                "closed": closed,
                "clipped": surface.clipped,
                "evaluations": surface.evaluations,
                "components": surface.components,
                "dropped": surface.dropped,
                "overshoot": surface.overshoot,
                "similarity": surface.similarity.to_numbers(),
            }
        )
    INDEX.write(folder / "index.parquet", sorted(rows, key=lambda row: (row["shape_id"], row["step"])))


class SurfaceFolder:
    """The surfaces of an artefact, read one at a time; cheap to send to another process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def rows(self) -> dict[tuple[str, int], dict[str, Any]]:
        """Rows of the index by shape id and step, sorted."""
        return {(row["shape_id"], row["step"]): row for row in INDEX.read(self.folder / "index.parquet")}

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder}

    def read(self, shape_id: str, step: int) -> Surface:
        """One surface. Raises InputError if there is none of that shape and step, or its file is damaged."""
        if (shape_id, step) not in self.rows:
            raise InputError(f"{self.folder}: has no surface of shape {shape_id!r}, step {step}")
        row = self.rows[shape_id, step]
        mesh = read_ply(self.folder / row["file"])
        similarity = Similarity.from_numbers(row["similarity"])
        return Surface(
            shape_id,
            step,
            row["held_out"],
            mesh,
            row["clipped"],
            row["evaluations"],
            similarity,
            row["components"],
            row["dropped"],
            row["overshoot"],
        )

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Surface]:
        return (self.read(*key) for key in self.rows)


def read_surfaces(folder: Path) -> SurfaceFolder:
    """Open `meshes/` for reading, a surface at a time."""
    return SurfaceFolder(folder)


def write_ply(path: Path, mesh: Mesh, kind: str = "float") -> None:
    """Write a mesh as binary PLY; positions are rounded to `kind`, one of KINDS."""
    faces = np.empty(len(mesh.faces), FACE)
    faces["count"] = 3
    faces["corners"] = mesh.faces
    header = HEADER.format(vertices=len(mesh.vertices), kind=kind, faces=len(faces))
    path.write_bytes(header.encode("ascii") + mesh.vertices.astype(KINDS[kind]).tobytes() + faces.tobytes())


def read_ply(path: Path) -> Mesh:
    """Undo `write_ply`. Raises InputError for any other kind of PLY file, and for a damaged one."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; rerun extract_meshes")
    content = path.read_bytes()
    head, end, body = content.partition(b"end_header\n")
    counts = [int(word) for word in head.split() if word.isdigit()][:2]
    headers = {
        HEADER.format(vertices=counts[0], kind=kind, faces=counts[1]).encode("ascii"): dtype
        for kind, dtype in KINDS.items()
        if len(counts) == 2
    }
    if head + end not in headers:
        raise InputError(f"{path}: not a PLY file of this project (binary, triangles)")
    vertices, faces = counts
    number = headers[head + end]
    start = 3 * number.itemsize * vertices
    if len(body) != start + FACE.itemsize * faces:
        raise InputError(
            f"{path}: wanted {vertices} vertices and {faces} faces in "
            f"{start + FACE.itemsize * faces} bytes, got {len(body)}; rerun extract_meshes"
        )
    positions = np.frombuffer(body, number, 3 * vertices).reshape(-1, 3)
    records = np.frombuffer(body, FACE, faces, offset=start)
    corners = records["corners"].astype(np.int32)
    if (records["count"] != 3).any() or ((corners < 0) | (corners >= vertices)).any() or np.isnan(positions).any():
        raise InputError(f"{path}: has faces of other vertices than its own, so it is damaged; rerun extract_meshes")
    return Mesh(positions.astype(np.float64), corners)
