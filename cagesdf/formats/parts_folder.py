"""Plain part meshes: a folder with one file a part, or one file whose groups or scene nodes are the parts.

Parts are assembled in place, in any unit. Nothing tells how they belong together, so the
structure is flat; labels are the letters in the parts' names ("left_leg_2" is "left leg").
"""

import io
import re
import struct
from pathlib import Path

import numpy as np

from cagesdf.errors import InputError
from cagesdf.formats import gltf
from cagesdf.formats.naming import UNNAMED, distinct_names, part_name
from cagesdf.formats.obj import read_bounded, read_obj, read_obj_groups
from cagesdf.meshes import Mesh, join
from cagesdf.shape import RawPart, RawShape
from cagesdf.structure.hierarchy import PartHierarchy

MESH_SUFFIXES = (".obj", ".ply", ".stl", *gltf.SUFFIXES)
SCENE_SUFFIXES = (".obj", *gltf.SUFFIXES)  # files that can hold several named parts


def part_files(folder: Path) -> list[Path]:
    """The mesh files of a folder, numbers in their names in numerical order."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in MESH_SUFFIXES and path.is_file()]
    return sorted((path for path in files if not path.name.startswith(".")), key=_natural)


def read_parts_folder(folder: Path, shape_id: str, split: str) -> RawShape:
    """One shape from a folder with a mesh file for each part; part ids are the files' names without extension.

    Raises InputError if there is no mesh file, two have the same name, or one can't be read.
    """
    files = part_files(folder)
    if not files:
        raise InputError(f"{folder}: holds no mesh; wanted one {', '.join(MESH_SUFFIXES)} file for each part")
    return _flat(folder, shape_id, split, [(part_name(path.stem), _read_mesh(path)) for path in files])


def read_parts_file(path: Path, shape_id: str, split: str) -> RawShape:
    """One shape from one OBJ, whose objects or groups are the parts, or one glTF, whose scene nodes are.

    A PLY or STL file, which has neither, is a shape of one part.

    Raises InputError if the file can't be read or has no faces.
    """
    parts = read_obj_groups(path) if path.suffix.lower() == ".obj" else _read_scene(path)
    if not parts:
        raise InputError(f"{path}: has no faces; wanted a part in each of its groups or nodes")
    ids = distinct_names(name for name, _ in parts)
    return _flat(path, shape_id, split, list(zip(ids, (mesh for _, mesh in parts), strict=True)))


def _natural(path: Path) -> tuple[list[str | int], str]:
    # Letters and numbers alternate in the split, so that positions compare like with like.
    return [int(piece) if piece.isdecimal() else piece for piece in re.split(r"(\d+)", path.stem)], path.name


def _flat(source: Path, shape_id: str, split: str, named: list[tuple[str, Mesh]]) -> RawShape:
    names = tuple(name for name, _ in named)
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(f"{source}: two parts are called {name!r}; rename one")
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
    """The meshes of a PLY, STL or glTF file with the names of their nodes, placed as the scene places them."""
    import trimesh

    if path.suffix.lower() in gltf.SUFFIXES:
        return gltf.read_gltf(path)
    kind = path.suffix.lower().removeprefix(".")
    content = io.BytesIO(read_bounded(path))
    try:
        # From bytes and without a resolver, so that a file can't make us open others.
        scene = trimesh.load_scene(content, file_type=kind, resolver=None, process=False, skip_materials=True)
        parts = []
        for node in scene.graph.nodes_geometry:
            pose, name = scene.graph[node]
            mesh = scene.geometry[name]
            if isinstance(mesh, trimesh.Trimesh):
                placed = np.asarray(mesh.vertices, np.float64) @ pose[:3, :3].T + pose[:3, 3]
                faces = np.asarray(mesh.faces, np.int32)
                # A mirroring pose turns the faces inside out.
                parts.append((str(node), Mesh(placed, faces if np.linalg.det(pose[:3, :3]) > 0 else faces[:, ::-1])))
    except (
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        OSError,
        MemoryError,
        RuntimeError,
        struct.error,
    ) as error:
        raise InputError(f"{path}: can't be read as {kind.upper()} ({error!r}); export it again") from error
    return parts
