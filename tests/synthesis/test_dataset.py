"""Procedural data sets: what makes the experiments mean something, counted."""

from collections import Counter
from functools import cache

import numpy as np
import pytest

from cagesdf.cage_fitting.boxes import fit_cuboid
from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import is_closed, join, sample_surface
from cagesdf.geometry.solid import as_manifold, cage_surface, union
from cagesdf.shape import RawPart
from cagesdf.structure.relations import Reflection, Rotation, Translation
from cagesdf.synthesis.dataset import CATEGORIES, build, cage_of, draw, draw_recipes
from cagesdf.synthesis.recipe import Recipe

ON_CAGE = 0.005  # of the longest side: nearer than this is on the cage's faces
EACH = list(CATEGORIES)


@cache
def recipes(category: str) -> tuple[Recipe, ...]:
    return tuple(draw_recipes(category, 64, 16, np.random.default_rng(1)))


@cache
def shape(category: str, number: int) -> tuple[Recipe, Cage, list[RawPart]]:
    recipe = recipes(category)[number]
    return recipe, cage_of(recipe), build(recipe, recipe)


def shapes(category: str, count: int = 64) -> list[tuple[Recipe, Cage, list[RawPart]]]:
    return [shape(category, number) for number in range(count)]


def longest(parts: list[RawPart]) -> float:
    return float(np.ptp(np.concatenate([part.mesh.vertices for part in parts]), axis=0).max())


@pytest.mark.parametrize("category", EACH)
def test_there_are_six_families_with_five_members_each(category: str) -> None:
    families = Counter(recipe.family for recipe in recipes(category) if recipe.split == "train")
    assert len(families) >= 6
    assert min(families.values()) >= 5


def test_a_mixed_data_set_has_all_categories_in_equal_shares() -> None:
    drawn = draw_recipes("mixed", 25, 7, np.random.default_rng(1))
    assert Counter((recipe.category, recipe.split) for recipe in drawn) == {
        ("chair", "train"): 9, ("table", "train"): 8, ("vase", "train"): 8,
        ("chair", "val"): 3, ("table", "val"): 2, ("vase", "val"): 2,
    }  # fmt: skip
    assert len({recipe.shape_id for recipe in drawn}) == len(drawn)
    assert all(recipe.shape_id.startswith(recipe.category) for recipe in drawn)
    assert {recipe.same_cage for recipe in drawn} - {""} <= {recipe.shape_id for recipe in drawn}
    with pytest.raises(InputError, match="wanted one of chair, table, vase or mixed"):
        draw_recipes("lamp", 1, 0, np.random.default_rng(1))


@pytest.mark.parametrize("category", EACH)
def test_members_of_a_family_share_a_signature_and_families_do_not(category: str) -> None:
    signatures = {(recipe.family, draw(recipe).structure.signature()) for recipe in recipes(category)}
    assert len(signatures) == len({family for family, _ in signatures}) == len({text for _, text in signatures})


@pytest.mark.parametrize("category", EACH)
def test_relations_say_the_truth_about_the_cuboids(category: str) -> None:
    """Mirroring, moving or turning one cuboid's corners gives the other's."""
    for recipe in recipes(category)[:9]:
        structure = draw(recipe).structure
        cage = Cage.of(structure.cuboids())
        corners = dict(zip(cage.part_ids, cage.corners()))
        for relation in structure.relations():
            match relation:
                case Reflection(a, b, point, normal):
                    moved = corners[a] - 2 * ((corners[a] - point) @ np.array(normal))[:, None] * np.array(normal)
                case Translation(a, b, offset):
                    moved = corners[a] + offset
                case Rotation(a, b, pivot, axis, angle):
                    about, arms = np.array(axis), corners[a] - pivot
                    moved = pivot + arms * np.cos(angle) + np.cross(about, arms) * np.sin(angle)
                    moved += np.outer(arms @ about, about) * (1 - np.cos(angle))
                case _:
                    continue
            assert np.linalg.norm(moved[:, None] - corners[b], axis=2).min(1).max() < 1e-9


@pytest.mark.parametrize("category", EACH)
def test_parts_are_closed_and_fill_the_cuboids_of_the_recipe(category: str) -> None:
    for _, cage, parts in shapes(category):
        assert tuple(part.part_id for part in parts) == cage.part_ids
        for i, part in enumerate(parts):
            assert is_closed(part.mesh)
            local = cage.to_local(part.mesh.vertices, i)
            assert local.max(0) == pytest.approx(cage.size[i] / 2, abs=1e-9)
            assert local.min(0) == pytest.approx(-cage.size[i] / 2, abs=1e-9)


@pytest.mark.parametrize("category", EACH)
def test_minimum_boxes_of_the_parts_are_the_recipes_cuboids(category: str) -> None:
    ratios = np.array(
        [
            fit_cuboid(part.mesh.vertices, slack=0.01, min_size=1e-4).size.prod() / cage.size[i].prod()
            for _, cage, parts in shapes(category, 12)  # two of each family
            for i, part in enumerate(parts)
        ]
    )
    assert (np.abs(ratios - 1) < 0.03).mean() > 0.95
    assert ratios.min() > 0.88


@pytest.mark.parametrize("category", EACH)
def test_at_most_35_percent_of_the_surface_lies_on_the_cage(category: str) -> None:
    shares = []
    for _, cage, parts in shapes(category, 27):
        points, _ = sample_surface(union([part.mesh for part in parts]), 1500, np.random.default_rng(0))
        away = SurfaceDistance(cage_surface(cage)).unsigned(points)
        shares.append((away < ON_CAGE * longest(parts)).mean())
    assert np.mean(shares) <= 0.35
    assert max(shares) <= 0.5


def shares_a_mesh(cage: Cage, parts: list[RawPart]) -> bool:
    """Whether a tenth of some part's vertices lie in another part's cuboid too.

    Averaging over cuboids then bends that part beyond any one affine map.
    """
    for i, part in enumerate(parts):
        others = np.delete(cage.signed_distance(part.mesh.vertices), i, axis=1)
        if (others <= 1e-6).any(axis=1).mean() >= 0.1:
            return True
    return False


def is_rotated(cage: Cage) -> bool:
    """Whether some cuboid's axes are more than a degree from the canonical ones."""
    return bool((np.abs(cage.axes).max(axis=2) < np.cos(np.radians(1))).any())


def is_asymmetric(cage: Cage) -> bool:
    """Whether mirroring in the middle plane of x leaves a cuboid without its image."""
    corners = cage.corners()
    mirrored = corners * [-1, 1, 1]
    mirrored[..., 0] += corners[..., 0].max() + corners[..., 0].min()
    gap = np.linalg.norm(mirrored[:, None, :, None] - corners[None, :, None], axis=-1).min(-1).max(-1)
    return bool(gap.min(axis=1).max() > 0.01)


@pytest.mark.parametrize("category", EACH)
def test_a_fifth_of_the_shapes_is_hard_in_each_way_and_a_tenth_has_thin_parts(category: str) -> None:
    counts = Counter[str]()
    for _, cage, parts in shapes(category):
        counts["shared"] += shares_a_mesh(cage, parts)
        counts["rotated"] += is_rotated(cage)
        counts["asymmetric"] += is_asymmetric(cage)
        counts["genus"] += any(as_manifold(part.mesh).genus() > 0 for part in parts)
        counts["thin"] += bool(cage.size.min() < 0.01 * longest(parts))
        assert cage.size.min() > 0.004 * longest(parts)
    assert min(counts[name] for name in ("shared", "rotated", "asymmetric", "genus")) >= 0.2 * 64, counts
    assert counts["thin"] >= 0.1 * 64


@pytest.mark.parametrize("category", EACH)
def test_pairs_share_the_cage_or_the_style_and_never_a_split(category: str) -> None:
    by_id = {recipe.shape_id: recipe for recipe in recipes(category)}
    twins = Counter[str]()
    for recipe in by_id.values():
        if recipe.same_cage:
            other = by_id[recipe.same_cage]
            assert (recipe.proportions, recipe.split) == (other.proportions, other.split)
            assert recipe.factors != other.factors
        if recipe.same_style:
            other = by_id[recipe.same_style]
            assert (recipe.kinds, recipe.factors, recipe.split) == (other.kinds, other.factors, other.split)
            assert recipe.proportions != other.proportions
        twins["cage"] += bool(recipe.same_cage)
        twins["style"] += bool(recipe.same_style)
    assert min(twins["cage"], twins["style"]) >= 64 / 8
    cages = [tuple(recipe.proportions.values()) for recipe in by_id.values() if recipe.split == "train"]
    assert not any(tuple(recipe.proportions.values()) in cages for recipe in by_id.values() if recipe.split == "val")


def held_out_r2(inputs: np.ndarray, values: np.ndarray, train: int) -> float:
    """R² of ridge regression on the first `train` rows, at the others."""
    inputs = (inputs - inputs[:train].mean(0)) / (inputs[:train].std(0) + 1e-9)
    values = values - values[:train].mean()
    gram = inputs[:train].T @ inputs[:train] + 10.0 * np.eye(inputs.shape[1])
    weights = np.linalg.solve(gram, inputs[:train].T @ values[:train])
    residual = values[train:] - inputs[train:] @ weights
    return float(1 - (residual**2).mean() / values[train:].var())


def nearest_r2(inputs: np.ndarray, values: np.ndarray, train: int) -> float:
    """R² of the mean over the eight nearest of the first `train` rows, at the others."""
    inputs = (inputs - inputs[:train].mean(0)) / (inputs[:train].std(0) + 1e-9)
    near = np.linalg.norm(inputs[train:, None] - inputs[None, :train], axis=2).argsort(axis=1)[:, :8]
    return float(1 - ((values[train:] - values[near].mean(1)) ** 2).mean() / values[train:].var())


@pytest.mark.parametrize("category", EACH)
def test_only_the_driven_factor_can_be_read_from_held_out_cages(category: str) -> None:
    kit = CATEGORIES[category]
    name, count = next(iter(kit.families)), len(kit.families)
    drawn = [r for r in draw_recipes(category, 240 * count, 120 * count, np.random.default_rng(5)) if r.family == name]
    inputs = np.array([cage_of(recipe).vectors().ravel() for recipe in drawn])
    driven = kit.driven[0]
    assert len(set(kit.factors) - {driven}) >= 4
    for factor in kit.factors:
        values = np.array([recipe.factors[factor] for recipe in drawn])
        if factor == driven:
            assert held_out_r2(inputs, values, 240) > 0.3
        else:
            assert held_out_r2(inputs, values, 240) < 0.2
            assert nearest_r2(inputs, values, 240) < 0.2


@pytest.mark.parametrize("category", EACH)
def test_the_cuboids_of_one_with_the_style_of_another_fill_the_same_cage(category: str) -> None:
    first = recipes(category)[0]
    second = next(r for r in recipes(category)[1:] if r.family == first.family and not r.same_cage)
    swapped, own = build(first, second), build(first, first)
    cage = cage_of(first)
    for i, (part, ours) in enumerate(zip(swapped, own)):
        assert (part.part_id, part.label) == (ours.part_id, ours.label)
        assert np.abs(cage.to_local(part.mesh.vertices, i)).max(0) == pytest.approx(cage.size[i] / 2, abs=1e-9)
    distance = SurfaceDistance(join([part.mesh for part in own]))
    moved = distance.unsigned(join([part.mesh for part in swapped]).vertices)
    assert moved.mean() > 0.002


def test_styles_of_another_family_are_refused() -> None:
    first, second = recipes("chair")[:2]
    with pytest.raises(ValueError, match="family"):
        build(first, second)


def test_recipes_come_back_from_json_and_say_what_is_missing() -> None:
    recipe = recipes("vase")[3]
    assert Recipe.from_json(recipe.to_json(defects={"4": "opened"})) == recipe
    with pytest.raises(ValueError, match="family"):
        Recipe.from_json('{"shape_id": "a", "split": "train", "category": "vase"}')


def test_equal_seeds_draw_equal_sets_and_unknown_categories_are_refused() -> None:
    assert draw_recipes("table", 5, 2, np.random.default_rng(3)) == draw_recipes(
        "table", 5, 2, np.random.default_rng(3)
    )
    with pytest.raises(InputError, match="lamp"):
        draw_recipes("lamp", 1, 1, np.random.default_rng(0))
