"""Fragments that belong together made one part.

Fragments of one component are merged, the cheapest pair of neighbours first, as long as one cuboid around both costs
less than two: the volume that it adds is below the price of a cuboid. Components are parts of their own, unless one is
small beside another whose cuboid it hardly enlarges, as a screw or a knob is; or they are too many.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cage_fitting.boxes import fit_cuboid
from cagesdf.cuboid import Cage, Cuboid
from cagesdf.deformation.matching import CONTACT, gaps
from cagesdf.parts.cutting import MIN_SIZE, SLACK, Fragment, hull_points

SMALL = 0.05  # share of the other's cuboid: a component that may be merged
ENLARGED = 0.02  # share by which it may enlarge that
SPECK = 2e-3  # share of all cuboids: a component that is merged with a neighbour if that costs less than a cuboid
MAX_PARTS = 48  # of a shape


@dataclass(frozen=True, eq=False)
class Group:
    """Fragments with one cuboid."""

    fragments: tuple[Fragment, ...]
    points: Float[ndarray, "v 3"]  # of their convex hulls, canonical
    cuboid: Cuboid  # that bounds them
    volume: float  # of the cuboid

    @staticmethod
    def of(fragments: tuple[Fragment, ...], points: Float[ndarray, "v 3"]) -> "Group":
        """Fragments whose hulls have these points."""
        cuboid = fit_cuboid(points, SLACK, MIN_SIZE)
        return Group(fragments, points, cuboid, float(cuboid.size.prod()))

    def with_(self, other: "Group") -> "Group":
        """Both as one."""
        return Group.of((*self.fragments, *other.fragments), np.concatenate([self.points, other.points]))

    @property
    def components(self) -> set[int]:
        """Numbers of the components that it has fragments of."""
        return {fragment.component for fragment in self.fragments}


def merged(fragments: list[Fragment], price: float) -> list[Group]:
    """Groups of fragments, the largest cuboid first; `price` is the volume that a cuboid must save."""
    pairs = _Pairs([Group.of((fragment,), hull_points(fragment.solid)) for fragment in fragments])

    def pays(a: Group, b: Group, added: float) -> bool:
        return a.components == b.components and added < price

    pairs.merge(pays)
    total = sum(group.volume for group in pairs.groups.values())

    def belongs(a: Group, b: Group, added: float) -> bool:
        small, large = sorted((a.volume, b.volume))
        enlarged = added + small
        return small < SMALL * large and (enlarged < ENLARGED * large or (small < SPECK * total and added < price))

    pairs.merge(belongs)
    pairs.reduce(MAX_PARTS)
    return sorted(pairs.groups.values(), key=lambda group: -group.volume)


class _Pairs:
    """Groups, and what a cuboid around two neighbours adds to the volume of theirs."""

    def __init__(self, groups: list[Group]) -> None:
        self.groups = dict(enumerate(groups))
        self._joined: dict[tuple[int, int], Group] = {}

    def merge(self, wanted: Callable[[Group, Group, float], bool]) -> None:
        """Merge the neighbours whose common cuboid adds least, of those that are wanted, until there are none."""
        while True:
            costs = [(added, pair) for added, pair in self._costs() if wanted(*self._ends(pair), added)]
            if not costs:
                return
            self._join(min(costs)[1])

    def reduce(self, count: int) -> None:
        """Merge the pair that adds least until there are at most `count` groups, neighbours first."""
        while len(self.groups) > count:
            costs = list(self._costs()) or [(added, pair) for added, pair in self._costs(np.inf)]
            self._join(min(costs)[1])

    def _ends(self, pair: tuple[int, int]) -> tuple[Group, Group]:
        return self.groups[pair[0]], self.groups[pair[1]]

    def _costs(self, reach: float = CONTACT) -> Iterator[tuple[float, tuple[int, int]]]:
        keys = list(self.groups)
        near = gaps(Cage.of({str(key): group.cuboid for key, group in self.groups.items()})) <= reach
        for i, j in np.argwhere(np.triu(near, 1)):
            pair = keys[i], keys[j]
            a, b = self._ends(pair)
            if pair not in self._joined:
                self._joined[pair] = a.with_(b)
            yield self._joined[pair].volume - a.volume - b.volume, pair

    def _join(self, pair: tuple[int, int]) -> None:
        self.groups[max(self.groups) + 1] = self._joined[pair]
        for key in pair:
            del self.groups[key]
        self._joined = {ends: group for ends, group in self._joined.items() if not {*ends} & {*pair}}
