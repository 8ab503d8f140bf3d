"""The shapes of a folder, the format of each, and those held out for validation.

A category folder may mix

    <shape>/result_after_merging.json     PartNet; hierarchy in <anything>_hier/<shape>.json if there is one
    <shape>/<part>.<suffix>               a mesh file a part
    <shape>.<suffix>                      a mesh file a shape, a part in each group or scene node
    <library>.<suffix>                    a file of LIBRARIES: the shape <library>_<piece> for each of its pieces

with MESH_SUFFIXES, each with a ShapeAssembly program in <anything>_programs/<shape>.txt if there is one: then its
leaves are the shape's parts, whatever the other files call parts. `<shape>.parts.json` beside a shape, if there is one,
has parts that its user wrote down. A shape's id is the name of its folder or file, as
`splits.composed` spells it; hierarchies and programs are found by exactly this name.

`train.txt` and `val.txt`, in the folder itself or else in those of hierarchies, as StructureNet has them, say which
shapes are held out: `splits.py` has the rules.

Everything else is no shape and is noted: folders without a mesh, mesh formats that aren't read, other files. Hidden
files and those of JUNK, which operating systems leave, are passed over.
"""

import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.formats import sh3f, shapeassembly, structurenet
from cagesdf.formats.alignment import Candidate
from cagesdf.formats.naming import ambiguity
from cagesdf.formats.partnet import MESH_FOLDERS, TREE, read_candidates, read_partnet
from cagesdf.formats.parts_folder import MESH_SUFFIXES, part_files, read_parts_file, read_parts_folder
from cagesdf.formats.shapeassembly import read_assembly
from cagesdf.formats.splits import TRAIN, VAL, composed, several, splits
from cagesdf.geometry.meshes import Mesh
from cagesdf.parts.written import SUFFIX, read_written
from cagesdf.shape import RawShape

JUNK = {"__macosx", "thumbs.db", "desktop.ini", "$recycle.bin", "system volume information", "@eadir", "lost+found"}
# Mesh and CAD formats that aren't read, and archives; those that MESH_SUFFIXES gains drop out.
FOREIGN = {
    ".3dm", ".3ds", ".3mf", ".7z", ".abc", ".amf", ".blend", ".c4d", ".ctm", ".dae", ".drc", ".dwg", ".dxf", ".fbx",
    ".gltf", ".gz", ".iges", ".igs", ".ifc", ".jt", ".lwo", ".ma", ".max", ".mb", ".mesh", ".msh", ".obj", ".off",
    ".pcd", ".ply", ".rar", ".skp", ".step", ".stl", ".stp", ".tar", ".tgz", ".usd", ".usda", ".usdc", ".usdz", ".vrm",
    ".vtk", ".vtp", ".wrl", ".x", ".x3d", ".xyz", ".zip",
} - {*MESH_SUFFIXES}  # fmt: skip


@dataclass(frozen=True)
class Library:
    """A format of files that hold several shapes each, their pieces."""

    names: Callable[[Path], list[str]]  # of a file's pieces, distinct; raises InputError
    read: Callable[[Path, int, str, str], RawShape]  # a piece by its place in `names`, with id and split; the same


LIBRARIES = {".sh3f": Library(sh3f.piece_names, sh3f.read_piece)}  # by the suffix


@dataclass(frozen=True)
class ShapeSource:
    """The place of one shape; nothing of it has been read."""

    shape_id: str  # unique in its category, Unicode NFC
    split: str  # "train" or "val"
    path: Path  # its folder or file
    hierarchy: Path | None  # StructureNet's JSON
    program: Path | None  # ShapeAssembly's text
    written: Path | None = None  # parts that a user wrote down
    rivals: tuple[Path, ...] = ()  # others of the same id: if there are any, none is read
    piece: int | None = None  # of a library, which `path` is then


@dataclass(frozen=True)
class Listing:
    """The shapes of a folder, and notes on everything else in it."""

    shapes: tuple[ShapeSource, ...]  # sorted by id
    notes: tuple[str, ...]  # a line each: entries that are no shape and why, ids that name none

    def __iter__(self) -> Iterator[ShapeSource]:
        return iter(self.shapes)

    def __len__(self) -> int:
        return len(self.shapes)


@dataclass
class _Entries:
    """The entries of a category folder by kind."""

    shapes: list[tuple[str, Path]] = field(default_factory=list)  # id, folder or file
    pieces: dict[tuple[str, Path], int] = field(default_factory=dict)  # of those that are pieces of a library
    hierarchies: list[Path] = field(default_factory=list)  # folders
    programs: list[Path] = field(default_factory=list)  # folders
    lists: dict[str, list[Path]] = field(default_factory=lambda: {TRAIN: [], VAL: []})
    foreign: list[str] = field(default_factory=list)  # files of FOREIGN
    empty: list[str] = field(default_factory=list)  # folders without a mesh
    unnamed: list[str] = field(default_factory=list)  # names that are no text
    closed: list[str] = field(default_factory=list)  # folders that can't be opened, and why
    misnamed: list[str] = field(default_factory=list)  # folders of hierarchies or programs with meshes
    damaged: list[str] = field(default_factory=list)  # libraries that can't be read, and why
    written: list[str] = field(default_factory=list)  # files with parts of shapes
    others: list[str] = field(default_factory=list)  # files

    def notes(self) -> Iterator[str]:
        """One line for each kind of entry that is no shape."""
        if self.foreign:
            yield f"not read: {several(self.foreign)}; export or unpack them as one of {', '.join(MESH_SUFFIXES)}"
        if self.empty:
            yield f"no shapes, as no mesh lies in these folders: {several(self.empty)}"
        if self.unnamed:
            yield f"no shapes, as their names are no text: {several(self.unnamed)}; rename them"
        if self.closed:
            yield f"left out, as these folders can't be opened: {several(self.closed)}"
        if self.damaged:
            yield f"left out: {several(self.damaged)}"
        if self.misnamed:
            yield (
                f"no shapes, as folders of hierarchies or programs end like them: {several(self.misnamed)}; "
                "rename those whose meshes are a shape"
            )
        ids = {f"{shape_id}{SUFFIX}" for shape_id, _ in self.shapes}
        if alone := [name for name in self.written if name not in ids]:
            yield f"parts of no shape, as none is called like these: {several(alone)}"
        if self.others:
            yield f"no shapes: {several(self.others)}"


def list_shapes(folder: Path, include: str) -> Listing:
    """The shapes of a category folder that are called `include` or whose id fits it as a glob.

    Folders and files that would have the same id are one shape, which `read_shape` rejects. Raises InputError if
    there is no such folder, no shape fits, or a list can't be read.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; wanted one with a folder or file for each shape")
    if (folder / TREE).is_file():
        raise InputError(f"{folder}: is a single PartNet shape; give the folder that holds it")
    fits = composed(include)
    entries = _entries(folder, fits)
    places: dict[str, list[Path]] = {}
    for shape_id, path in entries.shapes:
        places.setdefault(shape_id, []).append(path)
    shapes = sorted(shape_id for shape_id in places if _fits(shape_id, fits))
    notes = list(entries.notes())
    if not shapes:
        raise InputError(
            "; ".join([f"{folder}: no folder or mesh file fits include {include!r}; each would be one shape", *notes])
        )
    if len(shapes) > 1 and all(path.is_file() for _, path in entries.shapes) and not entries.pieces:
        notes.append(
            f"each mesh file is a shape; parts of one shape belong into a folder of their own, {folder.name}/<shape>"
        )
    train, val = (entries.lists[name] for name in (TRAIN, VAL))
    if not train and not val:
        train, val = ([f / name for f in entries.hierarchies if (f / name).is_file()] for name in (TRAIN, VAL))
    split, open_ids = splits(shapes, places.keys(), train, val)
    hierarchies, programs = _by_id(entries.hierarchies, ".json"), _by_id(entries.programs, ".txt")
    for kind, files in (("hierarchies", hierarchies), ("programs", programs)):
        if files and not files.keys() & places.keys():
            notes.append(f"none of the {len(files):,} {kind} is called like a shape: {several(sorted(files))}")
    sources = [
        ShapeSource(
            shape_id,
            split[shape_id],
            path,
            hierarchies.get(shape_id),
            programs.get(shape_id),
            None if (shape_id, path) in entries.pieces else _written(path),
            tuple(rivals),
            entries.pieces.get((shape_id, path)),
        )
        for shape_id in shapes
        for path, *rivals in [places[shape_id]]
    ]
    return Listing(tuple(sources), (*notes, *open_ids))


def find_shapes(path: Path, include: str) -> Listing:
    """The shapes at a path: a mesh file, a PartNet shape, a library, or a category folder as for `list_shapes`.

    Raises InputError if nothing of the kind is there.
    """
    if path.is_file() and path.suffix.lower() in LIBRARIES:
        return _pieces(path, composed(include))
    single = not path.is_dir() or (path / TREE).is_file()
    return Listing((find_shape(path),), ()) if single else list_shapes(path, include)


def find_shape(path: Path) -> ShapeSource:
    """The single shape at a path: a mesh file, a PartNet shape, or a folder of part meshes.

    It is taken by itself, without hierarchies or programs beside it. Raises InputError if nothing of the kind is
    there.
    """
    wanted = f"wanted one {', '.join(MESH_SUFFIXES)} file, or a folder of them"
    if path.is_file() and path.suffix.lower() in MESH_SUFFIXES:
        return ShapeSource(composed(path.stem), "train", path, None, None, _written(path))
    if path.is_file() and path.suffix.lower() in LIBRARIES:
        return _only(path, find_shapes(path, "*"))
    if not path.is_dir():
        raise InputError(f"{path}: {'is no mesh' if path.exists() else 'no such file or folder'}; {wanted}")
    if _holds_shape(path):
        return ShapeSource(composed(path.resolve().name), "train", path, None, None, _written(path.resolve()))
    shapes = [shape_id for shape_id, _ in _entries(path, "*").shapes]
    if shapes:
        raise InputError(f"{path}: holds {len(shapes):,} shapes, such as {shapes[0]}; name one")
    raise InputError(f"{path}: holds no mesh; {wanted}")


def _pieces(path: Path, fits: str) -> Listing:
    """The pieces of a library whose ids fit a glob."""
    ids = [_piece_id(path, name) for name in LIBRARIES[path.suffix.lower()].names(path)]
    sources = [ShapeSource(ids[i], "train", path, None, None, piece=i) for i in range(len(ids)) if _fits(ids[i], fits)]
    if not sources:
        raise InputError(f"{path}: none of its {len(ids):,} pieces fits include {fits!r}")
    return Listing(tuple(sorted(sources, key=lambda source: source.shape_id)), ())


def _only(path: Path, listing: Listing) -> ShapeSource:
    """The single piece of a library."""
    if len(listing) > 1:
        first = listing.shapes[0].shape_id
        raise InputError(
            f"{path}: holds {len(listing):,} pieces, such as {first}; give a folder that holds the library"
        )
    return listing.shapes[0]


def read_shape(source: ShapeSource) -> RawShape:
    """One shape as its files give it. Raises ShapeRejected if they can't be read, or others have the same id."""
    if source.rivals:
        names = [path.name for path in (source.path, *source.rivals)]
        reason = f"{source.path.parent}: {ambiguity(names, source.shape_id)}"
        raise ShapeRejected(source.shape_id, "import_shapes", reason)
    try:
        if source.written is not None:
            return replace(_read_parts(source), written=read_written(source.written))
        if source.program is None:
            return _read_parts(source)
        return read_assembly(source.program, source.shape_id, source.split, *_read_candidates(source))
    except InputError as error:
        raise ShapeRejected(source.shape_id, "import_shapes", str(error)) from error


def _written(path: Path) -> Path | None:
    """The file with a shape's parts beside its mesh or folder, if there is one."""
    written = path.with_name((path.name if path.is_dir() else path.stem) + SUFFIX)
    return written if written.is_file() else None


def _read_parts(source: ShapeSource) -> RawShape:
    if source.piece is not None:
        library = LIBRARIES[source.path.suffix.lower()]
        return library.read(source.path, source.piece, source.shape_id, source.split)
    if source.path.is_file():
        return read_parts_file(source.path, source.shape_id, source.split)
    if _is_partnet(source.path):
        return read_partnet(source.path, source.shape_id, source.split, source.hierarchy)
    return read_parts_folder(source.path, source.shape_id, source.split)


def _read_candidates(source: ShapeSource) -> tuple[list[Candidate], dict[str, Mesh]]:
    """The meshes that the leaves of a shape's program may stand for, and all its meshes by name."""
    if _is_partnet(source.path):
        return read_candidates(source.path)
    parts = _read_parts(source).parts
    candidates = [Candidate(part.part_id, part.label, (part.part_id,)) for part in parts]
    return candidates, {part.part_id: part.mesh for part in parts}


def _entries(folder: Path, fits: str) -> _Entries:
    """The entries of a folder by kind. Entries that are no shapes are named only if they fit."""
    entries = _Entries()
    for path in sorted(folder.iterdir()):
        name = composed(path.name)
        if name.startswith(".") or name.casefold() in JUNK:
            continue
        if any(unicodedata.category(character) in ("Cc", "Cs") for character in name):
            entries.unnamed.append(ascii(name))
        elif path.is_dir():
            try:
                _enter_folder(entries, name, path, _fits(name, fits))
            except OSError as error:
                entries.closed.append(f"{name} ({error.strerror})")
        elif path.is_file() and name.casefold() in entries.lists:
            entries.lists[name.casefold()].append(path)
        elif path.is_file() and path.suffix.lower() in MESH_SUFFIXES:
            entries.shapes.append((composed(path.stem), path))
        elif path.is_file() and path.suffix.lower() in LIBRARIES:
            _enter_library(entries, path)
        elif name.endswith(SUFFIX) and path.is_file():
            entries.written.append(name)
        elif _fits(composed(path.stem), fits):
            (entries.foreign if path.suffix.lower() in FOREIGN else entries.others).append(name)
    return entries


def _enter_library(entries: _Entries, path: Path) -> None:
    """Put the pieces of a library among the shapes."""
    try:
        names = LIBRARIES[path.suffix.lower()].names(path)
    except InputError as error:
        entries.damaged.append(str(error))
        return
    for place, name in enumerate(names):
        shape_id = _piece_id(path, name)
        entries.shapes.append((shape_id, path))
        entries.pieces[shape_id, path] = place


def _piece_id(path: Path, name: str) -> str:
    return composed(f"{path.stem}_{name}")


def _enter_folder(entries: _Entries, name: str, path: Path, fits: bool) -> None:
    """Put a folder where it belongs. Raises OSError if it can't be opened."""
    foreign, shape = _foreign(path), _holds_shape(path)
    for suffix, folders in ((structurenet.SUFFIX, entries.hierarchies), (shapeassembly.SUFFIX, entries.programs)):
        if name.endswith(suffix):
            folders.append(path)
            if shape and fits:
                entries.misnamed.append(name)
            return
    if shape:
        entries.shapes.append((name, path))
    elif fits:
        entries.empty.append(name)
    if fits:
        entries.foreign += [f"{name}/{composed(file.name)}" for file in foreign]


def _fits(shape_id: str, include: str) -> bool:
    return shape_id == include or fnmatchcase(shape_id, include)


def _holds_shape(folder: Path) -> bool:
    return _is_partnet(folder) or bool(part_files(folder))


def _is_partnet(path: Path) -> bool:
    """Whether it is a PartNet shape, or one whose tree is missing."""
    return (path / TREE).is_file() or (any((path / name).is_dir() for name in MESH_FOLDERS) and not part_files(path))


def _foreign(folder: Path) -> list[Path]:
    files = (path for path in folder.iterdir() if path.suffix.lower() in FOREIGN and path.is_file())
    return sorted(path for path in files if not path.name.startswith("."))


def _by_id(folders: Sequence[Path], suffix: str) -> dict[str, Path]:
    """The files of the folders by the shape with their name; the first folder has precedence."""
    files: dict[str, Path] = {}
    for path in _files(folders):
        if path.suffix.lower() == suffix and path.name.casefold() not in (TRAIN, VAL):
            files.setdefault(composed(path.stem), path)
    return files


def _files(folders: Iterable[Path]) -> Iterator[Path]:
    for folder in folders:
        yield from (path for path in sorted(folder.iterdir()) if path.is_file() and not path.name.startswith("."))
