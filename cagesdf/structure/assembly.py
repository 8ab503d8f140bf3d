"""A program as the structure of a shape: its leaves are the parts."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.structure.base import Structure
from cagesdf.structure.canonical import Fact, fact, node_signatures
from cagesdf.structure.executor import execute, execute_nodes
from cagesdf.structure.parsing import parse
from cagesdf.structure.program import (
    AXES,
    BBOX,
    AssemblyProgram,
    Attach,
    Block,
    Member,
    Reflect,
    Squeeze,
    Statement,
    Translate,
    numbers_of,
)
from cagesdf.structure.relations import Adjacency, Reflection, Relation, Translation, Vector

ROOT = "."  # id of the root; all others are paths of names from there


@dataclass(frozen=True, eq=False)
class Assembly(Structure):
    """A program, and where its root's frame lies in the shape's. Parts' ids are paths as `execute` makes them."""

    program: AssemblyProgram
    placement: Similarity  # program → canonical; the shape's raw frame until it is imported
    names: Mapping[str, str] = field(default_factory=dict)  # semantic, by part id, of those that have one

    def cage(self) -> Cage:
        """The leaves' cuboids, canonical. Raises ProgramError if the program doesn't execute."""
        return execute(self.program).transformed(self.placement)

    def with_program(self, program: AssemblyProgram) -> "Assembly":
        """Another program in the same place."""
        return replace(self, program=program)

    def labelled(self, names: Mapping[str, str]) -> "Assembly":
        """The same program with semantic names for its parts."""
        return replace(self, names={part: name for part, name in names.items() if name})

    def labels(self) -> dict[str, str]:
        """Labels by part id; the language has no place for them."""
        return {part: self.names.get(part, "") for part in self.parts()}

    def parameters_of(self, other: "Assembly", pairs: tuple[tuple[str, str], ...]) -> Float[ndarray, " t"]:
        """Another program's continuous parameters, in the order of this one's.

        `pairs` are corresponding parts, ours first: programs of equal signature may differ in names and
        order. Raises ValueError if statements about paired parts differ.
        """
        names = {ROOT: ROOT}
        for ours, theirs in pairs:
            names |= zip(_line(ours), _line(theirs))
        numbers: dict[str, list[float]] = {}  # by our block; copies share one
        for node, (block, members) in self._nodes.items():
            if block.name not in numbers:
                local = {member.name: names[below(node, member.name)].rpartition("/")[2] for member in members}
                other_block, _ = other._nodes[names[node]]
                numbers[block.name] = _in_order(block, other_block, {BBOX: BBOX, **local})
        return np.array([number for block in self.program.blocks for number in numbers[block.name]])

    def placed_program(self) -> tuple[AssemblyProgram, Similarity]:
        """Program and placement."""
        return self.program, self.placement

    def transformed(self, similarity: Similarity) -> "Assembly":
        """The same program, placed elsewhere."""
        return replace(self, placement=self.placement.then(similarity))

    @cached_property
    def _nodes(self) -> dict[str, tuple[Block, tuple[Member, ...]]]:
        """Blocks with their cuboids, by the id of the node that each fills."""
        result: dict[str, tuple[Block, tuple[Member, ...]]] = {}

        def visit(node: str, block: Block) -> None:
            result[node] = block, block.members()
            for member in block.members():
                inside = self.program.block(member.original)
                if inside is not None:
                    visit(below(node, member.name), inside)

        visit(ROOT, self.program.blocks[0])
        return result

    def root(self) -> str:
        """ROOT."""
        return ROOT

    def children(self, node: str) -> tuple[str, ...]:
        """Ids of a node's cuboids, declared ones first, then copies; empty for a part."""
        _, members = self._nodes.get(node, (None, ()))
        return tuple(below(node, member.name) for member in members)

    def parts(self) -> tuple[str, ...]:
        """Ids of the leaves, in the order of execution: breadth first."""
        level, leaves = [ROOT], list[str]()
        while level:
            children = [child for node in level for child in self.children(node)]
            leaves += [child for child in children if child not in self._nodes]
            level = [child for child in children if child in self._nodes]
        return tuple(leaves)

    def relations(self) -> tuple[Relation, ...]:
        """Attachments and copies among the cuboids of each block, canonical."""
        whole = Cuboid(np.zeros(3), np.eye(3), np.array(self.program.blocks[0].size)).transformed(self.placement)
        cuboids = {ROOT: whole, **execute_nodes(self.program).transformed(self.placement).cuboids()}
        return tuple(
            relation
            for node, (block, members) in self._nodes.items()
            for relation in _relations(node, block, members, cuboids)
        )

    def signatures(self) -> dict[str, str]:
        """Signatures by node id: see `canonical.node_signatures`. Names and the order of statements don't matter."""
        return node_signatures(self.program, ROOT)

    def to_json(self) -> str:
        """Program, placement and labels, where it has any, on one line."""
        content: dict[str, Any] = {"program": str(self.program), "placement": self.placement.to_numbers()}
        if self.names:
            content["labels"] = dict(self.names)
        return json.dumps(content, sort_keys=True, separators=(",", ":"))

    @staticmethod
    def from_json(text: str) -> "Assembly":
        """Undo `to_json`. Raises InputError for anything else."""
        try:
            content = json.loads(text)
            names = {str(part): str(name) for part, name in content.get("labels", {}).items()}
            return Assembly(parse(content["program"]), Similarity.from_numbers(content["placement"]), names)
        except (KeyError, TypeError, IndexError, AttributeError, RecursionError, json.JSONDecodeError) as error:
            raise InputError(f"structure: wanted a program and its placement, got {text[:60]} ({error!r})") from error


def below(node: str, name: str) -> str:
    """The id of a node's cuboid."""
    return name if node == ROOT else f"{node}/{name}"


def _line(part: str) -> list[str]:
    """Ids of the nodes down to a part, the root left out."""
    names = part.split("/")
    return ["/".join(names[: i + 1]) for i in range(len(names))]


def _in_order(block: Block, other: Block, names: Mapping[str, str]) -> list[float]:
    """Another block's parameters in the order of a block's, whose cuboids are called `names` there."""
    waiting: dict[Fact, list[Statement]] = {}
    for statement in other.statements:
        waiting.setdefault(fact(statement), []).append(statement)
    numbers = [*other.size]
    for statement in block.statements:
        kind, cuboids = fact(statement)
        same = waiting.get((kind, tuple(names[name] for name in cuboids)))
        if not same:
            raise ValueError(f"block {other.name} says nothing like {statement} of {names}")
        numbers += numbers_of(same.pop(0))
    return numbers


def _relations(node: str, block: Block, members: tuple[Member, ...], cuboids: Mapping[str, Cuboid]) -> list[Relation]:
    """Relations between one block's cuboids, without attachments to the bbox."""
    frame = cuboids[node]
    result: list[Relation] = []
    for statement in block.statements:
        attached = [statement] if isinstance(statement, Attach) else []
        if isinstance(statement, Squeeze):
            attached = [*statement.attaches()]
        result += [Adjacency(below(node, a.a), below(node, a.b), 0.0) for a in attached if a.b != BBOX]
    for member in members:
        original, copy = below(node, member.original), below(node, member.name)
        match member.copied_by:
            case Reflect(_, letter):
                normal = frame.axes[AXES.index(letter)]
                result.append(Reflection(original, copy, _vector(frame.centre), _vector(normal)))
            case Translate():
                offset = cuboids[copy].centre - cuboids[original].centre
                result.append(Translation(original, copy, _vector(offset / member.number)))
    return result


def _vector(values: np.ndarray) -> Vector:
    x, y, z = values.tolist()
    return x, y, z
