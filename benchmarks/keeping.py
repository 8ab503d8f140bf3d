"""Gains of warps without a network against the recipe's truth: the first table of docs/styles.md, "Details".

    OMP_NUM_THREADS=1 python -m benchmarks.keeping [--category chair] [--swaps 40] [--seed 101]

draws shapes that no run has (the default run's are drawn by another generator), and swaps of cuboids and styles
among them. The gain is that of docs/metrics.md: on the detail of the parts whose style changes, 1 is the truth and 0
the shape that was left alone. Measured are

box_warp         the other shape's parts deformed into the cuboids (§3.3): what `transfer: trilinear` teaches
keep_warp        the same with details that keep their size in the files' unit: `transfer: keep_details`
keep, canonical  the same in canonical units, in which each shape's radius is 1
"""

import argparse
from functools import cache, partial

import numpy as np

from cagesdf.cuboid import Cage, Sequence
from cagesdf.evaluation.edits import measure
from cagesdf.evaluation.surfaces import Truth
from cagesdf.evaluation.swaps import box_warp, keep_warp, swap_trials, swaps_of
from cagesdf.evaluation.trials import Trial
from cagesdf.frames import Similarity
from cagesdf.importing import import_shape
from cagesdf.meshes import Mesh
from cagesdf.shape import RawShape, Shape
from cagesdf.solid import union
from cagesdf.synthesis.dataset import build, cage_of, draw, draw_recipes
from cagesdf.synthesis.recipe import Recipe

POINTS, DETAIL = 3000, 0.005  # as the default run's make_trials
TRAIN = 64  # shapes drawn, as in the default run


def imported(recipe: Recipe) -> tuple[Shape, Cage]:
    """A shape as it is imported, and its recipe's cuboids, canonical."""
    raw = RawShape(recipe.shape_id, "train", tuple(build(recipe, recipe)), draw(recipe).structure)
    shape = import_shape(raw, "y", 1e-5, 10**6, 150, 1e-4)
    return shape, cage_of(recipe).transformed(shape.similarity)


def in_unit_of(shape: Shape, scale: float) -> Shape:
    """The shape as if its file had another unit."""
    similarity = Similarity(scale, shape.similarity.rotation, shape.similarity.translation)
    return Shape(shape.shape_id, shape.split, shape.parts, shape.structure, similarity, shape.alignment, shape.audit)


def gains(shape: Shape, rest: Cage, styled: Shape, styled_rest: Cage, recipes: dict[str, Recipe]) -> dict[str, float]:
    """The gain of each warp in one swap."""
    trial, _ = swap_trials(shape, rest, styled, styled_rest, recipes)
    distance = partial(detail_distance, trial, Truth(trial.truth, rest, DETAIL))
    unchanged = distance([part.mesh for part in shape.parts])
    canonical = in_unit_of(styled, shape.similarity.scale)
    meshes = {
        "box_warp": box_warp(styled, styled_rest, shape, rest)[0],
        "keep_warp": keep_warp(styled, styled_rest, shape, rest)[0],
        "keep, canonical": keep_warp(canonical, styled_rest, shape, rest)[0],
    }
    return {name: 1 - distance(parts) / unchanged for name, parts in meshes.items()}


def detail_distance(trial: Trial, truth: Truth, parts: list[Mesh]) -> float:
    """The distance that gains are made of, in % of the longest side."""
    return measure(union(parts), trial, truth, POINTS, np.random.default_rng(0))["distance_detail"]


def main(category: str, swaps: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    recipes = {recipe.shape_id: recipe for recipe in draw_recipes(category, TRAIN, 0, rng)}
    no_steps = {name: Sequence(name, None, np.zeros(1), (False,), (Cage.of({}),)) for name in recipes}
    shape_of = cache(lambda name: imported(recipes[name]))
    rows = [
        gains(*shape_of(a), *shape_of(b), recipes)
        for a, b in rng.permutation(swaps_of(recipes, no_steps)).tolist()[:swaps]
    ]
    print(f"{category}, seed {seed}: {len(rows)} swaps\n")
    print("| warp | median | quartiles | nearer than the unchanged shape | than box_warp |")
    print("|---|---|---|---|---|")
    for name in rows[0]:
        of_warp, of_box = (np.array([row[key] for row in rows]) for key in (name, "box_warp"))
        low, middle, high = np.quantile(of_warp, [0.25, 0.5, 0.75])
        nearer = int((of_warp > 0).sum()), int((of_warp > of_box).sum())
        print(f"| {name} | {middle:.2f} | {low:.2f} to {high:.2f} | {nearer[0]} | {nearer[1]} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--category", default="chair")
    parser.add_argument("--swaps", type=int, default=40)
    parser.add_argument("--seed", type=int, default=101)
    arguments = parser.parse_args()
    main(arguments.category, arguments.swaps, arguments.seed)
