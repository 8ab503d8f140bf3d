"""Names that users have for a shape's parts and its program's numbers."""

import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from fnmatch import fnmatchcase
from itertools import chain, count

from cagesdf.errors import SHOWN, InputError
from cagesdf.structure.base import Structure
from cagesdf.structure.program import BBOX, AssemblyProgram, Attach, Block, Declare, Squeeze, Translate

AXES = ("x", "y", "z")
UNNAMED = "part"
PATTERN = "*?|"  # characters that mean something in the patterns of `select`
MAX_NAME = 100  # characters
SHOWN_NAMES = 40  # parts that a message lists
# By kind of statement: its word, and its numbers in the order of `program.numbers_of`.
NUMBERS: dict[type, tuple[str, tuple[str, ...]]] = {
    Attach: ("attach", ("x1", "y1", "z1", "x2", "y2", "z2")),
    Squeeze: ("squeeze", ("u", "v")),
    Translate: ("translate", ("span",)),
}


def part_names(structure: Structure) -> dict[str, str]:
    """A name for each part, by id, the same in scripts, in exports, in `inspect` and in the editor.

    It is the part's label, or its id if it has none, on one line. Where several share a label, it is the id of a part
    that is called by the label and a number (leg_3), and the label and the part's number among them otherwise. No name
    is another part's label or id: where a third part is labelled leg_1, the first of two legs is leg__1. Names differ
    even for readers that ignore case or take blanks for underscores.
    """
    labels = structure.labels()
    return distinct_labels({part: labels[part] for part in structure.parts()})


def distinct_labels(labels: Mapping[str, str]) -> dict[str, str]:
    """The names of `part_names`, by id, from labels by id; "" is no label."""
    ids = {part: _plain(part) for part in labels}
    bases = {part: _plain(label) or ids[part] or UNNAMED for part, label in labels.items()}
    shared = Counter(_key(base) for base in bases.values())
    owners = Counter(_key(name) for name in ids.values())
    taken, numbers = set(shared), Counter[str]()
    names = {}
    for part, base in bases.items():
        label, part_key = _key(base), _key(ids[part])
        if shared[label] > 1:
            numbers[label] += 1
            numbered = part_key.startswith(f"{label}_") and part_key.removeprefix(f"{label}_").isdecimal()
            candidates = chain(
                [ids[part]] if numbered else [], (f"{base}{'_' * width}{numbers[label]}" for width in count(1))
            )
            base = next(
                name
                for name in candidates
                if _key(name) not in taken and owners[_key(name)] == (_key(name) == part_key)
            )
            taken.add(_key(base))
        names[part] = base
    return names


def free_name(text: str, taken: Iterable[str]) -> str:
    """A name like a text that isn't taken: itself, or with the least free number from 2 on."""
    base, keys = _plain(text) or UNNAMED, {_key(name) for name in taken}
    candidates = (f"{base}_{number}" for number in count(2))
    return next(name for name in chain([base], candidates) if _key(name) not in keys)


def _plain(text: str) -> str:
    """A text as a name: on one line, of printable characters, without those that patterns are made of."""
    printable = (letter if letter.isprintable() else " " for letter in text)
    words = "".join("_" if letter in PATTERN else letter for letter in printable).split()
    return " ".join(words)[:MAX_NAME].rstrip()


def _key(name: str) -> str:
    """Equal for names that some readers of files take for the same."""
    return unicodedata.normalize("NFKC", name).casefold().replace(" ", "_")


def select(structure: Structure, pattern: str) -> tuple[str, ...]:
    """Ids of the parts whose id, name or label is `pattern`: * and ? stand for any letters, any letter, | for or.

    An exact name of a part means that part alone. Raises InputError if one of the alternatives finds none, with
    the names that there are.
    """
    names, labels = part_names(structure), structure.labels()
    named = {name: part for part, name in names.items()}
    whole = pattern in labels or pattern in labels.values()
    selected: set[str] = set()
    for alternative in [pattern] if whole else pattern.split("|"):
        if alternative in named:
            selected.add(named[alternative])
            continue
        subset = {part for part, name in names.items() if _called(alternative, part, name, labels[part])}
        if not subset:
            known = ", ".join([*names.values()][:SHOWN_NAMES]) + (", …" if len(names) > SHOWN_NAMES else "")
            raise InputError(f"part {_short(alternative)}: no part is called so; wanted one of {known}")
        selected |= subset
    return tuple(part for part in names if part in selected)


def _called(pattern: str, *words: str) -> bool:
    # In fnmatch's patterns brackets are sets of letters.
    literal = pattern.replace("[", "[[]")
    return any(word == pattern or fnmatchcase(word, literal) for word in words)


def _short(text: str) -> str:
    return repr(text) if len(text) <= SHOWN else f"{text[:SHOWN]!r}…"


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
