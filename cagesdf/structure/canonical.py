"""When two programs are equal up to continuous parameters (§3.3).

Exactly: the same text but for the numbers. Canonically: also if cuboids are named otherwise or
statements come in another order.
"""

from collections.abc import Mapping
from dataclasses import replace

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

Fact = tuple[str, tuple[str, ...]]  # what a statement says but for numbers, and the cuboids it says it of
Colours = dict[str, int]  # by cuboid; two have the same as long as nothing tells them apart


def exact_signature(program: AssemblyProgram) -> str:
    """A text that two programs share if they differ in continuous parameters alone."""
    return ";".join(
        f"{block.name}:" + ",".join(f"{kind}({' '.join(names)})" for kind, names in map(_fact, block.statements))
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
    """By path of each node: a text that siblings share which nothing tells apart, in this program or an equal one.

    The root, under the path `root`, has the canonical signature.
    """
    signatures = {root: canonical_signature(program)}

    def visit(prefix: str, block: Block) -> None:
        colours = _refined(block, _initial(program, block))
        for member in block.members():
            by = "" if member.copied_by is None else f"{_fact(member.copied_by)[0]} {member.number}"
            signatures[prefix + member.name] = f"{colours[member.original]} {by}".rstrip()
            inside = program.block(member.original)
            if inside is not None:
                visit(f"{prefix}{member.name}/", inside)

    visit("", program.blocks[0])
    return signatures


def _fact(statement: Statement) -> Fact:
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


def _signature(program: AssemblyProgram, block: Block) -> str:
    colours = _refined(block, _initial(program, block))
    while len(set(colours.values())) < len(colours):
        # Name one of the cuboids that are alike first: whichever, if they are truly alike.
        counts = [list(colours.values()).count(colour) for colour in colours.values()]
        tied = min(colour for colour, count in zip(colours.values(), counts) if count > 1)
        chosen = next(name for name, colour in colours.items() if colour == tied)
        colours = _refined(block, _ranked({name: (colour, name != chosen) for name, colour in colours.items()}))
    facts = sorted((kind, [colours[name] for name in names]) for kind, names in map(_fact, block.statements))
    inside = {colours[name]: text for name, text in _inside(program, block).items()}
    said = ",".join(f"{kind}({' '.join(map(str, numbers))})" for kind, numbers in facts)
    return said + "".join(f",{colour}:[{inside[colour]}]" for colour in sorted(inside))


def _inside(program: AssemblyProgram, block: Block) -> dict[str, str]:
    """Signatures of the blocks that fill its cuboids, by cuboid."""
    blocks = {member.name: program.block(member.name) for member in block.members() if member.copied_by is None}
    return {name: _signature(program, filling) for name, filling in blocks.items() if filling is not None}


def _initial(program: AssemblyProgram, block: Block) -> Colours:
    """Colours from what a cuboid is by itself; copies, and the bbox, have their own."""
    inside = _inside(program, block)
    keys: dict[str, tuple] = {BBOX: (0, "", "")}
    for member in block.members():
        if member.copied_by is None:
            keys[member.name] = (1, "", inside.get(member.name, ""))
        else:
            keys[member.name] = (2, f"{_fact(member.copied_by)[0]} {member.number}", "")
    return _ranked(keys)


def _refined(block: Block, colours: Colours) -> Colours:
    """Tell cuboids apart by what is said of them and of which others, until nothing new comes up."""
    facts = list(map(_fact, block.statements))
    facts += [("copy", (member.name, member.original)) for member in block.members() if member.copied_by is not None]
    while True:
        said: dict[str, list[tuple]] = {name: [] for name in colours}
        for kind, names in facts:
            for place, name in enumerate(names):
                said[name].append((kind, place, *(colours[other] for other in names)))
        finer = _ranked({name: (colour, sorted(said[name])) for name, colour in colours.items()})
        if len(set(finer.values())) == len(set(colours.values())):
            return finer
        colours = finer


def _ranked(keys: Mapping[str, tuple]) -> Colours:
    order = sorted(set(map(_frozen, keys.values())))
    return {name: order.index(_frozen(key)) for name, key in keys.items()}


def _frozen(key: tuple) -> tuple:
    return tuple(tuple(item) if isinstance(item, list) else item for item in key)
