"""glTF's JSON: its schema as far as shapes need it, and the files that hold it."""

import re
import struct
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel
from scipy.spatial.transform import Rotation

from cagesdf.errors import InputError
from cagesdf.formats.content import read_bounded
from cagesdf.text import decode

MAX_VALUES = 5_000_000  # of the JSON; each may take some hundred bytes
MAX_ENTRIES = 100_000  # of each of the JSON's lists

MAGIC = b"glTF"
POINTS, LINES, LINE_LOOP, LINE_STRIP, TRIANGLES, STRIP, FAN = range(7)  # modes of primitives

# Extensions that change shapes: what they do, and what to do about them.
FOREIGN = {
    "KHR_draco_mesh_compression": ("compressed with Draco", "export without compression"),
    "EXT_meshopt_compression": ("compressed with meshopt", "export without compression"),
    "KHR_meshopt_compression": ("compressed with meshopt", "export without compression"),
    "EXT_mesh_gpu_instancing": ("has instances for the GPU alone", "make them nodes and export again"),
}
# Extensions that may be required and don't change shapes, apart from KHR_mesh_quantization, which is read.
KNOWN = re.compile(
    r"KHR_mesh_quantization|(KHR|EXT|MSFT|ADOBE|GOOGLE)_(materials|texture|lights)_\w+|EXT_mesh_features"
    r"|KHR_techniques_webgl|KHR_animation_pointer|KHR_xmp(_json_ld)?|EXT_structural_metadata|FB_ngon_encoding"
)

E = TypeVar("E")
Count = Annotated[int, Field(ge=0)]
Extensions = dict[str, Any]


class JsonObject(BaseModel):
    """An object of the JSON. Fields that aren't declared are of no concern here."""

    model_config = ConfigDict(alias_generator=to_camel, frozen=True, allow_inf_nan=False)


class About(JsonObject):
    """The file's version."""

    version: str
    min_version: str = "2.0"


class SceneEntry(JsonObject):
    """A scene: its trees of nodes."""

    nodes: tuple[Count, ...] = Field((), max_length=MAX_ENTRIES)


class NodeEntry(JsonObject):
    """A node: its place, its mesh, the nodes below it."""

    name: str = ""
    mesh: Count | None = None
    skin: Count | None = None
    children: tuple[Count, ...] = Field((), max_length=MAX_ENTRIES)
    matrix: tuple[float, ...] | None = Field(None, min_length=16, max_length=16)  # column by column
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)  # x, y, z, w
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    weights: tuple[float, ...] | None = None  # of the mesh's morph targets
    extensions: Extensions = {}

    def pose(self) -> Float[ndarray, "4 4"]:
        """Node → parent. Raises ValueError for a rotation of length 0."""
        if self.matrix is not None:
            return np.reshape(self.matrix, (4, 4)).T
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat(self.rotation).as_matrix() * self.scale
        pose[:3, 3] = self.translation
        return pose


class Primitive(JsonObject):
    """Triangles, lines or points of one material; numbers are those of accessors."""

    attributes: dict[str, Count]
    indices: Count | None = None
    mode: Count = TRIANGLES
    targets: tuple[dict[str, Count], ...] = Field((), max_length=MAX_ENTRIES)
    extensions: Extensions = {}


class MeshEntry(JsonObject):
    """A mesh: its primitives, and how far each morph target moves them at rest."""

    name: str = ""
    primitives: tuple[Primitive, ...] = Field(max_length=MAX_ENTRIES)
    weights: tuple[float, ...] | None = None


class SparseIndices(JsonObject):
    """Rows of an accessor that are replaced."""

    buffer_view: Count
    byte_offset: Count = 0
    component_type: int


class SparseValues(JsonObject):
    """Replacements of an accessor's rows."""

    buffer_view: Count
    byte_offset: Count = 0


class Sparse(JsonObject):
    """Rows of an accessor that are stored beside the others."""

    count: Count
    indices: SparseIndices
    values: SparseValues


class Accessor(JsonObject):
    """An array of `count` rows."""

    buffer_view: Count | None = None
    byte_offset: Count = 0
    component_type: int
    normalized: bool = False
    count: Count
    type: str
    sparse: Sparse | None = None

    def is_bare(self) -> bool:
        """Whether it holds nothing but zeros, which an extension may be meant to fill."""
        return self.buffer_view is None and self.sparse is None


class BufferView(JsonObject):
    """A stretch of a buffer, its rows `byte_stride` apart."""

    buffer: Count
    byte_offset: Count = 0
    byte_length: Count
    byte_stride: Count | None = None
    extensions: Extensions = {}


class Buffer(JsonObject):
    """A file beside this one, a data: URI, or the bytes that a binary file carries."""

    uri: str | None = None
    byte_length: Count


class GltfJson(JsonObject):
    """The JSON of a file."""

    asset: About
    scene: Count | None = None
    scenes: tuple[SceneEntry, ...] = Field((), max_length=MAX_ENTRIES)
    nodes: tuple[NodeEntry, ...] = Field((), max_length=MAX_ENTRIES)
    meshes: tuple[MeshEntry, ...] = Field((), max_length=MAX_ENTRIES)
    accessors: tuple[Accessor, ...] = Field((), max_length=MAX_ENTRIES)
    buffer_views: tuple[BufferView, ...] = Field((), max_length=MAX_ENTRIES)
    buffers: tuple[Buffer, ...] = Field((), max_length=MAX_ENTRIES)
    extensions_required: tuple[str, ...] = ()


def load(path: Path) -> tuple[GltfJson, memoryview | None]:
    """The JSON, and the bytes that a binary file carries. Raises InputError, as for extensions that can't be read."""
    content, binary = _chunks(path, read_bounded(path))
    text = _decoded(path, content)
    if (values := sum(map(text.count, ",[{"))) > MAX_VALUES:
        raise InputError(f"{path}: its JSON has about {values:,} values, at most {MAX_VALUES:,} are read; simplify it")
    try:
        document = GltfJson.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = " ".join(map(str, first["loc"])) or "JSON"
        raise _unreadable(path, f"{place}: {first['msg']}") from error
    for version in (document.asset.version, document.asset.min_version):
        if not version.startswith("2."):
            raise InputError(f"{path}: is glTF {version[:20]}; wanted glTF 2.0")
    for extension in document.extensions_required:
        if extension in FOREIGN:
            raise foreign(f"{path}", extension, " in extensionsRequired")
        if not KNOWN.fullmatch(extension):
            raise InputError(
                f"{path}: requires the extension {extension[:60]} (extensionsRequired), which isn't read; "
                "export without it"
            )
    return document, binary


def _chunks(path: Path, content: bytes) -> tuple[bytes, memoryview | None]:
    """JSON and binary chunk of a binary file; other files are all JSON, whatever their names."""
    if not content.startswith(MAGIC):
        return content, None
    if len(content) < 20:
        raise _unreadable(path, f"{len(content)} bytes are too few")
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        raise InputError(f"{path}: is glTF {version}; wanted glTF 2.0")
    if length > len(content):
        raise _unreadable(path, f"says it has {length:,} bytes, has {len(content):,}; is it cut short?")
    chunks: list[tuple[bytes, memoryview]] = []
    start = 12
    while start + 8 <= length and len(chunks) < 2:
        size, kind = struct.unpack_from("<I4s", content, start)
        start += 8
        if start + size > length:
            raise _unreadable(path, f"chunk {len(chunks)} says it has {size:,} bytes, {length - start:,} are left")
        chunks.append((kind, memoryview(content)[start : start + size]))
        start += size
    if not chunks or chunks[0][0] != b"JSON":
        raise _unreadable(path, "its first chunk isn't JSON")
    # Blanks fill the JSON's chunk; some programs take zeros.
    return bytes(chunks[0][1]).rstrip(b" \0"), chunks[1][1] if len(chunks) > 1 and chunks[1][0] == b"BIN\0" else None


def _decoded(path: Path, content: bytes) -> str:
    """JSON's text as `text.decode` knows it; otherwise in Latin-1, which programs for Windows write."""
    try:
        return decode(content, str(path))
    except InputError:
        return content.decode("latin-1")


def at(entries: tuple[E, ...], i: int, what: str) -> E:
    """Entry `i` of a list. Raises InputError that begins with `what` if there is none."""
    if i >= len(entries):
        raise InputError(f"{what} {i} is named; the file has {len(entries)}")
    return entries[i]


def foreign(where: str, extension: str, place: str = "") -> InputError:
    """The error for one of FOREIGN's extensions."""
    what, remedy = FOREIGN[extension]
    return InputError(f"{where}: {what} ({extension}{place}); {remedy}")


def _unreadable(path: Path, reason: str) -> InputError:
    return InputError(f"{path}: can't be read as {path.suffix[1:].upper() or 'glTF'} ({reason}); export it again")
