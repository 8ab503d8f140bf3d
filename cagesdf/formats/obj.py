"""Wavefront OBJ: vertices, faces and the objects or groups they belong to.

Lines, points, materials, texture coordinates and normals are left out. Surfaces that aren't polygons, and
calls of other files, are refused by name.
"""

import io
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy import ndarray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cagesdf.errors import InputError
from cagesdf.formats.content import names_of, number, plain_text, quoted, read_bounded, whole_number
from cagesdf.formats.polygons import Polygons, triangulated
from cagesdf.meshes import Mesh

# Statements that stand for surfaces, which would be missing without a word.
UNREAD = {
    b"surf": "free-form surfaces", b"bzp": "patches", b"bsp": "patches", b"cdc": "patches", b"cdp": "patches",
    b"res": "patches", b"call": "other files",
}  # fmt: skip
WHITESPACE = b" \t\n\r\x0b\x0c"


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
    content = _read(path)
    return _mesh(path, content, np.ones(len(content.counts), bool))


def read_obj_groups(path: Path) -> list[tuple[str, Mesh]]:
    """The named parts of a file in its order: its objects, or its groups if it has but one object.

    Faces of no group belong to the object, those of no object to "". Objects of one name that share no vertex are several parts, groups of one
    name are one. Two parts may have one name: `naming.distinct_names` tells them apart. Names that aren't UTF-8
    are read as Latin-1. Raises InputError as `read_obj` does.
    """
    content = _read(path)
    if not content.counts:
        return []
    owners = np.asarray(content.owners)
    objects, groups = _objects(content), [group or name for _, name, group in content.names]
    several = len(np.unique(objects[owners])) > 1
    keys = objects if several else np.unique(np.array(groups, object), return_inverse=True)[1]
    raw = [name for _, name, _ in content.names] if several else groups
    _, first, part = np.unique(keys[owners], return_index=True, return_inverse=True)
    order = np.argsort(first)
    names = names_of([_without_comment(raw[owners[first[i]]]) for i in order])
    return [(name, _mesh(path, content, part == i)) for name, i in zip(names, order)]


def _objects(content: _Content) -> Int[ndarray, " n"]:
    """The object of each of `names`: the statements of one name whose faces share vertices, directly or by others."""
    owner = np.repeat(np.asarray(content.owners), np.asarray(content.counts))
    _, name = np.unique(np.array([name for _, name, _ in content.names], object), return_inverse=True)
    statement = np.array([number for number, _, _ in content.names])
    count = len(content.coordinates) // 3
    _, vertex = np.unique(name[owner] * count + np.asarray(content.corners), return_inverse=True)
    size = int(statement.max()) + 1
    links = coo_array((np.ones(len(owner), bool), (statement[owner], size + vertex)), shape=(size + len(owner),) * 2)
    return connected_components(links, directed=False)[1][statement]


def _mesh(path: Path, content: _Content, chosen: ndarray) -> Mesh:
    counts, lines = np.asarray(content.counts), np.asarray(content.lines)[chosen]
    corners = np.asarray(content.corners)[np.repeat(chosen, counts)]
    vertices = np.asarray(content.coordinates).reshape(-1, 3)
    return triangulated(vertices, Polygons(corners, counts[chosen]), lambda i: f"{path}, line {lines[i]}")


def _read(path: Path) -> _Content:
    content = _Content()
    for at, line in _statements(plain_text(read_bounded(path), str(path))):
        key, *words = (line if b"#" not in line else _without_comment(line)).split() or (b"",)
        try:
            if key == b"v":
                _add_vertex(content, words)
            elif key in (b"f", b"fo"):
                _add_face(content, words, at)
            elif key == b"o":
                content.names.append((content.names[-1][0] + 1, line.strip()[1:].strip(), b""))
            elif key == b"g":
                content.names.append((*content.names[-1][:2], line.strip()[1:].strip()))
            elif key in UNREAD:
                raise ValueError(f"{UNREAD[key]} aren't read, wanted polygons")
        except ValueError as error:
            raise InputError(
                f"{path}, line {at}: can't read {quoted(line)} ({error}); is the file cut short? Export it again"
            ) from error
    return content


def _add_vertex(content: _Content, words: list[bytes]) -> None:
    """A vertex; a weight or colours behind its coordinates are left out."""
    if len(words) < 3:
        raise ValueError("a vertex needs three coordinates")
    content.coordinates.extend([number(word) for word in words][:3])


def _add_face(content: _Content, words: list[bytes], line: int) -> None:
    known = len(content.coordinates) // 3
    corners = [whole_number(word.partition(b"/")[0]) for word in words]
    if len(corners) < 3:
        raise ValueError("a face needs three vertices")
    if 0 in corners or max(corners) > known or min(corners) < -known:
        raise ValueError(f"there are {known} vertices before it, counted from 1, or from -1 backwards")
    content.corners.extend(corner - 1 if corner > 0 else corner + known for corner in corners)
    content.counts.append(len(corners))
    content.lines.append(line)
    content.owners.append(len(content.names) - 1)


def _statements(text: bytes) -> Iterator[tuple[int, bytes]]:
    """Lines with their numbers from 1; a backslash at a line's end continues it."""
    begun, first = b"", 0
    for at, line in enumerate(io.BytesIO(text), start=1):
        bare = line.rstrip()
        if _continues(begun + bare):
            begun, first = begun + bare[:-1] + b" ", first or at
            continue
        yield first or at, begun + bare
        begun, first = b"", 0
    if begun:
        yield first, begun


def _continues(line: bytes) -> bool:
    r"""Whether a line ends in a backslash that is no part of a comment, a path, or a letter in GBK or Shift JIS."""
    return line.endswith(b"\\") and line[:1] in b"vfolpg" and line[-2:-1] < b"\x80" and _without_comment(line) == line


def _without_comment(line: bytes) -> bytes:
    """A line up to the first # that begins a word; a name that would be empty then is all of it."""
    at = line.find(b"#")
    while at > 0 and line[at - 1] not in WHITESPACE:
        at = line.find(b"#", at + 1)
    return line if at < 0 else line[:at].rstrip() or line
