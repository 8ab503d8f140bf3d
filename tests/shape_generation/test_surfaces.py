"""Where codes of new shapes come from: each way draws what it says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import softmax

from cagesdf.cage_generation.cage_distance import cage_distances
from cagesdf.cage_generation.generator import Generated, Generator, Samples, samples_of
from cagesdf.cuboid import Cage, Sequence
from cagesdf.io.runs import Run
from cagesdf.models.latents import LatentTable
from cagesdf.shape_generation.surfaces import BATCH, CageDraws, Dependent, code_source, draw_cages, in_order, rest_cages
from tests.support.instant import Instant
from tests.support.untrained import FIGURES, untrained

NAMES = tuple("abcdef")


def scaled(cage: Cage, factor: float) -> Cage:
    return Cage(cage.part_ids, cage.centre * [1, factor, 1], cage.axes, cage.size * [1, factor, 1])


@pytest.fixture
def run() -> Run:
    """Six shapes of different heights, each with a code of its own."""
    known = untrained().run
    cage = known.sequences["a"].cages[0]
    return replace(
        known,
        latents=LatentTable.drawn(
            tuple((name, -1) for name in NAMES), FIGURES["latent_dim"], 3.0, seed=2
        ).requires_grad_(False),
        sequences={
            name: Sequence(name, None, np.zeros(1), (False,), (scaled(cage, 0.5 + 0.1 * i),))
            for i, name in enumerate(NAMES)
        },
        structures=dict.fromkeys(NAMES, known.structures["a"]),
        similarities=dict.fromkeys(NAMES, known.similarities["a"]),
    )


def test_the_likeliest_code_of_a_training_cage_is_its_own(run: Run) -> None:
    source = code_source(run, "dependent", 1e-4)
    for name in NAMES:
        code = source.draw(np.random.default_rng(0), run.sequences[name].cages[0], temperature=0.0)
        np.testing.assert_allclose(code.latent, run.latent(name, 0).numpy(), rtol=1e-6)
        assert code.effective == pytest.approx(1)


def test_weights_fall_with_the_distance_of_cages(run: Run) -> None:
    source = code_source(run, "dependent", 0.05)
    assert isinstance(source, Dependent)
    weights = source.weights(run.sequences["a"].cages[0])[0]
    assert (np.diff(weights) < 0).all()
    assert weights.sum() == pytest.approx(1)


def test_independent_codes_are_those_of_any_shape_whatever_the_cage(run: Run) -> None:
    source, rng = code_source(run, "independent", None), np.random.default_rng(0)
    known = {name: tuple(run.latent(name, 0).numpy().tolist()) for name in NAMES}
    codes = [source.draw(rng, run.sequences["a"].cages[0], temperature=0.0) for _ in range(200)]
    assert {tuple(code.latent.tolist()) for code in codes} == set(known.values())
    assert codes[0].effective == pytest.approx(len(NAMES))


@pytest.mark.parametrize("method", ["independent", "dependent", "isotropic"])
def test_codes_are_the_farther_from_their_middle_the_higher_the_temperature(run: Run, method: str) -> None:
    source = code_source(run, method, 1e-4)  # a dependent code is near that of its cage

    def draw(temperature: float) -> np.ndarray:
        rng = np.random.default_rng(1)
        return np.array([source.draw(rng, rest_cages(run)[0], temperature).latent for _ in range(10)])

    middle, one, two = draw(0.0), draw(1.0), draw(2.0)
    np.testing.assert_allclose(two - middle, 2 * (one - middle), rtol=1e-4, atol=1e-5)
    assert (one - middle).std() > 0.01


def test_a_gaussian_for_all_codes_has_their_mean_in_its_middle(run: Run) -> None:
    source = code_source(run, "isotropic", None)
    code = source.draw(np.random.default_rng(0), rest_cages(run)[0], temperature=0.0)
    np.testing.assert_allclose(code.latent, run.latents.values.numpy().mean(axis=0), rtol=1e-6)


def test_dependent_codes_are_drawn_by_the_likeness_of_their_cages(run: Run) -> None:
    source, cage = code_source(run, "dependent", 0.02), run.sequences["c"].cages[0]
    assert isinstance(source, Dependent)
    weights, uniform = source.weights(cage), source.kde.uniform(1)
    assert weights[0].argmax() == 2
    assert weights[0].max() > 2 * weights[0].min()
    drawn = [source.draw(np.random.default_rng(seed), cage, temperature=0.7) for seed in range(12)]
    by_weights, by_chance = (
        [source.kde.sample(np.random.default_rng(seed), rows, 0.7)[0] for seed in range(12)]
        for rows in (weights, uniform)
    )
    np.testing.assert_allclose([code.latent for code in drawn], by_weights, rtol=1e-5)
    assert not np.allclose(by_weights, by_chance)
    assert drawn[0].effective == pytest.approx(1 / np.square(weights).sum())


def test_tau_is_that_of_the_likeliest_codes_unless_it_is_given(run: Run) -> None:
    free, given = (code_source(run, "dependent", tau) for tau in (None, 0.125))
    assert isinstance(free, Dependent)
    assert isinstance(given, Dependent)
    apart = cage_distances(rest_cages(run), rest_cages(run))
    assert free.tau == free.kde.likeliest_tau(apart)
    assert given.about() == {
        "tau": 0.125,
        "kernels": len(NAMES),
        "effective_at_1": pytest.approx(float(np.median(1 / np.square(softmax(-apart, axis=1)).sum(axis=1)))),
    }


class Third(Generator):
    """Every third draw is valid, by number; it is told how many are asked for at once."""

    def __init__(self) -> None:
        self.batches: list[int] = []
        self.temperatures: set[float] = set()
        known = untrained().run
        self.kept = Generated(known.structures["a"], known.sequences["a"].cages[0])

    def sample(self, rng: np.random.Generator, count: int, temperature: float) -> Samples:
        drawn = sum(self.batches)
        self.batches.append(count)
        self.temperatures.add(temperature)
        return samples_of([self.kept if (drawn + i) % 3 == 0 else "bad luck" for i in range(count)])


def test_cages_are_drawn_in_batches_as_they_are_taken_and_numbered_as_if_at_once() -> None:
    generator = Third()
    draws = CageDraws(generator, np.random.default_rng(0), 1000, 0.3)
    taken = iter(draws)
    assert [next(taken)[0] for _ in range(3)] == [0, 3, 6]
    assert generator.batches == [BATCH], "no more than were taken"
    assert [number for number, _ in taken] == list(range(9, 3000, 3))
    assert max(generator.batches) == BATCH
    assert generator.temperatures == {0.3}
    assert draws.drawn == sum(generator.batches) == 1000 + draws.failures["bad luck"]
    samples = draw_cages(Third(), np.random.default_rng(0), 1000, 1.0)
    assert samples.numbers == tuple(range(0, 3000, 3))
    assert samples.failures == dict(draws.failures)


def test_shapes_are_made_a_few_ahead_of_those_taken_and_come_in_order() -> None:
    made: list[int] = []

    def make(number: int) -> int:
        made.append(number)
        return -number

    for ahead in (0, 1, 5):
        made.clear()
        for taken, number in enumerate(in_order(Instant(), make, iter(range(20)), ahead)):
            assert number == -taken
            assert len(made) == min(taken + 1 + ahead, 20)
    assert list(in_order(Instant(), make, [], 5)) == []


def test_a_shape_that_fails_ends_the_others() -> None:
    def make(number: int) -> int:
        if number == 3:
            raise ValueError("three")
        return number

    shapes = in_order(Instant(), make, range(100), 2)
    assert [next(shapes) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="three"):
        next(shapes)
    assert list(shapes) == []
