"""Where codes of new shapes come from: each method draws what it says; and their surfaces."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import softmax

from cagesdf.cage_generation.cage_distance import cage_distances
from cagesdf.cage_generation.generator import Generated
from cagesdf.cuboid import Cage, Cuboid, Sequence
from cagesdf.extraction import LOOSE, extract, field_of
from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import LatentTable
from cagesdf.run import Run
from cagesdf.shape_generation.static_stability import stable
from cagesdf.shape_generation.surfaces import (
    ByPart,
    Code,
    CodeSource,
    Dependent,
    Extracting,
    Order,
    code_source,
    in_order,
    make_shape,
    methods_of,
    rest_cages,
    usual_method,
)
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


@pytest.mark.parametrize("method", ["independent", "dependent", "by_part", "isotropic"])
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


def box(x: float, y: float, width: float, height: float) -> Cuboid:
    return Cuboid(np.array([x, y, 0.0]), np.eye(3), np.array([width, height, 0.5]))


BODY, LID = box(0, -0.25, 0.6, 1.0), box(0, 0.4, 0.4, 0.3)
LEFT, RIGHT = box(-0.5, 0, 0.1, 0.4), box(0.5, 0, 0.1, 0.4)
POTS = {
    "a": {"body": BODY},
    "b": {"body": BODY, "left": LEFT, "right": RIGHT},
    "c": {"body": BODY, "left": LEFT, "right": RIGHT},
    "d": {"body": BODY, "lid": LID},
}


@pytest.fixture
def pots(run: Run) -> Run:
    """Four pots, two with handles, one with a lid."""
    sequences = {name: Sequence(name, None, np.zeros(1), (False,), (Cage.of(parts),)) for name, parts in POTS.items()}
    return replace(run, sequences=sequences)


def names_of(run: Run, code: Code, part: str) -> str:
    """The training shape whose code a part has."""
    latent = code.part_latents.get(part, code.latent)
    [name] = [name for name in run.sequences if np.allclose(run.latent(name, 0).numpy(), latent, rtol=1e-6)]
    return name


def drawn_often(source: CodeSource, cage: Cage) -> list[Code]:
    return [source.draw(np.random.default_rng(seed), cage, temperature=0.0) for seed in range(60)]


def test_by_part_codes_are_of_shapes_that_have_parts_like_the_new_ones(pots: Run) -> None:
    source = code_source(pots, "by_part", 10.0)  # the likeness of cages says nothing
    assert isinstance(source, ByPart)
    codes = drawn_often(source, Cage.of({"x": LEFT, "y": BODY, "z": RIGHT}))
    assert {names_of(pots, code, part) for code in codes for part in "xyz"} == {"b", "c"}
    assert not any(code.part_latents for code in codes), "one shape has them all"
    assert codes[0].effective == pytest.approx(2, rel=0.01)
    # Beside handles a body is narrower than the whole.
    assert {names_of(pots, code, "x") for code in drawn_often(source, Cage.of({"x": BODY}))} == {"a", "d"}


def test_parts_that_no_shape_has_together_have_codes_of_several(pots: Run) -> None:
    source, cage = code_source(pots, "by_part", 10.0), Cage.of({"lid": LID, "x": LEFT, "y": BODY, "z": RIGHT})
    codes = drawn_often(source, cage)
    assert {names_of(pots, code, part) for code in codes for part in "xyz"} == {"b", "c"}
    assert {names_of(pots, code, "lid") for code in codes} == {"d"}
    assert all(code.part_latents.keys() == {"lid"} for code in codes)


def test_a_part_that_no_shape_has_gets_the_code_of_the_shape_with_the_nearest(pots: Run) -> None:
    handle = box(0.2, -0.2, 0.05, 1.5)  # through the body, twice as high as a handle
    source = code_source(pots, "by_part", 10.0)
    codes = drawn_often(source, Cage.of({"body": BODY, "left": LEFT, "right": RIGHT, "odd": handle}))
    assert {names_of(pots, code, "left") for code in codes} == {"b", "c"}
    assert {names_of(pots, code, "odd") for code in codes} <= {*POTS}


def test_by_part_codes_of_a_training_cage_are_those_of_its_own_shape(run: Run) -> None:
    source = code_source(run, "by_part", 1e-4)
    for name in NAMES:
        code = source.draw(np.random.default_rng(0), run.sequences[name].cages[0], temperature=0.0)
        np.testing.assert_allclose(code.latent, run.latent(name, 0).numpy(), rtol=1e-6)
        assert not code.part_latents


def test_only_parts_with_codes_of_their_own_are_drawn_by_part(run: Run) -> None:
    assert methods_of(run) == ("independent", "dependent", "by_part")
    whole = replace(run, decoder=make_decoder("CageDecoder", **FIGURES, seed=1).eval())
    assert methods_of(whole) == ("independent", "dependent")
    assert (usual_method(run), usual_method(whole)) == ("by_part", "dependent")


def test_each_part_s_surface_is_that_of_its_own_code_in_the_whole_cage(run: Run) -> None:
    known = untrained().run
    cage = known.sequences["a"].cages[0]
    one, two = (known.latent(name, 0) for name in ("a", "b"))
    code = Code(one.numpy(), 1.0, {cage.part_ids[0]: two.numpy()})
    how = Extracting(24, LOOSE["keep"], 10, stable)
    order = Order("by_part", "0", 0, 0, Generated(known.structures["a"], cage), code)
    shape = make_shape(known, how, np.random.default_rng(0), order)
    wholes = [extract(field_of(known.decoder, latent, cage), 24).parts for latent in (one, two)]
    for number, part in enumerate(cage.part_ids):
        np.testing.assert_array_equal(shape.parts[part].vertices, wholes[number == 0][part].vertices)
    assert len(shape.parts[cage.part_ids[0]].vertices) != len(wholes[0][cage.part_ids[0]].vertices)


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
