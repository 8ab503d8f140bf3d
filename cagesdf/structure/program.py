"""ShapeAssembly's language: programs that place and attach a shape's cuboids [Jones et al. 2020].

A program is a tree of blocks; the first is the root. In text:

    Assembly Program_0 {
        bbox = Cuboid(0.7, 1.4, 0.8, True)
        Program_1 = Cuboid(0.6, 0.7, 0.6, True)
        cube1 = Cuboid(0.6, 0.1, 0.7, True)
        attach(Program_1, bbox, 0.5, 0.0, 0.5, 0.5, 0.0, 0.5)
        attach(cube1, Program_1, 0.5, 0.0, 0.5, 0.5, 1.0, 0.5)
    }
    Assembly Program_1 {
        ...
    }

A cuboid with the name of a block is filled by that block; all others are leaves. `executor.py` defines
the statements' effects. `#` starts a comment.
"""

import math
import textwrap
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import ProgramError

Number = Any  # a float; a dual number while the program is differentiated
Triple = tuple[Number, Number, Number]

BBOX = "bbox"  # a block's own cuboid, centred in its frame
AXES = ("X", "Y", "Z")
# A face of a cuboid: its axis, and the coordinate of the face on it.
FACES = {"right": (0, 1.0), "left": (0, 0.0), "top": (1, 1.0), "bot": (1, 0.0), "front": (2, 1.0), "back": (2, 0.0)}

MAX_CHARACTERS = 1_000_000
MAX_STATEMENTS = 10_000
MAX_DEPTH = 16  # of blocks in blocks
MAX_MOVES = 64  # attachments of one cuboid, a squeeze counting as two
MAX_COPIES = 256  # that one translate makes
MAX_CUBOIDS = 320  # of one block, copies among them
MAX_LEAVES = 4_096  # after execution


@dataclass(frozen=True, slots=True)
class Declare:
    """`name = Cuboid(l, h, w, aligned)`: a new cuboid at the block's centre."""

    name: str  # unique in its block; that of another block if the cuboid is filled with it
    size: Triple  # full lengths along x, y, z, > 0
    aligned: bool  # keeps the block's axes, whatever it is attached to

    def __str__(self) -> str:
        return f"{self.name} = Cuboid({_commas(self.size)}, {self.aligned})"


@dataclass(frozen=True, slots=True)
class Attach:
    """`attach(a, b, x1, y1, z1, x2, y2, z2)`: move `a` so that its point meets one of `b`."""

    a: str  # moves
    b: str  # stays
    at_a: Triple  # place in a: 0 and 1 are its faces along each axis
    at_b: Triple  # place in b

    def __str__(self) -> str:
        return f"attach({self.a}, {self.b}, {_commas(self.at_a)}, {_commas(self.at_b)})"


@dataclass(frozen=True, slots=True)
class Squeeze:
    """`squeeze(a, b, c, face, u, v)`: attach `a` by its `face` to `b`, and by the opposite one to `c`."""

    a: str  # moves
    b: str  # its face touches this cuboid
    c: str  # its opposite face touches this one
    face: str  # one of FACES
    place: tuple[Number, Number]  # on b and c, along the two axes that are not the face's, x before y before z

    def attaches(self) -> tuple[Attach, Attach]:
        """The two attachments that it is short for, b's first."""
        axis, side = FACES[self.face]
        return self._attach(self.b, axis, side), self._attach(self.c, axis, 1.0 - side)

    def _attach(self, target: str, axis: int, side: float) -> Attach:
        at_a, at_b = [0.5, 0.5, 0.5], list(self.place)
        at_a[axis] = side
        at_b.insert(axis, side if target == BBOX else 1.0 - side)
        return Attach(self.a, target, (at_a[0], at_a[1], at_a[2]), (at_b[0], at_b[1], at_b[2]))

    def __str__(self) -> str:
        return f"squeeze({self.a}, {self.b}, {self.c}, {self.face}, {_commas(self.place)})"


@dataclass(frozen=True, slots=True)
class Reflect:
    """`reflect(a, axis)`: a copy of `a`, mirrored in the block's middle plane."""

    a: str
    axis: str  # one of AXES, normal to the plane

    def __str__(self) -> str:
        return f"reflect({self.a}, {self.axis})"


@dataclass(frozen=True, slots=True)
class Translate:
    """`translate(a, axis, count, span)`: copies of `a`, evenly spaced."""

    a: str
    axis: str  # one of AXES
    count: int  # of copies, without `a` itself
    span: Number  # from `a` to the last copy, as a share of the block's length along the axis

    def __str__(self) -> str:
        return f"translate({self.a}, {self.axis}, {self.count}, {self.span!r})"


Statement = Declare | Attach | Squeeze | Reflect | Translate


@dataclass(frozen=True, slots=True)
class Member:
    """A cuboid of an executed block."""

    name: str  # unique in the block
    original: str  # the declared cuboid that it is, or is a copy of
    copied_by: Reflect | Translate | None  # None for a declared cuboid
    number: int  # among the copies of that statement, from 1; 0 for a declared cuboid


@dataclass(frozen=True, slots=True)
class Block:
    """One level of a program."""

    name: str  # unique in the program
    size: Triple  # of its bbox, full lengths, > 0
    statements: tuple[Statement, ...]  # without the bbox's

    def __str__(self) -> str:
        lines = [Declare(BBOX, self.size, True), *self.statements]
        return "\n".join([f"Assembly {self.name} {{", *(f"\t{line}" for line in lines), "}"])

    def members(self) -> "tuple[Member, ...]":
        """Its cuboids once it is executed, without the bbox: declared ones, then copies, each in order."""
        declared: list[Member] = []
        copies: list[Member] = []
        for statement in self.statements:
            match statement:
                case Declare():
                    declared.append(Member(statement.name, statement.name, None, 0))
                case Reflect() | Translate():
                    for number in range(1, getattr(statement, "count", 1) + 1):
                        name = copy_name(len(declared) + len(copies))
                        copies.append(Member(name, statement.a, statement, number))
        return (*declared, *copies)


@dataclass(frozen=True, slots=True)
class AssemblyProgram:
    """A whole program. Raises ProgramError if it would not execute: see `parsing.parse`."""

    blocks: tuple[Block, ...]  # the root first

    def __post_init__(self) -> None:
        _check(self.blocks)

    def __str__(self) -> str:
        return "\n".join(str(block) for block in self.blocks) + "\n"

    def block(self, name: str) -> Block | None:
        """The block of that name, None if there is none: then the cuboid of that name is a leaf."""
        return next((block for block in self.blocks if block.name == name), None)

    def parameters(self) -> Float[ndarray, " t"]:
        """The continuous parameters, in the order of the text.

        A Cuboid's three lengths, an attach's six coordinates, a squeeze's two, a translate's span.
        """
        numbers = [
            number
            for block in self.blocks
            for part in (block.size, *map(numbers_of, block.statements))
            for number in part
        ]
        return np.array(numbers, dtype=np.float64)

    def with_parameters(self, parameters: Sequence[Any] | Float[ndarray, " t"]) -> "AssemblyProgram":
        """The same program with other continuous parameters, as `parameters` orders them.

        They may be any numbers that the executor can reckon with, such as dual numbers.
        Raises ProgramError for a length that isn't positive, ValueError for another number of them.
        """
        numbers = iter(parameters.tolist() if isinstance(parameters, ndarray) else parameters)
        try:
            program = AssemblyProgram(tuple([_renumbered(block, numbers) for block in self.blocks]))
        except StopIteration:
            raise ValueError(f"too few parameters: got {len(parameters)}") from None
        if next(numbers, None) is not None:
            raise ValueError(f"too many parameters: got {len(parameters)}")
        return program


def _commas(numbers: Sequence[Number]) -> str:
    return ", ".join(map(repr, numbers))


def numbers_of(statement: Statement) -> tuple[float, ...]:
    """A statement's continuous parameters."""
    match statement:
        case Declare():
            return statement.size
        case Attach():
            return statement.at_a + statement.at_b
        case Squeeze():
            return statement.place
        case Translate():
            return (statement.span,)
    return ()


def _renumbered(block: Block, numbers: Iterator[Number]) -> Block:
    def triple() -> Triple:
        return next(numbers), next(numbers), next(numbers)

    def renew(statement: Statement) -> Statement:
        match statement:
            case Declare():
                return Declare(statement.name, triple(), statement.aligned)
            case Attach():
                return Attach(statement.a, statement.b, triple(), triple())
            case Squeeze():
                return replace(statement, place=(next(numbers), next(numbers)))
            case Translate():
                return replace(statement, span=next(numbers))
        return statement

    return Block(block.name, triple(), tuple([renew(statement) for statement in block.statements]))


class Unexecutable(ProgramError):
    """The first error of a program, by block and statement."""

    def __init__(self, blocks: tuple[Block, ...], block: int, statement: int, wanted: str) -> None:
        text = str(blocks[block].statements[statement]) if statement >= 0 else ""
        super().__init__(f"block {blocks[block].name}" if blocks else "program", 0, text, wanted)
        self.block = block
        self.statement = statement  # -1: the block's head


def _check(blocks: tuple[Block, ...]) -> None:
    """Raise the first thing that would not execute, as Unexecutable."""

    def fail(block: int, statement: int, wanted: str) -> ProgramError:
        return Unexecutable(blocks, block, statement, wanted)

    if not blocks:
        raise fail(0, -1, "wanted at least one block: Assembly NAME {")
    places: dict[str, int] = {}
    total = 0
    for i, block in enumerate(blocks):
        if places.setdefault(block.name, i) != i:
            raise fail(i, -1, f"block {block.name} is there already; wanted another name")
        total += len(block.statements)
        if total > MAX_STATEMENTS:
            raise fail(i, -1, f"wanted at most {MAX_STATEMENTS:,} statements in all")
    copies = [_check_block(block, partial(fail, i)) for i, block in enumerate(blocks)]
    used: set[int] = {0}

    def leaves(i: int, depth: int) -> int:
        if depth > MAX_DEPTH:
            raise fail(i, -1, f"wanted at most {MAX_DEPTH} blocks within each other")
        count = 0
        for j, statement in enumerate(blocks[i].statements):
            if isinstance(statement, Declare):
                child = places.get(statement.name)
                if child is None:
                    count += copies[i][statement.name]
                    continue
                if child in used:
                    raise fail(i, j, f"block {statement.name} is used already; wanted each just once, the first never")
                used.add(child)
                count += copies[i][statement.name] * leaves(child, depth + 1)
        if count == 0:
            raise fail(i, -1, f"block {blocks[i].name} has no cuboid but its bbox; wanted at least one")
        if count > MAX_LEAVES:
            raise fail(i, -1, f"wanted at most {MAX_LEAVES:,} cuboids in all")
        return count

    leaves(0, 1)
    for i, block in enumerate(blocks):
        if i not in used:
            raise fail(i, -1, f"no cuboid is called {block.name}; wanted each block but the first to fill one")


def _check_block(block: Block, fail: Callable[[int, str], ProgramError]) -> dict[str, int]:
    """Number of cuboids for each declared one of a block: itself and its copies."""
    counts: dict[str, int] = {}
    copies: set[str] = set()
    moves: Counter[str] = Counter()
    if not _positive(block.size):
        raise fail(-1, f"bbox has lengths {_commas(block.size)}; wanted positive numbers")

    def known(j: int, *names: str) -> None:
        for name in names:
            if name not in counts and name not in copies and name != BBOX:
                declared = textwrap.shorten(", ".join([BBOX, *counts, *sorted(copies)]), 200, placeholder=" …")
                raise fail(j, f"{name} is not there yet; wanted one of {declared}")

    def moved(j: int, name: str, *targets: str) -> None:
        known(j, name, *targets)
        if name == BBOX:
            raise fail(j, "the bbox is fixed; wanted another cuboid first")
        if name in targets:
            raise fail(j, f"{name} can't be attached to itself")
        moves[name] += len(targets)
        if moves[name] > MAX_MOVES:
            raise fail(j, f"wanted at most {MAX_MOVES} attachments of {name}")

    def room(j: int, count: int) -> None:
        if len(counts) + len(copies) + count > MAX_CUBOIDS:
            raise fail(j, f"wanted at most {MAX_CUBOIDS} cuboids in a block, copies among them")

    def copied(j: int, name: str, count: int) -> None:
        moved(j, name)
        if name in copies:
            raise fail(j, f"{name} is a copy; wanted a declared cuboid")
        room(j, count)
        for _ in range(count):
            copy = copy_name(len(counts) + len(copies))
            if copy in counts or copy in copies:
                raise fail(j, f"its copy would be called {copy}, as another cuboid is; rename that")
            copies.add(copy)
        counts[name] += count

    for j, statement in enumerate(block.statements):
        match statement:
            case Declare(name, size):
                if name in counts or name in copies or name == BBOX:
                    raise fail(j, f"{name} is there already; wanted another name")
                if not _positive(size):
                    raise fail(j, f"lengths {_commas(size)}; wanted positive numbers")
                room(j, 1)
                counts[name] = 1
            case Attach():
                moved(j, statement.a, statement.b)
                _finite(statement.at_a + statement.at_b, j, fail)
            case Squeeze():
                moved(j, statement.a, statement.b, statement.c)
                _finite(statement.place, j, fail)
            case Reflect():
                copied(j, statement.a, 1)
            case Translate():
                if not 1 <= statement.count <= MAX_COPIES:
                    raise fail(j, f"{statement.count} copies; wanted 1 to {MAX_COPIES}")
                _finite((statement.span,), j, fail)
                copied(j, statement.a, statement.count)
    return counts


def copy_name(cuboids: int) -> str:
    """Name of the next copy in a block of `cuboids` cuboids, its bbox not counted."""
    return f"cube{cuboids}"


def _positive(size: Triple) -> bool:
    return all(0 < length < math.inf for length in size)


def _finite(numbers: tuple[Number, ...], j: int, fail: Callable[[int, str], ProgramError]) -> None:
    for number in numbers:
        if not -math.inf < number < math.inf:
            raise fail(j, f"{number} is not finite")
