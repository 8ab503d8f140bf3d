"""Furniture libraries of Sweet Home 3D (.sh3f): a zip with a catalogue and the models that it names.

`PluginFurnitureCatalog.properties` numbers the pieces from 1: name#1, model#1 (a member of the zip), width#1, depth#1,
height#1 in centimetres, modelRotation#1 (nine numbers, by rows) where the model lies otherwise. A piece's frame has x
along its width, y up and z along its depth; its model is turned, then stretched to these lengths. Only OBJ models are
read; materials, icons, prices and other languages aren't. Nothing is unpacked to a disk: members are read by name,
bounded, so that no name leads out of the zip.
"""

import lzma
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import SHOWN, InputError
from cagesdf.formats.content import MAX_BYTES, numbers, quoted
from cagesdf.formats.naming import distinct_names, part_name
from cagesdf.formats.obj import read_obj_groups
from cagesdf.formats.parts_folder import flat_shape
from cagesdf.geometry.meshes import Mesh
from cagesdf.shape import RawShape

CATALOGUE = "PluginFurnitureCatalog.properties"
MAX_CATALOGUE = 16 * 2**20  # bytes
MAX_PIECES = 10_000
MAX_LENGTH = 1e6  # centimetres
TURNED = 1e-3  # how far a rotation's rows may be from unit length and right angles
FLAT = 1e-9  # of its model's longest side: a side that can't be stretched

NAME = re.compile(r"name#([1-9][0-9]{0,5})")
ENTRY = re.compile(r"((?:\\.|[^\\=:\s])+)\s*[=:]?\s*(.*)", re.DOTALL)
ESCAPE = re.compile(r"\\(?:u([0-9A-Fa-f]{4})|(.))", re.DOTALL)
LETTERS = {"t": "\t", "n": "\n", "r": "\r", "f": "\f"}
# What zipfile raises for content that is damaged, encrypted, or packed in a way that it doesn't know.
DAMAGED = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, NotImplementedError, RuntimeError, EOFError, OSError,
    ValueError, OverflowError,
)  # fmt: skip


def piece_names(path: Path) -> list[str]:
    """A name for each piece of a library, by its number; no two are equal, none leads to another folder.

    Raises InputError if the file is no library, or its catalogue is missing, too large or without pieces.
    """
    catalogue = _catalogue(path)
    plain = [
        re.sub(r"[\\/][\\/.]*", "_", part_name(catalogue[f"name#{number}"])) for number in _pieces(path, catalogue)
    ]
    return distinct_names(name.lstrip(".") for name in plain)


def read_piece(path: Path, place: int, shape_id: str, split: str) -> RawShape:
    """The piece at a place of `piece_names`, in centimetres; its model's groups are its parts.

    Raises InputError if its entries are missing or no lengths, if the library doesn't hold its model, or the model
    can't be read.
    """
    catalogue = _catalogue(path)
    number = _pieces(path, catalogue)[place]
    where = f"{path}, piece {number}"
    size = np.array([_length(where, catalogue, f"{side}#{number}") for side in ("width", "height", "depth")])
    rotation = _rotation(where, catalogue.get(f"modelRotation#{number}", "1 0 0 0 1 0 0 0 1"))
    name = catalogue.get(f"model#{number}", "").removeprefix("/")
    if PurePosixPath(name).suffix.lower() != ".obj":
        raise InputError(f"{where}: its model is {name[:SHOWN]!r}; wanted an .obj file within the library")
    parts = read_obj_groups(path / name, _member(path, name, MAX_BYTES))
    if not parts:
        raise InputError(f"{where}: its model {name[:SHOWN]!r} has no faces")
    ids = distinct_names(name for name, _ in parts)
    meshes = _stretched([mesh for _, mesh in parts], rotation, size)
    return replace(flat_shape(shape_id, split, list(zip(ids, meshes, strict=True))), whole=True)


def _pieces(path: Path, catalogue: Mapping[str, str]) -> list[int]:
    """The numbers of the pieces that have a name."""
    pieces = sorted(int(match[1]) for match in map(NAME.fullmatch, catalogue) if match)
    if not 0 < len(pieces) <= MAX_PIECES:
        raise InputError(f"{path}: its catalogue has {len(pieces):,} pieces (name#1 …); wanted 1 to {MAX_PIECES:,}")
    return pieces


def _catalogue(path: Path) -> dict[str, str]:
    """The entries of the catalogue."""
    return properties(_member(path, CATALOGUE, MAX_CATALOGUE).decode("latin-1"))


def properties(text: str) -> dict[str, str]:
    r"""Java's property files: `key = value`, comments begin with # or !, lines that end in \ go on, \u00e9 is é."""
    entries: dict[str, str] = {}
    pending = ""
    for raw in re.split(r"\r\n|\r|\n", text):
        line = pending + raw.lstrip()
        pending = ""
        if not line or line[0] in "#!":
            continue
        if (len(line) - len(line.rstrip("\\"))) % 2:
            pending = line[:-1]
        elif match := ENTRY.match(line):
            key, value = (_unescaped(part) for part in match.groups())
            entries[key] = value
    return entries


def _unescaped(text: str) -> str:
    plain = ESCAPE.sub(lambda match: chr(int(match[1], 16)) if match[1] else LETTERS.get(match[2], match[2]), text)
    return plain.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def _member(path: Path, name: str, most: int) -> bytes:
    """The bytes of a member of the zip, of which at most `most` are unpacked."""
    try:
        with zipfile.ZipFile(path) as archive:
            if name not in archive.namelist():
                raise InputError(f"{path}: holds no {name[:SHOWN]!r}; is it a furniture library? Export it again")
            with archive.open(name) as stream:
                content = stream.read(most + 1)
    except DAMAGED as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: can't be read as a zip ({error}); export it again") from error
    if len(content) > most:
        raise InputError(f"{path}: {name[:SHOWN]!r} has more than {most:,} bytes, the most that are read; simplify it")
    return content


def _length(where: str, catalogue: Mapping[str, str], key: str) -> float:
    text = catalogue.get(key, "")
    [length] = _numbers(where, key, text, 1)
    if not 0 < length <= MAX_LENGTH:
        raise InputError(f"{where}: {key} is {text[:SHOWN]!r}; wanted centimetres above 0, at most {MAX_LENGTH:,.0f}")
    return length


def _rotation(where: str, text: str) -> Float[ndarray, "3 3"]:
    matrix = np.array(_numbers(where, "modelRotation", text, 9)).reshape(3, 3)
    if not (np.abs(matrix @ matrix.T - np.eye(3)).max() <= TURNED and np.linalg.det(matrix) > 0):
        raise InputError(f"{where}: modelRotation {text[:SHOWN]!r} is no rotation; wanted its nine numbers by rows")
    return matrix


def _numbers(where: str, key: str, text: str, count: int) -> list[float]:
    words = text.encode("utf-8", "replace").split()
    try:
        values = numbers(words)
    except ValueError as error:
        raise InputError(f"{where}: {key}: {error}") from error
    if len(values) != count or not np.isfinite(values).all() or max(map(abs, values)) > MAX_LENGTH:
        raise InputError(f"{where}: {key} is {quoted(text.encode())}; wanted {count} finite number(s)")
    return values


def _stretched(meshes: list[Mesh], rotation: Float[ndarray, "3 3"], size: Float[ndarray, " 3"]) -> list[Mesh]:
    """Meshes turned, then stretched together into the box [-w/2, w/2] × [0, h] × [-d/2, d/2]; flat sides stay flat."""
    turned = [mesh.vertices @ rotation.T for mesh in meshes]
    corners = np.concatenate(turned)
    low, side = corners.min(axis=0), np.ptp(corners, axis=0)
    flat = side <= FLAT * side.max()
    scale = np.where(flat, 1.0, size / np.where(flat, 1.0, side))
    start = np.array([-0.5, 0.0, -0.5]) * np.where(flat, 0.0, size)
    return [Mesh((vertices - low) * scale + start, mesh.faces) for vertices, mesh in zip(turned, meshes)]
