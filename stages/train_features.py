"""Train the classifier whose features generated shapes are compared in, or take one that was trained elsewhere (§4.4).

It learns to tell procedural shapes of all categories and families apart, drawn for it alone: the same features
whatever the data, so that figures of different runs can be compared.

python -m stages.train_features data/features
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.clouds import Clouds, cloud_of, label_of, recipe_parts
from cagesdf.io.features import read_features, write_features
from cagesdf.models.features import Features
from cagesdf.models.pointnet import make_classifier
from cagesdf.seeds import item_rng
from cagesdf.synthesis.dataset import CATEGORIES, draw_recipes
from cagesdf.synthesis.recipe import Recipe
from cagesdf.training.features import ClassifierSettings, classify, train_classifier
from pipeline import FeaturesParams, artefact, counter, parallel_map, run_stage
from pipeline.cost import Cost

COST = Cost(
    "steps",
    lambda sections, arm: sections["train_features"].steps,
    {"train": 9, "val": 9, "steps": 20},
    grows=False,
)


def main(out: Path, params: FeaturesParams) -> None:
    """Write `features/`, and how many shapes that it was not trained on the classifier recognises."""
    given = {"weights": Path(params.weights)} if params.weights else {}
    for path in given.values():
        if not path.is_file():
            raise InputError(f'{path}: no such file; wanted a classifier\'s weights, or train_features.weights: ""')
    with artefact.write("features", out, inputs={}, foreign=given, params=params) as folder:
        held_out = drawn("held out", params.val, params)
        features = read_features(given["weights"]) if given else trained(drawn("train", params.train, params), params)
        accuracy = {"shapes": len(held_out), **accuracy_of(features, held_out)}
        write_features(folder, features, accuracy)
        print(f"{len(features.classes)} classes; of {len(held_out)} held-out shapes recognised: {listed(accuracy)}")


def drawn(name: str, count: int, params: FeaturesParams) -> Clouds:
    """`count` shapes of each procedural category; those that kill their process are left out and named."""
    recipes = [
        recipe
        for category in CATEGORIES
        for recipe in draw_recipes(category, count, 0, item_rng(params.seed, name, category))
    ]
    label = f"train_features, shapes: {name}"
    done, rejected = parallel_map(
        partial(sampled, name, params), recipes, rejects=ShapeRejected, label=label, lost=lost
    )
    if not done:
        raise InputError(f"train_features: none of {len(recipes)} {name} shapes became a cloud; {rejected[0]}")
    for rejection in rejected:
        print(f"left out: {rejection}")
    return Clouds(
        tuple(recipe.shape_id for recipe, _ in done),
        tuple(label_of(recipe) for recipe, _ in done),
        np.stack([points for _, points in done]),
    )


def sampled(name: str, params: FeaturesParams, recipe: Recipe) -> tuple[Recipe, Float[ndarray, "p 3"]]:
    """A recipe with its cloud."""
    rng = item_rng(params.seed, name, "points", recipe.shape_id)
    return recipe, cloud_of(recipe_parts(recipe, recipe), params.points, rng)


def lost(recipe: Recipe, reason: str) -> ShapeRejected:
    """The rejection of a shape that kills its worker."""
    return ShapeRejected(recipe.shape_id, "train_features", reason)


def trained(clouds: Clouds, params: FeaturesParams) -> Features:
    """A classifier of these clouds by their labels."""
    classes = tuple(sorted(set(clouds.labels)))
    numbers = torch.tensor([classes.index(label) for label in clouds.labels])
    model = make_classifier(params.widths, params.hidden, len(classes), params.seed)
    settings = ClassifierSettings(params.steps, params.batch, params.batch_points, params.learning_rate, params.seed)
    with counter(params.steps, "steps", "train_features") as bar:
        train_classifier(
            model, torch.from_numpy(clouds.points), numbers, settings, lambda step, loss: bar(step, loss=f"{loss:.4f}")
        )
    return Features(model.eval().requires_grad_(False), params.widths, params.hidden, classes, params.points)


def accuracy_of(features: Features, clouds: Clouds) -> dict[str, Any]:
    """Shares of the clouds whose category and whose label is recognised; null for what the classifier doesn't know."""
    _, numbers = classify(features.model, features.taken(clouds.points))
    categories = [label.split("/")[0] for label in clouds.labels]
    by_category = [features.category(int(number)) == category for number, category in zip(numbers, categories)]
    by_label = [features.classes[int(number)] == label for number, label in zip(numbers, clouds.labels)]
    return {
        "category": float(np.mean(by_category)) if set(categories) <= features.categories else None,
        "family": float(np.mean(by_label)) if set(clouds.labels) <= set(features.classes) else None,
    }


def listed(accuracy: dict[str, Any]) -> str:
    """Both shares in words."""
    shares = [(name, accuracy[name]) for name in ("category", "family")]
    return ", ".join(f"{name} {'not known' if share is None else f'{share:.1%}'}" for name, share in shares)


if __name__ == "__main__":
    run_stage(main, InputError)
