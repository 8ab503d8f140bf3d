"""Rules for the next statement of a program that is being written [Jones et al. 2020, supplement].

A block is written statement by statement and executed as it grows. What these rules rule out never
happens in published programs, or leads to a part that hangs in the air:

- cuboids come first, then attachments, then copies; a block attaches something before it ends;
- what is attached to has a place, since it was attached itself or is the bbox; a cuboid is attached at
  most twice, a squeeze counting as both;
- a squeeze that has to do with the bbox is vertical, one between others has two of them;
- only what has moved is copied, once, and mirrored only in a plane that it isn't centred on;
- no cuboid's length falls below MIN_LENGTH, no corner leaves the bbox by more than OVERHANG.

The official decoder forbids more, such as places in the middle of the bbox's height, which programs
that were fitted to shapes do have.
"""

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from cagesdf.cage_generation.tokens import (
    ATTACH,
    COMMANDS,
    CUBOID,
    END,
    FACE_NAMES,
    MAX_LINES,
    PHASE,
    REFLECT,
    SLOTS,
    SQUEEZE,
    TRANSLATE,
)
from cagesdf.structure.executor import Body, run_statement
from cagesdf.structure.program import BBOX, Attach, Declare, Reflect, Squeeze, Statement, Translate, Triple

MOVES = 2  # of one cuboid
OVERHANG = 0.75  # share of the bbox's longest side that a block's cuboid may stick out by
MIN_LENGTH = 1e-4  # of an executed cuboid, program's unit
OFF_PLANE = 0.01  # share of the bbox's length: nearer to the mirror a centre is on it


class Invalid(Exception):
    """A program that breaks a rule; the message is one of a few, so that failures can be counted."""


class BlockRules:
    """A block that is being written. Slots are as in `tokens`: the bbox is 0."""

    def __init__(self, size: Triple) -> None:
        self.statements: list[Statement] = []
        self.names = [BBOX]  # by slot
        self.phase = 0
        self.size = np.array(size)  # its bbox's lengths
        self._bodies = {BBOX: Body(BBOX, size, True)}
        self._moves = np.zeros(SLOTS, int)
        self._grounded = np.arange(SLOTS) == 0
        self._copied = np.zeros(SLOTS, bool)

    def commands(self) -> Bool[ndarray, " 7"]:
        """Whether each command may come next; at least one may."""
        allowed = np.zeros(len(COMMANDS), bool)
        allowed[CUBOID] = self.phase == PHASE[CUBOID] and len(self.names) < SLOTS
        if len(self.statements) < MAX_LINES:
            for command in (ATTACH, SQUEEZE, REFLECT, TRANSLATE):
                allowed[command] = PHASE[command] >= self.phase and self.operands(command, ()).any()
        allowed[END] = self._grounded[1:].any()
        return allowed

    def operands(self, command: int, chosen: tuple[int, ...]) -> Bool[ndarray, " 11"]:
        """Whether each slot may be the next operand of a command, after those chosen."""
        if command == CUBOID:
            return np.arange(SLOTS) == len(self.names)
        if command in (REFLECT, TRANSLATE):
            able = self._grounded & ~self._copied & (np.arange(SLOTS) > 0)
            if command == REFLECT:
                able &= np.array([able[slot] and bool(self.axes(command, slot).any()) for slot in range(SLOTS)])
            return able
        if not chosen:
            declared = (np.arange(SLOTS) > 0) & (np.arange(SLOTS) < len(self.names))
            return declared & (self._moves < (1 if command == SQUEEZE else MOVES))
        others = [slot for slot in chosen if slot > 0]
        return self._grounded & ~np.isin(np.arange(SLOTS), others)

    def axes(self, command: int, slot: int) -> Bool[ndarray, " 3"]:
        """Whether a cuboid may be copied along each axis."""
        if command == TRANSLATE:
            return np.ones(3, bool)
        return np.abs(np.array(self._bodies[self.names[slot]].centre)) > OFF_PLANE * self.size

    @staticmethod
    def faces(operands: tuple[int, ...]) -> Bool[ndarray, " 6"]:
        """Whether a squeeze may hold its cuboid by each of FACES."""
        upright = [name in ("top", "bot") for name in FACE_NAMES]
        return np.array(upright) if 0 in operands[1:] else np.ones(6, bool)

    def add(self, statement: Statement) -> None:
        """Write a statement and execute it. Raises Invalid if the executed cuboids break a rule."""
        self.statements.append(statement)
        before = set(self._bodies)
        try:
            run_statement(self._bodies, statement)
        except (ZeroDivisionError, OverflowError):
            raise Invalid("degenerate numbers") from None
        touched = {name for name in self._bodies if name not in before}
        match statement:
            case Declare(name):
                self.names.append(name)
                return  # it has no place yet
            case Attach(a):
                self._note_moves(a, 1)
                touched.add(a)
            case Squeeze(a):
                self._note_moves(a, 2)
                touched.add(a)
            case Reflect(a) | Translate(a):
                self._copied[self.names.index(a)] = True
        self.phase = max(self.phase, 1 if isinstance(statement, Attach | Squeeze) else 2)
        for name in touched:
            self._check(self._bodies[name])

    def _note_moves(self, moved: str, times: int) -> None:
        slot = self.names.index(moved)
        self._moves[slot] += times
        self._grounded[slot] = True

    def _check(self, body: Body) -> None:
        size, axes = np.array(body.size, float), np.array(body.axes, float)
        reach = np.abs(np.array(body.centre, float)) + np.abs(axes.T) @ np.abs(size / 2)
        if not np.isfinite(reach).all():
            raise Invalid("degenerate numbers")
        if size.min() < MIN_LENGTH:
            raise Invalid("cuboid shrunk to nothing")
        if (reach - self.size / 2).max() > OVERHANG * self.size.max():
            raise Invalid("cuboid outside its block")

    def attached(self) -> list[int]:
        """Slots of the cuboids that are attached to something; the others would hang in the middle of the block."""
        return [slot for slot in range(1, len(self.names)) if self._grounded[slot]]
