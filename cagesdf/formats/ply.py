"""PLY: vertices and polygons or triangle strips, as text or binary in either byte order.

http://gamma.cs.unc.edu/POWERPLANT/papers/ply.pdf, with the types that later writers added.
"""

import codecs
import io
import re
import struct
from abc import ABC, abstractmethod
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.formats.content import numbers, plain_text, quoted, read_bounded, whole_numbers
from cagesdf.formats.polygons import Polygons, triangulated
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.text import encoding_of

MAX_HEADER = 65_536  # bytes
MAX_ROWS = 5_000_000  # of an element with lists, which are read one by one
MAX_INDEX = 2**62  # larger indices, which no file has vertices for, become this one
TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
AXES = ("x", "y", "z")
LOOPS = ("vertex_indices", "vertex_index")  # names of a face's list of corners
FACES = {"face": "face", "tristrips": "triangle of its strips,"}  # elements of faces, and what messages call them
NONE = Polygons(np.zeros(0, np.int64), np.zeros(0, np.int64))
CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q", "f4": "f", "f8": "d"}
RESTART = -1  # ends a strip in a list of several


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str  # of TYPES' values
    length: str | None  # the type of a list's length; None for a single value


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]

    def index(self, *names: str) -> int | None:
        """The first property with one of these names."""
        return next((i for i, item in enumerate(self.properties) if item.name in names), None)


@dataclass(frozen=True)
class _Header:
    order: str  # of bytes, "<" or ">"; "" for text
    elements: dict[str, _Element]  # in the file's order
    size: int  # bytes
    lines: int


class _Rows(ABC):
    """The rows of all elements, one after the other, behind the header."""

    @abstractmethod
    def table(self, element: _Element, columns: list[int]) -> Float[ndarray, "r p"]:
        """Values of these columns, all rows of an element without lists."""

    def alike(self, element: _Element) -> Shaped[ndarray, " r"] | None:
        """All rows of an element at once, a field for each property, if they are of one size; otherwise None."""
        return None

    @abstractmethod
    def begin(self, element: _Element, row: int) -> None:
        """Go on to a row of an element that has lists."""

    @abstractmethod
    def take(self, kind: str, count: int) -> Sequence[int | float]:
        """The next values of the row."""

    @abstractmethod
    def skip(self, kind: str, count: int) -> None:
        """Leave out the next values of the row."""

    @abstractmethod
    def end(self) -> None:
        """Check that the row has no further values."""

    @abstractmethod
    def close(self) -> None:
        """Check that the file has no further rows."""


def read_ply(path: Path) -> Mesh:
    """The faces of a file as one mesh, raw frame, polygons triangulated; strips of triangles are read too.

    Colours, normals and other elements are left out. Raises InputError, with the line of a text file and
    otherwise the element and row, for a header that can't be read, a file that is shorter or longer than its header
    says, a list of negative length, and faces as `polygons.triangulated` does.
    """
    content = read_bounded(path)
    if encoding_of(content) != "utf-8":
        content = plain_text(content, str(path))
    content = content.removeprefix(codecs.BOM_UTF8)
    header = _read_header(path, content)
    rows: _Rows = _Binary(path, content, header) if header.order else _Text(path, content, header)
    vertices, pieces = np.zeros((0, 3)), []
    for element in header.elements.values():
        axes = [i for axis in AXES if (i := element.index(axis)) is not None] if element.name == "vertex" else []
        loops = element.index(*LOOPS) if element.name in FACES else None
        numbers, lists = _read_element(path, rows, element, axes, loops)
        if axes:
            vertices = numbers
        if loops is not None:
            pieces.append((element.name, lists if element.name == "face" else _unrolled(lists)))
    rows.close()
    if not any(len(polygons.counts) for _, polygons in pieces):
        raise InputError(f"{path}: has no faces; wanted an element face with a list {LOOPS[0]}")
    return join([_mesh(path, vertices, name, polygons) for name, polygons in pieces])


def _mesh(path: Path, vertices: Float[ndarray, "v 3"], name: str, polygons: Polygons) -> Mesh:
    return triangulated(vertices, polygons, lambda i: f"{path}, {FACES[name]} {i}, counted from 0")


def _read_element(
    path: Path, rows: _Rows, element: _Element, axes: list[int], loops: int | None
) -> tuple[Float[ndarray, "r a"], Polygons]:
    """The properties `axes` of an element's rows, and the lists of its property `loops`."""
    if not any(item.length for item in element.properties):
        return rows.table(element, axes), NONE
    if (alike := rows.alike(element)) is not None:
        columns = [alike[str(axis)].astype(np.float64) for axis in axes]
        loop = alike[str(loops)].astype(np.int64) if loops is not None else np.zeros((0, 0), np.int64)
        polygons = Polygons(loop.ravel(), np.full(len(loop), loop.shape[1]))
        return np.stack(columns, axis=1) if columns else np.zeros((0, 0)), polygons
    if element.count > MAX_ROWS:
        raise InputError(f"{path}: has {element.count:,} rows of element {element.name}; wanted at most {MAX_ROWS:,}")
    numbers, corners, counts = array("d"), array("q"), array("q")
    for row in range(element.count):
        rows.begin(element, row)
        for i, item in enumerate(element.properties):
            count = 1 if item.length is None else int(rows.take(item.length, 1)[0])
            if i == loops:
                corners.extend([min(int(index), MAX_INDEX) for index in rows.take(item.kind, count)])
                counts.append(count)
            elif i in axes:
                numbers.extend(rows.take(item.kind, count))
            else:
                rows.skip(item.kind, count)
        rows.end()
    lists = Polygons(*(np.asarray(values).view(np.int64) for values in (corners, counts)))  # from C's long long
    order = [sorted(axes).index(axis) for axis in axes]
    return np.array(numbers).reshape(element.count, len(axes))[:, order], lists


class _Text(_Rows):
    """Rows of text: a line each."""

    def __init__(self, path: Path, content: bytes, header: _Header) -> None:
        self._path = path
        lines = enumerate(io.BytesIO(plain_text(content, str(path))), start=1)
        self._lines = ((i, line.split()) for i, line in lines if i > header.lines and line.strip())
        self._number, self._at = header.lines, 0
        self._words: list[bytes] = []

    def table(self, element: _Element, columns: list[int]) -> Float[ndarray, "r p"]:
        width, numbers = len(element.properties), array("d")
        for row in range(element.count if width else 0):
            self.begin(element, row)
            values = self.take("f8", width)
            self.end()
            numbers.extend(values[i] for i in columns)
        return np.array(numbers).reshape(-1, len(columns)) if columns else np.zeros((0, 0))

    def begin(self, element: _Element, row: int) -> None:
        self._at = 0
        try:
            self._number, self._words = next(self._lines)
        except StopIteration:
            raise InputError(
                f"{self._path}: ends after line {self._number}, before row {row} of the {element.count:,} of element "
                f"{element.name}; the file is cut short, export it again"
            ) from None

    def take(self, kind: str, count: int) -> Sequence[int | float]:
        words = self._words[self._at : self._at + max(count, 0)]
        self.skip(kind, count)
        try:
            return numbers(words) if kind[0] == "f" else whole_numbers(words)
        except ValueError as error:
            raise self._wrong(str(error)) from error

    def skip(self, kind: str, count: int) -> None:
        if not 0 <= count <= len(self._words) - self._at:
            raise self._wrong(f"{count} values wanted, {len(self._words) - self._at} there")
        self._at += count

    def end(self) -> None:
        if self._at < len(self._words):
            raise self._wrong(f"{self._at} values wanted, {len(self._words)} there")

    def close(self) -> None:
        self._number, self._words = next(self._lines, (self._number, []))
        if self._words:
            raise self._wrong("the header says that there is nothing more")

    def _wrong(self, reason: str) -> InputError:
        line = quoted(b" ".join(self._words))
        return InputError(f"{self._path}, line {self._number}: can't read {line} ({reason}); export it again")


class _Binary(_Rows):
    """Rows of bytes, without gaps."""

    def __init__(self, path: Path, content: bytes, header: _Header) -> None:
        self._path, self._content, self._at, self._order = path, content, header.size, header.order
        self._place = "the header"

    def table(self, element: _Element, columns: list[int]) -> Float[ndarray, "r p"]:
        kinds = np.dtype([(str(i), self._order + item.kind) for i, item in enumerate(element.properties)])
        self._place = f"the {element.count:,} rows of element {element.name}"
        start = self._pass(element.count * kinds.itemsize)
        if not columns:
            return np.zeros((0, 0))
        rows = np.frombuffer(self._content, kinds, element.count, start) if element.count else np.zeros(0, kinds)
        with np.errstate(invalid="ignore"):  # NaN is refused with its face
            return np.stack([rows[str(i)].astype(np.float64) for i in columns], axis=1)

    def alike(self, element: _Element) -> Shaped[ndarray, " r"] | None:
        if not element.count:
            return None
        start, lengths = self._at, []
        fields: list[tuple[Any, ...]] = []
        self.begin(element, 0)
        for i, item in enumerate(element.properties):
            count = 1
            if item.length is not None:
                count = int(self.take(item.length, 1)[0])
                lengths.append(f"length of {i}")
                fields.append((lengths[-1], self._order + item.length))
            self.skip(item.kind, count)
            fields.append((str(i), self._order + item.kind, () if item.length is None else (count,)))
        self._at = start
        kinds = np.dtype(fields)
        if element.count * kinds.itemsize > len(self._content) - start:
            return None
        rows = np.frombuffer(self._content, kinds, element.count, start)
        if any((rows[length] != rows[length][0]).any() for length in lengths):
            return None
        self._pass(element.count * kinds.itemsize)
        return rows

    def begin(self, element: _Element, row: int) -> None:
        self._place = f"row {row} of the {element.count:,} of element {element.name}"

    def take(self, kind: str, count: int) -> Sequence[int | float]:
        start = self._at
        self.skip(kind, count)
        values: Sequence[int | float] = struct.unpack_from(f"{self._order}{count}{CODES[kind]}", self._content, start)
        return values

    def skip(self, kind: str, count: int) -> None:
        if count < 0:
            raise InputError(f"{self._path}: {self._place} has a list of {count} values; export it again")
        self._pass(count * int(kind[1]))

    def end(self) -> None:
        """A binary row ends with its last value: there is nothing to check."""

    def close(self) -> None:
        if rest := len(self._content) - self._at:
            raise InputError(
                f"{self._path}: has {rest:,} bytes more than its header says; is it damaged? Export it again"
            )

    def _pass(self, size: int) -> int:
        """Advance by `size` bytes, which must exist; returns where they begin."""
        if size > len(self._content) - self._at:
            raise InputError(
                f"{self._path}: {self._place} takes {size:,} bytes from byte {self._at:,}, but the file has "
                f"{len(self._content):,}; it is cut short or its header is wrong, export it again"
            )
        self._at += size
        return self._at - size


def _unrolled(strips: Polygons) -> Polygons:
    """The triangles of strips, every second one turned; RESTART parts strips, triangles of two equal corners vanish."""
    triangles = [np.zeros((0, 3), np.int64)]
    for corners in np.split(strips.corners, np.cumsum(strips.counts)[:-1]):
        for piece in np.split(corners, np.flatnonzero(corners == RESTART)):
            strip = piece[piece != RESTART]
            a, b, c = strip[:-2], strip[1:-1], strip[2:]
            turned = np.arange(len(c)) % 2 == 1
            triangles.append(np.stack([np.where(turned, b, a), np.where(turned, a, b), c], axis=1))
    corners = np.concatenate(triangles)
    a, b, c = corners.T
    proper = corners[(a != b) & (b != c) & (c != a)]
    return Polygons(proper.ravel(), np.full(len(proper), 3))


def _read_header(path: Path, content: bytes) -> _Header:
    head = content[:MAX_HEADER]
    match = re.match(rb"ply[ \t]*(\r\n|\n|\r)", head)
    if match is None:
        raise InputError(f"{path}: can't be read as PLY: wanted a first line ply, got {quoted(head[:20])}")
    lines = head[match.end() :].split(match[1])
    end = next((i for i, line in enumerate(lines[:-1]) if line.strip() == b"end_header"), None)
    if end is None:
        raise InputError(
            f"{path}: can't be read as PLY: no line end_header in its first {MAX_HEADER:,} bytes; is it cut short?"
        )
    size = match.end() + sum(len(line) + len(match[1]) for line in lines[: end + 1])
    order: str | None = None
    elements: dict[str, _Element] = {}
    for number_of_line, line in enumerate(lines[:end], start=2):
        try:
            words = line.decode("latin-1").split()
            if not words or words[0] in ("comment", "obj_info"):
                continue
            if words[0] == "format" and order is None:
                order = _format(words)
            else:
                _declare(words, elements)
        except ValueError as error:
            raise InputError(f"{path}, line {number_of_line}: can't read {quoted(line)} ({error})") from error
    if order is None:
        raise InputError(f"{path}: the header has no line format; wanted one of {', '.join(ORDERS)}")
    missing = [axis for axis in AXES if "vertex" not in elements or elements["vertex"].index(axis) is None]
    if missing:
        raise InputError(f"{path}: has no property {', '.join(missing)} of an element vertex; wanted x, y, z")
    return _Header(order, elements, size, end + 2)


def _format(words: list[str]) -> str:
    if words[1:2] and words[1] in ORDERS and words[2:] == ["1.0"]:
        return ORDERS[words[1]]
    raise ValueError(f"wanted one of {', '.join(ORDERS)} and 1.0")


def _declare(words: list[str], elements: dict[str, _Element]) -> None:
    """A line of the header that begins an element or gives the last one a property. Raises ValueError."""
    match words:
        case ["element", name, digits] if re.fullmatch("[0-9]{1,10}", digits) and name not in elements:
            elements[name] = _Element(name, int(digits), ())
            return
        case ["property", "list", length, kind, name] if TYPES.get(length, "f")[0] != "f" and kind in TYPES:
            added = _Property(name, TYPES[kind], TYPES[length])
        case ["property", kind, name] if kind in TYPES:
            added = _Property(name, TYPES[kind], None)
        case _:
            raise ValueError("wanted an element and its number of rows, or a property, its type and name, once each")
    if not elements:
        raise ValueError("wanted an element before its properties")
    last = next(reversed(elements.values()))
    if last.index(added.name) is not None:
        raise ValueError("a second property of that name")
    if last.name == "vertex" and added.name in AXES and added.length is not None:
        raise ValueError("wanted a single number")
    if last.name in FACES and added.name in LOOPS and (added.length is None or added.kind[0] == "f"):
        raise ValueError("wanted a list of whole numbers")
    elements[last.name] = _Element(last.name, last.count, (*last.properties, added))
