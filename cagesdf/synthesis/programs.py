"""Programs of procedural shapes, with the inaccuracies of the published ones [Jones et al. 2020].

Each labelled group of several cuboids becomes a block, its bbox the axis-aligned box of its members.
Cuboids stand in the order of their lowest points, so that each is attached to what is below it, and
what is mirrored or repeated along an axis is declared once. Upright cuboids are aligned and held at
one place. Turned ones are attached at both ends of an axis, which turns them by the least rotation
that takes the axis there: their twist about that axis is lost.

Which cuboid is attached to which, and by what, is decided on a typical drawing of the family, and
only the numbers on the shape's own: so all shapes of a family have the same program up to continuous
parameters (§3.3).

As in published programs, leaves end where they enter another part (here CUT at most), lengths and
places are rounded, and copies share the numbers of what they are copies of. So leaves don't quite
bound their parts, but some parameters of the same program do.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cuboid
from cagesdf.frames import Similarity
from cagesdf.structure.hierarchy import Node
from cagesdf.structure.program import BBOX, AssemblyProgram, Block, Declare, Statement, copy_name
from cagesdf.structure.relations import Adjacency, Reflection, Translation
from cagesdf.synthesis.fixings import (
    LENGTH_DIGITS,
    Copies,
    Fixing,
    Standing,
    Target,
    Through,
    Touching,
    Turned,
    beyond,
    highest,
    lengths,
    lowest,
    meeting_point,
    point_in,
    rounded,
)
from cagesdf.synthesis.layout import TOUCHING, Drawing

CUT = 0.02  # raw units: a leaf's end that lies in another part is moved back so far at most
SHARE = 1 / 8  # and by this share of its length at most
EXACT = 1e-6  # raw units: what differs less is equal
UPRIGHT = 1e-3  # sine of the angle to the nearest axis, below which an axis counts as upright

Move = Callable[[ndarray], ndarray]  # from a point of a cuboid to that of its copy


@dataclass(frozen=True, eq=False)
class Slot:
    """A declared cuboid of a block, whatever its numbers."""

    child: int  # place among the node's children
    permutation: Float[ndarray, "3 3"]  # names its axes as the program does
    axis: int  # of these, the one that it is turned by, or else its longest
    aligned: bool
    fixing: Fixing
    copies: Copies | None
    inside: "tuple[Slot, ...]"  # of the block that fills it; empty for a leaf


@dataclass(frozen=True, eq=False)
class Assembled:
    """A drawing's program."""

    program: AssemblyProgram
    placement: Similarity  # program → raw: a translation
    part_ids: tuple[str, ...]  # the drawing's part of each leaf, in the order of execution


def assemble(drawing: Drawing, typical: Drawing) -> Assembled:
    """The program of a drawing; `typical`, a drawing of the same family, decides on all but its numbers."""
    tree = drawing.structure.tree
    cuboids = drawing.structure.cuboids()
    blocks: list[Block] = []
    part_ids: list[str] = []
    # Breadth first, as programs are executed.
    waiting = [("Program_0", tree, plan_block(typical.structure.tree))]
    for name, node, slots in waiting:
        block = _Writer(node, slots, cuboids, len(waiting))
        blocks.append(Block(name, lengths(_box(node).size), tuple(block.statements())))
        part_ids += block.parts()
        waiting += block.filled()
    placement = Similarity(1.0, np.eye(3), _box(tree).centre)
    return Assembled(AssemblyProgram(tuple(blocks)), placement, tuple(part_ids))


# Plan of a block: the same for all shapes of a family.


def plan_block(node: Node) -> tuple[Slot, ...]:
    """Plan of the block of a node with children: its cuboids from the ground up."""
    children = tuple(map(_inner, node.children))
    frame = _box(node)
    copies = _copies(node, frame)
    copied = {child for item in copies.values() for child in item.children}
    # Rounded, so that equal heights tie whatever the last digit is.
    order = sorted(
        set(range(len(children))) - copied, key=lambda i: (round(float(lowest(_box(children[i]))[1]), LENGTH_DIGITS), i)
    )
    slots: list[Slot] = []
    placed: list[Cuboid] = []
    for i in order:
        permutation, axis, aligned = _naming(children[i])
        cuboid = _as_executed(_box(children[i]).permuted(permutation), axis, aligned)
        neighbours = _neighbours(node, slots, (i, *(copies[i].children if i in copies else ())))
        holder = _Holder(cuboid, frame, {place: placed[place] for place in neighbours}, _moves(node, i, copies, frame))
        fixing = holder.upright() if aligned else holder.turned(axis)
        inside = plan_block(children[i]) if children[i].children else ()
        slots.append(Slot(i, permutation, axis, aligned, fixing, copies.get(i), inside))
        placed.append(cuboid)
    return tuple(slots)


@dataclass(frozen=True, eq=False)
class _Holder:
    """Finds what a cuboid of a typical drawing can be attached to."""

    cuboid: Cuboid
    frame: Cuboid  # of the block
    targets: Mapping[int, Cuboid]  # cuboids before it that it touches, and its copies do
    moves: tuple[Move, ...]  # to each of its copies

    def upright(self) -> Fixing:
        """A fixing to the cuboid that it overlaps most; else through the bbox's height, or to its nearer face."""
        held = {
            place: _overlap(self.cuboid, cuboid)
            for place, cuboid in self.targets.items()
            if self._reaches(meeting_point(self.cuboid, cuboid), cuboid)
        }
        if held:
            return Touching(max(held, key=lambda place: held[place]))
        under, over = (lowest(self.cuboid) - lowest(self.frame))[1], (highest(self.frame) - highest(self.cuboid))[1]
        return Through() if max(under, over) < EXACT else Standing(0.0 if under <= over else 1.0)

    def turned(self, axis: int) -> Fixing:
        """A fixing at the side of its axis where most ends meet cuboids before it; the middle first."""
        sides = [(0.5, 0.5), *((u, 0.5) for u in (0.0, 1.0)), *((0.5, v) for v in (0.0, 1.0))]
        fixings = []
        for u, v in sides:
            ends = [np.insert(np.array([u, v]), axis, end) for end in (0.0, 1.0)]
            low, high = (self._target(point_in(self.cuboid, end)) for end in ends)
            fixings.append(Turned(rounded(ends[0]), rounded(ends[1]), (low, high)))
        return max(fixings, key=lambda fixing: sum(target is not None for target in fixing.targets))

    def _target(self, point: ndarray) -> int | None:
        return next((place for place, cuboid in self.targets.items() if self._reaches(point, cuboid)), None)

    def _reaches(self, point: ndarray, cuboid: Cuboid) -> bool:
        """Whether a cuboid holds a point, and its copies': the executor puts no copy beyond its target's faces."""
        return all(beyond(cuboid, p) < EXACT for p in (point, *(move(point) for move in self.moves)))


def _naming(node: Node) -> tuple[Float[ndarray, "3 3"], int, bool]:
    """Permutation that names a cuboid's axes, the axis it is turned by (else its longest), whether it is aligned."""
    cuboid = _box(node)
    turned = np.sqrt(np.clip(1 - np.abs(cuboid.axes).max(axis=1) ** 2, 0, 1)) > UPRIGHT
    if not turned.any():
        named = cuboid.nearest_to(np.eye(3))
        return _permutation(cuboid, named), int(named.size.argmax()), True
    direction = cuboid.axes[int(np.where(turned, cuboid.size, 0).argmax())]
    axis = int(np.abs(direction).argmax())
    frame = _least_turn(axis, direction * np.sign(direction[axis]))
    return _permutation(cuboid, cuboid.nearest_to(frame)), axis, False


def _copies(node: Node, frame: Cuboid) -> dict[int, Copies]:
    """Copies that a reflect or a translate can make, by the child that they are copied from."""
    place = {child.node_id: i for i, child in enumerate(node.children)}
    result: dict[int, Copies] = {}
    copied: set[int] = set()
    for relation in node.relations:
        if isinstance(relation, Adjacency):
            continue
        a, b = place[relation.a], place[relation.b]
        if isinstance(relation, Reflection) and not {a, b} & (result.keys() | copied):
            axis = int(np.abs(relation.normal).argmax())
            if abs(relation.point[axis] - frame.centre[axis]) < EXACT:
                result[a] = Copies((b,), axis, True)
                copied.add(b)
        elif isinstance(relation, Translation) and b not in result.keys() | copied:
            offset = np.array(relation.offset)
            axis = int(np.abs(offset).argmax())
            if offset[axis] > 0 and np.abs(np.delete(offset, axis)).max() < EXACT:
                first = next((i for i, item in result.items() if a in item.children), a)
                result[first] = Copies((*(result[first].children if first in result else ()), b), axis, False)
                copied.add(b)
    return result


def _neighbours(node: Node, slots: Sequence[Slot], children: tuple[int, ...]) -> list[int]:
    """Slots that all the children touch; for more than one child, those that aren't copied themselves.

    A copy is attached to its original's targets, never to copies of them.
    """
    touching = {frozenset((r.a, r.b)) for r in node.relations if isinstance(r, Adjacency)}
    names = [child.node_id for child in node.children]
    return [
        place
        for place, slot in enumerate(slots)
        if (len(children) == 1 or slot.copies is None)
        and all(frozenset((names[slot.child], names[child])) in touching for child in children)
    ]


def _moves(node: Node, child: int, copies: Mapping[int, Copies], frame: Cuboid) -> tuple[Move, ...]:
    if child not in copies:
        return ()
    item = copies[child]

    def move(copy: int, point: ndarray) -> ndarray:
        moved = point.copy()
        if item.mirrored:
            moved[item.axis] = 2 * frame.centre[item.axis] - point[item.axis]
        else:
            moved += _box(node.children[copy]).centre - _box(node.children[child]).centre
        return moved

    return tuple(partial(move, copy) for copy in item.children)


# The shape's own numbers.


@dataclass(frozen=True, eq=False)
class _Writer:
    """One block of a drawing."""

    node: Node
    slots: tuple[Slot, ...]
    cuboids: Mapping[str, Cuboid]  # all parts of the drawing
    first: int  # number of the first block that fills one of its cuboids

    def names(self) -> list[str]:
        """Names of the declared cuboids."""
        names, number = [], self.first
        for i, slot in enumerate(self.slots):
            names.append(f"Program_{number}" if slot.inside else copy_name(i))
            number += bool(slot.inside)
        return names

    def filled(self) -> list[tuple[str, Node, tuple[Slot, ...]]]:
        """Name, node and slots for each cuboid that a block fills."""
        return [
            (name, self._child(slot.child), slot.inside) for name, slot in zip(self.names(), self.slots) if slot.inside
        ]

    def parts(self) -> list[str]:
        """The drawing's part of each leaf: declared ones, then copies."""
        declared = [slot.child for slot in self.slots if not slot.inside]
        copies = [child for slot in self.slots if slot.copies for child in slot.copies.children]
        return [self._child(child).node_id for child in declared + copies]

    def statements(self) -> list[Statement]:
        """Cuboids, then what holds them, then symmetries."""
        frame = _box(self.node)
        targets: dict[int | None, Target] = {None: (BBOX, frame)}
        declared, held, copied = list[Statement](), list[Statement](), list[Statement]()
        for place, (name, slot) in enumerate(zip(self.names(), self.slots)):
            cuboid = self._cuboid(slot)
            declared.append(Declare(name, lengths(cuboid.size), slot.aligned))
            held += slot.fixing.statements(name, cuboid, targets)
            if slot.copies:
                last = _box(self._child(slot.copies.children[-1]))
                copied.append(slot.copies.statement(name, _box(self._child(slot.child)), last, frame))
            targets[place] = name, cuboid
        return [*declared, *held, *copied]

    def _child(self, place: int) -> Node:
        return _inner(self.node.children[place])

    def _cuboid(self, slot: Slot) -> Cuboid:
        node = self._child(slot.child)
        named = _box(node).permuted(slot.permutation)
        if not slot.inside:
            others = [cuboid for part_id, cuboid in self.cuboids.items() if part_id != node.node_id]
            named = _shortened(named, slot.axis, others)
        return _as_executed(named, slot.axis, slot.aligned)


def _shortened(cuboid: Cuboid, axis: int, others: Sequence[Cuboid]) -> Cuboid:
    """The cuboid without those of its ends along an axis that lie in others, at most CUT and SHARE."""
    cuts = []
    for end in (0.0, 1.0):
        at = np.full(3, 0.5)
        at[axis] = end
        inward = cuboid.axes[axis] * (1 - 2 * end)
        cuts.append(max([_depth(other, point_in(cuboid, at), inward) for other in others], default=0.0))
    low, high = np.minimum(cuts, min(CUT, SHARE * cuboid.size[axis]))
    size = cuboid.size.copy()
    size[axis] -= low + high
    return Cuboid(cuboid.centre + (low - high) / 2 * cuboid.axes[axis], cuboid.axes, size)


def _depth(cuboid: Cuboid, point: ndarray, direction: ndarray) -> float:
    """Distance from a point to a cuboid's surface in a direction; 0 from outside."""
    if beyond(cuboid, point) >= 0:
        return 0.0
    start, step = cuboid.axes @ (point - cuboid.centre), cuboid.axes @ direction
    moving = np.abs(step) > EXACT
    return float(((cuboid.size / 2 - np.sign(step) * start)[moving] / np.abs(step[moving])).min())


# Geometry.


def _inner(node: Node) -> Node:
    """The node itself, or its only child."""
    while len(node.children) == 1:
        node = node.children[0]
    return node


def _box(node: Node) -> Cuboid:
    """A part's cuboid, or the axis-aligned box of a group's."""
    node = _inner(node)
    if node.cuboid is not None:
        return node.cuboid
    cuboids = [leaf.cuboid for leaf in node.walk() if leaf.cuboid is not None]
    low, high = np.min(list(map(lowest, cuboids)), axis=0), np.max(list(map(highest, cuboids)), axis=0)
    return Cuboid((low + high) / 2, np.eye(3), high - low)


def _overlap(a: Cuboid, b: Cuboid) -> float:
    """The volume that their axis-aligned boxes share, each grown by half of TOUCHING on all sides."""
    shared = np.minimum(highest(a), highest(b)) - np.maximum(lowest(a), lowest(b)) + TOUCHING
    return float(np.prod(np.maximum(shared, 0)))


def _permutation(cuboid: Cuboid, named: Cuboid) -> Float[ndarray, "3 3"]:
    return np.round(named.axes @ cuboid.axes.T)


def _as_executed(cuboid: Cuboid, axis: int, aligned: bool) -> Cuboid:
    """The cuboid with the axes that executing its program gives it."""
    return replace(cuboid, axes=np.eye(3) if aligned else _least_turn(axis, cuboid.axes[axis]))


def _least_turn(axis: int, direction: Float[ndarray, " 3"]) -> Float[ndarray, "3 3"]:
    """The frame's axes after the smallest rotation that takes one of them to a unit vector."""
    # Two half-turns: about the old axis, then about the line between old and new.
    old = np.eye(3)[axis]
    between = old + direction
    half = 2 * np.outer(between, between) / (between @ between) - np.eye(3)
    return (half @ (2 * np.outer(old, old) - np.eye(3))).T
