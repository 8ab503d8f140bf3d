"""Plain part meshes: a folder with one file a part, or one file whose groups or scene nodes are the parts.

A folder with a single mesh file, as models are downloaded, is that file.
Parts are assembled in place, in any unit. Nothing tells how they belong together, so the
structure is flat; labels are the letters in the parts' names ("left_leg_2" is "left leg").
"""

import os
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from cagesdf.errors import InputError
from cagesdf.formats import gltf
from cagesdf.formats.content import names_of
from cagesdf.formats.naming import UNNAMED, ambiguity, distinct_names, part_name
from cagesdf.formats.obj import read_obj, read_obj_groups
from cagesdf.formats.ply import read_ply
from cagesdf.formats.stl import read_stl
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.shape import RawPart, RawShape
from cagesdf.structure.hierarchy import PartHierarchy

# Mesh formats by their suffix: each reads the named meshes of a file, its groups, solids, or nodes where they are
# placed. Names may be equal or "".
READERS: dict[str, Callable[[Path], list[tuple[str, Mesh]]]] = {
    ".obj": read_obj_groups,
    ".ply": lambda path: [("", read_ply(path))],
    ".stl": read_stl,
    **dict.fromkeys(gltf.SUFFIXES, gltf.read_gltf),
}
MESH_SUFFIXES = tuple(READERS)


def part_files(folder: Path) -> list[Path]:
    """The mesh files of a folder, numbers in their names in numerical order."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in MESH_SUFFIXES and path.is_file()]
    return sorted((path for path in files if not path.name.startswith(".")), key=_natural)


def read_parts_folder(folder: Path, shape_id: str, split: str) -> RawShape:
    """One shape from a folder with a mesh file for each part; part ids are the files' names without extension.

    The groups or nodes of a single file are its parts, as `read_parts_file` has them. Raises InputError if there is no
    mesh file, two have the same name, or one can't be read.
    """
    files = part_files(folder)
    if not files:
        raise InputError(f"{folder}: holds no mesh; wanted one {', '.join(MESH_SUFFIXES)} file for each part")
    names = [part_name(name) for name in names_of([os.fsencode(path.stem) for path in files])]
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        rivals = [path.name for path, name in zip(files, names) if name == twice]
        raise InputError(f"{folder}: {ambiguity(rivals, twice)}")
    if len(files) > 1:
        return flat_shape(shape_id, split, list(zip(names, map(_read_mesh, files), strict=True)))
    shape = read_parts_file(files[0], shape_id, split)
    if len(shape.parts) > 1:
        return shape
    return replace(flat_shape(shape_id, split, [(names[0], shape.parts[0].mesh)]), whole=True)


def read_parts_file(path: Path, shape_id: str, split: str) -> RawShape:
    """One shape from one file: an OBJ's objects or groups, an STL's solids and a glTF's scene nodes are its parts.

    A PLY file, which has none of these, is a shape of one part. Of parts that share a name, all but the first
    get a number. Raises InputError if the file can't be read or has no faces.
    """
    parts = _read_scene(path)
    if not parts:
        raise InputError(f"{path}: has no faces; wanted a part in each of its groups or nodes")
    ids = distinct_names(name for name, _ in parts)
    return replace(flat_shape(shape_id, split, list(zip(ids, (mesh for _, mesh in parts), strict=True))), whole=True)


def _natural(path: Path) -> tuple[list[str | int], str]:
    # Letters and numbers alternate in the split, so that positions compare like with like.
    return [int(piece) if piece.isdecimal() else piece for piece in re.split(r"(\d+)", path.stem)], path.name


def flat_shape(shape_id: str, split: str, named: list[tuple[str, Mesh]]) -> RawShape:
    """A shape of parts by distinct names, of which nothing tells how they belong together."""
    names = tuple(name for name, _ in named)
    labels = tuple(map(_label, names))
    parts = tuple(RawPart(name, label, mesh) for (name, mesh), label in zip(named, labels))
    return RawShape(shape_id, split, parts, PartHierarchy.flat(names, labels, ""))


def _label(name: str) -> str:
    return " ".join(re.sub(r"[\W\d_]+", " ", name).split()).lower() or UNNAMED


def _read_mesh(path: Path) -> Mesh:
    if path.suffix.lower() == ".obj":
        return read_obj(path)
    meshes = [mesh for _, mesh in _read_scene(path)]
    if not meshes:
        raise InputError(f"{path}: has no faces; is the file cut short? Export it again")
    return join(meshes)


def _read_scene(path: Path) -> list[tuple[str, Mesh]]:
    return READERS[path.suffix.lower()](path)
