"""Parts that mirror or repeat each other, and what a change of one means for the other.

A change is a function from cuboid to cuboid, so its mirrored counterpart is: mirror, change, mirror back; that of a
part which repeats another is: go there, change, come back.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation as Turn

from cagesdf.cuboid import PROPER_PERMUTATIONS, Cage, Cuboid
from cagesdf.editing.state import State
from cagesdf.structure.base import Structure
from cagesdf.structure.relations import Reflection, Relation, Rotation, Translation

Change = Callable[[Cuboid], Cuboid]

# The improper signed permutations: they name a mirrored cuboid's axes so that these are right-handed again.
IMPROPER = -PROPER_PERMUTATIONS

ALIKE = 0.02  # of their size: two cuboids with corners no further apart, once one is moved onto the other, are alike


@runtime_checkable
class Link(Protocol):
    """How a part is made of another one."""

    def __call__(self, point: Float[ndarray, " 3"]) -> Float[ndarray, " 3"]:
        """Where a point of the one is on the other."""

    def carried(self, change: Change, axes: Float[ndarray, "3 3"]) -> Change:
        """The equivalent change for the linked cuboid; `axes` are those of the cuboid that changes."""


# By part, those that follow it, and how they are made of it.
Links = dict[str, dict[str, Link]]


@dataclass(frozen=True, eq=False)
class Mirror:
    """A plane."""

    point: Float[ndarray, " 3"]  # on it, canonical
    normal: Float[ndarray, " 3"]  # unit, canonical

    def __call__(self, point: Float[ndarray, " 3"]) -> Float[ndarray, " 3"]:
        """The mirror image of a point."""
        return point - 2 * ((point - self.point) @ self.normal) * self.normal

    def inverse(self) -> "Mirror":
        """The mirror itself."""
        return self

    def carried(self, change: Change, axes: Float[ndarray, "3 3"]) -> Change:
        """The equivalent change for the mirrored cuboid; `axes` are those of the cuboid that changes."""
        flip = np.eye(3) - 2 * np.outer(self.normal, self.normal)

        def other(cuboid: Cuboid) -> Cuboid:
            flipped = cuboid.axes @ flip
            naming = IMPROPER[int(np.einsum("kij,jl,il->k", IMPROPER, flipped, axes).argmax())]
            image = Cuboid(self(cuboid.centre), naming @ flipped, np.abs(naming) @ cuboid.size)
            changed = change(image)
            return Cuboid(self(changed.centre), naming.T @ changed.axes @ flip, np.abs(naming.T) @ changed.size)

        return other


@dataclass(frozen=True, eq=False)
class Motion:
    """A rigid motion."""

    rotation: Float[ndarray, "3 3"]
    offset: Float[ndarray, " 3"]  # canonical units

    def __call__(self, point: Float[ndarray, " 3"]) -> Float[ndarray, " 3"]:
        """Where it takes a point."""
        return self.rotation @ point + self.offset

    def inverse(self) -> "Motion":
        """The motion back."""
        return Motion(self.rotation.T, -self.rotation.T @ self.offset)

    def moved(self, cuboid: Cuboid) -> Cuboid:
        """Where it takes a cuboid."""
        return Cuboid(self(cuboid.centre), cuboid.axes @ self.rotation.T, cuboid.size)

    def carried(self, change: Change, axes: Float[ndarray, "3 3"]) -> Change:
        """The equivalent change for the moved cuboid; `axes` move with it."""
        back = self.inverse()
        return lambda cuboid: self.moved(change(back.moved(cuboid)))


def mirrors(state: State) -> Links:
    """By part, the parts that mirror it according to the structure, and in which plane."""
    links: Links = {part: {} for part in state.cage.part_ids}
    for a, b, link in _pairs(state):
        if isinstance(link, Mirror):
            links[a][b] = links[b][a] = link
    return links


def repeats(state: State) -> Links:
    """By part, those that are the same part moved or turned to another place, and which motion leads there."""
    links: Links = {part: {} for part in state.cage.part_ids}
    for a, b, link in _pairs(state):
        if isinstance(link, Motion):
            links[a][b], links[b][a] = link, link.inverse()
    return links


def followed(state: State, mirror: bool, repeat: bool) -> list[Links]:
    """The links along which other parts follow."""
    return [kind(state) for kind, follow in ((mirrors, mirror), (repeats, repeat)) if follow]


def link_of(relation: Relation, state: State) -> Link | None:
    """How its part b is made of its part a, the state being stretched; None where it says nothing of that."""
    match relation:
        case Reflection(point=point, normal=normal):
            across = np.array(normal) / state.stretch
            length = np.linalg.norm(across)
            # Files may name no direction at all, which is no plane.
            return Mirror(np.array(point) * state.stretch, across / length) if length > 0 else None
        case Translation(offset=offset):
            return Motion(np.eye(3), np.array(offset) * state.stretch)
        case Rotation(pivot=pivot, axis=axis, angle=angle):
            turn = Turn.from_rotvec(angle * np.array(axis)).as_matrix()
            centre = np.array(pivot) * state.stretch
            return Motion(turn, centre - turn @ centre)
    return None


def part_relations(state: State) -> tuple[Relation, ...]:
    """The structure's relations, as relations between parts.

    One between nodes pairs the parts below them: each with the one that is nearest to its image. Groups that touch say
    nothing of which of their parts do.
    """
    relations: list[Relation] = []
    for relation in state.structure.relations():
        ours, theirs = (_leaves(state.structure, node) for node in (relation.a, relation.b))
        link = link_of(relation, state)
        if link is not None:
            relations += [replace(relation, a=a, b=b) for a, b in _nearest(state.cage, ours, theirs, link)]
        elif (relation.a, relation.b) == (ours[0], theirs[0]):
            relations.append(relation)
    return tuple(relations)


def _pairs(state: State) -> Iterator[tuple[str, str, Link]]:
    for relation in part_relations(state):
        link = link_of(relation, state)
        if link is not None:
            yield relation.a, relation.b, link


def alike(state: State) -> Links:
    """By part, those of its label whose cuboids in `State.seen_by_part` are the same, moved or mirrored.

    Structures don't say it of a chair's front and back legs. Parts that mirror each other are left out.
    """
    labels, cage, related = state.structure.labels(), state.seen_by_part(), mirrors(state)
    links: Links = {part: {} for part in cage.part_ids}
    for a, b in combinations(cage.part_ids, 2):
        if labels[a] and labels[a] == labels[b] and b not in related[a]:
            link = _onto(cage[a], cage[b])
            if link is not None:
                links[a][b], links[b][a] = link, link.inverse()
    return links


def _onto(a: Cuboid, b: Cuboid) -> Mirror | Motion | None:
    """The translation, or the mirror between them, that takes a cuboid onto another one; None where neither does."""
    translation = b.centre - a.centre
    distance = float(np.linalg.norm(translation))
    if not distance > ALIKE * a.size.max():
        return None
    mirror = Mirror((a.centre + b.centre) / 2, translation / distance)
    corners, others = (Cage.of({"": cuboid}).corners()[0] for cuboid in (a, b))
    for link in (Motion(np.eye(3), translation), mirror):
        images = np.array([link(corner) for corner in corners])
        if np.linalg.norm(images[:, None] - others, axis=2).min(axis=1).max() <= ALIKE * a.size.max():
            return link
    return None


def locked(state: State, changes: Mapping[str, Change], links: Sequence[Links]) -> dict[str, Change]:
    """The changes of some parts, and what they mean for those linked with them, directly or through others."""
    every = dict(changes)
    waiting = deque(changes)
    while waiting:
        part = waiting.popleft()
        for other, link in [pair for group in links for pair in group[part].items()]:
            if other not in every:
                every[other] = link.carried(every[part], state.cage[part].axes)
                waiting.append(other)
    return every


def linked(parts: Iterable[str], links: Sequence[Links]) -> tuple[str, ...]:
    """Some parts, and all that are linked with them, directly or through others."""
    every = list(dict.fromkeys(parts))
    for part in every:  # grows on the way
        for other in [other for kind in links for other in kind[part]]:
            if other not in every:
                every.append(other)
    return tuple(every)


def _leaves(structure: Structure, node: str) -> list[str]:
    children = structure.children(node)
    return [leaf for child in children for leaf in _leaves(structure, child)] if children else [node]


def _nearest(cage: Cage, ours: list[str], theirs: list[str], link: Link) -> list[tuple[str, str]]:
    """Pairs of parts, so that the images are near."""
    images = np.array([link(cage[part].centre) for part in ours])
    centres = np.array([cage[part].centre for part in theirs])
    rows, columns = linear_sum_assignment(np.linalg.norm(images[:, None] - centres, axis=2))
    return [(ours[i], theirs[j]) for i, j in zip(rows, columns)]
