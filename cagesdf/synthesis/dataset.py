"""Procedural data sets: the recipes of their shapes, and the meshes."""

from collections.abc import Mapping, Sequence

import numpy as np

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import InputError
from cagesdf.geometry.meshes import Mesh
from cagesdf.shape import RawPart
from cagesdf.synthesis.chairs import CHAIRS
from cagesdf.synthesis.layout import Drawing, Style, finish
from cagesdf.synthesis.programs import Assembled
from cagesdf.synthesis.recipe import Category, Recipe
from cagesdf.synthesis.tables import TABLES
from cagesdf.synthesis.vases import VASES

CATEGORIES: dict[str, Category] = {"chair": CHAIRS, "table": TABLES, "vase": VASES}
MIXED = "mixed"  # shapes of all categories together
NOISE = 0.12  # of the driven factor, as a share of its range


def draw_recipes(category: str, train: int, val: int, rng: np.random.Generator) -> list[Recipe]:
    """Recipes of a data set: of each category first `train`, then `val`, families in turn.

    MIXED is a data set of all categories, in equal shares, the first ones' a shape larger if need be. Of a
    family's shapes in one split, one in four has the cage of an earlier one and a fresh style, and one in four
    the style of an earlier one and a fresh cage. The splits share neither. Raises InputError for an unknown
    category.
    """
    if category not in (*CATEGORIES, MIXED):
        raise InputError(f"category {category!r}: wanted one of {', '.join(CATEGORIES)} or {MIXED}")
    names = list(CATEGORIES) if category == MIXED else [category]
    recipes: list[Recipe] = []
    for place, name in enumerate(names):
        of_category: list[Recipe] = []
        for split, count in (("train", train), ("val", val)):
            begun = len(of_category)
            for _ in range((count + len(names) - 1 - place) // len(names)):
                of_category.append(_draw(name, split, of_category[begun:], len(of_category), rng))
        recipes += of_category
    return recipes


def _draw(category: str, split: str, earlier: Sequence[Recipe], number: int, rng: np.random.Generator) -> Recipe:
    kit = CATEGORIES[category]
    name = list(kit.families)[len(earlier) % len(kit.families)]
    family = kit.families[name]
    relatives = [recipe for recipe in earlier if recipe.family == name]
    turn = len(relatives) % 4
    proportions = {key: float(rng.uniform(low, high)) for key, (low, high) in family.ranges.items()}
    if turn == 2:
        proportions = dict(relatives[-2].proportions)
    kinds = {key: str(rng.choice(choices)) for key, choices in kit.kinds.items()}
    factors = {key: float(rng.uniform(low, high)) for key, (low, high) in kit.factors.items()}
    factor, driver = kit.driven
    factors[factor] = _follow(proportions[driver], family.ranges[driver], kit.factors[factor], rng)
    if turn == 3:
        kinds, factors = dict(relatives[-2].kinds), dict(relatives[-2].factors)
    return Recipe(
        f"{category}_{number:04d}",
        split,
        category,
        name,
        proportions,
        kinds,
        factors,
        relatives[-2].shape_id if turn == 2 else "",
        relatives[-2].shape_id if turn == 3 else "",
    )


def _follow(value: float, source: tuple[float, float], target: tuple[float, float], rng: np.random.Generator) -> float:
    """A place in `target` like that of `value` in `source`, give or take NOISE."""
    share = (value - source[0]) / (source[1] - source[0]) + rng.normal(0, NOISE)
    return float(target[0] + np.clip(share, 0, 1) * (target[1] - target[0]))


def draw(recipe: Recipe) -> Drawing:
    """The structure with its cuboids, and the surfaces that fill them."""
    family = CATEGORIES[recipe.category].families[recipe.family]
    return finish(family.draw(recipe.proportions))


def assemble(recipe: Recipe) -> Assembled | None:
    """The program of a recipe's cuboids; None if its category has none."""
    category = CATEGORIES[recipe.category]
    return category.assemble and category.assemble(draw(recipe), category.families[recipe.family].typical())


def cage_of(recipe: Recipe) -> Cage:
    """The recipe's cuboids, raw frame, axes as their surfaces are made."""
    return Cage.of(draw(recipe).structure.cuboids())


def build(cage: Recipe, style: Recipe) -> list[RawPart]:
    """The parts of the cuboids of one recipe in the style of another, raw frame, each closed.

    `build(a, a)` is the shape of `a`. Each mesh fills its cuboid, whatever the style. Raises
    ValueError if the recipes are of different families: their parts don't correspond.
    """
    if (cage.category, cage.family) != (style.category, style.family):
        raise ValueError(
            f"cuboids of {cage.shape_id} ({cage.category} {cage.family}) can't take the style of {style.shape_id} "
            f"({style.category} {style.family}); wanted recipes of one family"
        )
    return fill_cuboids(cage, style.style, draw(cage).structure.cuboids())


def fill_cuboids(recipe: Recipe, style: Style, cuboids: Mapping[str, Cuboid]) -> list[RawPart]:
    """The parts of a recipe's structure in a style, each filling a cuboid of its own, raw frame.

    `cuboids` are by part id, their axes as the recipe's surfaces are made: see `cage_of`. What a
    surface takes from the recipe's proportions besides its size (a body's mouth, say) is the recipe's.
    """
    drawing = draw(recipe)
    labels = drawing.structure.labels()
    parts = []
    for part_id, surface in drawing.surfaces.items():
        cuboid = cuboids[part_id]
        mesh = surface(cuboid.size, style)
        placed = Mesh(mesh.vertices @ cuboid.axes + cuboid.centre, mesh.faces)
        parts.append(RawPart(part_id, labels[part_id], placed))
    return parts
