"""Plain names of a program's numbers: by part, "height" instead of Program_0.cube1.y."""

from collections.abc import Mapping

from cagesdf.editing.naming import group_names
from cagesdf.editing.parts import part_names
from cagesdf.structure.assembly import ROOT, Assembly, below
from cagesdf.structure.base import Structure
from cagesdf.structure.program import BBOX

WHOLE = "the whole"
LENGTHS = {"x": "width", "y": "height", "z": "depth"}
SIDES = {"1": "on itself", "2": "on the other"}
SQUEEZED = {"u": "sideways", "v": "upwards"}


def grouped(structure: Structure, parameters: Mapping[str, float]) -> dict[str, dict[str, str]]:
    """Plain names of numbers and their parameters, by part or block: {"seat": {"height": "Program_0.cube1.y"}}.

    Names are unique within a part; a cuboid that fills several places is listed under the first of its parts.
    """
    owners = _owners(structure)
    groups: dict[str, dict[str, str]] = {}
    for parameter in parameters:
        block, cuboid, number = parameter.split(".", 2)
        owner = WHOLE if cuboid == BBOX else owners.get((block, cuboid), cuboid)
        numbers = groups.setdefault(owner, {})
        text = plain(number)
        numbers[text if text not in numbers else f"{text} ({parameter})"] = parameter
    return groups


def plain(number: str) -> str:
    """A number of a cuboid in words: y is its height, attach1.x2 where it is attached for the first time."""
    if number in LENGTHS:
        return LENGTHS[number]
    kind, _, rest = number.partition(".")
    name, ordinal = kind.rstrip("0123456789"), kind.lstrip("abcdefghijklmnopqrstuvwxyz")
    match name:
        case "attach":
            return f"attachment {ordinal}: {rest[0]} {SIDES.get(rest[1:], rest[1:])}"
        case "squeeze":
            return f"between two, {ordinal}: {SQUEEZED.get(rest, rest)}"
        case "translate":
            return f"copies {ordinal}: how far"
    return number


def _owners(structure: Structure) -> dict[tuple[str, str], str]:
    """By block and cuboid, the name of the first part, or the path of the first node, that it is."""
    owners: dict[tuple[str, str], str] = {}
    if not isinstance(structure, Assembly):
        return owners
    names, program = part_names(structure), structure.program
    parts = {*names.values()}
    names |= {node: f"all of {text}" if text in parts else text for node, text in group_names(structure).items()}

    def visit(node: str, block_name: str) -> None:
        block = program.block(block_name) or program.blocks[0]
        for member in block.members():
            path = below(node, member.name)
            owners.setdefault((block.name, member.original), names[path])
            if program.block(member.original) is not None:
                visit(path, member.original)

    visit(ROOT, program.blocks[0].name)
    return owners
