"""Which shapes a folder holds, in which format each is, and which are for validation.

A category folder may mix

    <shape>/result_after_merging.json     PartNet; hierarchy in <anything>_hier/<shape>.json if there is one
    <shape>/*.obj, .ply, .stl, .glb       one file a part
    <shape>.obj, <shape>.glb              one file, a part in each group or scene node

each with a ShapeAssembly program in <anything>_programs/<shape>.txt if there is one: then its
leaves are the shape's parts, whatever the other files call parts. A folder may also
hold `train.txt` and `val.txt` with an id on each line (as does StructureNet's folder of
hierarchies). With a train.txt, a shape that it doesn't list is for validation, since it may be
of a test set; else the shapes in val.txt are; else none is.
"""

from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from cagesdf.alignment import Candidate
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.formats import shapeassembly, structurenet
from cagesdf.formats.partnet import TREE, read_candidates, read_partnet
from cagesdf.formats.parts_folder import MESH_SUFFIXES, SCENE_SUFFIXES, part_files, read_parts_file, read_parts_folder
from cagesdf.formats.shapeassembly import find_program, read_assembly
from cagesdf.formats.structurenet import find_hierarchy
from cagesdf.meshes import Mesh
from cagesdf.shape import RawShape


@dataclass(frozen=True)
class ShapeSource:
    """Where one shape is; nothing of it has been read."""

    shape_id: str  # unique in its category
    split: str  # "train" or "val"
    path: Path  # its folder or file
    hierarchy: Path | None  # StructureNet's JSON
    program: Path | None  # ShapeAssembly's text


def list_shapes(folder: Path, include: str) -> list[ShapeSource]:
    """The shapes of a category folder whose id fits the glob `include`, sorted by id.

    Raises InputError if there is no such folder, no shape fits, or two have the same id.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; wanted one with a folder or file for each shape")
    if (folder / TREE).is_file():
        raise InputError(f"{folder}: is a single PartNet shape; give the folder that holds it")
    places: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        shape_id = _shape_id(path)
        if shape_id is None or not fnmatchcase(shape_id, include):
            continue
        if shape_id in places:
            raise InputError(f"{folder}: {places[shape_id].name} and {path.name} would both be shape {shape_id}")
        places[shape_id] = path
    if not places:
        raise InputError(f"{folder}: no folder, .obj or .glb file fits include {include!r}; each would be one shape")
    train, val = _read_ids(folder, "train"), _read_ids(folder, "val")

    def split(shape_id: str) -> str:
        held_out = shape_id not in train if train is not None else shape_id in (val or ())
        return "val" if held_out else "train"

    return [
        ShapeSource(shape_id, split(shape_id), path, find_hierarchy(folder, shape_id), find_program(folder, shape_id))
        for shape_id, path in sorted(places.items())
    ]


def find_shapes(path: Path) -> list[ShapeSource]:
    """The shapes at a path: a mesh file, a folder of part meshes, a PartNet shape, or a folder of shapes.

    Meshes side by side are the parts of one shape, which is taken by itself, without hierarchies
    or programs beside it. Raises InputError if nothing of the kind is there.
    """
    if path.is_file() and path.suffix.lower() in MESH_SUFFIXES:
        return [ShapeSource(path.stem, "train", path, None, None)]
    if not path.is_dir():
        known = "no such file or folder" if not path.exists() else "no mesh"
        raise InputError(f"{path}: {known}; wanted one {', '.join(MESH_SUFFIXES)} file, or a folder of them")
    if (path / TREE).is_file() or part_files(path):
        return [ShapeSource(path.resolve().name, "train", path, None, None)]
    return list_shapes(path, "*")


def read_shape(source: ShapeSource) -> RawShape:
    """One shape as its files give it. Raises ShapeRejected with the reason if they can't be read."""
    try:
        if source.program is None:
            return _read_parts(source)
        return read_assembly(source.program, source.shape_id, source.split, *_read_candidates(source))
    except InputError as error:
        raise ShapeRejected(source.shape_id, "import_shapes", str(error)) from error


def _read_parts(source: ShapeSource) -> RawShape:
    if source.path.is_file():
        return read_parts_file(source.path, source.shape_id, source.split)
    if (source.path / TREE).is_file():
        return read_partnet(source.path, source.shape_id, source.split, source.hierarchy)
    return read_parts_folder(source.path, source.shape_id, source.split)


def _read_candidates(source: ShapeSource) -> tuple[list[Candidate], dict[str, Mesh]]:
    """What the leaves of a shape's program may stand for, and all its meshes."""
    if (source.path / TREE).is_file():
        return read_candidates(source.path)
    parts = _read_parts(source).parts
    candidates = [Candidate(part.part_id, part.label, (part.part_id,)) for part in parts]
    return candidates, {part.part_id: part.mesh for part in parts}


def _shape_id(path: Path) -> str | None:
    if path.name.startswith("."):
        return None
    if path.is_dir():
        return None if path.name.endswith((structurenet.SUFFIX, shapeassembly.SUFFIX)) else path.name
    return path.stem if path.suffix.lower() in SCENE_SUFFIXES else None


def _read_ids(folder: Path, split: str) -> frozenset[str] | None:
    """The ids that a split's file lists, None if there is none; the category folder's wins over the hierarchies'."""
    files = [folder / f"{split}.txt", *sorted(folder.glob(f"*{structurenet.SUFFIX}/{split}.txt"))]
    for path in files:
        if path.is_file():
            return frozenset(path.read_text(encoding="utf-8").split())
    return None
