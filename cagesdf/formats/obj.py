"""Wavefront OBJ: vertices, faces and the objects or groups they belong to.

Lines, points, materials, texture coordinates and normals are left out. Surfaces that aren't polygons, and
calls of other files, are refused by name.
"""

import io
import re
import warnings
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int
from numpy import ndarray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cagesdf.errors import InputError
from cagesdf.formats.content import MAX_PARTS, names_of, numbers, plain_text, quoted, read_bounded, whole_numbers
from cagesdf.formats.polygons import Polygons, triangulated
from cagesdf.geometry.meshes import Mesh

# Statements that stand for surfaces: ignoring them would lose these silently.
UNREAD = {
    b"surf": "free-form surfaces", b"bzp": "patches", b"bsp": "patches", b"cdc": "patches", b"cdp": "patches",
    b"res": "patches", b"call": "other files",
}  # fmt: skip
NUMBERED = (b"v", b"f", b"l", b"p")  # first letters of lines of numbers: names and paths may end in a backslash
# Runs of lines of three coordinates each, or of three corners: most of a file.
RUN = re.compile(
    rb"(?:^v(?:[ \t]++[-+.0-9eE]++){3}[ \t]*+\r?\n)++|(?:^f(?:[ \t]++-?[0-9]{1,18}+(?:/[-0-9/]*+)?){3}[ \t]*+\r?\n)++",
    re.MULTILINE,
)
BEHIND_SLASH = re.compile(rb"/[-0-9/]*")
COMMENT = re.compile(rb"(?<!\S)#")  # "leg#2" is a name


@dataclass
class _Content:
    coordinates: array = field(default_factory=lambda: array("d"))  # x, y, z of each vertex in turn
    corners: array = field(default_factory=lambda: array("q"))  # vertex numbers from 0, face after face
    counts: array = field(default_factory=lambda: array("q"))  # corners of each face
    lines: array = field(default_factory=lambda: array("q"))  # of each face, from 1
    owners: array = field(default_factory=lambda: array("q"))  # of each face, an index into names
    names: list[tuple[int, bytes, bytes]] = field(default_factory=lambda: [(0, b"", b"")])
    # An object's number, from 0 before the first, its name, and a group's within it; as they stand in the file.


def read_obj(path: Path) -> Mesh:
    """All faces of a file as one mesh, raw frame; polygons are triangulated, see `polygons.triangulated`.

    Raises InputError with file, line and text for a line that can't be read, a face with fewer than three
    vertices, and an index that names no vertex so far in the file.
    """
    content = _read(path, read_bounded(path))
    return _mesh(path, content, np.arange(len(content.counts)))


def read_obj_groups(path: Path, packed: bytes | None = None) -> list[tuple[str, Mesh]]:
    """The named parts of a file in its order: its objects, or its groups if all objects have one name.

    Faces of no group belong to the object, those of no object to "". Groups of one name are one part. Where all
    objects and groups have one name, objects that share no vertex are several parts of it:
    `naming.distinct_names` tells them apart. Names that aren't UTF-8 are read as Latin-1. `packed` is the content of a
    file that lies in an archive. Raises InputError as `read_obj` does.
    """
    content = _read(path, read_bounded(path) if packed is None else packed)
    owners = np.asarray(content.owners)
    objects, groups = _numbers([name for _, name, _ in content.names]), _numbers([group for *_, group in content.names])
    if len(np.unique(objects[owners])) > 1:
        keys = objects
    elif len(np.unique(groups[owners])) > 1:
        keys = groups
    else:
        keys = _components(content)
    _, first, part = np.unique(keys[owners], return_index=True, return_inverse=True)
    if len(first) > MAX_PARTS:
        raise InputError(f"{path}: has {len(first):,} named parts, at most {MAX_PARTS:,} are read; join some of them")
    names = names_of([_name(content.names[owner], keys is groups) for owner in owners[first]])
    chosen = np.split(np.argsort(part, kind="stable"), np.cumsum(np.bincount(part))[:-1])
    return [(names[i], _mesh(path, content, chosen[i])) for i in np.argsort(first)]


def _numbers(names: list[bytes]) -> Int[ndarray, " n"]:
    """A number for each name, equal ones for equal names."""
    return np.unique(np.array(names, object), return_inverse=True)[1]


def _name(owner: tuple[int, bytes, bytes], grouped: bool) -> bytes:
    _, name, group = owner
    return _without_comment((group or name) if grouped else (name or group))


def _components(content: _Content) -> Int[ndarray, " n"]:
    """The object of each of `names`: all statements whose faces share vertices, directly or by others."""
    statements = np.array([number for number, *_ in content.names])
    owners = np.repeat(statements[np.asarray(content.owners)], np.asarray(content.counts))
    size = int(statements.max()) + 1
    total = size + len(content.coordinates) // 3
    links = coo_array((np.ones(len(owners), bool), (owners, size + np.asarray(content.corners))), shape=(total, total))
    return connected_components(links, directed=False)[1][statements]


def _mesh(path: Path, content: _Content, chosen: Int[ndarray, " p"]) -> Mesh:
    """The mesh of the chosen faces of a file."""
    all_counts = np.asarray(content.counts).view(np.int64)  # from C's long long
    counts, lines = all_counts[chosen], np.asarray(content.lines)[chosen]
    starts = np.cumsum(all_counts)[chosen] - counts
    inside = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    used, corners = np.unique(np.asarray(content.corners)[np.repeat(starts, counts) + inside], return_inverse=True)
    vertices = np.asarray(content.coordinates).reshape(-1, 3)[used]
    return triangulated(vertices, Polygons(corners, counts), lambda i: f"{path}, line {lines[i]}")


def _read(path: Path, raw: bytes) -> _Content:
    content, text = _Content(), plain_text(raw, str(path))
    done, at = 0, 1
    for run in RUN.finditer(text):
        # A line continued by the run's first one belongs to it. A run that can't be read is read by statements, so that
        # the error names the line.
        goes_on = text[done : run.start()].rstrip().endswith(b"\\")
        if not goes_on:
            at = _add_statements(path, content, text[done : run.start()], at)
            done = run.start()
        if goes_on or not _add_run(content, run[0], at):
            at = _add_statements(path, content, text[done : run.end()], at)
        else:
            at += run[0].count(b"\n")
        done = run.end()
    _add_statements(path, content, text[done:], at)
    return content


def _add_run(content: _Content, run: bytes, first: int) -> bool:
    """Vertices alone or triangles alone, all at once, from line `first` on; adds nothing if a statement is wrong."""
    count = 3 * run.count(b"\n")
    if run.startswith(b"v"):
        places = _parsed(run.replace(b"v", b" "), np.float64)
        if len(places) == count:
            content.coordinates.frombytes(places.tobytes())
        return len(places) == count
    corners = _parsed(BEHIND_SLASH.sub(b"", run).replace(b"f", b" "), np.int64)
    known = len(content.coordinates) // 3
    if len(corners) != count or (corners == 0).any() or corners.max() > known or corners.min() < -known:
        return False
    ones = np.ones(count // 3, np.int64)
    content.corners.frombytes(np.where(corners > 0, corners - 1, corners + known).tobytes())
    content.counts.frombytes((3 * ones).tobytes())
    content.lines.frombytes((first + np.cumsum(ones) - 1).tobytes())
    content.owners.frombytes(((len(content.names) - 1) * ones).tobytes())
    return True


def _parsed(numbers: bytes, kind: type[np.number[Any]]) -> ndarray:
    """Numbers between spaces; none if one can't be read."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(numbers.decode("ascii"), kind, sep=" ")
        except (DeprecationWarning, ValueError):
            return np.zeros(0, kind)


def _add_statements(path: Path, content: _Content, text: bytes, first: int) -> int:
    """Any statements, one at a time, from line `first` on; returns the number of the line behind them."""
    for at, line in _statements(text, first):
        key, *words = (line if b"#" not in line else _without_comment(line)).split() or (b"",)
        try:
            if key == b"v":
                _add_vertex(content, words)
            elif key in (b"f", b"fo"):
                _add_face(content, words, at)
            elif key == b"o":
                content.names.append((content.names[-1][0] + 1, line[1:].strip(), b""))
            elif key == b"g":
                content.names.append((*content.names[-1][:2], line[1:].strip()))
            elif key in UNREAD:
                raise ValueError(f"{UNREAD[key]} aren't read, wanted polygons")
        except ValueError as error:
            raise InputError(
                f"{path}, line {at}: can't read {quoted(line)} ({error}); is the file cut short? Export it again"
            ) from error
    return first + text.count(b"\n")


def _add_vertex(content: _Content, words: list[bytes]) -> None:
    """A vertex; a weight or colours behind its coordinates are left out."""
    if len(words) < 3:
        raise ValueError("a vertex needs three coordinates")
    content.coordinates.extend(numbers(words)[:3])


def _add_face(content: _Content, words: list[bytes], line: int) -> None:
    known = len(content.coordinates) // 3
    corners = whole_numbers([word.partition(b"/")[0] for word in words])
    if len(corners) < 3:
        raise ValueError("a face needs three vertices")
    if 0 in corners or max(corners) > known or min(corners) < -known:
        raise ValueError(f"there are {known} vertices before it, counted from 1, or from -1 backwards")
    content.corners.extend([corner - 1 if corner > 0 else corner + known for corner in corners])
    content.counts.append(len(corners))
    content.lines.append(line)
    content.owners.append(len(content.names) - 1)


def _statements(text: bytes, first: int) -> Iterator[tuple[int, bytes]]:
    """Lines with their numbers from `first` on; a backslash at the end of a line of numbers continues it."""
    pieces: list[bytes] = []
    for at, line in enumerate(io.BytesIO(text), start=first):
        bare = line.strip()
        if bare.endswith(b"\\") and (pieces or bare[:1] in NUMBERED) and _without_comment(bare) == bare:
            pieces.append(bare[:-1])
        elif pieces:
            yield at - len(pieces), b" ".join([*pieces, bare])
            pieces = []
        else:
            yield at, bare
    if pieces:
        yield at - len(pieces) + 1, b" ".join(pieces)


def _without_comment(line: bytes) -> bytes:
    """A line up to the first # that begins a word; a name that would be empty then is all of it."""
    comment = COMMENT.search(line)
    return line if comment is None else line[: comment.start()].rstrip() or line
