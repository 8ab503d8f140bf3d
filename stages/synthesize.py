"""Draw procedural shapes of one category, in the layout of the real data sets.

python -m stages.synthesize chair data/raw/chair
"""

from functools import partial
from pathlib import Path

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.seeds import item_rng
from cagesdf.synthesis.dataset import draw_recipes
from cagesdf.synthesis.recipe import Recipe
from cagesdf.synthesis.writing import write_shape, write_splits
from pipeline import SynthesizeParams, artefact, parallel_map, run_stage
from pipeline.cost import Cost, shapes

COST = Cost("shapes", shapes, {"train": 2, "val": 0})


def main(category: str, out: Path, params: SynthesizeParams) -> None:
    """Write `raw/`: one folder a shape, hierarchies and splits beside them."""
    recipes = draw_recipes(category, params.train, params.val, item_rng(params.seed, "synthesize", category))
    with artefact.write("raw", out, inputs={}, params=params) as folder:
        write = partial(write_one, folder, params)
        parallel_map(write, recipes, rejects=ShapeRejected, label="synthesize")
        write_splits(folder, recipes)


def write_one(folder: Path, params: SynthesizeParams, recipe: Recipe) -> None:
    """One shape; its defects depend on its id alone."""
    write_shape(folder, recipe, params.defective, item_rng(params.seed, "defects", recipe.shape_id))


if __name__ == "__main__":
    run_stage(main, InputError)
