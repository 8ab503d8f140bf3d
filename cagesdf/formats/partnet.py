"""PartNet: `<shape>/result_after_merging.json` and the meshes in `objs/` (PartNet-Mobility: `textured_objs/`)."""

import unicodedata
from collections.abc import Iterator, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cagesdf.errors import InputError
from cagesdf.formats.alignment import Candidate
from cagesdf.formats.obj import read_obj
from cagesdf.formats.structurenet import read_hierarchy, read_json
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.shape import RawPart, RawShape
from cagesdf.structure.hierarchy import MAX_DEPTH, MAX_NODES, Node, PartHierarchy

TREE = "result_after_merging.json"
MESH_FOLDERS = ("objs", "textured_objs")
SUFFIX = ".obj"
SHOWN = 5  # missing meshes that a message names
REMAINDER = "-1"  # StructureNet's id for the meshes that a node holds beside its labelled children
OTHER = "other"  # and its label


@dataclass(frozen=True)
class _Entry:
    """One node of PartNet's tree."""

    node_id: str
    label: str
    objs: tuple[str, ...]  # names of its OBJ files and of those of all below it
    children: tuple["_Entry", ...]

    def walk(self) -> Iterator["_Entry"]:
        yield self
        for child in self.children:
            yield from child.walk()

    def remainder(self) -> tuple[str, ...]:
        """Meshes that no child has: merging drops their labels."""
        taken = {name for child in self.children for name in child.objs}
        return tuple(name for name in self.objs if name not in taken)


def read_partnet(folder: Path, shape_id: str, split: str, hierarchy: Path | None) -> RawShape:
    """One shape. Its structure is `hierarchy` (StructureNet's JSON) if there is one, else PartNet's tree.

    A part's mesh is all its OBJ files together, each of them once. In PartNet's tree, meshes that a node has and no
    child has become a child labelled "other", as StructureNet makes them. Raises InputError that names node and OBJ
    if one is missing, empty, broken or in two parts, and InputError if a leaf of the hierarchy has no mesh in
    PartNet's tree.
    """
    tree = _read_tree(folder / TREE)
    structure = PartHierarchy(_with_remainders(tree)) if hierarchy is None else read_hierarchy(hierarchy)
    labels = structure.labels()
    objs_of_parts = _objs_of_parts(structure, tree, hierarchy or folder / TREE)
    meshes = _read_meshes(folder, tree, {name for objs in objs_of_parts.values() for name in objs})
    parts = [
        RawPart(part_id, labels[part_id], join([meshes[name] for name in objs]))
        for part_id, objs in objs_of_parts.items()
    ]
    return RawShape(shape_id, split, tuple(parts), structure)


def read_candidates(folder: Path) -> tuple[list[Candidate], dict[str, Mesh]]:
    """Candidates for the leaves of a shape's program, in preorder, and all meshes by name.

    Each node of PartNet's tree with all meshes below it, then its remainder, labelled "other".
    Raises InputError as `read_partnet` does.
    """
    tree = _read_tree(folder / TREE)
    candidates: list[Candidate] = []
    for entry in tree.walk():
        candidates.append(Candidate(entry.node_id, entry.label, entry.objs))
        if entry.children and entry.remainder():
            candidates.append(Candidate(f"{REMAINDER}@{entry.node_id}", OTHER, entry.remainder()))
    return candidates, _read_meshes(folder, tree, set(tree.objs))


def _read_meshes(folder: Path, tree: _Entry, names: Set[str]) -> dict[str, Mesh]:
    """The meshes of these names, by name. Raises InputError with node and OBJ for those that can't be used."""
    files = _mesh_files(folder)
    listed = [name for name in tree.objs if name in names]
    if missing := [name for name in listed if name not in files]:
        shown = ", ".join(f"{name}{SUFFIX} of {_owner(tree, name)}" for name in missing[:SHOWN])
        others = f" and {len(missing) - SHOWN:,} more" if len(missing) > SHOWN else ""
        raise InputError(
            f"{folder}: lacks {len(missing):,} of the {len(listed):,} meshes that {TREE} lists: {shown}{others}; "
            "download the shape again"
        )
    meshes = {}
    for name in listed:
        file = files[name]
        try:
            mesh = read_obj(file)
        except InputError as error:
            raise InputError(f"{error}; it is of {_owner(tree, name)}") from error
        if len(mesh.faces) == 0:
            raise InputError(f"{file}: has no faces; it is of {_owner(tree, name)}; download it again")
        meshes[name] = mesh
    return meshes


def _mesh_files(folder: Path) -> dict[str, Path]:
    """The OBJ files of a shape by name. Names in JSON are only looked up, never opened as paths."""
    folders = [folder / name for name in MESH_FOLDERS if (folder / name).is_dir()]
    if not folders:
        raise InputError(f"{folder}: has {TREE}, but neither {' nor '.join(MESH_FOLDERS)} with its meshes")
    files: dict[str, Path] = {}
    for path in (path for place in folders for path in sorted(place.iterdir())):
        if path.suffix.lower() == SUFFIX and path.is_file():
            files.setdefault(_mesh_name(path.name), path)
    return files


def _mesh_name(name: str) -> str:
    """The name of an OBJ file without its suffix, if it has it, in Unicode's form NFC."""
    return unicodedata.normalize("NFC", name[: -len(SUFFIX)] if name.lower().endswith(SUFFIX) else name)


def _owner(tree: _Entry, name: str) -> str:
    """The deepest node that lists a mesh, for a message."""
    *_, entry = (entry for entry in tree.walk() if name in entry.objs)
    return f"node {entry.node_id} ({entry.label})"


def _read_tree(path: Path) -> _Entry:
    if not path.is_file():
        raise InputError(f"{path.parent}: lacks {path.name}, which says whose its meshes are; download the shape again")
    content = read_json(path)
    roots = content if isinstance(content, list) else [content]
    if len(roots) != 1:
        raise InputError(f"{path}: wanted a list with one root, got {len(roots)}")
    seen: set[str] = set()

    def read(entry: Any, depth: int) -> _Entry:
        if depth > MAX_DEPTH or len(seen) >= MAX_NODES:
            raise InputError(f"{path}: more than {MAX_DEPTH} levels or {MAX_NODES} nodes")
        if not isinstance(entry, dict) or "id" not in entry:
            raise InputError(f"{path}: wanted a node with an id, got {str(entry)[:60]}")
        node_id, objs = str(entry["id"]), entry.get("objs") or []
        if node_id in seen:
            raise InputError(f"{path}: two nodes have the id {node_id}")
        if not isinstance(objs, list) or not all(isinstance(o, str) and Path(o).name == o for o in objs):
            raise InputError(f"{path}: node {node_id}: objs must be a list of file names, got {str(objs)[:60]}")
        seen.add(node_id)
        label = str(entry.get("name") or entry.get("text") or "")
        listed = entry.get("children") or []
        if not isinstance(listed, list):
            raise InputError(f"{path}: node {node_id}: children must be a list of nodes, got {str(listed)[:60]}")
        children = tuple(read(child, depth + 1) for child in listed)
        # Older files list meshes at leaves only.
        below = [name for child in children for name in child.objs]
        return _Entry(node_id, label, tuple(dict.fromkeys([*map(_mesh_name, objs), *below])), children)

    return read(roots[0], 0)


def _with_remainders(entry: _Entry) -> Node:
    children = [_with_remainders(child) for child in entry.children]
    if children and entry.remainder():
        children.append(Node(f"{REMAINDER}@{entry.node_id}", OTHER, (), (), None))
    return Node(entry.node_id, entry.label, tuple(children), (), None)


def _objs_of_parts(structure: PartHierarchy, tree: _Entry, source: Path) -> dict[str, tuple[str, ...]]:
    """Mesh names by part id, in the structure's order. Raises InputError if a part has none, or one of another's."""
    entries = {entry.node_id: entry for entry in tree.walk()}
    objs_by_part: dict[str, tuple[str, ...]] = {}
    owners: dict[str, str] = {}  # part id by mesh name

    def visit(node: Node, parent: _Entry | None) -> None:
        entry = entries.get(node.node_id)
        for child in node.children:
            visit(child, entry)
        if node.children:
            return
        if node.node_id.startswith(REMAINDER):
            objs = parent.remainder() if parent else ()
        else:
            objs = entry.objs if entry else ()
        if not objs:
            raise InputError(f"{source}: leaf {node.node_id} ({node.label}) has no mesh in {TREE}")
        for name in objs:
            if name in owners:
                raise InputError(
                    f"{source}: {name}{SUFFIX} is of node {owners[name]} and of node {node.node_id}; wanted it in one"
                )
            owners[name] = node.node_id
        objs_by_part[node.node_id] = objs

    visit(structure.tree, None)
    return objs_by_part
