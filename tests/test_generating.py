"""Where codes of new shapes come from: each way draws what it says."""

from dataclasses import replace

import numpy as np
import pytest
from untrained import FIGURES, untrained

from cagesdf.cuboid import Cage, Sequence
from cagesdf.generating import Dependent, code_source
from cagesdf.io.runs import Run
from cagesdf.models.latents import LatentTable

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
