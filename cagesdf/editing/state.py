"""A shape that is being edited, and its earlier states."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.structure.base import Structure


@dataclass(frozen=True, eq=False)
class PartStyle:
    """A step of one part's code towards the code of another shape's part."""

    latent: Float32[ndarray, " d"]  # of the other shape
    cage: Cage | None  # canonical, that the code is made from; None: the edited shape's own, `State.seen`
    part: str  # of that cage
    weight: float  # 0: the code stays, 1: it becomes the other's


@dataclass(frozen=True, eq=False)
class State:
    """All that a surface follows from but the network."""

    cage: Cage  # canonical
    # That part codes are made from, canonical: cuboids move, come and go, and what isn't touched stays as it is.
    seen: Cage
    structure: Structure  # canonical; the cage follows from its program, if it has one, where nothing was moved by hand
    latent: Float32[ndarray, " d"]
    similarity: Similarity  # raw → canonical: raw is the frame that operations speak of
    stretch: Float[ndarray, " 3"]  # of the whole since it was opened, along the canonical axes
    # By id, for parts with a style of their own: steps from the code that latent and `seen` give, in order.
    part_styles: Mapping[str, tuple[PartStyle, ...]] = field(default_factory=dict)
    # By id, for parts whose details keep their size: lengths of the cuboid in which they have it, canonical. There the
    # network is evaluated, and the surface is resized to the part's own cuboid.
    kept: Mapping[str, Float[ndarray, " 3"]] = field(default_factory=dict)
    # By id of parts of `seen`: residuals that are added to their codes, as `cagesdf fit` gives them.
    residuals: Mapping[str, Float32[ndarray, " k"]] = field(default_factory=dict)
    # By id, for parts that came after `seen`: the part of it whose code they have.
    like: Mapping[str, str] = field(default_factory=dict)

    @staticmethod
    def opened(cage: Cage, structure: Structure, latent: Float32[ndarray, " d"], similarity: Similarity) -> "State":
        """A shape that nothing was done to."""
        return State(cage, cage, structure, latent, similarity, np.ones(3))

    def seen_as(self, part: str) -> str:
        """The part of `seen` whose code a part has."""
        return self.like.get(part, part)

    def seen_by_part(self) -> Cage:
        """The cuboids of `seen` whose codes the parts have."""
        return Cage.of({part: self.seen[self.seen_as(part)] for part in self.cage.part_ids})

    def evaluated(self) -> Cage:
        """The cuboids that the network is evaluated in."""
        if not self.kept:
            return self.cage
        size = [self.kept.get(part, lengths) for part, lengths in zip(self.cage.part_ids, self.cage.size)]
        return replace(self.cage, size=np.array(size))

    def evaluated_in(self, lengths: Mapping[str, Float[ndarray, " 3"]]) -> "State":
        """The state whose details keep the size that they have in cuboids of these lengths, by id."""
        sizes = dict(zip(self.cage.part_ids, self.cage.size))
        return replace(self, kept={part: kept for part, kept in lengths.items() if (kept != sizes[part]).any()})

    def with_cage(self, cage: Cage) -> "State":
        """The same parts in other cuboids."""
        return replace(self, cage=cage)

    def direction(self, axis: str) -> Float[ndarray, " 3"]:
        """A user's axis, "x", "y" or "z", in the canonical frame; a unit vector."""
        return self.similarity.rotation[:, "xyz".index(axis)]

    def own_axis(self, axis: str) -> tuple[int, float]:
        """Which of a cuboid's axes is named after a user's axis, and 1 or -1: which way along it."""
        direction = self.direction(axis)
        row = int(np.abs(direction).argmax())
        return row, float(np.sign(direction[row]))


@dataclass(frozen=True, eq=False)
class History:
    """States in the order in which they came about."""

    past: tuple[State, ...]  # oldest first
    present: State
    future: tuple[State, ...]  # that were taken back, the next one first

    @staticmethod
    def of(state: State) -> "History":
        """A history that begins."""
        return History((), state, ())

    def then(self, state: State) -> "History":
        """Go on; what was taken back is forgotten."""
        return History((*self.past, self.present), state, ())

    def undone(self) -> "History":
        """One state back. Raises InputError at the beginning."""
        if not self.past:
            raise InputError("there is nothing to take back")
        return History(self.past[:-1], self.past[-1], (self.present, *self.future))

    def redone(self) -> "History":
        """One state forth. Raises InputError if nothing was taken back."""
        if not self.future:
            raise InputError("nothing was taken back that could be done again")
        return History((*self.past, self.present), self.future[0], self.future[1:])
