"""Surfaces for other programs: PLY, STL, OBJ and glTF, in the frame and unit of the user's files.

.ply, .stl   the surface
.obj         objects surface/PART, which share their vertices, and cuboids/PART
.glb         scene "surface", the one that is shown, and scene "cuboids", a node a part in each

Equal models give equal bytes: no times, no names of machines or libraries' versions.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.io.meshes import write_ply
from cagesdf.meshes import Mesh, compact, face_normals

TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# glTF's numbers for what they are called here.
FLOAT, UNSIGNED = 5126, 5125
VERTICES, INDICES = 34962, 34963


@dataclass(frozen=True, eq=False)
class Model:
    """A surface cut into parts, and their cuboids."""

    surface: Mesh  # raw frame, closed, outwards; as `as_stored` makes it
    owner: Int[ndarray, " f"]  # by face, the number of its part
    cuboids: Mapping[str, Mesh]  # by the part's name, in the order of the numbers; raw frame

    def faces(self) -> dict[str, Int[ndarray, "_ 3"]]:
        """The surface's faces by part, without parts that have none."""
        faces = {part: self.surface.faces[self.owner == i] for i, part in enumerate(self.cuboids)}
        return {part: own for part, own in faces.items() if len(own)}


def as_stored(mesh: Mesh) -> Mesh:
    """A mesh as these formats hold it: positions in float32, vertices that so fall together made one.

    Where readers merge what is in one place, they would find faces without corners else. A closed mesh stays closed:
    what merging takes away are faces between an edge and its opposite.
    """
    positions = mesh.vertices.astype(np.float32)
    places, place = np.unique(positions, axis=0, return_inverse=True)
    a, b, c = place.ravel()[mesh.faces].T
    faces = np.stack([a, b, c], axis=1)[(a != b) & (b != c) & (c != a)]
    return compact(Mesh(places.astype(np.float64), faces.astype(np.int32)))


def write_model(path: Path, model: Model) -> None:
    """Write a model in the format that the name's ending says, one of WRITERS."""
    check_name(path)
    WRITERS[path.suffix.lower()](path, model)


def check_name(path: Path) -> None:
    """Raise InputError for a name that doesn't end like one of WRITERS."""
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"{path}: wanted a name that ends in {', '.join(WRITERS)}")


def _write_ply(path: Path, model: Model) -> None:
    write_ply(path, model.surface)


def _write_stl(path: Path, model: Model) -> None:
    normals = face_normals(model.surface)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = np.zeros(len(normals), TRIANGLE)
    triangles["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    triangles["corners"] = model.surface.corners()
    path.write_bytes(bytes(80) + np.uint32(len(triangles)).astype("<u4").tobytes() + triangles.tobytes())


def _write_obj(path: Path, model: Model) -> None:
    surface = {f"surface/{part}": faces for part, faces in model.faces().items()}
    boxes = [(mesh.vertices, {f"cuboids/{part}": mesh.faces}) for part, mesh in model.cuboids.items()]
    path.write_text(obj([(model.surface.vertices.astype(np.float32), surface), *boxes]), encoding="utf-8", newline="\n")


def obj(groups: Iterable[tuple[Float[ndarray, "_ 3"], Mapping[str, Int[ndarray, "_ 3"]]]]) -> str:
    """Wavefront OBJ: vertices, and the faces over them by object; as many digits as tell the numbers of their type."""
    lines: list[str] = []
    start = 1
    for vertices, objects in groups:
        lines += [f"v {x} {y} {z}" for x, y, z in vertices.astype(str).tolist()]
        for name, faces in objects.items():
            lines += [f"o {_plain(name)}", *(f"f {a} {b} {c}" for a, b, c in (faces + start).tolist())]
        start += len(vertices)
    return "\n".join(lines) + "\n"


def _write_glb(path: Path, model: Model) -> None:
    pieces = {part: compact(Mesh(model.surface.vertices, faces)) for part, faces in model.faces().items()}
    gltf = _Gltf()
    for name, meshes in (("surface", pieces), ("cuboids", model.cuboids)):
        gltf.add_scene(name, meshes)
    path.write_bytes(gltf.packed())


class _Gltf:
    """glTF 2.0 in one binary file, as it grows."""

    def __init__(self) -> None:
        self._tree: dict[str, Any] = {"asset": {"version": "2.0", "generator": "cagesdf"}, "scene": 0}
        self._tree |= {kind: [] for kind in ("scenes", "nodes", "meshes", "accessors", "bufferViews")}
        self._bytes = bytearray()

    def add_scene(self, name: str, meshes: Mapping[str, Mesh]) -> None:
        """A scene with a node and a mesh, both of that name, for each part."""
        nodes = []
        for part, mesh in meshes.items():
            positions = mesh.vertices.astype("<f4")
            bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
            attributes = {"POSITION": self._add(positions, "VEC3", FLOAT, VERTICES, len(positions), bounds)}
            indices = self._add(mesh.faces.astype("<u4"), "SCALAR", UNSIGNED, INDICES, mesh.faces.size, {})
            primitive = {"attributes": attributes, "indices": indices}
            self._append("meshes", {"name": f"{name}/{_plain(part)}", "primitives": [primitive]})
            nodes.append(self._append("nodes", {"name": _plain(part), "mesh": len(self._tree["meshes"]) - 1}))
        self._append("scenes", {"name": name, "nodes": nodes})

    def _add(self, array: ndarray, kind: str, number: int, target: int, count: int, bounds: dict[str, Any]) -> int:
        """Numbers in a view of their own; the number of the accessor to them."""
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


def _plain(name: str) -> str:
    """A name on one line."""
    return " ".join(name.split())


WRITERS: dict[str, Callable[[Path, Model], None]] = {
    ".ply": _write_ply,
    ".obj": _write_obj,
    ".stl": _write_stl,
    ".glb": _write_glb,
}
