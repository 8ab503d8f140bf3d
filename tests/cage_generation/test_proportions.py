"""New proportions: linear relations hold, the mean is the mean, and what comes apart is discarded."""

from dataclasses import replace

import numpy as np
import pytest

from cagesdf.cage_generation.proportions import Family, ProportionGenerator, families
from cagesdf.cuboid import Cage
from cagesdf.deformation.matching import touching
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.structure.relations import Reflection
from tests.support.generators import jar, jars


def generator(count: int = 6) -> ProportionGenerator:
    return ProportionGenerator(families(*jars(count)), 1.1)


def test_every_draw_keeps_the_mirror_the_contacts_and_the_tree() -> None:
    samples = generator().sample(np.random.default_rng(0), 60, 1.0)
    assert len(samples.kept) + sum(samples.failures.values()) == 60
    assert len(samples.kept) >= 54
    for item in samples.kept:
        cage = item.cage
        left, right = cage["left"], cage["right"]
        assert np.allclose(left.centre * [-1, 1, 1], right.centre)
        assert np.allclose(left.size, right.size)
        flip = np.diag([-1.0, 1, 1])
        assert np.allclose(np.abs(left.axes @ flip @ right.axes.T), np.eye(3), atol=1e-7)
        assert np.allclose(cage.axes @ cage.axes.transpose(0, 2, 1), np.eye(3))
        body = cage.part_ids.index("body")
        assert touching(cage)[body].sum() == 2
        assert item.structure.signature() == jar(0)[0].signature()
        (relation,) = item.structure.relations()
        assert isinstance(relation, Reflection)
        assert np.allclose(relation.point[0], 0)
        assert np.allclose(np.abs(relation.normal), [1, 0, 0])
        assert np.allclose(item.structure.cage()["body"].centre, cage["body"].centre)


def test_all_draws_of_temperature_0_are_the_mean_and_higher_ones_differ() -> None:
    def draw(seed: int, temperature: float) -> list[np.ndarray]:
        return [item.cage.vectors() for item in generator().sample(np.random.default_rng(seed), 4, temperature).kept]

    assert all(np.array_equal(cage, draw(0, 0.0)[0]) for cage in draw(0, 0.0) + draw(1, 0.0))
    assert np.array_equal(draw(2, 1.0), draw(2, 1.0))
    assert not np.allclose(draw(2, 1.0)[0], draw(2, 1.0)[1])
    structures, cages = jars(6)
    widths = [cage["body"].size for cage in cages.values()]
    (family,) = families(structures, cages)
    mean = family.combined(np.full(6, 1 / 6))
    assert np.allclose(mean["body"].size, np.mean(widths, axis=0))


def test_draws_of_temperature_1_have_the_covariance_of_the_shapes() -> None:
    (family,) = families(*jars(6))
    rng = np.random.default_rng(0)
    spreads = [np.eye(1)] * 0
    for _ in range(4000):
        normal = rng.standard_normal(6)
        weights = 1 / 6 + (normal - normal.mean()) / np.sqrt(5)
        spreads.append(weights @ family.cuboids[:, 0, 12:15])
    drawn, shapes = np.array(spreads), family.cuboids[:, 0, 12:15]
    assert np.allclose(drawn.mean(axis=0), shapes.mean(axis=0), atol=0.01)
    assert np.allclose(np.cov(drawn.T), np.cov(shapes.T), atol=0.15 * np.cov(shapes.T).max())


def test_a_weight_of_1_gives_the_shape_itself_with_its_parts_in_the_familys_order() -> None:
    structures, cages = jars(4)
    (family,) = families(structures, cages)
    for i, name in enumerate(sorted(structures)):
        cage = family.combined(np.eye(4)[i])
        for part in ("body", "left", "right"):
            assert np.allclose(cage[part].centre, cages[name][part].centre)
            assert np.allclose(cage[part].axes, cages[name][part].axes)


def test_shapes_of_another_structure_are_another_family_and_the_largest_comes_first() -> None:
    structures, cages = jars(3)
    alone = PartHierarchy.flat(("body",), ("body",), "bowl")
    structures["bowl"], cages["bowl"] = alone, Cage.of({"body": cages["jar0"]["body"]})
    first, second = families(structures, cages)
    assert len(first.cuboids) == 3
    assert second.part_ids == ("body",)


def test_structures_are_drawn_as_often_as_training_has_them() -> None:
    structures, cages = jars(7)
    alone = PartHierarchy.flat(("body",), ("body",), "bowl")
    structures["bowl"], cages["bowl"] = alone, Cage.of({"body": cages["jar0"]["body"]})
    samples = ProportionGenerator(families(structures, cages), 1.0).sample(np.random.default_rng(0), 160, 0.0)
    assert len(samples.kept) == 160
    bowls = sum(len(item.cage) == 1 for item in samples.kept)
    assert 10 <= bowls <= 30, "one of eight"


def test_what_comes_apart_or_shrinks_to_nothing_is_discarded_with_its_reason() -> None:
    (family,) = families(*jars(4))
    samples = ProportionGenerator((family,), 1.0).sample(np.random.default_rng(0), 60, 12.0)
    assert samples.failures
    assert set(samples.failures) <= {"parts came apart", "cuboid shrunk to nothing"}


def test_a_single_shape_of_a_structure_can_only_be_repeated() -> None:
    samples = generator(1).sample(np.random.default_rng(0), 5, 1.0)
    assert len({item.cage.vectors().tobytes() for item in samples.kept}) == 1


def test_a_family_of_cages_with_other_contacts_asks_only_for_common_ones() -> None:
    (family,) = families(*jars(4))
    apart = family.cuboids.copy()
    apart[0, :, 0] *= 3
    assert replace(family, cuboids=apart).contacts().sum() == 0
    assert family.contacts().sum() == 4


@pytest.mark.parametrize("weights", [np.array([2.0, -1.0]), np.array([0.5, 0.5])])
def test_opposite_tilts_stay_opposite(weights: np.ndarray) -> None:
    (family,) = families(*jars(2))
    assert isinstance(family, Family)
    cage = family.combined(weights)
    assert np.allclose(cage["left"].axes[0] * [1, -1, 1], cage["right"].axes[0])
