"""Many programs at once: the blocks of one depth are read and written together, whatever shapes they belong to.

Lines are packed: the first lines of all blocks, longest block first, then the second lines of those that
have one, and so on.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from cagesdf.generation.tokens import COMMAND, COMMANDS, END, START, WIDTH, BlockTokens, ProgramTokens


@dataclass(frozen=True, eq=False)
class Level:
    """The blocks of one depth, longest first; each has a line more than statements."""

    lines: Float[Tensor, "n 63"]  # START, then its statements: what the network is given
    running: tuple[int, ...]  # how many blocks have a line of each number
    last: Int[Tensor, " b"]  # each block's last line
    size: Float[Tensor, "b 3"]  # of their bboxes
    shape: Int[Tensor, " b"]  # number of the program
    block: Int[Tensor, " n"]  # of each line: number of its block in this level
    outer: Int[Tensor, " o"]  # line of the level above after which the cuboid that each block fills is written
    outer_given: Int[Tensor, " o"]  # line of the level above that is given that cuboid; both empty in the first level
    depth: int


@dataclass(frozen=True, eq=False)
class Batch:
    """Programs to learn from. The lines of all levels, one level after another, are what follows each given line."""

    levels: tuple[Level, ...]
    count: int  # of programs
    targets: Float[Tensor, "m 63"]  # a statement or END
    shape: Int[Tensor, " m"]  # number of each line's program
    size: Float[Tensor, "m 3"]  # of its block's bbox
    leaf: Float[Tensor, " m"]  # 1 where nothing fills the cuboid that the line declares
    declared: Int[Tensor, " m"]  # how many cuboids its block declares
    rows: tuple[Tensor, ...]  # Int[Tensor, " k"] each: of the targets, by command

    @staticmethod
    def of(programs: Sequence[ProgramTokens]) -> "Batch":
        """All of them in one batch, float32. At least one program."""
        levels: list[Level] = []
        parts: list[tuple[Tensor, Tensor, Tensor, Tensor, Tensor]] = []
        # Program, block, and where its cuboid is declared: block of the level above, line.
        waiting = [(shape, 0, (-1, -1)) for shape in range(len(programs))]
        above = np.zeros(0, int)
        while waiting:
            waiting.sort(key=lambda entry: -len(programs[entry[0]][entry[1]].lines))
            blocks = [programs[shape][block] for shape, block, _ in waiting]
            shapes = torch.tensor([shape for shape, _, _ in waiting])
            outer = np.array([place for _, _, place in waiting]) if levels else np.zeros((0, 2), int)
            starts, running, order = _packing(blocks)
            given, targets, leaf = (
                torch.from_numpy(np.concatenate(values)[order]).float() for values in zip(*map(_columns, blocks))
            )
            block = torch.from_numpy(np.repeat(np.arange(len(blocks)), [len(b.lines) + 1 for b in blocks])[order])
            size = torch.from_numpy(np.array([b.size for b in blocks])).float()
            declared = torch.tensor([int(b.lines[:, COMMAND.start + 1].sum()) for b in blocks])
            lines_above = torch.from_numpy(above[outer[:, 1]] + outer[:, 0])
            given_above = torch.from_numpy(above[outer[:, 1] + 1] + outer[:, 0]) if levels else lines_above
            last = torch.from_numpy(starts[[len(b.lines) for b in blocks]] + np.arange(len(blocks)))
            level = Level(
                given, tuple(running.tolist()), last, size, shapes, block, lines_above, given_above, len(levels)
            )
            parts.append((targets, shapes[block], size[block], leaf, declared[block]))
            levels.append(level)
            above = starts
            waiting = [
                (shape, int(child), (rank, line))
                for rank, (shape, number, _) in enumerate(waiting)
                for line, child in enumerate(programs[shape][number].filling)
                if child >= 0
            ]
        targets, shape, size, leaf, declared = (torch.cat(values) for values in zip(*parts))
        command = targets[:, COMMAND].argmax(dim=1)
        rows = tuple(torch.nonzero(command == number)[:, 0] for number in range(len(COMMANDS)))
        return Batch(tuple(levels), len(programs), targets, shape, size, leaf, declared, rows)


def _packing(blocks: Sequence[BlockTokens]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where lines of each number start, how many there are, and which line of all blocks in turn each is."""
    lengths = np.array([len(block.lines) + 1 for block in blocks])
    first = np.cumsum(lengths) - lengths
    number = np.arange(lengths[0])
    running = (lengths[:, None] > number).sum(axis=0)
    order = (first[:, None] + number)[lengths[:, None] > number].reshape(-1)
    packed = np.lexsort((np.repeat(np.arange(len(blocks)), lengths), np.concatenate([np.arange(n) for n in lengths])))
    return np.cumsum(running) - running, running, order[packed]


def _columns(block: BlockTokens) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the network is given, what it is to write after each of it, and whether that declares a leaf."""
    start, end = np.zeros((2, 1, WIDTH))
    start[0, START] = end[0, END] = 1
    leaf = np.append(block.filling < 0, True)
    return np.concatenate([start, block.lines]), np.concatenate([block.lines, end]), leaf.astype(float)
