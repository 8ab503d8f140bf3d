"""Surfaces for other programs: PLY, STL, OBJ and glTF, in the frame and unit of the user's files.

.ply   the surface: one closed mesh
.stl   the same
.obj   an object for each part, named as the part, closed
.glb   scene "parts", the one that is shown, a node for each part, closed; scene "surface", one node; scene "cuboids",
       a node a part

Parts run into each other where the shape's do; the surface is their union. Cuboids that other formats are to have go
into a file of their own: readers that join all objects would count them as surface. Positions are exact to float32 of
the shape's own size wherever it stands: far from the origin .obj and .ply have them in double precision, .glb from a
node's translation, and .stl, whose numbers are float32, is refused.

Equal shapes give equal bytes: no times, no names of machines or libraries' versions.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.exported import ExportedShape
from cagesdf.geometry.meshes import Mesh, face_normals, join
from cagesdf.io.meshes import write_ply

TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# glTF's numbers of component types and of buffer targets.
FLOAT, UNSIGNED = 5126, 5125
VERTICES, INDICES = 34962, 34963

# The meshes of a file by name, in scenes by name; the first scene is the one that viewers show.
Scenes = Mapping[str, Mapping[str, Mesh]]


def write_export(path: Path, shape: ExportedShape) -> None:
    """Write a shape in the format that the name's ending says, one of WRITERS.

    Raises InputError for another ending, and for .stl far from the origin.
    """
    scenes = {"parts": shape.parts, "surface": {"surface": shape.surface}, "cuboids": shape.cuboids}
    _write(path, shape.origin, shape.surface, scenes)


def write_boxes(path: Path, shape: ExportedShape) -> None:
    """Write a shape's cuboids alone, as `write_export` writes surfaces."""
    _write(path, shape.origin, join([*shape.cuboids.values()]), {"cuboids": shape.cuboids})


def _write(path: Path, origin: Float[ndarray, " 3"], whole: Mesh, scenes: Scenes) -> None:
    check_name(path)
    WRITERS[path.suffix.lower()](path, origin, whole, scenes)


def check_name(path: Path) -> None:
    """Raise InputError for a name that doesn't end like one of WRITERS."""
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"{path}: wanted a name that ends in {', '.join(WRITERS)}")


def _positions(mesh: Mesh, origin: Float[ndarray, " 3"]) -> Float[ndarray, "v 3"]:
    """Vertices in the user's frame: float32 near the origin, float64 far from there."""
    return mesh.vertices + origin if origin.any() else mesh.vertices.astype(np.float32)


def _write_ply(path: Path, origin: Float[ndarray, " 3"], whole: Mesh, scenes: Scenes) -> None:
    write_ply(path, whole.with_vertices(whole.vertices + origin), "double" if origin.any() else "float")


def _write_stl(path: Path, origin: Float[ndarray, " 3"], whole: Mesh, scenes: Scenes) -> None:
    if origin.any():
        reach = np.abs(origin).max()
        raise InputError(
            f"{path.suffix}: the shape is {reach:,.0f} from the origin, where STL's float32 numbers are "
            f"{np.spacing(np.float32(reach)):.2g} apart; write .obj, .ply or .glb, or move the shape to the origin"
        )
    normals = face_normals(whole)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = np.zeros(len(normals), TRIANGLE)
    triangles["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    triangles["corners"] = whole.corners()
    path.write_bytes(bytes(80) + np.uint32(len(triangles)).astype("<u4").tobytes() + triangles.tobytes())


def _write_obj(path: Path, origin: Float[ndarray, " 3"], whole: Mesh, scenes: Scenes) -> None:
    shown = next(iter(scenes.values()))
    groups = [(_positions(mesh, origin), {name: mesh.faces}) for name, mesh in shown.items()]
    path.write_text(obj(groups), encoding="utf-8", newline="\n")


def obj(groups: Iterable[tuple[Float[ndarray, "_ 3"], Mapping[str, Int[ndarray, "_ 3"]]]]) -> str:
    """Wavefront OBJ: vertices, and the faces over them by object; as many digits as distinguish numbers of their type.

    Names have underscores for blanks, where some readers would cut them.
    """
    lines: list[str] = []
    start = 1
    for vertices, objects in groups:
        lines += [f"v {x} {y} {z}" for x, y, z in vertices.astype(str).tolist()]
        for name, faces in objects.items():
            lines += [f"o {'_'.join(name.split())}", *(f"f {a} {b} {c}" for a, b, c in (faces + start).tolist())]
        start += len(vertices)
    return "\n".join(lines) + "\n"


def _write_glb(path: Path, origin: Float[ndarray, " 3"], whole: Mesh, scenes: Scenes) -> None:
    gltf = _Gltf()
    for name, meshes in scenes.items():
        gltf.add_scene(name, meshes, origin)
    path.write_bytes(gltf.packed())


class _Gltf:
    """glTF 2.0 in one binary file, as it grows."""

    def __init__(self) -> None:
        self._tree: dict[str, Any] = {"asset": {"version": "2.0", "generator": "cagesdf"}, "scene": 0}
        self._tree |= {kind: [] for kind in ("scenes", "nodes", "meshes", "accessors", "bufferViews")}
        self._bytes = bytearray()

    def add_scene(self, name: str, meshes: Mapping[str, Mesh], origin: Float[ndarray, " 3"]) -> None:
        """A scene with a node, moved to `origin`, for each mesh."""
        translation = {"translation": origin.tolist()} if origin.any() else {}
        nodes = []
        for part, mesh in meshes.items():
            positions = mesh.vertices.astype("<f4")
            bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
            attributes = {"POSITION": self._add(positions, "VEC3", FLOAT, VERTICES, len(positions), bounds)}
            indices = self._add(mesh.faces.astype("<u4"), "SCALAR", UNSIGNED, INDICES, mesh.faces.size, {})
            primitive = {"attributes": attributes, "indices": indices}
            self._append("meshes", {"name": f"{name}/{part}", "primitives": [primitive]})
            node = {"name": part, "mesh": len(self._tree["meshes"]) - 1, **translation}
            nodes.append(self._append("nodes", node))
        self._append("scenes", {"name": name, "nodes": nodes})

    def _add(self, array: ndarray, kind: str, number: int, target: int, count: int, bounds: dict[str, Any]) -> int:
        """Add numbers in a view of their own; returns the number of their accessor."""
        content = array.tobytes()
        view = {"buffer": 0, "byteOffset": len(self._bytes), "byteLength": len(content), "target": target}
        self._bytes += content
        accessor = {"bufferView": self._append("bufferViews", view), "componentType": number}
        return self._append("accessors", {**accessor, "count": count, "type": kind, **bounds})

    def _append(self, kind: str, entry: dict[str, Any]) -> int:
        self._tree[kind].append(entry)
        return len(self._tree[kind]) - 1

    def packed(self) -> bytes:
        """The file: header, JSON, numbers."""
        text = json.dumps({**self._tree, "buffers": [{"byteLength": len(self._bytes)}]}, separators=(",", ":"))
        chunks = b"".join(
            np.array([len(content) + -len(content) % 4], "<u4").tobytes() + kind + content + fill * (-len(content) % 4)
            for kind, content, fill in ((b"JSON", text.encode("utf-8"), b" "), (b"BIN\0", bytes(self._bytes), b"\0"))
        )
        return b"glTF" + np.array([2, 12 + len(chunks)], "<u4").tobytes() + chunks


WRITERS: dict[str, Callable[[Path, Float[ndarray, " 3"], Mesh, Scenes], None]] = {
    ".ply": _write_ply,
    ".obj": _write_obj,
    ".stl": _write_stl,
    ".glb": _write_glb,
}
