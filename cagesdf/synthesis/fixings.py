"""Fixings of a procedural program's cuboids, whatever their numbers, and the statements for them."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import CORNER_ORDER, Cuboid
from cagesdf.structure.program import AXES, Attach, Reflect, Squeeze, Statement, Translate, Triple

LENGTH_DIGITS = 3  # after the point
PLACE_DIGITS = 2
ROUNDS = 16  # of looking for a point in two cuboids

Target = tuple[str, Cuboid]  # name in the block, and where it is
Targets = Mapping[int | None, Target]  # by place among the block's declared cuboids; None: the bbox


class Fixing(ABC):
    """The attachments that hold a cuboid in its block."""

    @abstractmethod
    def statements(self, name: str, held: Cuboid, targets: Targets) -> list[Statement]:
        """The statements that put the cuboid in its place, `held`."""


@dataclass(frozen=True)
class Touching(Fixing):
    """Attached to a cuboid before it, where they meet."""

    target: int

    def statements(self, name: str, held: Cuboid, targets: Targets) -> list[Statement]:
        """One attach."""
        other, cuboid = targets[self.target]
        meeting = meeting_point(held, cuboid)
        return [Attach(name, other, rounded(place_in(held, meeting)), rounded(place_in(cuboid, meeting)))]


@dataclass(frozen=True)
class Standing(Fixing):
    """Attached to the bbox by the middle of its lower (0) or upper (1) end."""

    end: float

    def statements(self, name: str, held: Cuboid, targets: Targets) -> list[Statement]:
        """One attach."""
        box, frame = targets[None]
        at = np.array([0.5, self.end, 0.5])
        return [Attach(name, box, rounded(at), rounded(place_in(frame, point_in(held, at))))]


@dataclass(frozen=True)
class Through(Fixing):
    """Squeezed between the bbox's floor and its ceiling."""

    def statements(self, name: str, held: Cuboid, targets: Targets) -> list[Statement]:
        """One squeeze."""
        box, frame = targets[None]
        u, _, v = rounded(place_in(frame, held.centre))
        return [Squeeze(name, box, box, "bot", (u, v))]


@dataclass(frozen=True)
class Turned(Fixing):
    """Attached at both ends of an axis."""

    low: Triple  # place of the one end in the cuboid
    high: Triple  # of the other: it differs along the axis alone
    targets: tuple[int | None, int | None]  # what each end is attached to

    def statements(self, name: str, held: Cuboid, targets: Targets) -> list[Statement]:
        """Two attaches."""
        ends = [(at, *targets[target]) for at, target in zip((self.low, self.high), self.targets)]
        return [
            Attach(name, other, at, rounded(place_in(cuboid, point_in(held, np.array(at)))))
            for at, other, cuboid in ends
        ]


@dataclass(frozen=True)
class Copies:
    """Further children of a node that are the same cuboid again, along an axis of the block."""

    children: tuple[int, ...]  # places among the node's children
    axis: int
    mirrored: bool  # there is one, the mirror image; else they follow each other in equal steps

    def statement(self, name: str, original: Cuboid, last: Cuboid, frame: Cuboid) -> Statement:
        """The statement that makes them; `last` is the last of them."""
        if self.mirrored:
            return Reflect(name, AXES[self.axis])
        span = (last.centre - original.centre)[self.axis] / frame.size[self.axis]
        return Translate(name, AXES[self.axis], len(self.children), round(float(span), PLACE_DIGITS))


def _corners(cuboid: Cuboid) -> Float[ndarray, "8 3"]:
    return (CORNER_ORDER * cuboid.size) @ cuboid.axes + cuboid.centre


def lowest(cuboid: Cuboid) -> Float[ndarray, " 3"]:
    """The least x, y and z of a cuboid."""
    return _corners(cuboid).min(axis=0)


def highest(cuboid: Cuboid) -> Float[ndarray, " 3"]:
    """The largest x, y and z of a cuboid."""
    return _corners(cuboid).max(axis=0)


def meeting_point(a: Cuboid, b: Cuboid) -> Float[ndarray, " 3"]:
    """A point in both cuboids, or near both: the middle of their axis-aligned boxes' overlap if it is such a point."""
    point = (np.maximum(lowest(a), lowest(b)) + np.minimum(highest(a), highest(b))) / 2
    for _ in range(ROUNDS):
        point = point_in(a, place_in(a, point_in(b, place_in(b, point))))
    return point


def place_in(cuboid: Cuboid, point: Float[ndarray, " 3"]) -> Float[ndarray, " 3"]:
    """Coordinates of a point in a cuboid, 0 and 1 on its faces; those of the nearest place within."""
    return np.clip(cuboid.axes @ (point - cuboid.centre) / cuboid.size + 0.5, 0, 1)


def point_in(cuboid: Cuboid, place: Float[ndarray, " 3"]) -> Float[ndarray, " 3"]:
    """Undo `place_in`."""
    return ((place - 0.5) * cuboid.size) @ cuboid.axes + cuboid.centre


def beyond(cuboid: Cuboid, point: Float[ndarray, " 3"]) -> float:
    """Largest distance of a point beyond one of a cuboid's faces; negative inside."""
    return float((np.abs(cuboid.axes @ (point - cuboid.centre)) - cuboid.size / 2).max())


def lengths(size: Float[ndarray, " 3"]) -> Triple:
    """A cuboid's lengths as programs have them."""
    x, y, z = (round(float(length), LENGTH_DIGITS) for length in size)
    return x, y, z


def rounded(place: Float[ndarray, " 3"]) -> Triple:
    """A place in a cuboid as programs have it."""
    x, y, z = (round(float(number), PLACE_DIGITS) for number in place)
    return x, y, z
