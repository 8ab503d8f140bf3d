"""ShapeAssembly programs for tests: small ones by hand, and a strategy for random ones."""

import gzip
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st

from cagesdf.structure.parsing import parse
from cagesdf.structure.program import (
    AXES,
    BBOX,
    FACES,
    AssemblyProgram,
    Attach,
    Block,
    Declare,
    Reflect,
    Squeeze,
    Statement,
    Translate,
)

SHARED = Path(__file__).parents[3] / "shared" / "data" / "shapeassembly"
FINE = 2**30  # coordinates are multiples of 1 / FINE, so that 1 - q is exact

CHAIR = parse("""
Assembly Chair {
    bbox = Cuboid(0.6, 1.0, 0.6, True)
    Base = Cuboid(0.6, 0.45, 0.6, True)
    seat = Cuboid(0.6, 0.05, 0.6, True)
    back = Cuboid(0.6, 0.5, 0.06, False)
    arm = Cuboid(0.05, 0.05, 0.5, False)
    attach(Base, bbox, 0.5, 0.0, 0.5, 0.5, 0.0, 0.5)
    attach(seat, Base, 0.5, 0.0, 0.5, 0.5, 1.0, 0.5)
    attach(back, seat, 0.5, 0.0, 0.0, 0.5, 1.0, 0.0)
    attach(back, bbox, 0.5, 1.0, 0.0, 0.5, 1.0, 0.02)
    attach(arm, back, 0.5, 0.5, 0.0, 0.05, 0.4, 1.0)
    attach(arm, seat, 0.5, 0.0, 1.0, 0.05, 1.0, 0.9)
    reflect(arm, X)
}
Assembly Base {
    bbox = Cuboid(0.6, 0.45, 0.6, True)
    Side = Cuboid(0.05, 0.45, 0.6, True)
    squeeze(Side, bbox, bbox, top, 0.1, 0.5)
    reflect(Side, X)
}
Assembly Side {
    bbox = Cuboid(0.05, 0.45, 0.6, True)
    leg = Cuboid(0.05, 0.4, 0.05, False)
    bar = Cuboid(0.03, 0.03, 0.3, False)
    squeeze(leg, bbox, bbox, top, 0.4, 0.05)
    squeeze(bar, leg, bbox, back, 0.4, 0.3)
    translate(leg, Z, 2, 0.9)
}
""")

# An aligned cuboid that ends short of the one that it is attached to, and so grows.
GROWN = parse("""
Assembly Grown {
    bbox = Cuboid(2.0, 2.0, 2.0, True)
    low = Cuboid(0.8, 0.3, 0.7, True)
    post = Cuboid(0.21, 0.6, 0.23, True)
    high = Cuboid(0.9, 0.2, 0.94, True)
    attach(low, bbox, 0.5, 0.0, 0.5, 0.5, 0.0, 0.5)
    attach(high, bbox, 0.5, 1.0, 0.5, 0.52, 1.0, 0.49)
    attach(post, low, 0.5, 0.0, 0.5, 0.43, 1.0, 0.61)
    attach(post, high, 0.5, 1.0, 0.5, 0.5, 0.0, 0.5)
    reflect(post, X)
}
""")


def real_programs(category: str, count: int | None = None) -> list[tuple[str, str, np.ndarray]]:
    """Id, text and published cuboids of real programs, evenly chosen; skips the test where they are absent."""
    if not SHARED.is_dir():
        pytest.skip("needs the published programs")
    with gzip.open(SHARED / f"{category}_cuboids.jsonl.gz", "rt", encoding="utf-8") as lines:
        rows = [json.loads(line) for line in lines]
    chosen = rows if count is None else rows[:: max(1, len(rows) // count)][:count]
    return [
        (row["id"], (SHARED / category / f"{row['id']}.txt").read_text(encoding="utf-8"), np.array(row["cuboids"]))
        for row in chosen
    ]


def mirrored(program: AssemblyProgram) -> AssemblyProgram:
    """The program of the shape's mirror image along x."""

    def flip(q: tuple[float, float, float]) -> tuple[float, float, float]:
        return (1 - q[0], q[1], q[2])

    def renew(statement: Statement) -> Statement:
        match statement:
            case Attach(a, b, at_a, at_b):
                return Attach(a, b, flip(at_a), flip(at_b))
            case Squeeze(a, b, c, face, (u, v)):
                if FACES[face][0] == 0:
                    return Squeeze(a, b, c, {"left": "right", "right": "left"}[face], (u, v))
                return Squeeze(a, b, c, face, (1 - u, v))
            case Translate(_, "X", _, span):
                return replace(statement, span=-span)
        return statement

    return AssemblyProgram(
        tuple(Block(block.name, block.size, tuple(map(renew, block.statements))) for block in program.blocks)
    )


def scaled(program: AssemblyProgram, factor: float) -> AssemblyProgram:
    """The program with all lengths multiplied."""

    def longer(size: tuple[float, float, float]) -> tuple[float, float, float]:
        return (size[0] * factor, size[1] * factor, size[2] * factor)

    def renew(statement: Statement) -> Statement:
        return replace(statement, size=longer(statement.size)) if isinstance(statement, Declare) else statement

    return AssemblyProgram(
        tuple(Block(block.name, longer(block.size), tuple(map(renew, block.statements))) for block in program.blocks)
    )


def operands(statement: Statement) -> tuple[str, ...]:
    """The cuboids that a statement, other than a declaration, is about."""
    match statement:
        case Declare():
            return ()
        case Attach(a, b):
            return a, b
        case Squeeze(a, b, c):
            return a, b, c
    return (statement.a,)


def scrambled(program: AssemblyProgram, rng: np.random.Generator) -> AssemblyProgram:
    """The same program with its cuboids called otherwise and its statements in another possible order."""
    numbers = rng.permutation(len(program.blocks)).tolist()
    names = {block.name: f"Filled{number}" for block, number in zip(program.blocks, numbers)}
    first, *others = [_scrambled(block, names, rng) for block in program.blocks]
    return AssemblyProgram((first, *(others[i] for i in rng.permutation(len(others)))))


def renamed(statement: Statement, called: Mapping[str, str]) -> Statement:
    """A statement about cuboids of other names."""
    match statement:
        case Declare():
            return replace(statement, name=called[statement.name])
        case Squeeze():
            return replace(statement, a=called[statement.a], b=called[statement.b], c=called[statement.c])
        case Attach():
            return replace(statement, a=called[statement.a], b=called[statement.b])
        case Reflect() | Translate():
            return replace(statement, a=called[statement.a])


def _scrambled(block: Block, names: dict[str, str], rng: np.random.Generator) -> Block:
    declared = [statement.name for statement in block.statements if isinstance(statement, Declare)]
    fresh = dict(zip(declared, (f"n{number}" for number in rng.permutation(len(declared)))))
    copies = iter([member.name for member in block.members() if member.copied_by is not None])
    made = {
        j: [next(copies) for _ in range(getattr(statement, "count", 1))]
        for j, statement in enumerate(block.statements)
        if isinstance(statement, Reflect | Translate)
    }
    called, out = {BBOX: BBOX}, list[Statement]()
    waiting = list(range(len(block.statements)))
    while waiting:
        possible = [j for j in waiting if all(name in called for name in operands(block.statements[j]))]
        j = possible[int(rng.integers(len(possible)))]
        waiting.remove(j)
        statement = block.statements[j]
        if isinstance(statement, Declare):
            called[statement.name] = names.get(statement.name, fresh[statement.name])
        for copy in made.get(j, []):
            called[copy] = f"cube{len(called) - 1}"
        out.append(renamed(statement, called))
    return Block(names[block.name], block.size, tuple(out))


@st.composite
def program_texts(draw: st.DrawFn, moves: int = 3, depth: int = 3) -> str:
    """Random valid programs: the structure is drawn, the numbers are generic, so that nothing is tied.

    Each cuboid is attached at most `moves` times, to cuboids that came before it, before any is
    attached to it. Text, because records made within a strategy draw from `random` when checked.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))

    def numbers(count: int, low: float = 0.0, high: float = 1.0) -> str:
        return ", ".join(map(repr, (np.round(rng.uniform(low, high, count) * FINE) / FINE).tolist()))

    def cuboid(name: str, aligned: bool) -> str:
        return f"{name} = Cuboid({numbers(3, 0.1, 1.5)}, {aligned})"

    def block(name: str, level: int) -> list[str]:
        declared, inside = list[str](), list[str]()
        for i in range(draw(st.integers(1, 4))):
            filled = level < depth and draw(st.integers(0, 3)) == 0
            declared.append(f"{name}_{i}" if filled else f"part{i}")
            inside += [declared[-1]] if filled else []
        lines = [f"Assembly {name} {{", cuboid(BBOX, True), *(cuboid(part, draw(st.booleans())) for part in declared)]
        for i, part in enumerate(declared):
            targets = st.sampled_from([BBOX, *declared[:i]])
            left = draw(st.integers(0, moves))
            if left >= 2 and draw(st.booleans()):
                face = draw(st.sampled_from([*FACES]))
                lines.append(f"squeeze({part}, {draw(targets)}, {draw(targets)}, {face}, {numbers(2)})")
                left -= 2
            lines += [f"attach({part}, {draw(targets)}, {numbers(6)})" for _ in range(left)]
        for part in draw(st.lists(st.sampled_from(declared), max_size=2)):
            axis, count = draw(st.sampled_from(AXES)), draw(st.integers(0, 3))
            copy = f"translate({part}, {axis}, {count}, {numbers(1, 0.1)})" if count else f"reflect({part}, {axis})"
            lines.append(copy)
        return [*lines, "}", *(line for child in inside for line in block(child, level + 1))]

    return "\n".join(block("P", 1))
