"""PartNet: `<shape>/result_after_merging.json` and the meshes in `objs/` (PartNet-Mobility: `textured_objs/`)."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cagesdf.alignment import Candidate
from cagesdf.errors import InputError
from cagesdf.formats.obj import read_obj
from cagesdf.formats.structurenet import read_hierarchy, read_json
from cagesdf.meshes import Mesh, join
from cagesdf.shape import RawPart, RawShape
from cagesdf.structure.hierarchy import MAX_DEPTH, MAX_NODES, Node, PartHierarchy

TREE = "result_after_merging.json"
MESH_FOLDERS = ("objs", "textured_objs")
REMAINDER = "-1"  # StructureNet's id of what a node holds beside its labelled children
OTHER = "other"  # and its label


@dataclass(frozen=True)
class _Entry:
    """One node of PartNet's tree."""

    node_id: str
    label: str
    objs: tuple[str, ...]  # mesh names of the node and all below it, no extension
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

    A part's mesh is all its OBJ files together. In PartNet's tree, meshes that a node has and no
    child has become a child labelled "other", as StructureNet makes them. Raises InputError if
    a file is missing or broken, or a leaf of the hierarchy has no mesh in PartNet's tree.
    """
    tree = _read_tree(folder / TREE)
    structure = PartHierarchy(_with_remainders(tree)) if hierarchy is None else read_hierarchy(hierarchy)
    meshes = _mesh_folder(folder)
    labels = structure.labels()
    parts = []
    for part_id, objs in _objs_of_parts(structure, tree, hierarchy or folder / TREE).items():
        mesh = join([read_obj(meshes / f"{name}.obj") for name in objs])
        parts.append(RawPart(part_id, labels[part_id], mesh))
    return RawShape(shape_id, split, tuple(parts), structure)


def read_candidates(folder: Path) -> tuple[list[Candidate], dict[str, Mesh]]:
    """What the leaves of a shape's program may stand for, in preorder, and all meshes by name.

    Each node of PartNet's tree with all meshes below it, then its remainder, labelled "other".
    Raises InputError if a file is missing or broken.
    """
    tree = _read_tree(folder / TREE)
    meshes = _mesh_folder(folder)
    found: list[Candidate] = []
    for entry in tree.walk():
        found.append(Candidate(entry.node_id, entry.label, entry.objs))
        if entry.children and entry.remainder():
            found.append(Candidate(f"{REMAINDER}@{entry.node_id}", OTHER, entry.remainder()))
    return found, {name: read_obj(meshes / f"{name}.obj") for name in tree.objs}


def _mesh_folder(folder: Path) -> Path:
    for name in MESH_FOLDERS:
        if (folder / name).is_dir():
            return folder / name
    raise InputError(f"{folder}: has {TREE}, but neither {' nor '.join(MESH_FOLDERS)} with its meshes")


def _read_tree(path: Path) -> _Entry:
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
        # Names are joined to a path, and the file is someone else's.
        if not isinstance(objs, list) or not all(
            isinstance(o, str) and Path(o).name == o and "\\" not in o for o in objs
        ):
            raise InputError(f"{path}: node {node_id}: objs must be a list of file names, got {str(objs)[:60]}")
        seen.add(node_id)
        label = str(entry.get("name") or entry.get("text") or "")
        children = tuple(read(child, depth + 1) for child in entry.get("children") or [])
        # Older files list meshes at leaves only.
        below = [name for child in children for name in child.objs]
        return _Entry(node_id, label, tuple(dict.fromkeys([*objs, *below])), children)

    return read(roots[0], 0)


def _with_remainders(entry: _Entry) -> Node:
    children = [_with_remainders(child) for child in entry.children]
    if children and entry.remainder():
        children.append(Node(f"{REMAINDER}@{entry.node_id}", OTHER, (), (), None))
    return Node(entry.node_id, entry.label, tuple(children), (), None)


def _objs_of_parts(structure: PartHierarchy, tree: _Entry, source: Path) -> dict[str, tuple[str, ...]]:
    """Mesh names by part id, in the structure's order."""
    entries = {entry.node_id: entry for entry in tree.walk()}
    found: dict[str, tuple[str, ...]] = {}

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
        found[node.node_id] = objs

    visit(structure.tree, None)
    return found
