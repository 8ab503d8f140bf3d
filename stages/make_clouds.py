"""Training and reference shapes as clouds of points: what generated shapes are compared with (§4.4).

The references are the validation shapes and, where there are recipes, freshly drawn shapes: no network saw them.

python -m stages.make_clouds data/raw/chair data/shapes/chair data/clouds/chair
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.clouds import FRESH, Clouds, cloud_of, label_of, recipe_parts
from cagesdf.io.clouds import SETS, write_clouds
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.seeds import item_rng
from cagesdf.synthesis.dataset import draw_recipes
from cagesdf.synthesis.recipe import Recipe
from cagesdf.synthesis.writing import read_recipes
from pipeline import CloudsParams, artefact, parallel_map, run_stage
from pipeline.cost import Cost, references

COST = Cost("shapes", references, {"drawn": 8})


@dataclass(frozen=True)
class Subject:
    """A shape that is to become a cloud."""

    set: str  # one of SETS
    shape_id: str  # unique in its set
    label: str  # of the recipe that it is from, "" where there is none
    recipe: Recipe | None  # of a drawn shape; None: it is an imported one


def main(raw: Path, shapes: Path, out: Path, params: CloudsParams) -> None:
    """Read `shapes/` and the recipes in `raw`, write `clouds/`; without recipes the references are the validation's.

    A shape that kills its process is left out and named.
    """
    with artefact.write("clouds", out, inputs={"shapes": shapes}, foreign={"raw": raw}, params=params) as folder:
        source = read_shapes(shapes)
        subjects = subjects_of(source, read_recipes(raw), params)
        sample = partial(sampled, source, params)
        done, rejected = parallel_map(sample, subjects, rejects=ShapeRejected, label="make_clouds", lost=lost)
        clouds = {name: stacked(done, name, params.points) for name in SETS}
        if not len(clouds["train"]):
            raise InputError(f"{shapes}: none of its training shapes became a cloud" + "".join(map(left_out, rejected)))
        write_clouds(folder, clouds)
        references = [subject.recipe is not None for subject, _ in done if subject.set == "reference"]
        print(
            f"{len(clouds['train'])} training shapes; {references.count(False)} validation shapes and "
            f"{references.count(True)} drawn ones for reference" + "".join(map(left_out, rejected))
        )


def subjects_of(source: ShapeFolder, recipes: Mapping[str, Recipe], params: CloudsParams) -> list[Subject]:
    """All training shapes, then all references."""
    imported = [("train", shape_id) for shape_id in source.ids_of("train")]
    imported += [("reference", shape_id) for shape_id in source.ids_of("val")]
    labels = {shape_id: label_of(recipe) for shape_id, recipe in recipes.items()}
    return [Subject(name, shape_id, labels.get(shape_id, ""), None) for name, shape_id in imported] + [
        Subject("reference", FRESH + recipe.shape_id, label_of(recipe), recipe) for recipe in fresh(recipes, params)
    ]


def fresh(recipes: Mapping[str, Recipe], params: CloudsParams) -> list[Recipe]:
    """New recipes of the same category, by another seed than the data set's; none where that has no recipes."""
    categories = sorted({recipe.category for recipe in recipes.values()})
    return [
        recipe
        for category in categories
        for recipe in draw_recipes(category, 0, params.drawn, item_rng(params.seed, "reference", category))
    ]


def sampled(source: ShapeFolder, params: CloudsParams, subject: Subject) -> tuple[Subject, Float[ndarray, "p 3"]]:
    """A shape with its cloud."""
    recipe = subject.recipe
    if recipe is not None:
        rng = item_rng(params.seed, "drawn", recipe.shape_id)
        return subject, cloud_of(recipe_parts(recipe, recipe), params.points, rng)
    rng = item_rng(params.seed, "imported", subject.shape_id)
    return subject, cloud_of([part.mesh for part in source.read(subject.shape_id).parts], params.points, rng)


def stacked(done: Iterable[tuple[Subject, Float[ndarray, "p 3"]]], name: str, points: int) -> Clouds:
    """The clouds of one set, of `points` points each."""
    rows = [(subject, cloud) for subject, cloud in done if subject.set == name]
    return Clouds(
        tuple(subject.shape_id for subject, _ in rows),
        tuple(subject.label for subject, _ in rows),
        np.array([cloud for _, cloud in rows], np.float32).reshape(-1, points, 3),
    )


def lost(subject: Subject, reason: str) -> ShapeRejected:
    """The rejection of a shape that kills its worker."""
    return ShapeRejected(subject.shape_id, "make_clouds", reason)


def left_out(rejected: ShapeRejected) -> str:
    """A rejected shape and the reason, as the end of a line."""
    return f"; left out: {rejected.shape_id}, {rejected.reason}"


if __name__ == "__main__":
    run_stage(main, InputError)
