"""Programs as numbers: one row a statement, as ShapeAssembly's network reads and writes them [Jones et al. 2020].

A row has 63 columns, those that a statement has no use for are 0. Cuboids go by slots: the bbox has
slot 0, the cuboids that a block declares have 1, 2, … in order, and nothing else can be attached or
copied. Names are lost; `program_of` calls cuboids `cube0`, `cube1`, … and those that blocks fill
`Program_1`, `Program_2`, …, as the published programs do.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from cagesdf.errors import ProgramError
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
    numbers_of,
)

COMMANDS = ("start", "cuboid", "attach", "reflect", "translate", "squeeze", "end")
START, CUBOID, ATTACH, REFLECT, TRANSLATE, SQUEEZE, END = range(7)
PHASE = {CUBOID: 0, ATTACH: 1, SQUEEZE: 1, REFLECT: 2, TRANSLATE: 2, END: 3}  # in which a block's statements stand
OPERANDS = {CUBOID: 1, ATTACH: 2, REFLECT: 1, TRANSLATE: 1, SQUEEZE: 3}  # cuboids that a statement is about
FACE_NAMES = tuple(FACES)

SLOTS = 11  # the bbox and ten cuboids

# Columns.
COMMAND = slice(0, 7)  # one of COMMANDS
OPERAND = (slice(7, 18), slice(18, 29), slice(29, 40))  # slots of up to three cuboids
SIZE = slice(40, 43)  # of a declared cuboid
PLACES = slice(43, 49)  # of an attach: in its first cuboid, in its second
AXIS = slice(49, 52)  # of a reflect or translate
COUNT = 52  # of a translate's copies
SPAN = 53  # of a translate
FACE = slice(54, 60)  # of a squeeze: one of FACES, in order
PLACE = slice(60, 62)  # of a squeeze
ALIGNED = 62  # of a declared cuboid: 1 if it is
WIDTH = 63

# Bounds of the rows' numbers; published and fitted programs lie well inside.
SIZES = (1e-4, 10.0)  # lengths, program's unit
REACH = (-1.0, 2.0)  # coordinates in cuboids, and spans
MAX_COUNT = 64  # copies by one translate
MAX_LINES = 64  # statements of a block
MAX_LEVELS = 4  # blocks within each other
MAX_BLOCKS = 64  # of a program


@dataclass(frozen=True, eq=False)
class BlockTokens:
    """One block."""

    size: Float[ndarray, " 3"]  # its bbox's lengths
    lines: Float[ndarray, "n 63"]  # one a statement, in order: cuboids, then attachments, then copies
    filling: Int[ndarray, " n"]  # number of the block that fills the cuboid which the line declares, -1 elsewhere


ProgramTokens = tuple[BlockTokens, ...]  # in breadth, the root first


def tokens_of(program: AssemblyProgram) -> ProgramTokens:
    """A program's rows.

    Raises ProgramError for one that they can't hold: more than ten cuboids in a block, statements in
    another order, a copy that something is attached to, and what exceeds this module's limits.
    """
    order = [program.blocks[0]]
    level_of = {order[0].name: 1}
    for block in order:
        inside = [program.block(s.name) for s in block.statements if isinstance(s, Declare)]
        for child in filter(None, inside):
            level_of[child.name] = level_of[block.name] + 1
            order.append(child)
    if len(order) > MAX_BLOCKS or max(level_of.values()) > MAX_LEVELS:
        wanted = f"wanted at most {MAX_BLOCKS} blocks, {MAX_LEVELS} within each other, for the generator"
        raise ProgramError(f"program {order[0].name}", 0, "", wanted)
    numbers = {block.name: i for i, block in enumerate(order)}
    return tuple(_block_tokens(block, numbers) for block in order)


def _block_tokens(block: Block, numbers: Mapping[str, int]) -> BlockTokens:
    def fail(statement: Statement | str, wanted: str) -> ProgramError:
        return ProgramError(f"block {block.name}", 0, str(statement), f"{wanted}, for the generator")

    slots = {BBOX: 0}
    lines = np.zeros((len(block.statements), WIDTH))
    filling = np.full(len(block.statements), -1)
    if len(lines) > MAX_LINES:
        raise fail("", f"wanted at most {MAX_LINES} statements")
    if not all(SIZES[0] <= length <= SIZES[1] for length in block.size):
        raise fail(f"bbox of lengths {block.size}", f"wanted lengths from {SIZES[0]} to {SIZES[1]}")
    phase = 0
    for i, statement in enumerate(block.statements):
        if isinstance(statement, Declare):
            if len(slots) == SLOTS:
                raise fail(statement, f"wanted at most {SLOTS - 1} cuboids")
            slots[statement.name] = len(slots)
            filling[i] = numbers.get(statement.name, -1)
        try:
            command = write_line(lines[i], statement, slots)
        except KeyError as error:
            raise fail(statement, f"{error.args[0]} is a copy; wanted declared cuboids") from None
        low, high = SIZES if command == CUBOID else REACH
        if not all(low <= number <= high for number in numbers_of(statement)):
            raise fail(statement, f"wanted numbers from {low} to {high}")
        if lines[i, COUNT] > MAX_COUNT:
            raise fail(statement, f"wanted at most {MAX_COUNT} copies")
        if PHASE[command] < phase:
            raise fail(statement, "wanted cuboids before attachments before copies")
        phase = PHASE[command]
    return BlockTokens(np.array(block.size, dtype=np.float64), lines, filling)


def write_line(line: Float[ndarray, " 63"], statement: Statement, slots: Mapping[str, int]) -> int:
    """Fill a row of zeros; `slots` are by name. Returns the command. Raises KeyError for a name that has none."""
    command, names = command_of(statement)
    line[command] = 1
    for column, name in zip(OPERAND, names):
        line[column.start + slots[name]] = 1
    match statement:
        case Declare(_, size, aligned):
            line[SIZE] = size
            line[ALIGNED] = aligned
        case Attach():
            line[PLACES] = statement.at_a + statement.at_b
        case Squeeze():
            line[FACE.start + FACE_NAMES.index(statement.face)] = 1
            line[PLACE] = statement.place
        case Reflect(_, axis):
            line[AXIS.start + AXES.index(axis)] = 1
        case Translate(_, axis, count, span):
            line[AXIS.start + AXES.index(axis)] = 1
            line[COUNT], line[SPAN] = count, span
    return command


def command_of(statement: Statement) -> tuple[int, tuple[str, ...]]:
    """A statement's command, and the cuboids that it is about."""
    match statement:
        case Declare(name):
            return CUBOID, (name,)
        case Attach(a, b):
            return ATTACH, (a, b)
        case Squeeze(a, b, c):
            return SQUEEZE, (a, b, c)
        case Reflect(a):
            return REFLECT, (a,)
        case Translate(a):
            return TRANSLATE, (a,)


def read_line(line: Float[ndarray, " 63"], names: Sequence[str]) -> Statement:
    """A row's statement, cuboids being called `names`, by slot; a declared one's own name is among them.

    Raises ProgramError for a row that says nothing, or speaks of a slot that has no name.
    """
    command = int(line[COMMAND].argmax())
    slots = [int(line[columns].argmax()) for columns in OPERAND[: OPERANDS.get(command, 0)]]
    if command not in OPERANDS or line[command] == 0 or any(slot >= len(names) for slot in slots):
        wanted = f"wanted a statement about some of {', '.join(names)}"
        raise ProgramError("tokens", 0, f"{COMMANDS[command]} of slots {slots}", wanted)
    operands = [names[slot] for slot in slots]
    axis = AXES[int(line[AXIS].argmax())]
    if command == CUBOID:
        length, height, width = line[SIZE].tolist()
        return Declare(operands[0], (length, height, width), bool(line[ALIGNED] > 0.5))
    if command == ATTACH:
        x1, y1, z1, x2, y2, z2 = line[PLACES].tolist()
        return Attach(operands[0], operands[1], (x1, y1, z1), (x2, y2, z2))
    if command == REFLECT:
        return Reflect(operands[0], axis)
    if command == TRANSLATE:
        return Translate(operands[0], axis, round(float(line[COUNT])), float(line[SPAN]))
    u, v = line[PLACE].tolist()
    return Squeeze(operands[0], operands[1], operands[2], FACE_NAMES[int(line[FACE].argmax())], (u, v))


def program_of(tokens: ProgramTokens) -> AssemblyProgram:
    """The program that rows say. Raises ProgramError if they don't say one that executes."""
    blocks: list[Block] = []
    for number, block in enumerate(tokens):
        declared = [i for i, line in enumerate(block.lines) if line[CUBOID]]
        filling = [int(block.filling[i]) for i in declared]
        names = [BBOX, *(f"cube{i}" if child < 0 else f"Program_{child}" for i, child in enumerate(filling))]
        length, height, width = block.size.tolist()
        statements = tuple(read_line(line, names) for line in block.lines)
        blocks.append(Block(f"Program_{number}", (length, height, width), statements))
    return AssemblyProgram(tuple(blocks))
