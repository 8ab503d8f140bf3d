"""Swaps with ground truth: recipes fill the cuboids they are given, and a swap that training showed isn't tried."""

from dataclasses import replace

import numpy as np
import pytest

from cagesdf.cuboid import Cage, Sequence
from cagesdf.evaluation.swaps import (
    box_warp,
    differ,
    in_style,
    keep_warp,
    kept_parts,
    mix_trials,
    swap_trials,
    swaps_of,
)
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, is_closed
from cagesdf.geometry.solid import union
from cagesdf.importing import import_shape
from cagesdf.shape import RawShape, Shape
from cagesdf.synthesis.dataset import build, cage_of, draw, draw_recipes
from cagesdf.synthesis.recipe import Recipe


def recipes_of(category: str) -> dict[str, Recipe]:
    """The shapes of a small data set by id: of some families there are four."""
    drawn = draw_recipes(category, 34, 0, np.random.default_rng(4))
    return {recipe.shape_id: recipe for recipe in drawn}


CHAIRS, VASES = recipes_of("chair"), recipes_of("vase")


def shape_of(recipe: Recipe) -> tuple[Shape, Cage]:
    """A shape as it is imported, and its cuboids as its recipe has them."""
    raw = RawShape(recipe.shape_id, "train", tuple(build(recipe, recipe)), draw(recipe).structure)
    shape = import_shape(raw, "y", 1e-5, 10**6, 100, 1e-4)
    return shape, cage_of(recipe).transformed(shape.similarity)


def sequences_of(recipes: dict[str, Recipe], targets: dict[str, str]) -> dict[str, Sequence]:
    nowhere = Cage.of({})
    return {name: Sequence(name, targets.get(name), np.zeros(1), (False,), (nowhere,)) for name in recipes}


def apart(a: Mesh, b: Mesh) -> float:
    return max(SurfaceDistance(x).unsigned(y.vertices).max() for x, y in ((a, b), (b, a)))


def family(recipes: dict[str, Recipe], name: str) -> list[Recipe]:
    return [recipe for recipe in recipes.values() if recipe.family == name]


PAIRS = [family(CHAIRS, "panel")[:2], family(CHAIRS, "wire")[:2], family(VASES, "amphora")[:2]]


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair[0].family)
def test_every_part_of_a_truth_fills_its_cuboid(pair: list[Recipe]) -> None:
    a, b = pair
    shape, rest = shape_of(a)
    for cage in (rest, replace(rest, size=rest.size * [1.2, 0.9, 1.0])):
        for i, mesh in enumerate(in_style(shape, cage, a, b.style)):
            assert is_closed(mesh)
            points = cage.to_unit(mesh.vertices, i)
            assert np.allclose([points.min(axis=0), points.max(axis=0)], [[-0.5] * 3, [0.5] * 3], atol=1e-9)


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair[0].family)
def test_in_its_own_style_a_shape_is_itself(pair: list[Recipe]) -> None:
    a, b = pair
    shape, rest = shape_of(a)
    assert all(not differ(x, y.mesh) for x, y in zip(in_style(shape, rest, a, a.style), shape.parts))
    trials = swap_trials(shape, rest, *shape_of(b), {a.shape_id: a, b.shape_id: b})
    assert [trial.kind for trial in trials] == ["swap", "warp"]
    for trial in trials:
        assert (trial.shape_id, trial.style_of, trial.cage) == (a.shape_id, b.shape_id, rest)
        assert apart(trial.truth, union([part.mesh for part in shape.parts])) > 0.005


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair[0].family)
def test_what_a_swap_teaches_is_the_other_shape_itself_where_the_cuboids_are_its_own(pair: list[Recipe]) -> None:
    styled, styled_rest = shape_of(pair[1])
    own = swap_trials(styled, styled_rest, styled, styled_rest, {pair[1].shape_id: pair[1]})[1]
    assert apart(own.truth, union([part.mesh for part in styled.parts])) == pytest.approx(0, abs=1e-9)
    assert not own.changed.any(), "its style is its own"


def test_a_mix_takes_the_style_in_its_parts_alone() -> None:
    a, b = family(CHAIRS, "panel")[:2]
    (shape, rest), styled = shape_of(a), shape_of(b)
    recipes = {a.shape_id: a, b.shape_id: b}
    own = union([part.mesh for part in shape.parts])
    for whole, every, nothing in zip(
        *(swap_trials(shape, rest, *styled, recipes, parts) for parts in (None, rest.part_ids, ()))
    ):
        assert np.array_equal(every.truth.vertices, whole.truth.vertices)
        assert np.array_equal(every.changed, whole.changed)
        assert apart(nothing.truth, own) == pytest.approx(0, abs=1e-6)
        assert not nothing.changed.any()
    legs = {part.part_id for part in shape.parts if part.label == "leg"}
    other = [part.mesh for part in shape.parts if part.part_id not in legs]
    swap, warp = swap_trials(shape, rest, *styled, recipes, legs)
    for trial in (swap, warp):
        assert trial.changed.any()
        kept = trial.truth.corners().mean(axis=1)[~trial.changed]
        assert SurfaceDistance(union(other)).unsigned(kept).max() < 1e-6
    # Warped legs may leave their cuboids: where cuboids overlap, vertices go with the mean of them.
    changed = rest.signed_distance(swap.truth.corners().mean(axis=1)[swap.changed])
    assert changed[:, [part in legs for part in rest.part_ids]].min(axis=1).max() < 1e-6


def test_a_mix_is_of_one_label_that_shows_the_style_and_has_a_trial_for_each_truth() -> None:
    a, b = family(CHAIRS, "panel")[:2]
    (shape, rest), styled = shape_of(a), shape_of(b)
    recipes, labels = {a.shape_id: a, b.shape_id: b}, {part.part_id: part.label for part in shape.parts}
    trials = mix_trials(shape, rest, *styled, recipes, np.random.default_rng(0))
    assert [trial.kind for trial in trials] == ["mix", "mix_warp", "mix_keep"]
    (pattern,) = {trial.part_id for trial in trials}
    parts = pattern.split("|")
    (label,) = {labels[part] for part in parts}
    assert parts == [part for part in rest.part_ids if labels[part] == label]
    for trial, same in zip(trials, swap_trials(shape, rest, *styled, recipes, parts)):
        assert trial.trial_id == f"{trial.kind}/{a.shape_id}/{b.shape_id}"
        assert trial.changed.any()
        assert np.array_equal(trial.truth.vertices, same.truth.vertices)
    assert trials[2].truth is trials[0].truth
    kept = dict(zip(keep_warp(*styled, shape, rest)[1], kept_parts(*styled, shape, rest, parts)))
    for part in shape.parts:
        assert (kept[part.part_id] is part.mesh) == (part.part_id not in parts)
    own = {a.shape_id: a}
    assert not mix_trials(shape, rest, shape, rest, own, np.random.default_rng(0)), "its style is its own"


def test_faces_of_parts_that_show_no_style_are_not_changed() -> None:
    a, b = family(CHAIRS, "wire")[:2]
    shape, rest = shape_of(a)
    for trial in swap_trials(shape, rest, *shape_of(b), {a.shape_id: a, b.shape_id: b}):
        labels = np.array([part.label for part in shape.parts])[rest.assign(trial.truth.corners().mean(axis=1))[0]]
        # The bow's cuboid holds the spindles too; legs are where nothing else is.
        assert not trial.changed[labels == "spindle"].any()
        assert trial.changed[labels == "leg"].mean() > 0.95


def test_a_shape_warped_onto_its_own_cuboids_is_itself_and_onto_others_fills_them() -> None:
    a, b = family(CHAIRS, "panel")[:2]
    (shape, rest), (other, cage) = shape_of(a), shape_of(b)
    own = union(box_warp(shape, rest, shape, rest)[0])
    assert apart(own, union([part.mesh for part in shape.parts])) == pytest.approx(0, abs=1e-9)
    warped = union(box_warp(other, cage, shape, rest)[0])
    assert np.allclose(np.ptp(warped.vertices, axis=0), np.ptp(rest.corners().reshape(-1, 3), axis=0), rtol=0.1)


def test_a_keep_warp_onto_its_own_cuboids_is_the_shape_and_onto_others_fills_them() -> None:
    a, b = family(CHAIRS, "panel")[:2]
    (shape, rest), (other, cage) = shape_of(a), shape_of(b)
    for mesh, part in zip(keep_warp(shape, rest, shape, rest)[0], shape.parts):
        np.testing.assert_allclose(mesh.vertices, part.mesh.vertices, atol=1e-12)
    meshes, taken = keep_warp(other, cage, shape, rest)
    assert taken == box_warp(other, cage, shape, rest)[1]
    for mesh, part_id in zip(meshes, taken):
        assert is_closed(mesh)
        points = rest.to_unit(mesh.vertices, rest.part_ids.index(part_id))
        np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [[-0.5] * 3, [0.5] * 3], atol=1e-6)


def test_details_keep_their_size_in_the_files_unit() -> None:
    """Cuboids of a shape twice as large are not larger in its canonical frame, but details are half as long there."""
    a, b = family(CHAIRS, "panel")[:2]
    (shape, rest), (styled, styled_rest) = shape_of(a), shape_of(b)
    large = replace(shape, similarity=replace(shape.similarity, scale=shape.similarity.scale / 2))
    doubled = replace(rest, centre=2 * rest.centre, size=2 * rest.size)
    ours, theirs = keep_warp(styled, styled_rest, large, rest)[0], keep_warp(styled, styled_rest, shape, doubled)[0]
    for mesh, other in zip(ours, theirs):
        np.testing.assert_allclose(2 * mesh.vertices, other.vertices, atol=1e-9)


def test_swaps_stay_in_a_family_and_change_the_style() -> None:
    pairs = swaps_of(CHAIRS, sequences_of(CHAIRS, {}))
    assert pairs
    for a, b in pairs:
        assert CHAIRS[a].family == CHAIRS[b].family
        assert CHAIRS[a].style != CHAIRS[b].style
        assert CHAIRS[a].proportions != CHAIRS[b].proportions


def test_families_of_two_categories_that_are_called_alike_swap_no_styles() -> None:
    recipes = recipes_of("mixed")
    names = {(recipe.category, recipe.family) for recipe in recipes.values()}
    assert len({family for _, family in names}) < len(names)
    pairs = swaps_of(recipes, sequences_of(recipes, {}))
    assert pairs
    assert all(recipes[a].category == recipes[b].category for a, b in pairs)


def test_a_style_that_a_step_showed_on_a_cage_is_not_tried_on_it() -> None:
    first, second, third, fourth = family(CHAIRS, "panel")[:4]
    # The third has the cage of the first, the fourth the style of the second.
    assert third.proportions == first.proportions
    assert fourth.style == second.style
    pairs = swaps_of(CHAIRS, sequences_of(CHAIRS, {}))
    assert (first.shape_id, third.shape_id) not in pairs
    assert (first.shape_id, second.shape_id) in pairs
    assert (fourth.shape_id, second.shape_id) not in pairs
    # Once the second is deformed towards the third's cage, neither shape of that cage takes its style, whose-ever.
    shown = swaps_of(CHAIRS, sequences_of(CHAIRS, {second.shape_id: third.shape_id}))
    lost = {(cage.shape_id, style.shape_id) for cage in (first, third) for style in (second, fourth)}
    assert set(pairs) - set(shown) == lost


def test_shapes_without_recipes_have_no_swaps() -> None:
    assert swaps_of({}, sequences_of(CHAIRS, {})) == []
