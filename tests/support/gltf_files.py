"""glTF files of every kind, written piece by piece."""

import json
import struct
from copy import deepcopy
from typing import Any

import numpy as np

from cagesdf.geometry.meshes import Mesh

TYPES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
# By list, but for that of the one buffer: the fields that name its entries, in whatever entry they are.
NAMES = {
    "accessors": {"indices", "POSITION"},
    "bufferViews": {"bufferView"},
    "meshes": {"mesh"},
    "nodes": {"children", "nodes"},
    "scenes": {"scene"},
}


class Gltf:
    """A file as it grows: `tree` is its JSON, `data` its one buffer."""

    def __init__(self) -> None:
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}}
        self.data = bytearray()

    def add(self, kind: str, **entry: Any) -> int:
        self.tree.setdefault(kind, []).append(entry)
        return len(self.tree[kind]) - 1

    def view(self, content: bytes, **entry: Any) -> int:
        self.data += bytes(-len(self.data) % 4)
        start = len(self.data)
        self.data += content
        return self.add("bufferViews", buffer=0, byteOffset=start, byteLength=len(content), **entry)

    def rows(self, array: np.ndarray, kind: str, offset: int = 0, stride: int = 0) -> tuple[int, int]:
        """A view of rows, `stride` bytes apart, that begin at `offset`; what lies between is rubbish."""
        rows = np.ascontiguousarray(np.asarray(array).reshape(len(array), -1), f"<{kind}")
        size = rows.itemsize * rows.shape[1]
        content = bytearray(b"\xa5" * (offset + (stride or size) * len(rows)))
        for i, row in enumerate(rows):
            start = offset + i * (stride or size)
            content[start : start + size] = row.tobytes()
        return self.view(bytes(content), **({"byteStride": stride} if stride else {})), rows.shape[1]

    def accessor(self, array: Any, kind: str = "f4", offset: int = 0, stride: int = 0, **entry: Any) -> int:
        array = np.asarray(array)
        view, width = self.rows(array, kind, offset, stride)
        layout = {"bufferView": view, "byteOffset": offset, "componentType": TYPES[kind]}
        return self.add("accessors", **{**layout, "count": len(array), "type": SHAPES[width], **entry})

    def sparse(self, array: Any, base: Any, kind: str = "f4", places: str = "u2", stride: int = 0) -> int:
        """`array`, told by the rows in which it differs from `base`, from zeros if that is None."""
        array = np.asarray(array)
        width = array.reshape(len(array), -1).shape[1]
        start = np.zeros_like(array) if base is None else np.asarray(base)
        changed = np.flatnonzero((array != start).reshape(len(array), -1).any(axis=1))
        entry: dict[str, Any] = {"componentType": TYPES[kind], "count": len(array), "type": SHAPES[width]}
        if base is not None:
            entry["bufferView"] = self.rows(start, kind, 0, stride)[0]
        entry["sparse"] = {
            "count": len(changed),
            "indices": {"bufferView": self.rows(changed, places)[0], "componentType": TYPES[places]},
            "values": {"bufferView": self.rows(array[changed], kind)[0]},
        }
        return self.add("accessors", **entry)

    def primitive(self, positions: int, indices: int | None = None, **entry: Any) -> dict[str, Any]:
        told = {} if indices is None else {"indices": indices}
        return {"attributes": {"POSITION": positions}, **told, **entry}

    def mesh(self, *meshes: Mesh, **entry: Any) -> int:
        """A mesh with a primitive for each."""
        primitives = [self.primitive(self.accessor(m.vertices), self.accessor(m.faces.ravel(), "u4")) for m in meshes]
        return self.add("meshes", primitives=primitives, **entry)

    def show(self, *nodes: int) -> "Gltf":
        """A scene of these nodes, the one that is shown."""
        self.tree["scene"] = self.add("scenes", nodes=list(nodes))
        return self

    def part(self, mesh: Mesh, name: str = "", **entry: Any) -> int:
        """A node with a mesh of its own."""
        return self.add("nodes", mesh=self.mesh(mesh), **({"name": name} if name else {}), **entry)

    def glb(self) -> bytes:
        buffers = self.tree.get("buffers", [{"byteLength": len(self.data)}])
        return packed({**self.tree, "buffers": buffers}, bytes(self.data))

    def text(self, uri: str) -> str:
        """The JSON of a file whose buffer is elsewhere."""
        return json.dumps({**self.tree, "buffers": [{"uri": uri, "byteLength": len(self.data)}]})

    def shuffled(self, rng: np.random.Generator) -> "Gltf":
        """The same file with every list of its JSON in another order."""
        order = {kind: rng.permutation(len(self.tree.get(kind, []))).tolist() for kind in NAMES}
        other = Gltf()
        other.data = self.data
        other.tree = _renamed(deepcopy(self.tree), {kind: np.argsort(order[kind]).tolist() for kind in NAMES})
        for kind in NAMES:
            if kind in other.tree:
                other.tree[kind] = [other.tree[kind][i] for i in order[kind]]
        return other


def _renamed(entry: Any, places: dict[str, list[int]]) -> Any:
    if isinstance(entry, list):
        return [_renamed(item, places) for item in entry]
    if not isinstance(entry, dict):
        return entry
    result = {}
    for key, value in entry.items():
        kind = next((kind for kind, fields in NAMES.items() if key in fields), None)
        if kind is None or isinstance(value, dict) or any(isinstance(item, dict) for item in np.atleast_1d(value)):
            result[key] = _renamed(value, places)
        else:
            result[key] = [places[kind][i] for i in value] if isinstance(value, list) else places[kind][value]
    return result


def packed(tree: dict[str, Any] | list[Any], data: bytes) -> bytes:
    """A binary file."""
    text = json.dumps(tree).encode("utf-8")
    chunks = b"".join(
        struct.pack("<I", len(content) + -len(content) % 4) + kind + content + fill * (-len(content) % 4)
        for kind, content, fill in ((b"JSON", text, b" "), (b"BIN\0", data, b"\0"))
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
