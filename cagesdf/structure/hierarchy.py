"""StructureNet's part hierarchy: a tree of nodes, siblings joined by relations (§3.2).

The JSON is StructureNet's own: `box` is centre (3), full lengths (3), x axis (3), y axis (3),
the z axis being their cross product; edges name their ends by position among the children.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.structure.base import Structure
from cagesdf.structure.relations import Adjacency, Reflection, Relation, Rotation, Translation

MAX_NODES = 10_000
MAX_DEPTH = 64


@dataclass(frozen=True, eq=False)
class Node:
    """One node of the tree; a leaf is a part."""

    node_id: str  # unique in the tree
    label: str  # semantic name, "" if there is none
    children: tuple["Node", ...]
    relations: tuple[Relation, ...]  # between the children
    cuboid: Cuboid | None  # canonical; None where none is known

    def walk(self) -> Iterator["Node"]:
        """This node and all below it, parents first, children in order."""
        yield self
        for child in self.children:
            yield from child.walk()


@dataclass(frozen=True, eq=False)
class PartHierarchy(Structure):
    """A tree whose leaves are the parts."""

    tree: Node
    found: bool = False  # relations were found in the parts' surfaces: they come and go with proportions

    @staticmethod
    def flat(part_ids: tuple[str, ...], labels: tuple[str, ...], category: str) -> "PartHierarchy":
        """A root with the parts below it: the hierarchy of a plain folder of part meshes."""
        leaves = tuple(Node(part_id, label, (), (), None) for part_id, label in zip(part_ids, labels))
        root = "root"
        while root in part_ids:
            root += "_"
        return PartHierarchy(Node(root, category, leaves, (), None))

    def _nodes(self) -> dict[str, Node]:
        return {node.node_id: node for node in self.tree.walk()}

    def parts(self) -> tuple[str, ...]:
        """Ids of the leaves, in preorder."""
        return tuple(node.node_id for node in self.tree.walk() if not node.children)

    def labels(self) -> dict[str, str]:
        """Labels by part id."""
        return {node.node_id: node.label for node in self.tree.walk() if not node.children}

    def children(self, node: str) -> tuple[str, ...]:
        """Ids of a node's children, in order."""
        return tuple(child.node_id for child in self._nodes()[node].children)

    def root(self) -> str:
        """Id of the tree's top."""
        return self.tree.node_id

    def relations(self) -> tuple[Relation, ...]:
        """Relations of all nodes, parents first."""
        return tuple(relation for node in self.tree.walk() for relation in node.relations)

    def cuboids(self) -> dict[str, Cuboid]:
        """The parts' cuboids, where the hierarchy knows them."""
        return {node.node_id: node.cuboid for node in self.tree.walk() if not node.children and node.cuboid is not None}

    def cage(self) -> Cage:
        """The parts' cuboids. Raises InputError if one isn't known."""
        known = self.cuboids()
        missing = [part for part in self.parts() if part not in known]
        if missing:
            raise InputError(f"structure: the part {missing[0]!r} has no cuboid, as {len(missing)} have none")
        return Cage.of(known)

    def transformed(self, similarity: Similarity) -> "PartHierarchy":
        """The same tree, its cuboids and relations taken through a similarity."""

        def renew(node: Node) -> Node:
            return replace(
                node,
                children=tuple(renew(child) for child in node.children),
                relations=tuple(relation.transformed(similarity) for relation in node.relations),
                cuboid=node.cuboid and node.cuboid.transformed(similarity),
            )

        return replace(self, tree=renew(self.tree))

    def is_bare(self) -> bool:
        """Whether it is a root with the parts below it and no relations."""
        return not self.tree.relations and not any(child.children for child in self.tree.children)

    def with_relations(self, relations: tuple[Relation, ...]) -> "PartHierarchy":
        """The tree with relations that were found between its parts. Raises ValueError where it isn't bare."""
        if not self.is_bare():
            raise ValueError("the hierarchy tells its parts' relations itself")
        return PartHierarchy(replace(self.tree, relations=relations), found=True)

    def with_cuboids(self, cuboids: Mapping[str, Cuboid]) -> "PartHierarchy":
        """The same tree around other cuboids, by part id; planes, ways and pivots are those between their centres."""

        def centre(node: Node) -> Float[ndarray, " 3"]:
            return np.mean([cuboids[part.node_id].centre for part in node.walk() if not part.children], axis=0)

        def renew(node: Node) -> Node:
            centres = {child.node_id: centre(child) for child in node.children}
            return replace(
                node,
                children=tuple(renew(child) for child in node.children),
                relations=tuple(r.between(centres[r.a], centres[r.b]) for r in node.relations),
                cuboid=cuboids.get(node.node_id),
            )

        return replace(self, tree=renew(self.tree))

    def signatures(self) -> dict[str, str]:
        """Signatures by node id: labels, nesting and counts of the subtree, and relations among siblings.

        Siblings are sorted by their own signature, so their order in the file doesn't matter; relations that depend on
        proportions are left out: adjacency, and relations that were found.
        """

        signatures: dict[str, str] = {}

        def sign(node: Node) -> str:
            inside = ",".join(sorted([sign(child) for child in node.children]))
            pairs = sorted(
                f"{type(r).__name__[:3]}({'~'.join(sorted((signatures[r.a], signatures[r.b])))})"
                for r in node.relations
                if not (self.found or isinstance(r, Adjacency))
            )
            signatures[node.node_id] = (
                node.label + (f"[{inside}]" if node.children else "") + (f"{{{','.join(pairs)}}}" if pairs else "")
            )
            return signatures[node.node_id]

        sign(self.tree)
        return signatures

    def to_dict(self) -> dict[str, Any]:
        """The tree as StructureNet's JSON object; `found` stands beside it if it is true."""

        def write(node: Node) -> dict[str, Any]:
            entry: dict[str, Any] = {"id": node.node_id, "label": node.label}
            if node.cuboid is not None:
                numbers = np.concatenate(
                    [node.cuboid.centre, node.cuboid.size, node.cuboid.axes[0], node.cuboid.axes[1]]
                )
                entry["box"] = [float(number) for number in numbers]
            if node.children:
                entry["children"] = [write(child) for child in node.children]
                place = {child.node_id: i for i, child in enumerate(node.children)}
                entry["edges"] = [_write_relation(relation, place) for relation in node.relations]
            return entry

        return write(self.tree) | ({"found": True} if self.found else {})

    def to_json(self) -> str:
        """StructureNet's JSON on one line, keys sorted."""
        return json.dumps(self.to_dict(), sort_keys=True, separators=(",", ":"))

    @staticmethod
    def from_json(text: str) -> "PartHierarchy":
        """Undo `to_json`. Raises InputError as `from_dict` does."""
        return PartHierarchy.from_dict(json.loads(text))

    @staticmethod
    def from_dict(entry: Any) -> "PartHierarchy":
        """Read StructureNet's JSON object.

        Ids that occur twice (StructureNet gives every unlabelled remainder the id −1) are made
        unique by the position of the node. Raises InputError for a tree deeper than MAX_DEPTH or
        larger than MAX_NODES, a box that isn't twelve finite numbers, and an edge whose ends
        aren't children.
        """
        seen: set[str] = set()

        def read(entry: Any, path: str, depth: int) -> Node:
            if not isinstance(entry, dict) or "id" not in entry:
                raise InputError(f"hierarchy node {path or 'root'}: wanted an object with an id, got {str(entry)[:60]}")
            if depth > MAX_DEPTH or len(seen) >= MAX_NODES:
                raise InputError(f"hierarchy: more than {MAX_DEPTH} levels or {MAX_NODES} nodes at node {path}")
            node_id = str(entry["id"])
            while node_id in seen:
                node_id = f"{node_id}@{path}"
            seen.add(node_id)
            children = tuple(
                read(child, f"{path}/{i}" if path else str(i), depth + 1)
                for i, child in enumerate(_list(entry, "children", path))
            )
            relations = tuple(_read_relation(edge, children, path or "root") for edge in _list(entry, "edges", path))
            return Node(node_id, str(entry.get("label", "")), children, relations, _read_box(entry.get("box"), path))

        return PartHierarchy(read(entry, "", 0), found=entry.get("found") is True)


def _list(entry: Mapping[str, Any], name: str, path: str) -> list[Any]:
    values = entry.get(name) or []
    if not isinstance(values, list):
        raise InputError(f"hierarchy node {path or 'root'}: wanted a list of {name}, got {str(values)[:60]}")
    return values


def _read_box(box: Any, path: str) -> Cuboid | None:
    if box is None:
        return None
    try:
        numbers = np.asarray(box, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.zeros(0)
    if numbers.shape != (12,) or not np.isfinite(numbers).all():
        raise InputError(f"hierarchy node {path or 'root'}: box needs 12 finite numbers, got {str(box)[:60]}")
    x, y = numbers[6:9], numbers[9:12]
    # Published axes are rounded: straighten them before they count as a rotation.
    x = x / max(float(np.linalg.norm(x)), 1e-12)
    y = y - x * (x @ y)
    y = y / max(float(np.linalg.norm(y)), 1e-12)
    return Cuboid(numbers[:3], np.stack([x, y, np.cross(x, y)]), np.abs(numbers[3:6]))


def _vector(numbers: Any) -> tuple[float, float, float]:
    x, y, z = (float(number) for number in numbers)
    if not np.isfinite([x, y, z]).all():
        raise ValueError("wanted finite numbers")
    return x, y, z


def _read_relation(edge: Any, children: tuple[Node, ...], path: str) -> Relation:
    try:
        places = int(edge["part_a"]), int(edge["part_b"])
        if min(places) < 0:
            raise IndexError("children are numbered from 0")
        a, b = (children[place].node_id for place in places)
        params = edge.get("params") or []
        if edge["type"] == "ADJ":
            return Adjacency(a, b, float(edge.get("dist", 0.0)))
        if edge["type"] == "REF_SYM":
            return Reflection(a, b, _vector(params[:3]), _vector(params[3:6]))
        if edge["type"] == "TRANS_SYM":
            return Translation(a, b, _vector(params[:3]))
        if edge["type"] == "ROT_SYM":
            return Rotation(a, b, _vector(params[:3]), _vector(params[3:6]), float(params[6]))
    except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"hierarchy node {path}: edge {str(edge)[:80]} can't be read ({error!r})") from error
    raise InputError(
        f"hierarchy node {path}: edge type {edge['type']!r} is not one of ADJ, REF_SYM, TRANS_SYM, ROT_SYM"
    )


def _write_relation(relation: Relation, place: dict[str, int]) -> dict[str, Any]:
    ends = {"part_a": place[relation.a], "part_b": place[relation.b]}
    match relation:
        case Adjacency():
            return {**ends, "type": "ADJ", "dist": relation.distance}
        case Reflection():
            return {**ends, "type": "REF_SYM", "params": [*relation.point, *relation.normal]}
        case Translation():
            return {**ends, "type": "TRANS_SYM", "params": list(relation.offset)}
        case Rotation():
            return {**ends, "type": "ROT_SYM", "params": [*relation.pivot, *relation.axis, relation.angle]}
