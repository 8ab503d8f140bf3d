"""STL: solids of triangles, as text, where each has a name, or binary."""

import re
from array import array
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.formats.content import MAX_PARTS, names_of, numbers, plain_text, quoted, read_bounded
from cagesdf.formats.polygons import Polygons, triangulated
from cagesdf.geometry.meshes import Mesh
from cagesdf.text import encoding_of

HEADER = 80  # bytes before a binary file's number of triangles
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
PROBE = 1024  # bytes within which a binary file that begins like text has a zero

NUMBER = rb"\s+(\S+)"
STEPS = (
    ("facet normal x y z", rb"facet\s+normal" + NUMBER * 3),
    ("outer loop", rb"outer\s+loop"),
    *(("vertex x y z", rb"vertex" + NUMBER * 3),) * 3,
    ("endloop", rb"endloop"),
    ("endfacet", rb"endfacet"),
)
FACET = re.compile(rb"\s*" + rb"\s+".join(pattern for _, pattern in STEPS) + rb"(?!\S)", re.IGNORECASE)
SOLID = re.compile(rb"\s*solid(?!\S)([^\n]*)", re.IGNORECASE)
END = re.compile(rb"\s*endsolid(?!\S)[^\n]*", re.IGNORECASE)
WORD = re.compile(rb"\s*(\S+)")


def read_stl(path: Path) -> list[tuple[str, Mesh]]:
    """The solids of a text file with their names, which may be "" or equal; a binary file is one without name.

    Corners are as in the file, three for each triangle; colours are left out. Names that aren't UTF-8 are read as
    Latin-1. Raises InputError for a text file's line that is not as it must be, a solid that is cut short or has
    no facet, and a binary file whose length doesn't fit its number of triangles.
    """
    content = read_bounded(path)
    if _is_text(content):
        return _read_text(path, plain_text(content, str(path)))
    return [("", _read_binary(path, content))]


def _is_text(content: bytes) -> bool:
    """Whether a file is text. Binary ones may begin with "solid" too: those have bytes of 0, or the length they say."""
    if encoding_of(content) != "utf-8":
        return len(content) != _length(content)
    begins = re.match(rb"(\xef\xbb\xbf)?\s*solid(?!\S)", content[:PROBE], re.IGNORECASE)
    return begins is not None and 0 not in content[:PROBE] and len(content) != _length(content)


def _length(content: bytes) -> int:
    """The length of a binary file by its own number of triangles; 0 if that is missing."""
    start = HEADER + 4
    return start + TRIANGLE.itemsize * int.from_bytes(content[HEADER:start], "little") if len(content) >= start else 0


def _read_binary(path: Path, content: bytes) -> Mesh:
    wanted, length = _length(content), len(content)
    if not wanted:
        raise InputError(
            f"{path}: is no STL: has {length:,} bytes; wanted text that begins with solid, or a header of "
            f"{HEADER} bytes and a number of triangles"
        )
    if length != wanted:
        count = (wanted - HEADER - 4) // TRIANGLE.itemsize
        differs = f"{wanted - length:,} are missing" if length < wanted else f"{length - wanted:,} are too many"
        raise InputError(
            f"{path}: as a binary STL, says that it has {count:,} triangles, which take {wanted:,} bytes, but has "
            f"{length:,}: {differs}; is the file cut short or damaged? Export it again"
        )
    with np.errstate(invalid="ignore"):  # NaN is refused with its facet
        corners = np.frombuffer(content, TRIANGLE, offset=HEADER + 4)["corners"].astype(np.float64)
    if not len(corners):
        raise InputError(f"{path}: a binary STL of 0 triangles: has no faces; export it again")
    return _mesh(path, corners)


def _read_text(path: Path, text: bytes) -> list[tuple[str, Mesh]]:
    solids = [*islice(_solids(path, text), MAX_PARTS + 1)]
    if len(solids) > MAX_PARTS:
        raise InputError(f"{path}: has more than {MAX_PARTS:,} solids, the most that are read; join some of them")
    names = names_of([name for name, _ in solids])
    return [(name, mesh) for name, (_, mesh) in zip(names, solids)]


def _solids(path: Path, text: bytes) -> Iterator[tuple[bytes, Mesh]]:
    position = 0
    while WORD.match(text, position):
        begin = SOLID.match(text, position)
        if begin is None:
            raise _unexpected(path, text, position, "solid NAME")
        position, coordinates = begin.end(), array("d")
        while facet := FACET.match(text, position):
            try:
                coordinates.extend(numbers([*facet.groups()[3:]]))
            except ValueError:
                raise _no_number(path, text, facet) from None
            position = facet.end()
        end = END.match(text, position)
        if end is None:
            raise _broken(path, text, position, begin)
        if not coordinates:
            line = _line(text, begin.start(1))
            raise InputError(f"{path}, {line}: {_called(begin)} has no faces; remove it, or export it again")
        yield begin[1].strip(), _mesh(path, np.array(coordinates).reshape(-1, 3, 3))
        position = end.end()


def _no_number(path: Path, text: bytes, facet: re.Match[bytes]) -> InputError:
    """The error for a facet's coordinate that is no number."""
    for group in range(4, 13):
        try:
            numbers([facet[group]])
        except ValueError as error:
            return InputError(f"{path}, {_line(text, facet.start(group))}: {error}; export it again")
    raise AssertionError("all are numbers")


def _broken(path: Path, text: bytes, position: int, begin: re.Match[bytes]) -> InputError:
    """The error for a broken facet: the place where it deviates, and the text wanted there."""
    wanted = STEPS[0][0]
    for wanted, pattern in STEPS:  # noqa: B007
        step = re.compile(rb"\s*" + pattern + rb"(?!\S)", re.IGNORECASE).match(text, position)
        if step is None:
            break
        position = step.end()
    if WORD.match(text, position) is None:
        return InputError(
            f"{path}, {_line(text, len(text.rstrip()))}: ends within {_called(begin)}, which begins in "
            f"{_line(text, begin.start(1))}; the file is cut short, export it again"
        )
    return _unexpected(path, text, position, wanted)


def _unexpected(path: Path, text: bytes, position: int, wanted: str) -> InputError:
    word = WORD.match(text, position)
    start = word.start(1) if word else len(text)
    line = text[start : start + PROBE].partition(b"\n")[0]
    return InputError(
        f"{path}, {_line(text, start)}: wanted {wanted}, got {quoted(line)}; "
        "is the file cut short or damaged? Export it again"
    )


def _called(begin: re.Match[bytes]) -> str:
    name = begin[1].strip()
    return f"solid {quoted(name)}" if name else "a solid without name"


def _line(text: bytes, position: int) -> str:
    number_of_line = text.count(b"\n", 0, position) + 1
    return f"line {number_of_line}"


def _mesh(path: Path, corners: Float[ndarray, "f 3 3"]) -> Mesh:
    count = len(corners)
    polygons = Polygons(np.arange(3 * count), np.full(count, 3))
    return triangulated(corners.reshape(-1, 3), polygons, lambda i: f"{path}, facet {i + 1}")
