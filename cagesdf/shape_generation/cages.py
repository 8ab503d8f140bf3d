"""Draws of new cages that stand and whose parts are familiar (§4.4)."""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from cagesdf.cage_generation.familiarity import Familiarity
from cagesdf.cage_generation.generator import Generated, Samples
from cagesdf.cage_generation.trained import TrainedGenerator
from cagesdf.shape_generation.static_stability import stable

ROUNDS = 32  # draws for each cage that is wanted, at most
BATCH = 256  # draws that are made at once, at most
# Why a valid cage is discarded.
FALLS = "falls over or apart"
STRANGE = "a part where no known shape has one"


class CageDraws:
    """Valid cages that stand and are familiar, with the numbers of their draws, `count` of them.

    ROUNDS · `count` draws are made at most. Iterated once: cages are drawn in batches as they are taken, so that none
    is held. Every draw is numbered and counted, in `drawn` and by the reason of its failure in `failures`.
    """

    def __init__(self, trained: TrainedGenerator, rng: np.random.Generator, count: int, temperature: float) -> None:
        self.generator, self.rng, self.count, self.temperature = trained.generator, rng, count, temperature
        self.familiarity = Familiarity.of(trained.cages.values())
        self.drawn = 0
        self.failures: Counter[str] = Counter()

    def __iter__(self) -> Iterator[tuple[int, Generated]]:
        kept, most = 0, ROUNDS * self.count
        while kept < self.count and self.drawn < most:
            batch = min(BATCH, self.count - kept, most - self.drawn)
            samples = self.generator.sample(self.rng, batch, self.temperature)
            first, self.drawn = self.drawn, self.drawn + batch
            self.failures.update(samples.failures)
            for number, item in zip(samples.numbers, samples.kept):
                if not stable(item.cage):
                    self.failures[FALLS] += 1
                elif not self.familiarity.familiar(item.cage):
                    self.failures[STRANGE] += 1
                else:
                    kept += 1
                    yield first + number, item


def draw_cages(trained: TrainedGenerator, rng: np.random.Generator, count: int, temperature: float) -> Samples:
    """All of `CageDraws` at once."""
    draws = CageDraws(trained, rng, count, temperature)
    kept = list(draws)
    failures = dict(sorted(draws.failures.items()))
    return Samples(tuple(item for _, item in kept), tuple(number for number, _ in kept), failures)
