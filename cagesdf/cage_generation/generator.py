"""The interface of all generators of cages."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cagesdf.cuboid import Cage
from cagesdf.structure.base import Structure


@dataclass(frozen=True, eq=False)
class Generated:
    """One new shape before it has a surface."""

    structure: Structure
    cage: Cage  # canonical: centred, its farthest corner as far out as the training cages' is in the median
    floating: int = 0  # cuboids of it that were attached to nothing and left out


@dataclass(frozen=True)
class Samples:
    """The results of a number of draws."""

    kept: tuple[Generated, ...]  # the valid ones, in the order of their draws
    numbers: tuple[int, ...]  # their draws' numbers, from 0
    failures: Mapping[str, int]  # how many draws were discarded, by reason


class Generator(ABC):
    """Draws structures with cages."""

    @abstractmethod
    def sample(self, rng: np.random.Generator, count: int, temperature: float) -> Samples:
        """Draw `count` times; invalid draws are discarded, not repeated.

        `temperature` scales the normal numbers that a draw is made from; 0 gives the mean.
        """


def samples_of(drawn: Sequence[Generated | str]) -> Samples:
    """Samples of numbered draws; failed ones are counted by their reason."""
    kept = {number: item for number, item in enumerate(drawn) if isinstance(item, Generated)}
    failures = Counter(item for item in drawn if isinstance(item, str))
    return Samples(tuple(kept.values()), tuple(kept), dict(sorted(failures.items())))
