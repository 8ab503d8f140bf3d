"""Draws of new cages: valid ones that stand and are familiar, in order, all of them counted."""

import numpy as np

from cagesdf.cage_generation.generator import Generated, Generator, Samples, samples_of
from cagesdf.cage_generation.trained import TrainedGenerator
from cagesdf.cuboid import Cage, Cuboid
from cagesdf.shape_generation.cages import BATCH, FALLS, ROUNDS, STRANGE, CageDraws, draw_cages
from cagesdf.shape_generation.static_stability import stable
from tests.support.untrained import untrained

RUN = untrained().run
STRUCTURE, CHAIR = RUN.structures["a"], RUN.sequences["a"].cages[0]


def box(x: float, y: float, width: float, height: float) -> Cuboid:
    return Cuboid(np.array([x, y, 0]), np.eye(3), np.array([width, height, width]))


def known(generator: Generator, *cages: Cage) -> TrainedGenerator:
    """As if it had been trained on these cages, or on a chair: one cage alone makes every other familiar."""
    return TrainedGenerator(generator, {}, {str(number): cage for number, cage in enumerate(cages or [CHAIR])})


class Leaning(Generator):
    """Every second cage has its one leg beside its top's middle."""

    CAGES = tuple(Cage.of({"top": box(0, 0.5, 2, 0.1), "leg": box(x, 0, 0.2, 0.9)}) for x in (0.0, 0.9))

    def sample(self, rng: np.random.Generator, count: int, temperature: float) -> Samples:
        return samples_of([Generated(STRUCTURE, self.CAGES[i % 2]) for i in range(count)])


def test_cages_that_would_fall_over_are_discarded_and_counted() -> None:
    draws = CageDraws(known(Leaning()), np.random.default_rng(0), 5, 1.0)
    kept = [*draws]
    assert len(kept) == 5
    assert all(stable(item.cage) for _, item in kept)
    assert draws.failures == {FALLS: draws.drawn - 5}
    assert [number for number, _ in kept] == sorted({number for number, _ in kept})

    class Fallen(Leaning):
        def sample(self, rng: np.random.Generator, count: int, temperature: float) -> Samples:
            return samples_of([item for item in super().sample(rng, 2, temperature).kept[1:] for _ in range(count)])

    nothing = CageDraws(known(Fallen()), np.random.default_rng(0), 5, 1.0)
    assert [*nothing] == []
    assert nothing.failures == {FALLS: 5 * ROUNDS}


class Tables(Generator):
    """Tables of growing tops; of every second the leg is on top."""

    def sample(self, rng: np.random.Generator, count: int, temperature: float) -> Samples:
        return samples_of([Generated(STRUCTURE, table(1.8 + 0.1 * (i % 4), i % 2 == 1)) for i in range(count)])


def table(width: float, upside_down: bool = False) -> Cage:
    top = box(0, -0.05 if upside_down else 0.95, width, 0.1)
    return Cage.of({"top": top, "leg": box(0, 0.45, 0.2, 0.9)})


def test_cages_with_a_part_where_no_known_shape_has_one_are_discarded_and_counted() -> None:
    assert stable(table(2.0, upside_down=True)), "it isn't discarded for falling over"
    draws = CageDraws(known(Tables(), table(1.9), table(2.0), table(2.2)), np.random.default_rng(0), 5, 1.0)
    kept = [*draws]
    assert len(kept) == 5
    assert all(item.cage.centre[0, 1] > 0.9 for _, item in kept)
    assert draws.failures == {STRANGE: 3}, "two of five draws, one of the next two, none of the last one"
    assert draws.drawn == 8


class Third(Generator):
    """Every third draw is valid, by number; it is told how many are asked for at once."""

    def __init__(self) -> None:
        self.batches: list[int] = []
        self.temperatures: set[float] = set()
        self.kept = Generated(STRUCTURE, CHAIR)

    def sample(self, rng: np.random.Generator, count: int, temperature: float) -> Samples:
        drawn = sum(self.batches)
        self.batches.append(count)
        self.temperatures.add(temperature)
        return samples_of([self.kept if (drawn + i) % 3 == 0 else "bad luck" for i in range(count)])


def test_cages_are_drawn_in_batches_as_they_are_taken_and_numbered_as_if_at_once() -> None:
    generator = Third()
    draws = CageDraws(known(generator), np.random.default_rng(0), 1000, 0.3)
    taken = iter(draws)
    assert [next(taken)[0] for _ in range(3)] == [0, 3, 6]
    assert generator.batches == [BATCH], "no more than were taken"
    assert [number for number, _ in taken] == list(range(9, 3000, 3))
    assert max(generator.batches) == BATCH
    assert generator.temperatures == {0.3}
    assert draws.drawn == sum(generator.batches) == 1000 + draws.failures["bad luck"]
    samples = draw_cages(known(Third()), np.random.default_rng(0), 1000, 1.0)
    assert samples.numbers == tuple(range(0, 3000, 3))
    assert samples.failures == dict(draws.failures)
