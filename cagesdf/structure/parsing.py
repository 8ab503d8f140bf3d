"""Reading ShapeAssembly programs from text.

One pattern a kind of line, so that a line is checked and taken apart at once.
"""

import re
from pathlib import Path

from cagesdf.errors import InputError, ProgramError
from cagesdf.structure.program import (
    BBOX,
    FACES,
    MAX_CHARACTERS,
    AssemblyProgram,
    Attach,
    Block,
    Declare,
    Reflect,
    Squeeze,
    Statement,
    Translate,
    Unexecutable,
)
from cagesdf.text import read_text

_NUMBER = r"\s*([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*"
_NAME = r"\s*(\w+)\s*"
_AXIS = r"\s*([XYZ])\s*"
_PATTERNS = {
    kind: re.compile(pattern, re.ASCII)
    for kind, pattern in {
        "cuboid": rf"(\w+)\s*=\s*Cuboid\({_NUMBER},{_NUMBER},{_NUMBER}(?:,\s*(True|False)\s*)?\)",
        "attach": rf"attach\({_NAME},{_NAME},{','.join([_NUMBER] * 6)}\)",
        "squeeze": rf"squeeze\({_NAME},{_NAME},{_NAME},\s*({'|'.join(FACES)})\s*,{_NUMBER},{_NUMBER}\)",
        "reflect": rf"reflect\({_NAME},{_AXIS}\)",
        "translate": rf"translate\({_NAME},{_AXIS},\s*(\d{{1,9}})\s*,{_NUMBER}\)",
    }.items()
}
_HEAD = re.compile(r"Assembly\s+(\w+)\s*\{", re.ASCII)
_FORMS = {
    "cuboid": "name = Cuboid(l, h, w, True or False)",
    "attach": "attach(a, b, x1, y1, z1, x2, y2, z2)",
    "squeeze": f"squeeze(a, b, c, {' or '.join(FACES)}, u, v)",
    "reflect": "reflect(a, X or Y or Z)",
    "translate": "translate(a, X or Y or Z, count, span)",
}


def parse(text: str, source: str = "program") -> AssemblyProgram:
    """Read a program; `source` names it in errors.

    Raises ProgramError with line, text and what was wanted: for a line that is none of the
    language, a name that is declared twice or not at all, a bbox that is moved or copied, a copy
    that is copied, a length that isn't positive, a number that isn't finite, a block that isn't
    used just once, and for more than the module's limits allow.
    """
    if len(text) > MAX_CHARACTERS:
        raise ProgramError(source, 0, "", f"at most {MAX_CHARACTERS:,} characters, got {len(text):,}")
    blocks: list[Block] = []
    lines: list[list[int]] = []  # of each block: its head's line, its statements' lines
    name, statements = "", list[Statement]()
    raw = text.splitlines()
    for number, line in enumerate(raw, start=1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        if not name:
            head = _HEAD.fullmatch(content)
            if head is None:
                raise ProgramError(source, number, content, "wanted Assembly NAME {")
            name, statements = head[1], []
            lines.append([number])
        elif content == "}":
            if not statements:
                raise ProgramError(source, number, content, "wanted bbox = Cuboid(l, h, w, True) first in its block")
            first = statements[0]
            assert isinstance(first, Declare)
            blocks.append(Block(name, first.size, tuple(statements[1:])))
            name = ""
        else:
            statement = _statement(content, source, number)
            if not statements and not (isinstance(statement, Declare) and statement.name == BBOX):
                raise ProgramError(source, number, content, "wanted bbox = Cuboid(l, h, w, True) first in its block")
            statements.append(statement)
            lines[-1].append(number)
    if name:
        raise ProgramError(source, len(raw), "", f"wanted }} at the end of block {name}")

    try:
        return AssemblyProgram(tuple(blocks))
    except Unexecutable as error:
        # A block's head and its bbox stand before its other statements.
        number = lines[error.block][error.statement + 2 if error.statement >= 0 else 0] if lines else 0
        raise ProgramError(source, number, raw[number - 1].strip() if number else "", error.wanted) from None


def read_program(path: Path) -> AssemblyProgram:
    """Parse a file. Raises ProgramError as `parse` does, and for a file that is missing, too large or no text."""
    try:
        text = read_text(path, 4 * MAX_CHARACTERS)
    except InputError as error:
        raise ProgramError(str(path), 0, "", f"wanted a text file with a program ({error})") from error
    return parse(text, str(path))


def _statement(content: str, source: str, number: int) -> Statement:
    kind = content.partition("(")[0]
    if kind not in _PATTERNS or kind == "cuboid":
        kind = "cuboid"
        if "=" not in content:
            raise ProgramError(source, number, content, f"wanted one of {'; '.join(_FORMS.values())}")
    match = _PATTERNS[kind].fullmatch(content)
    if match is None:
        raise ProgramError(source, number, content, f"wanted {_FORMS[kind]}")
    g = match.groups()
    match kind:
        case "cuboid":
            return Declare(g[0], (float(g[1]), float(g[2]), float(g[3])), g[4] == "True")
        case "attach":
            x1, y1, z1, x2, y2, z2 = map(float, g[2:])
            return Attach(g[0], g[1], (x1, y1, z1), (x2, y2, z2))
        case "squeeze":
            return Squeeze(g[0], g[1], g[2], g[3], (float(g[4]), float(g[5])))
        case "reflect":
            return Reflect(g[0], g[1])
    return Translate(g[0], g[1], int(g[2]), float(g[3]))
