"""What a user calls a shape's parts and its program's numbers."""

from collections import Counter
from difflib import get_close_matches
from fnmatch import fnmatchcase

from cagesdf.errors import InputError
from cagesdf.structure.base import Structure
from cagesdf.structure.program import BBOX, AssemblyProgram, Attach, Block, Declare, Squeeze, Translate

AXES = ("x", "y", "z")
# By kind of statement: what it is called, and its numbers in the order of `program.numbers_of`.
NUMBERS: dict[type, tuple[str, tuple[str, ...]]] = {
    Attach: ("attach", ("x1", "y1", "z1", "x2", "y2", "z2")),
    Squeeze: ("squeeze", ("u", "v")),
    Translate: ("translate", ("span",)),
}


def part_names(structure: Structure) -> dict[str, str]:
    """A name for each part, by id: its label, numbered from 1 where several share it; its id if it has none."""
    labels = structure.labels()
    counts, seen = Counter(labels.values()), Counter[str]()
    names = {}
    for part in structure.parts():
        label = labels[part]
        seen[label] += 1
        names[part] = part if not label else f"{label}_{seen[label]}" if counts[label] > 1 else label
    return names


def select(structure: Structure, pattern: str) -> tuple[str, ...]:
    """Ids of the parts whose id, name or label is `pattern`: * and ? stand for any letters, any letter, | for or.

    Raises InputError if one of the alternatives finds none, with the names that there are.
    """
    names, labels = part_names(structure), structure.labels()
    found: set[str] = set()
    for alternative in pattern.split("|"):
        own = {part for part, name in names.items() if _called(alternative, part, name, labels[part])}
        if not own:
            raise InputError(f"part {alternative!r}: no part is called so; wanted one of {', '.join(names.values())}")
        found |= own
    return tuple(part for part in names if part in found)


def _called(pattern: str, *words: str) -> bool:
    return any(fnmatchcase(word, pattern) for word in words)


def parameters(program: AssemblyProgram) -> dict[str, float]:
    """A program's continuous parameters by name, in the order of the text.

    BLOCK.CUBOID.x, y, z are declared lengths, BLOCK.bbox.x those of the root's bbox. Of the n-th attachment of a
    cuboid BLOCK.CUBOID.attach<n>.x1 ... z2 are the two places; BLOCK.CUBOID.squeeze<n>.u, v and
    BLOCK.CUBOID.translate<n>.span go likewise. The lengths of other blocks' bboxes go with those of the cuboids
    that they fill: see `with_parameter`.
    """
    inner = {name for block in program.blocks[1:] for name in _lengths(block, BBOX)}
    return {name: value for name, value in _all(program).items() if name not in inner}


def with_parameter(program: AssemblyProgram, name: str, value: float) -> AssemblyProgram:
    """The program with another value of one of its `parameters`.

    A cuboid that a block fills takes its contents along: all lengths that are declared in the block along that
    axis, and in blocks within it, change in the same ratio. By itself the length would stretch the contents but
    leave them where they are (see docs/programs.md), and they would part. Raises InputError if there is no such
    parameter, ProgramError for a value that can't be.
    """
    known = parameters(program)
    if name not in known:
        near = get_close_matches(name, known, n=3, cutoff=0.4) or list(known)[:3]
        raise InputError(
            f"parameter {name!r}: there is none of that name among its {len(known)}; did you mean {', '.join(near)}?"
        )
    values = {**_all(program), name: value}
    _, cuboid, number = name.split(".", 2)
    if number in AXES:
        for inner in _inside(program, cuboid, number):
            values[inner] *= value / known[name]
    return program.with_parameters([*values.values()])


def _inside(program: AssemblyProgram, cuboid: str, axis: str) -> list[str]:
    """Names of the lengths along an axis that are declared in the block which a cuboid is filled with, at any depth."""
    block = program.block(cuboid)
    if block is None:
        return []
    declared = [statement.name for statement in block.statements if isinstance(statement, Declare)]
    deeper = [name for member in declared for name in _inside(program, member, axis)]
    return [f"{cuboid}.{member}.{axis}" for member in (BBOX, *declared)] + deeper


def _all(program: AssemblyProgram) -> dict[str, float]:
    names = [name for block in program.blocks for name in _names(block)]
    return dict(zip(names, program.parameters().tolist(), strict=True))


def _lengths(block: Block, cuboid: str) -> list[str]:
    return [f"{block.name}.{cuboid}.{axis}" for axis in AXES]


def _names(block: Block) -> list[str]:
    names = _lengths(block, BBOX)
    seen: Counter[tuple[type, str]] = Counter()
    for statement in block.statements:
        if isinstance(statement, Declare):
            names += _lengths(block, statement.name)
            continue
        seen[type(statement), statement.a] += 1
        kind, numbers = NUMBERS.get(type(statement), ("", ()))
        head = f"{block.name}.{statement.a}.{kind}{seen[type(statement), statement.a]}"
        names += [f"{head}.{number}" for number in numbers]
    return names
