"""Equality of programs up to continuous parameters (§3.3).

Exactly: the same text but for the numbers. Canonically: also if cuboids are named otherwise or
statements come in another order.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice

from cagesdf.structure.program import (
    BBOX,
    AssemblyProgram,
    Attach,
    Block,
    Declare,
    Reflect,
    Squeeze,
    Statement,
    Translate,
)

Fact = tuple[str, tuple[str, ...]]  # a statement without its numbers, and the cuboids that it is about
Colours = dict[str, int]  # by cuboid; equal as long as nothing distinguishes two cuboids


def exact_signature(program: AssemblyProgram) -> str:
    """A text that two programs share if they differ in continuous parameters alone."""
    return ";".join(
        f"{block.name}:" + ",".join(f"{kind}({' '.join(names)})" for kind, names in map(fact, block.statements))
        for block in program.blocks
    )


def canonical_signature(program: AssemblyProgram) -> str:
    """A text that two programs share if they also differ in names and in the order of statements.

    Equal texts mean that one program can be renamed and reordered into the other. The reverse
    holds too, but for programs with cuboids that differ and yet have the same neighbourhoods at
    every distance.
    """
    return _signature(program, program.blocks[0])


def without_flags(program: AssemblyProgram) -> AssemblyProgram:
    """The program with no cuboid aligned: for signatures that leave the flag out."""

    def renew(statement: Statement) -> Statement:
        return replace(statement, aligned=False) if isinstance(statement, Declare) else statement

    return AssemblyProgram(
        tuple(Block(block.name, block.size, tuple(map(renew, block.statements))) for block in program.blocks)
    )


def node_signatures(program: AssemblyProgram, root: str) -> dict[str, str]:
    """Signatures by node path: siblings that nothing distinguishes share one, in this program or an equal one.

    The root, under the path `root`, has the canonical signature.
    """
    signatures = {root: canonical_signature(program)}

    def visit(prefix: str, block: Block) -> None:
        colours = _refined(_facts(block), _initial(block, _inside(program, block)))
        for member in block.members():
            signatures[prefix + member.name] = str(colours[member.name])
            inside = program.block(member.original)
            if inside is not None:
                visit(f"{prefix}{member.name}/", inside)

    visit("", program.blocks[0])
    return signatures


def fact(statement: Statement) -> Fact:
    """The text of a statement without its numbers, and the cuboids that it is about."""
    match statement:
        case Declare():
            return f"Cuboid {statement.aligned}", (statement.name,)
        case Attach():
            return "attach", (statement.a, statement.b)
        case Squeeze():
            return f"squeeze {statement.face}", (statement.a, statement.b, statement.c)
        case Reflect():
            return f"reflect {statement.axis}", (statement.a,)
        case Translate():
            return f"translate {statement.axis} {statement.count}", (statement.a,)


def _facts(block: Block) -> list[Fact]:
    """Facts of a block's statements; those of statements that copy are about the copies too, in order."""
    copies = iter([member.name for member in block.members() if member.copied_by is not None])
    facts: list[Fact] = []
    for statement in block.statements:
        match statement:
            case Reflect():
                made = 1
            case Translate():
                made = statement.count
            case _:
                made = 0
        kind, names = fact(statement)
        facts.append((kind, (*names, *islice(copies, made))))
    return facts


def _signature(program: AssemblyProgram, block: Block) -> str:
    facts, inside = _facts(block), _inside(program, block)
    colours = _refined(facts, _initial(block, inside))
    while len(set(colours.values())) < len(colours):
        # Name one of the cuboids that are alike first: whichever, if they are truly alike.
        lowest = min(colour for colour, count in Counter(colours.values()).items() if count > 1)
        tied = [name for name, colour in colours.items() if colour == lowest]
        named = tied if _interchangeable(facts, tied) else tied[:1]
        places = {name: place for place, name in enumerate(named)}
        keys = {name: (colour, places.get(name, len(named))) for name, colour in colours.items()}
        colours = _refined(facts, _ranked(keys))
    coloured = sorted((kind, [colours[name] for name in names]) for kind, names in facts)
    filled = sorted((colours[name], text) for name, text in inside.items())
    return ",".join(
        [f"{kind}({' '.join(map(str, numbers))})" for kind, numbers in coloured]
        + [f"{colour}:[{text}]" for colour, text in filled]
    )


def _interchangeable(facts: Sequence[Fact], names: Sequence[str]) -> bool:
    """Whether the facts about each of these cuboids are the same, and none is about two of them: any order will do."""
    by_name: dict[str, list[tuple[str, ...]]] = {name: [] for name in names}
    for kind, about in facts:
        members = [name for name in about if name in by_name]
        if len(members) > 1:
            return False
        if members:
            by_name[members[0]].append((kind, *["" if name == members[0] else name for name in about]))
    return len({tuple(sorted(entries)) for entries in by_name.values()}) == 1


def _inside(program: AssemblyProgram, block: Block) -> dict[str, str]:
    """Signatures of the blocks that fill its cuboids, by cuboid."""
    blocks = {member.name: program.block(member.name) for member in block.members() if member.copied_by is None}
    return {name: _signature(program, filling) for name, filling in blocks.items() if filling is not None}


def _initial(block: Block, inside: Mapping[str, str]) -> Colours:
    """Colours from what a cuboid is by itself: the bbox, a declared one and what fills it, or a copy."""
    keys: dict[str, tuple] = {BBOX: (0, "")}
    for member in block.members():
        keys[member.name] = (1, inside.get(member.name, "")) if member.copied_by is None else (2, "")
    return _ranked(keys)


def _refined(facts: Sequence[Fact], colours: Colours) -> Colours:
    """Colours refined by the facts about each cuboid and its neighbours, until they no longer change."""
    while True:
        by_name: dict[str, list[tuple]] = {name: [] for name in colours}
        for kind, names in facts:
            numbers = [colours[name] for name in names]
            for place, name in enumerate(names):
                by_name[name].append((kind, place, *numbers))
        finer = _ranked({name: (colour, *sorted(by_name[name])) for name, colour in colours.items()})
        if len(set(finer.values())) == len(set(colours.values())):
            return finer
        colours = finer


def _ranked(keys: Mapping[str, tuple]) -> Colours:
    rank = {key: i for i, key in enumerate(sorted(set(keys.values())))}
    return {name: rank[key] for name, key in keys.items()}
