"""Wavefront OBJ: vertices, faces and the objects or groups they belong to; nothing else is read."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from cagesdf.errors import InputError
from cagesdf.meshes import Mesh, compact

MAX_BYTES = 512 * 2**20


@dataclass
class _Content:
    vertices: list[list[float]] = field(default_factory=list)  # x, y, z
    triangles: list[tuple[int, int, int]] = field(default_factory=list)  # vertex numbers from 0
    owners: list[tuple[str, str]] = field(default_factory=list)  # object and group of each triangle


def read_obj(path: Path) -> Mesh:
    """All faces of a file as one mesh, raw frame; polygons become fans of triangles.

    Raises InputError with file, line and text for a line that can't be read, a face with fewer
    than three vertices, or an index that names no vertex so far in the file.
    """
    content = _read(path)
    return _mesh(content, content.triangles)


def read_obj_groups(path: Path) -> list[tuple[str, Mesh]]:
    """The named parts of a file in its order: its objects, or its groups if it has but one object.

    Faces without a name belong to "". Raises InputError as `read_obj` does.
    """
    content = _read(path)
    kind = 0 if len({owner[0] for owner in content.owners}) > 1 else 1
    parts: dict[str, list[tuple[int, int, int]]] = {}
    for triangle, owner in zip(content.triangles, content.owners):
        parts.setdefault(owner[kind], []).append(triangle)
    return [(name, _mesh(content, triangles)) for name, triangles in parts.items()]


def read_bounded(path: Path) -> bytes:
    """A file's bytes. Raises InputError if it is missing, unreadable or larger than MAX_BYTES."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: has {path.stat().st_size:,} bytes, at most {MAX_BYTES:,} are read; simplify it")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror}); export it again") from error


def _mesh(content: _Content, triangles: Sequence[tuple[int, int, int]]) -> Mesh:
    faces = np.array(triangles, dtype=np.int32).reshape(-1, 3)
    return compact(Mesh(np.array(content.vertices, dtype=np.float64).reshape(-1, 3), faces))


def _read(path: Path) -> _Content:
    content = _Content()
    owner = ("", "")
    # A backslash at a line's end continues it.
    text = read_bounded(path).decode("utf-8", errors="replace").replace("\r\n", "\n").replace("\\\n", " ")
    for number, line in enumerate(text.split("\n"), start=1):
        words = line.split()
        if not words:
            continue
        key = words[0]
        try:
            if key == "v":
                x, y, z = words[1:4]
                content.vertices.append([float(x), float(y), float(z)])
            elif key == "f":
                corners = [int(word.partition("/")[0]) for word in words[1:]]
                known = len(content.vertices)
                corners = [corner - 1 if corner > 0 else corner + known for corner in corners]
                if len(corners) < 3:
                    raise ValueError("a face needs three vertices")
                if min(corners) < 0 or max(corners) >= known:
                    raise ValueError(f"there are {known} vertices before it")
                content.triangles += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
                content.owners += [owner] * (len(corners) - 2)
            elif key == "o":
                owner = (" ".join(words[1:]), "")
            elif key == "g":
                owner = (owner[0], " ".join(words[1:]))
        except ValueError as error:
            raise InputError(
                f"{path}, line {number}: can't read {line[:60]!r} ({error}); is the file cut short? Export it again"
            ) from error
    return content
