"""glTF's numbers: accessors, and the buffers behind them."""

import base64
import binascii
import re
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from jaxtyping import Float, Int, Shaped
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.formats.content import MAX_BYTES, read_bounded
from cagesdf.formats.gltf_json import FOREIGN, Accessor, Extensions, GltfJson, at, foreign

DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # by component type
INDEX_TYPES = (5121, 5123, 5125)
WIDTHS = {"SCALAR": 1, "VEC3": 3}  # components by type; no other type is used


class Numbers:
    """The accessors of a file, and the buffers behind them."""

    def __init__(self, path: Path, document: GltfJson, binary: memoryview | None) -> None:
        self._path = path
        self._document = document
        self._binary = binary
        self._arrays: dict[int, Shaped[ndarray, "n width"]] = {}  # by accessor
        self._buffers: dict[int, bytes | memoryview] = {}

    def entry(self, accessor: int, where: str) -> Accessor:
        """The JSON of an accessor. Raises InputError if there is none."""
        return at(self._document.accessors, accessor, f"{where}: accessor")

    def positions(self, accessor: int, rows: Int[ndarray, " r"], where: str) -> Float[ndarray, "r 3"]:
        """Rows of an accessor of vectors; normalised integers are between −1 and 1."""
        values = self._read(accessor, "VEC3", where)[rows]
        if self.entry(accessor, where).normalized and values.dtype.kind != "f":
            return np.maximum(values / np.iinfo(values.dtype).max, -1.0)
        return values.astype(np.float64)

    def indices(self, accessor: int, where: str) -> Int[ndarray, " n"]:
        """An accessor of indices."""
        if (kind := self.entry(accessor, where).component_type) not in INDEX_TYPES:
            raise InputError(f"{where}: its indices are of component type {kind}; wanted one of {INDEX_TYPES}")
        return self._read(accessor, "SCALAR", where)[:, 0].astype(np.int64)

    def _read(self, accessor: int, kind: str, where: str) -> Shaped[ndarray, "n width"]:
        if accessor not in self._arrays:
            self._arrays[accessor] = self._assemble(self.entry(accessor, where), f"{where}, accessor {accessor}")
        array = self._arrays[accessor]
        if array.shape[1] != WIDTHS[kind]:
            raise InputError(f"{where}, accessor {accessor}: is {self.entry(accessor, where).type}; wanted {kind}")
        return array

    def _assemble(self, entry: Accessor, where: str) -> Shaped[ndarray, "n width"]:
        if entry.type not in WIDTHS:
            raise InputError(f"{where}: is {entry.type[:60]}; wanted one of {', '.join(WIDTHS)}")
        width, dtype = WIDTHS[entry.type], _dtype(entry.component_type, where)
        if entry.buffer_view is None:
            array = np.zeros((entry.count, width), dtype)
        else:
            array = self._view(entry.buffer_view, entry.byte_offset, entry.count, width, dtype, where)
        if entry.sparse is None:
            return array
        sparse, places, values = entry.sparse, entry.sparse.indices, entry.sparse.values
        where = f"{where}, sparse"
        if places.component_type not in INDEX_TYPES or sparse.count > entry.count:
            raise InputError(
                f"{where}: {sparse.count:,} places of component type {places.component_type}; wanted at most "
                f"{entry.count:,} of one of {INDEX_TYPES}"
            )
        kind = _dtype(places.component_type, where)
        rows = self._view(places.buffer_view, places.byte_offset, sparse.count, 1, kind, where)[:, 0]
        if len(rows) and (largest := int(rows.max())) >= entry.count:
            raise InputError(f"{where}: replaces element {largest}; there are {entry.count}, from 0")
        array = array.copy()
        array[rows] = self._view(values.buffer_view, values.byte_offset, sparse.count, width, dtype, where)
        return array

    def _view(
        self, index: int, offset: int, count: int, width: int, dtype: np.dtype, where: str
    ) -> Shaped[ndarray, "n width"]:
        """`count` rows of `width` numbers in a view of a buffer; nothing is copied."""
        view = at(self._document.buffer_views, index, f"{where}: bufferView")
        where = f"{where}, bufferView {index}"
        size = width * dtype.itemsize
        stride = view.byte_stride or size
        needed = offset + stride * (count - 1) + size if count else 0
        if needed > view.byte_length or stride < size:
            raise InputError(
                f"{where}: {count:,} elements of {size} bytes, {stride} apart, end at byte {needed:,}; "
                f"the view has {view.byte_length:,}"
            )
        held = at(self._document.buffers, view.buffer, f"{where}: buffer").byte_length
        if view.byte_offset + view.byte_length > held:
            end = view.byte_offset + view.byte_length
            raise InputError(f"{where}: ends at byte {end:,} of buffer {view.buffer}, which has {held:,}")
        if count == 0:
            return np.zeros((0, width), dtype)
        buffer = self._buffer(view.buffer, view.extensions, where)
        return np.ndarray((count, width), dtype, buffer, view.byte_offset + offset, (stride, dtype.itemsize))

    def _buffer(self, index: int, extensions: Extensions, where: str) -> bytes | memoryview:
        """The bytes of a buffer, at least the number in the file. `extensions` are those of a view of it."""
        if index in self._buffers:
            return self._buffers[index]
        entry = self._document.buffers[index]
        if (total := entry.byte_length + sum(map(len, self._buffers.values()))) > MAX_BYTES:
            raise InputError(f"{self._path}: its buffers have {total:,} bytes or more, at most {MAX_BYTES:,} are read")
        content: bytes | memoryview
        if entry.uri is not None:
            content = _embedded(entry.uri, where) if entry.uri[:5].lower() == "data:" else self._beside(entry.uri)
        elif index == 0 and self._binary is not None:
            content = self._binary
        else:
            for extension in sorted(FOREIGN.keys() & extensions.keys()):
                raise foreign(where, extension)
            raise InputError(f"{where}: buffer {index} names no file and the file carries none; export it again")
        if len(content) < entry.byte_length:
            raise InputError(
                f"{where}: buffer {index} has {len(content):,} bytes, wanted {entry.byte_length:,}; is it cut short?"
            )
        self._buffers[index] = content
        return content

    def _beside(self, uri: str) -> bytes:
        """A file in the glTF's own folder or below. Raises InputError for every other place."""
        shown = uri[:120]
        name = unquote(uri).replace("\\", "/")
        if re.match(r"[a-z][a-z0-9+.-]*:", uri, re.IGNORECASE) or PurePosixPath(name).is_absolute():
            raise InputError(f"{self._path}: buffer {shown!r} is not in the file's folder; copy it there")
        try:
            place = (self._path.parent / name).resolve()
            inside = ".." not in PurePosixPath(name).parts and place.is_relative_to(self._path.parent.resolve())
            is_file = inside and place.is_file()
        except (OSError, ValueError, RuntimeError) as error:  # names too long, with a 0 in them, links in a circle
            raise InputError(f"{self._path}: buffer {shown!r} is no file's name ({error})") from error
        if not inside:
            raise InputError(f"{self._path}: buffer {shown!r} is not in the file's folder; copy it there")
        if not is_file:
            raise InputError(f"{self._path}: buffer {shown!r} is missing; copy it beside the file")
        return read_bounded(place)


def _dtype(component_type: int, where: str) -> np.dtype:
    if component_type not in DTYPES:
        raise InputError(f"{where}: component type {component_type} is none of {', '.join(map(str, DTYPES))}")
    return np.dtype(DTYPES[component_type])


def _embedded(uri: str, where: str) -> bytes:
    """The bytes of a data: URI (RFC 2397)."""
    kind, comma, body = uri.partition(",")
    try:
        if not comma:
            raise ValueError("it has no comma")
        is_base64 = kind.lower().endswith(";base64")
        return base64.b64decode(unquote(body), validate=True) if is_base64 else unquote_to_bytes(body)
    except (ValueError, binascii.Error) as error:
        raise InputError(f"{where}: its data: URI can't be read ({error}); export it again") from error
