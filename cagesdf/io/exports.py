"""Surfaces for other programs: PLY, STL, OBJ and glTF, in the frame and unit of the user's files.

.ply   the surface
.stl   the surface as one solid: cut into parts none of its solids would be closed
.obj   an object for each part, named as the part, over shared vertices
.glb   scene "surface", the one that is shown, and scene "cuboids", a node a part in each

Cuboids that other formats are to have go into a file of their own: readers that join all objects would count them as
surface. Positions are exact to float32 of the shape's own size wherever it stands: far from the origin .obj and .ply
have them in double precision, .glb from a node's translation, and .stl, whose numbers are float32, is refused.

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
from cagesdf.meshes import Mesh, compact, face_normals, join

TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# glTF's numbers for what they are called here.
FLOAT, UNSIGNED = 5126, 5125
VERTICES, INDICES = 34962, 34963

# Beyond FAR times its longest side from the origin a shape is written from an origin of its own. Up to there float32
# changes volumes by less than 1e-5 (docs/editing.md); at 1,000 times it makes edges where four faces meet.
FAR = 64
FARTHEST = 2.0**36  # longest sides from the origin: there float64 is as exact as float32 at FAR
SMALLEST, LARGEST = 1e-30, 1e30  # longest sides, user's unit: what float32 has squares of


@dataclass(frozen=True, eq=False)
class Pieces:
    """A mesh whose faces belong to named parts."""

    mesh: Mesh  # from the model's origin
    owner: Int[ndarray, " f"]  # by face, the number of its part
    parts: tuple[str, ...]  # distinct names, on one line each

    def faces(self) -> dict[str, Int[ndarray, "_ 3"]]:
        """The faces by part, without parts that have none."""
        faces = {part: self.mesh.faces[self.owner == i] for i, part in enumerate(self.parts)}
        return {part: subset for part, subset in faces.items() if len(subset)}


@dataclass(frozen=True, eq=False)
class Model:
    """A surface cut into parts, and their cuboids. Frame: the user's, from `origin`."""

    surface: Mesh  # closed, outwards; as `as_stored` makes it
    owner: Int[ndarray, " f"]  # by face, the number of its part
    cuboids: Mapping[str, Mesh]  # by the part's name, in the order of the numbers
    origin: Float[ndarray, " 3"]  # user's frame; 0 for all shapes but those that are far from there

    @staticmethod
    def of(
        mesh: Mesh,
        cuboids: Mapping[str, Mesh],
        owner_of: Callable[[Float[ndarray, "f 3"]], Int[ndarray, " f"]],
    ) -> "Model":
        """A model of a surface and cuboids in the user's frame; `owner_of` tells faces' parts by their middles, there.

        Raises InputError as `as_stored`.
        """
        surface, origin = as_stored(mesh)
        boxes = {part: box.with_vertices(box.vertices - origin) for part, box in cuboids.items()}
        return Model(surface, owner_of(surface.corners().mean(axis=1) + origin), boxes, origin)

    def pieces(self) -> Pieces:
        """The surface by part."""
        return Pieces(self.surface, self.owner, tuple(self.cuboids))

    def boxes(self) -> Pieces:
        """The cuboids by part."""
        boxes = [*self.cuboids.values()]
        owner = np.repeat(np.arange(len(boxes)), [len(box.faces) for box in boxes])
        return Pieces(join(boxes), owner, tuple(self.cuboids))


# What is written: scenes by name, the one that is shown first.
Scenes = Mapping[str, Pieces]


def as_stored(mesh: Mesh) -> tuple[Mesh, Float[ndarray, " 3"]]:
    """A mesh as all formats hold it, and the place, in the mesh's own frame, from which it is given.

    Positions are float32's there, and the place plus a position is exact in float64. Vertices that so fall together are
    made one: readers that merge what is in one place would find faces without corners otherwise. A closed mesh stays
    closed: what merging takes away are faces between an edge and its opposite.

    Raises InputError for a mesh that is too large, too small or too far from the origin for these numbers.
    """
    if not len(mesh.faces):
        return mesh, np.zeros(3)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    side, reach = float((high - low).max()), float(np.abs(mesh.vertices).max())
    if not (SMALLEST <= side <= LARGEST and reach <= FARTHEST * side):
        raise InputError(
            f"the surface is {side:.3g} long and {reach:.3g} from the origin; files hold lengths from {SMALLEST:g} to "
            f"{LARGEST:g}, at most {FARTHEST:.2g} times as far from the origin; move it there, or use another unit"
        )
    origin, positions = np.zeros(3), mesh.vertices
    if reach > FAR * side:
        unit = 2.0 ** np.ceil(np.log2(side))
        step = max(unit * 2.0**-23, 2.0 ** (np.ceil(np.log2(reach)) - 52))
        origin = np.round((low + high) / 2 / unit) * unit
        # Adding 0 makes -0 be 0.
        positions = np.round((mesh.vertices - origin) / step) * step + 0.0
    places, place = np.unique(positions.astype(np.float32), axis=0, return_inverse=True)
    a, b, c = place.ravel()[mesh.faces].T
    faces = np.stack([a, b, c], axis=1)[(a != b) & (b != c) & (c != a)]
    return compact(Mesh(places.astype(np.float64), faces.astype(np.int32))), origin


def write_model(path: Path, model: Model) -> None:
    """Write a model in the format that the name's ending says, one of WRITERS.

    Raises InputError for another ending, and for .stl far from the origin.
    """
    _write(path, model.origin, {"surface": model.pieces(), "cuboids": model.boxes()})


def write_boxes(path: Path, model: Model) -> None:
    """Write a model's cuboids alone, as `write_model` writes surfaces."""
    _write(path, model.origin, {"cuboids": model.boxes()})


def _write(path: Path, origin: Float[ndarray, " 3"], scenes: Scenes) -> None:
    check_name(path)
    WRITERS[path.suffix.lower()](path, origin, scenes)


def check_name(path: Path) -> None:
    """Raise InputError for a name that doesn't end like one of WRITERS."""
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"{path}: wanted a name that ends in {', '.join(WRITERS)}")


def _shown(scenes: Scenes) -> Pieces:
    return next(iter(scenes.values()))


def _positions(mesh: Mesh, origin: Float[ndarray, " 3"]) -> Float[ndarray, "v 3"]:
    """Vertices in the user's frame: float32 near the origin, float64 far from there."""
    return mesh.vertices + origin if origin.any() else mesh.vertices.astype(np.float32)


def _write_ply(path: Path, origin: Float[ndarray, " 3"], scenes: Scenes) -> None:
    mesh = _shown(scenes).mesh
    write_ply(path, mesh.with_vertices(mesh.vertices + origin), "double" if origin.any() else "float")


def _write_stl(path: Path, origin: Float[ndarray, " 3"], scenes: Scenes) -> None:
    mesh = _shown(scenes).mesh
    if origin.any():
        reach = np.abs(origin).max()
        raise InputError(
            f"{path.suffix}: the shape is {reach:,.0f} from the origin, where STL's float32 numbers are "
            f"{np.spacing(np.float32(reach)):.2g} apart; write .obj, .ply or .glb, or move the shape to the origin"
        )
    normals = face_normals(mesh)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = np.zeros(len(normals), TRIANGLE)
    triangles["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    triangles["corners"] = mesh.corners()
    path.write_bytes(bytes(80) + np.uint32(len(triangles)).astype("<u4").tobytes() + triangles.tobytes())


def _write_obj(path: Path, origin: Float[ndarray, " 3"], scenes: Scenes) -> None:
    pieces = _shown(scenes)
    path.write_text(obj([(_positions(pieces.mesh, origin), pieces.faces())]), encoding="utf-8", newline="\n")


def obj(groups: Iterable[tuple[Float[ndarray, "_ 3"], Mapping[str, Int[ndarray, "_ 3"]]]]) -> str:
    """Wavefront OBJ: vertices, and the faces over them by object; as many digits as tell the numbers of their type.

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


def _write_glb(path: Path, origin: Float[ndarray, " 3"], scenes: Scenes) -> None:
    gltf = _Gltf()
    for name, pieces in scenes.items():
        meshes = {part: compact(Mesh(pieces.mesh.vertices, faces)) for part, faces in pieces.faces().items()}
        gltf.add_scene(name, meshes, origin)
    path.write_bytes(gltf.packed())


class _Gltf:
    """glTF 2.0 in one binary file, as it grows."""

    def __init__(self) -> None:
        self._tree: dict[str, Any] = {"asset": {"version": "2.0", "generator": "cagesdf"}, "scene": 0}
        self._tree |= {kind: [] for kind in ("scenes", "nodes", "meshes", "accessors", "bufferViews")}
        self._bytes = bytearray()

    def add_scene(self, name: str, meshes: Mapping[str, Mesh], origin: Float[ndarray, " 3"]) -> None:
        """A scene with a node, moved to `origin`, and a mesh for each part."""
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


WRITERS: dict[str, Callable[[Path, Float[ndarray, " 3"], Scenes], None]] = {
    ".ply": _write_ply,
    ".obj": _write_obj,
    ".stl": _write_stl,
    ".glb": _write_glb,
}
