"""Parts that are kept in a file beside a shape's mesh, to be edited by hand: `<shape>.parts.json`.

    {"components": 2, "parts": [
        {"name": "seat", "label": "seat", "pieces": [
            {"component": 0, "planes": [[0, 1, 0, 0.45]], "inside": [0, 0.4, 0]}]}, …]}

A piece is the part of a connected component of the shape in half-spaces n·x ≤ d, around a point. To merge parts, put
their pieces into one list; to split a piece by a plane, write it twice, with the plane and with its opposite. Lengths
are in the mesh file's frame and unit; components are numbered by volume, the largest first.
"""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cagesdf.errors import InputError
from cagesdf.shape import WrittenPart, WrittenParts, WrittenPiece
from cagesdf.text import read_text

SUFFIX = ".parts.json"
MAX_BYTES = 16 * 2**20
MAX_PARTS, MAX_PIECES, MAX_PLANES = 1000, 10_000, 1000  # of a shape, a shape and a piece
UNIT = 1e-3  # by how much a normal's length may differ from 1


def read_written(path: Path) -> WrittenParts:
    """The parts of a file. Raises InputError that names the file and the first wrong entry."""
    try:
        content = json.loads(read_text(path, MAX_BYTES))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is no JSON ({error}); write it anew with cagesdf parts") from error
    try:
        return _parts(content)
    except _WrongError as error:
        raise InputError(f"{path}: {error}") from error


def written_json(parts: WrittenParts) -> str:
    """The text of a file, a part a line."""
    rows = [json.dumps(asdict(part), ensure_ascii=False) for part in parts.parts]
    return f'{{"components": {parts.components}, "parts": [\n' + ",\n".join(rows) + "\n]}\n"


class _WrongError(Exception):
    """An entry that isn't as it must be."""


def _parts(content: Any) -> WrittenParts:
    entries = _list(_object(content, "the file"), "parts", "the file", MAX_PARTS)
    parts = tuple(_part(entry, f"part {i}") for i, entry in enumerate(entries))
    names = [part.name for part in parts]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise _WrongError(f"two parts are called {twice!r}; rename one")
    if sum(len(part.pieces) for part in parts) > MAX_PIECES:
        raise _WrongError(f"more than {MAX_PIECES:,} pieces")
    return WrittenParts(_whole(content, "components", "the file"), parts)


def _part(entry: Any, place: str) -> WrittenPart:
    name, label = (_object(entry, place).get(key, "") for key in ("name", "label"))
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise _WrongError(f"{place}: wanted a name of printable letters, got {str(name)[:60]!r}")
    if not isinstance(label, str) or (label and not label.isprintable()):
        raise _WrongError(f"{place}: wanted a label of printable letters, got {str(label)[:60]!r}")
    pieces = _list(entry, "pieces", place, MAX_PIECES)
    return WrittenPart(name, label, tuple(_piece(piece, f"{place}, piece {i}") for i, piece in enumerate(pieces)))


def _piece(entry: Any, place: str) -> WrittenPiece:
    component = _whole(_object(entry, place), "component", place)
    planes = entry.get("planes", [])
    if not isinstance(planes, list) or len(planes) > MAX_PLANES:
        raise _WrongError(f"{place}: wanted a list of at most {MAX_PLANES:,} planes, got {str(planes)[:60]}")
    rows = []
    for plane in planes:
        x, y, z, d = _numbers(plane, 4, f"{place}: a plane's normal and offset")
        if abs(math.hypot(x, y, z) - 1) > UNIT:
            raise _WrongError(f"{place}: wanted a plane with a normal of length 1, got {[x, y, z]}")
        rows.append((x, y, z, d))
    x, y, z = _numbers(entry.get("inside"), 3, f"{place}: a point inside")
    return WrittenPiece(component, tuple(rows), (x, y, z))


def _object(entry: Any, place: str) -> dict[str, Any]:
    if not isinstance(entry, dict):
        raise _WrongError(f"{place}: wanted an object, got {str(entry)[:60]}")
    return entry


def _list(entry: dict[str, Any], key: str, place: str, most: int) -> list[Any]:
    values = entry.get(key)
    if not isinstance(values, list) or not 0 < len(values) <= most:
        raise _WrongError(f"{place}: wanted a list of 1 to {most:,} {key}, got {str(values)[:60]}")
    return values


def _whole(entry: dict[str, Any], key: str, place: str) -> int:
    value = entry.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise _WrongError(f"{place}: wanted a whole number of 0 or more as {key}, got {str(value)[:60]}")
    return value


def _numbers(values: Any, count: int, place: str) -> list[float]:
    numbers = values if isinstance(values, list) else []
    if len(numbers) != count or any(isinstance(n, bool) or not isinstance(n, int | float) for n in numbers):
        raise _WrongError(f"{place}: wanted {count} numbers, got {str(values)[:60]}")
    if not all(abs(n) < 1e30 for n in numbers):  # NaN and infinity aren't, nor are integers that no float holds
        raise _WrongError(f"{place}: wanted finite numbers, got {str(values)[:60]}")
    return [float(n) for n in numbers]
