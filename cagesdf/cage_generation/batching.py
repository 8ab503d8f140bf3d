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

from cagesdf.cage_generation.tokens import COMMAND, COMMANDS, CUBOID, END, START, WIDTH, BlockTokens, ProgramTokens


@dataclass(frozen=True, eq=False)
class Level:
    """The blocks of one depth, longest first; each has a line more than statements."""

    lines: Float[Tensor, "n 63"]  # START, then its statements: what the network is given
    running: tuple[int, ...]  # how many blocks have a line of each number
    last: Int[Tensor, " b"]  # number of each block's last line
    size: Float[Tensor, "b 3"]  # of their bboxes
    shape: Int[Tensor, " b"]  # number of the program
    block: Int[Tensor, " n"]  # of each line: number of its block in this level
    outer: Int[Tensor, " o"]  # line of the level above after which the cuboid that each block fills is written
    outer_given: Int[Tensor, " o"]  # line of the level above that is given that cuboid; both empty in the first level
    depth: int


@dataclass(frozen=True, eq=False)
class Batch:
    """Programs to learn from. Targets, one for each given line, are the lines of all levels, level after level."""

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
        # Program, block, and where the cuboid that it fills is declared: line, and rank of that line's block.
        waiting = [(shape, 0, (0, 0)) for shape in range(len(programs))]
        starts = np.zeros(2, int)
        while waiting:
            waiting.sort(key=lambda entry: -len(programs[entry[0]][entry[1]].lines))
            blocks = [programs[shape][number] for shape, number, _ in waiting]
            line, rank = np.array([place for _, _, place in waiting]).T[:, : len(waiting) if levels else 0]
            outer, outer_given = starts[line] + rank, starts[line + 1] + rank
            given, targets, leaf = (np.concatenate(values) for values in zip(*map(_columns, blocks)))

            lengths = np.array([len(block.lines) + 1 for block in blocks])
            ranks = np.repeat(np.arange(len(blocks)), lengths)
            numbers = np.concatenate([np.arange(length) for length in lengths])
            order = np.lexsort((ranks, numbers))
            running = np.bincount(numbers)
            starts = np.cumsum(running) - running
            last = starts[lengths - 1] + np.arange(len(blocks))

            shape, block = torch.tensor([shape for shape, _, _ in waiting]), torch.from_numpy(ranks[order])
            size = torch.from_numpy(np.array([block.size for block in blocks])).float()
            declared = torch.tensor([int(block.lines[:, CUBOID].sum()) for block in blocks])
            levels.append(
                Level(
                    torch.from_numpy(given[order]).float(),
                    tuple(running.tolist()),
                    torch.from_numpy(last),
                    size,
                    shape,
                    block,
                    torch.from_numpy(outer),
                    torch.from_numpy(outer_given),
                    len(levels),
                )
            )
            written, leaves = (torch.from_numpy(values[order]).float() for values in (targets, leaf))
            parts.append((written, shape[block], size[block], leaves, declared[block]))
            waiting = [
                (shape, int(child), (line, rank))
                for rank, (shape, number, _) in enumerate(waiting)
                for line, child in enumerate(programs[shape][number].filling)
                if child >= 0
            ]
        all_targets, all_shape, all_size, all_leaf, all_declared = (torch.cat(values) for values in zip(*parts))
        command = all_targets[:, COMMAND].argmax(dim=1)
        rows = tuple(torch.nonzero(command == number)[:, 0] for number in range(len(COMMANDS)))
        return Batch(tuple(levels), len(programs), all_targets, all_shape, all_size, all_leaf, all_declared, rows)


def _columns(block: BlockTokens) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Input lines of a block, the target line after each of them, and whether the target declares a leaf."""
    start, end = np.zeros((2, 1, WIDTH))
    start[0, START] = end[0, END] = 1
    leaf = np.append(block.filling < 0, True)
    return np.concatenate([start, block.lines]), np.concatenate([block.lines, end]), leaf.astype(float)
