"""Whether the features that generated shapes are compared in see what makes a shape: style, noise, missing parts.

    python -m benchmarks.features [chair table vase] [--features data/features] [--shapes 256] [--few 32]

prints a Markdown table: FD and KPD between `--shapes` drawn references and as many other shapes, as they are drawn and
changed in one way each, the same cages every time; ± is the standard deviation over five sets as drawn. Then the same
for sets of `--few`, of which a default run generates: in how many of them the changed set is farther than as drawn.
`data/features` is that of `make repro`. Changes:

    style mixed      each part in the style of another shape
    style permuted   each shape in the style of another of its family
    one style        all shapes in the style of one
    cuboids          no style: the cuboids themselves
    noise            each point moved by a normal distance of 1 % of the bounding sphere's radius, along each axis
    part dropped     one part of each shape missing
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from cagesdf.evaluation.clouds import cloud_of, recipe_parts
from cagesdf.evaluation.shape_sets import feature_figures
from cagesdf.frames import canonical_similarity
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import CUBE_FACES
from cagesdf.io.features import FILE, read_features
from cagesdf.models.features import Features
from cagesdf.synthesis.dataset import CATEGORIES, cage_of, draw, draw_recipes
from cagesdf.synthesis.recipe import Recipe
from cagesdf.training.features import classify

NOISE = 0.01
PAIRS = 5
Parts = Callable[[Sequence[Recipe], int, np.random.Generator], list[Mesh]]


def styled(recipe: Recipe, style: Recipe) -> Recipe:
    return replace(recipe, kinds=style.kinds, factors=style.factors)


def as_drawn(recipes: Sequence[Recipe], i: int, rng: np.random.Generator) -> list[Mesh]:
    return recipe_parts(recipes[i], recipes[i])


def mixed(recipes: Sequence[Recipe], i: int, rng: np.random.Generator) -> list[Mesh]:
    drawing = draw(recipes[i])
    meshes = []
    for part_id, surface in drawing.surfaces.items():
        cuboid = drawing.structure.cuboids()[part_id]
        mesh = surface(cuboid.size, recipes[int(rng.integers(len(recipes)))].style)
        meshes.append(mesh.with_vertices(mesh.vertices @ cuboid.axes + cuboid.centre))
    return canonical(meshes)


def permuted(recipes: Sequence[Recipe], i: int, rng: np.random.Generator) -> list[Mesh]:
    kin = (recipes[i].category, recipes[i].family)
    family = [recipe for recipe in recipes if (recipe.category, recipe.family) == kin]
    return recipe_parts(recipes[i], family[int(rng.integers(len(family)))])


def one_style(recipes: Sequence[Recipe], i: int, rng: np.random.Generator) -> list[Mesh]:
    recipe = styled(recipes[i], recipes[0])
    return recipe_parts(recipe, recipe)


def cuboids(recipes: Sequence[Recipe], i: int, rng: np.random.Generator) -> list[Mesh]:
    return canonical([Mesh(corners, CUBE_FACES) for corners in cage_of(recipes[i]).corners()])


def dropped(recipes: Sequence[Recipe], i: int, rng: np.random.Generator) -> list[Mesh]:
    parts = as_drawn(recipes, i, rng)
    lost = int(rng.integers(len(parts)))
    return [part for number, part in enumerate(parts) if number != lost]


def canonical(meshes: list[Mesh]) -> list[Mesh]:
    similarity = canonical_similarity(np.concatenate([mesh.vertices for mesh in meshes]), "y")
    return [mesh.with_vertices(similarity.to_canonical(mesh.vertices)) for mesh in meshes]


CHANGES: dict[str, Parts] = {
    "style mixed": mixed,
    "style permuted": permuted,
    "one style": one_style,
    "cuboids": cuboids,
    "part dropped": dropped,
}


def clouds(recipes: Sequence[Recipe], parts: Parts, points: int, seed: int) -> np.ndarray:
    result = []
    for i in range(len(recipes)):
        rng = np.random.default_rng([seed, i])
        result.append(cloud_of(parts(recipes, i, rng), points, rng))
    return np.stack(result)


def measure(classifier: Features, category: str, count: int, few: int) -> list[str]:
    def described(points: np.ndarray) -> np.ndarray:
        return classify(classifier.model, points)[0]

    sets = [draw_recipes(category, count, 0, np.random.default_rng([77, i])) for i in range(PAIRS + 1)]
    real = [described(clouds(recipes, as_drawn, classifier.points, 1)) for recipes in sets]
    reference = real[0]
    changed = {name: described(clouds(sets[1], parts, classifier.points, 2)) for name, parts in CHANGES.items()}
    points = clouds(sets[1], as_drawn, classifier.points, 2)
    noise = np.random.default_rng(3).normal(scale=NOISE, size=points.shape)
    changed["noise"] = described((points + noise).astype(np.float32))
    floors = {name: [feature_figures(other, reference)[name] for other in real[1:]] for name in ("fd", "kpd")}
    spreads = " | ".join(f"{some[0]:.3g} ± {np.std(some, ddof=1):.2g}" for some in floors.values())
    lines = [f"| {category} | as drawn | {spreads} | | |"]
    for name, features in changed.items():
        distances = feature_figures(features, reference)
        cells = [f"{distances[f]:.3g}" for f in floors]
        rises = dict.fromkeys(floors, 0)
        for start in range(0, count - few + 1, few):
            rows = slice(start, start + few)
            before, after = (feature_figures(some[rows], reference) for some in (real[1], features))
            for f in rises:
                rises[f] += after[f] > before[f]
        cells += [f"{number} of {count // few}" for number in rises.values()]
        lines.append(f"| {category} | {name} | " + " | ".join(cells) + " |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("categories", nargs="*", default=list(CATEGORIES))
    parser.add_argument("--features", type=Path, default=Path("data/features"))
    parser.add_argument("--shapes", type=int, default=256)
    parser.add_argument("--few", type=int, default=32)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    classifier = read_features(arguments.features / FILE)
    few = f"of sets of {arguments.few}, farther than as drawn by"
    print(f"| category | {arguments.shapes} shapes | FD | KPD | {few} FD | {few} KPD |\n|---|---|---|---|---|---|")
    for category in arguments.categories:
        print("\n".join(measure(classifier, category, arguments.shapes, arguments.few)), flush=True)


if __name__ == "__main__":
    main()
