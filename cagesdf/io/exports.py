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
from cagesdf.geometry.meshes import Mesh, compact, face_normals, join
from cagesdf.io.meshes import write_ply

TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# glTF's numbers of component types and of buffer targets.
FLOAT, UNSIGNED = 5126, 5125
VERTICES, INDICES = 34962, 34963

# Beyond FAR times its longest side from the origin a shape is written from an origin of its own. Up to there float32
# changes volumes by less than 1e-5 (docs/editing.md); at 1,000 times it makes edges where four faces meet.
FAR = 64
FARTHEST = 2.0**36  # longest sides from the origin: there float64 is as exact as float32 at FAR
SMALLEST, LARGEST = 1e-30, 1e30  # longest sides, user's unit, whose squares float32 holds


@dataclass(frozen=True, eq=False)
class Model:
    """A surface, the parts whose union it is, and their cuboids. Frame: the user's, from `origin`."""

    surface: Mesh  # closed, outward; as `as_stored` makes it
    parts: Mapping[str, Mesh]  # by name, those that have faces; closed, outward, stored in the same way
    cuboids: Mapping[str, Mesh]  # by name
    origin: Float[ndarray, " 3"]  # user's frame; 0 for all shapes but those that are far from there

    @staticmethod
    def of(mesh: Mesh, parts: Mapping[str, Mesh], cuboids: Mapping[str, Mesh]) -> "Model":
        """A model of a surface, parts and cuboids in the user's frame; names are distinct, on one line each.

        Raises InputError as `as_stored`.
        """
        place = Place.of(mesh)
        stored = {part: place.stored(solid) for part, solid in parts.items()}
        boxes = {part: box.with_vertices(box.vertices - place.origin) for part, box in cuboids.items()}
        held = {part: solid for part, solid in stored.items() if len(solid.faces)}
        return Model(place.stored(mesh), held, boxes, place.origin)


# The meshes of a file by name, in scenes by name; the first scene is the one that viewers show.
Scenes = Mapping[str, Mapping[str, Mesh]]


@dataclass(frozen=True, eq=False)
class Place:
    """Origin and step of a shape's stored vertices."""

    origin: Float[ndarray, " 3"]  # of the stored vertices, in the mesh's own frame
    step: float  # between possible coordinates, mesh units; 0: float32's

    @staticmethod
    def of(mesh: Mesh) -> "Place":
        """The place for a mesh, and for meshes beside it. Raises InputError as `as_stored`."""
        if not len(mesh.faces):
            return Place(np.zeros(3), 0.0)
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        side, reach = float((high - low).max()), float(np.abs(mesh.vertices).max())
        if not (SMALLEST <= side <= LARGEST and reach <= FARTHEST * side):
            raise InputError(
                f"the surface is {side:.3g} long and {reach:.3g} from the origin; files hold lengths from "
                f"{SMALLEST:g} to {LARGEST:g}, at most {FARTHEST:.2g} times as far from the origin; move it there, or "
                "use another unit"
            )
        if reach <= FAR * side:
            return Place(np.zeros(3), 0.0)
        unit = 2.0 ** np.ceil(np.log2(side))
        step = max(unit * 2.0**-23, 2.0 ** (np.ceil(np.log2(reach)) - 52))
        return Place(np.round((low + high) / 2 / unit) * unit, step)

    def stored(self, mesh: Mesh) -> Mesh:
        """A mesh from here, as all formats hold it; see `as_stored`."""
        if not len(mesh.faces):
            return mesh
        positions = mesh.vertices
        if self.step:
            # Adding 0 makes -0 be 0.
            positions = np.round((mesh.vertices - self.origin) / self.step) * self.step + 0.0
        places, place = np.unique(positions.astype(np.float32), axis=0, return_inverse=True)
        a, b, c = place.ravel()[mesh.faces].T
        faces = np.stack([a, b, c], axis=1)[(a != b) & (b != c) & (c != a)]
        return compact(Mesh(places.astype(np.float64), faces.astype(np.int32)))


def as_stored(mesh: Mesh) -> tuple[Mesh, Float[ndarray, " 3"]]:
    """A mesh as all formats hold it, and the place, in the mesh's own frame, from which it is given.

    Positions are float32's there, and the place plus a position is exact in float64. Vertices that so fall together are
    made one: readers that merge what is in one place would find faces without corners otherwise. A closed mesh stays
    closed: what merging takes away are faces between an edge and its opposite.

    Raises InputError for a mesh that is too large, too small or too far from the origin for these numbers.
    """
    place = Place.of(mesh)
    return place.stored(mesh), place.origin


def write_model(path: Path, model: Model) -> None:
    """Write a model in the format that the name's ending says, one of WRITERS.

    Raises InputError for another ending, and for .stl far from the origin.
    """
    scenes = {"parts": model.parts, "surface": {"surface": model.surface}, "cuboids": model.cuboids}
    _write(path, model.origin, model.surface, scenes)


def write_boxes(path: Path, model: Model) -> None:
    """Write a model's cuboids alone, as `write_model` writes surfaces."""
    _write(path, model.origin, join([*model.cuboids.values()]), {"cuboids": model.cuboids})


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
