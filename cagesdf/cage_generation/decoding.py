"""Decoding of programs from codes: the likeliest line that the rules allow, then the next, all programs at once.

A program that turns out invalid is discarded, not mended: the share of valid ones says how much of the
language the network has learnt. (The official decoder discards new programs, too.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from cagesdf.cage_generation.program_vae import Decoder
from cagesdf.cage_generation.rules import BlockRules, Invalid
from cagesdf.cage_generation.tokens import (
    ALIGNED,
    ATTACH,
    AXIS,
    COMMAND,
    COUNT,
    CUBOID,
    END,
    FACE,
    MAX_BLOCKS,
    MAX_COUNT,
    MAX_LEVELS,
    OPERAND,
    OPERANDS,
    PLACE,
    PLACES,
    REACH,
    REFLECT,
    SIZE,
    SIZES,
    SLOTS,
    SPAN,
    SQUEEZE,
    START,
    TRANSLATE,
    WIDTH,
    BlockTokens,
    command_of,
    program_of,
    read_line,
    write_line,
)
from cagesdf.errors import ProgramError
from cagesdf.structure.executor import execute
from cagesdf.structure.program import BBOX, AssemblyProgram, Declare

THINNEST = 1e-3  # lengths that are written, program's unit
ASIDE = 0.25  # share of the root bbox's longest side that a part may leave it by
COPIES = (REFLECT, TRANSLATE)


@dataclass(frozen=True)
class Written:
    """A program that was written from a code."""

    program: AssemblyProgram
    floating: int  # cuboids that it declared and attached to nothing: they are left out


@dataclass(frozen=True, eq=False)
class _Draft:
    """A block that is being written."""

    sample: int  # which code's
    rules: BlockRules
    inner: dict[str, Tensor] = field(default_factory=dict)  # by cuboid: code of the block that fills it


@torch.no_grad()
def decode(decoder: Decoder, codes: Float[Tensor, "s d"]) -> list[Written | str]:
    """The program of each code, or the reason why there is none."""
    written: list[list[BlockTokens]] = [[] for _ in codes]
    named = [1 for _ in codes]  # blocks that a program has, those still to be written among them
    floating = [0 for _ in codes]
    failures: dict[int, str] = {}
    waiting = list(enumerate(decoder.root(codes)))
    for depth in range(MAX_LEVELS):
        if not waiting:
            break
        drafts = _write(decoder, waiting, depth, failures)
        waiting = []
        for draft in drafts:
            sample = draft.sample
            tokens, inner = _finished(draft, named[sample])
            written[sample].append(tokens)
            named[sample] += len(inner)
            floating[sample] += len(draft.rules.names) - 1 - len(draft.rules.attached())
            waiting += [(sample, code) for code in inner]
        failures |= {sample: "too many blocks" for sample, count in enumerate(named) if count > MAX_BLOCKS}
        waiting = [(sample, code) for sample, code in waiting if sample not in failures]
    return [failures.get(sample) or _checked(*parts) for sample, parts in enumerate(zip(written, floating))]


def _write(
    decoder: Decoder, waiting: Sequence[tuple[int, Tensor]], depth: int, failures: dict[int, str]
) -> list[_Draft]:
    """The blocks of one depth, by sample and code, without samples that fail; `failures` gets the reasons."""
    codes = torch.stack([code for _, code in waiting])
    sizes = decoder.bbox(codes).clamp(THINNEST, SIZES[1])
    drafts = [_Draft(sample, BlockRules(_triple(size))) for (sample, _), size in zip(waiting, sizes.numpy())]
    states, active = codes, list(range(len(drafts)))
    lines = torch.zeros(len(drafts), WIDTH)
    lines[:, START] = 1
    while active:
        steps = decoder.steps(lines[active], sizes[active], depth)
        states = states.index_copy(0, torch.tensor(active), decoder.writer.step(steps, states[active]))
        lines[active] = _next_lines(decoder, [drafts[i] for i in active], states[active], sizes[active])
        still: list[int] = []
        for i in active:
            draft = drafts[i]
            if draft.sample in failures or lines[i, END]:
                continue
            line = lines[i].numpy().astype(np.float64)
            statement = read_line(line, [*draft.rules.names, f"cube{len(draft.rules.names) - 1}"])
            try:
                draft.rules.add(statement)
            except Invalid as reason:
                failures[draft.sample] = str(reason)
                continue
            still.append(i)
        declared = [i for i in still if lines[i, CUBOID]] if depth + 1 < MAX_LEVELS else []
        if declared:
            both = torch.cat([states[declared], codes[declared]], dim=1)
            inner, leaf = decoder.inner(both), decoder.leaf(both)[:, 0] > 0
            for k, i in enumerate(declared):
                if not leaf[k]:
                    drafts[i].inner[drafts[i].rules.names[-1]] = inner[k]
        active = still
    return [draft for draft in drafts if draft.sample not in failures]


def _next_lines(
    decoder: Decoder,
    drafts: Sequence[_Draft],
    states: Float[Tensor, "n w"],
    sizes: Float[Tensor, "n 3"],
) -> Float[Tensor, "n 63"]:
    """The next line of each block: the likeliest allowed command, on the likeliest cuboids, with its numbers."""
    lines = torch.zeros(len(drafts), WIDTH)
    commands = _likeliest(decoder.command(states), [draft.rules.commands() for draft in drafts])
    lines[torch.arange(len(drafts)), commands] = 1
    logits = decoder.operands(torch.cat([states, lines[:, COMMAND]], dim=1)).unflatten(1, (len(OPERAND), SLOTS))
    operands: list[tuple[int, ...]] = []
    for i, (draft, command) in enumerate(zip(drafts, commands)):
        chosen: tuple[int, ...] = ()
        for columns in OPERAND[: OPERANDS.get(command, 0)]:
            slots = logits[i, len(chosen)]
            chosen += (_likeliest(slots[None], [draft.rules.operands(command, chosen)])[0],)
            lines[i, columns.start + chosen[-1]] = 1
        operands.append(chosen)

    sized = torch.cat([states, sizes], dim=1)
    lengths, aligned = decoder.lengths(sized).clamp(THINNEST, SIZES[1]), decoder.aligned(sized)[:, 0] > 0
    places = decoder.places(torch.cat([states, lines[:, OPERAND[0]], lines[:, OPERAND[1]]], dim=1)).clamp(*REACH)
    copies = decoder.copies(torch.cat([states, lines[:, OPERAND[0]], sizes], dim=1))
    held = decoder.squeeze(torch.cat([states, *[lines[:, columns] for columns in OPERAND]], dim=1))
    for i, (draft, command, slots) in enumerate(zip(drafts, commands, operands)):
        if command == CUBOID:
            lines[i, SIZE], lines[i, ALIGNED] = lengths[i], aligned[i]
        elif command == ATTACH:
            lines[i, PLACES] = places[i]
        elif command == SQUEEZE:
            lines[i, FACE.start + _likeliest(held[i : i + 1, :6], [draft.rules.faces(slots)])[0]] = 1
            lines[i, PLACE] = held[i, 6:].clamp(*REACH)
        elif command in COPIES:
            axis = _likeliest(copies[i : i + 1, :3], [draft.rules.axes(command, slots[0])])[0]
            lines[i, AXIS.start + axis] = 1
        if command == TRANSLATE:
            lines[i, COUNT] = copies[i, 3].round().clamp(1, MAX_COUNT)
            lines[i, SPAN] = copies[i, 4].clamp(*REACH)
    return lines


def _likeliest(logits: Float[Tensor, "n k"], allowed: Sequence[ndarray]) -> list[int]:
    """Number of each row's largest entry among those allowed."""
    masked = logits.masked_fill(~torch.from_numpy(np.stack(allowed)), -torch.inf)
    return [int(number) for number in masked.argmax(dim=1)]


def _triple(values: ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _finished(draft: _Draft, number: int) -> tuple[BlockTokens, list[Tensor]]:
    """A block without cuboids in mid-air, and the codes of the blocks in it, which get numbers from `number`."""
    names = [draft.rules.names[slot] for slot in draft.rules.attached()]
    slots = {name: slot for slot, name in enumerate([BBOX, *names])}
    kept = [statement for statement in draft.rules.statements if set(command_of(statement)[1]) <= set(slots)]
    lines, filling, inner = np.zeros((len(kept), WIDTH)), np.full(len(kept), -1), list[Tensor]()
    for i, statement in enumerate(kept):
        write_line(lines[i], statement, slots)
        if isinstance(statement, Declare) and statement.name in draft.inner:
            filling[i] = number + len(inner)
            inner.append(draft.inner[statement.name])
    return BlockTokens(draft.rules.size, lines, filling), inner


def _checked(blocks: Sequence[BlockTokens], floating: int) -> Written | str:
    """The program, unless its parts are far from its bbox or nowhere."""
    try:
        program = program_of(tuple(blocks))
        corners = execute(program).corners().reshape(-1, 3)
    except ProgramError:
        return "degenerate numbers"
    size = np.array(program.blocks[0].size)
    aside = (np.abs(corners) - size / 2).max() > ASIDE * size.max()
    return "part outside the program's bbox" if aside else Written(program, floating)
