"""Training and reference shapes as clouds of points: what generated shapes are compared with (§4.4).

The references are the validation shapes and, where there are recipes, freshly drawn shapes: no network saw them.

python -m stages.make_clouds data/raw/chair data/shapes/chair data/clouds/chair
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.clouds import FRESH, Clouds, cloud_of, label_of, recipe_parts
from cagesdf.io.clouds import write_clouds
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.synthesis.dataset import draw_recipes
from cagesdf.synthesis.recipe import Recipe
from cagesdf.synthesis.writing import read_recipes
from pipeline import CloudsParams, artefact, item_rng, parallel_map, run_stage


def main(raw: Path, shapes: Path, out: Path, params: CloudsParams) -> None:
    """Read `shapes/` and the recipes in `raw`, write `clouds/`; without recipes the references are the validation's."""
    with artefact.write("clouds", out, inputs={"shapes": shapes}, foreign={"raw": raw}, params=params) as folder:
        source, recipes = read_shapes(shapes), read_recipes(raw)
        drawn = fresh(recipes, params)
        train, val = source.ids_of("train"), source.ids_of("val")
        sample = partial(points_of, source, params)
        points, _ = parallel_map(sample, [*train, *val, *drawn], rejects=ShapeRejected, label="make_clouds")
        labels = [label_of(recipes[i]) if i in recipes else "" for i in (*train, *val)] + [label_of(r) for r in drawn]
        ids = [*train, *val, *(FRESH + recipe.shape_id for recipe in drawn)]
        sets = {"train": slice(len(train)), "reference": slice(len(train), None)}
        stacked = np.stack(points)
        clouds = {name: Clouds(tuple(ids[part]), tuple(labels[part]), stacked[part]) for name, part in sets.items()}
        write_clouds(folder, clouds)
        print(f"{len(train)} training shapes; {len(val)} validation shapes and {len(drawn)} drawn ones for reference")


def fresh(recipes: Mapping[str, Recipe], params: CloudsParams) -> list[Recipe]:
    """New recipes of the same category, by another seed than the data set's; none where that has no recipes."""
    categories = sorted({recipe.category for recipe in recipes.values()})
    return [
        recipe
        for category in categories
        for recipe in draw_recipes(category, 0, params.drawn, item_rng(params.seed, "reference", category))
    ]


def points_of(source: ShapeFolder, params: CloudsParams, item: str | Recipe) -> Float[ndarray, "p 3"]:
    """The cloud of an imported shape, by its id, or of a recipe's."""
    if isinstance(item, Recipe):
        rng = item_rng(params.seed, "drawn", item.shape_id)
        return cloud_of(recipe_parts(item, item), params.points, rng)
    rng = item_rng(params.seed, "imported", item)
    return cloud_of([part.mesh for part in source.read(item).parts], params.points, rng)


if __name__ == "__main__":
    run_stage(main, InputError)
