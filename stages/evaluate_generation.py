"""Measure the shapes that all arms generated against the references: Table 3 (§4.4).

python -m stages.evaluate_generation data/generated/chair data/clouds/chair data/features data/generation/chair
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.clouds import FRESH, Clouds
from cagesdf.evaluation.shape_sets import (
    FIGURES,
    Described,
    Draw,
    Scored,
    definitions,
    drawn,
    feature_figures,
    resampling_noise,
    score,
)
from cagesdf.evaluation.table3 import REAL
from cagesdf.io.clouds import read_clouds
from cagesdf.io.features import FILE, read_accuracy, read_features
from cagesdf.io.generated_shapes import read_generated
from cagesdf.io.generation_scores import write_generation
from cagesdf.models.features import Features
from cagesdf.seeds import item_rng
from cagesdf.training.features import classify
from pipeline import GenerationParams, artefact, parallel_map, run_stage
from pipeline.cost import Cost, references

Key = tuple[str, str, int]  # arm, method, draw

COST = Cost("references", references)


@dataclass(frozen=True, eq=False)
class Task:
    """A set of shapes to be scored."""

    arm: str  # whose network made them, or REAL
    method: str
    draw: int  # of the set, where several were drawn
    shapes: Described
    recognised: float  # share of them that the classifier takes for their category, or NaN
    reference: Described  # none of the shapes among them
    draws: Sequence[Draw]  # of these

    @property
    def key(self) -> Key:
        """Arm, method and draw, which identify the set."""
        return self.arm, self.method, self.draw


def main(generated: Path, clouds: Path, features: Path, out: Path, params: GenerationParams) -> None:
    """Read the shapes of all generators, `clouds/` and `features/`, write `generation/`.

    There are no figures where there are fewer than four references: own data with hardly any validation shapes.
    Draws are as large as the smallest method that has two shapes or more; one with fewer has a row, too.
    """
    arms = artefact.inside(generated, params.generators, "generated", params.format)
    manifests = {name: folder / artefact.MANIFEST for name, folder in arms.items()}
    inputs = {"clouds": clouds, "features": features}
    with artefact.write("generation", out, inputs=inputs, params=params, foreign=manifests) as folder:
        classifier, sets = read_features(features / FILE), read_clouds(clouds)
        folders = {arm: read_generated(path) for arm, path in arms.items()}
        made = {
            (arm, method): described(
                classifier, clouds.name, params, *stacked(shapes.points(method), classifier.points)
            )
            for arm, shapes in folders.items()
            for method in shapes.methods
        }
        train, reference = (real(classifier, clouds.name, params, sets[name]) for name in ("train", "reference"))
        size = min([len(reference[0]) // 2, *(len(shapes) for shapes, _ in made.values() if len(shapes) > 1)])
        draws = drawn(reference[0], size, params.draws, item_rng(params.seed, "draws")) if size > 1 else []
        tasks = list(tasks_of(made, train, reference, draws, params)) if draws else []
        done, rejected = parallel_map(
            partial(score_one, train[0]), tasks, rejects=ShapeRejected, label="evaluate_generation"
        )
        for rejection in rejected:  # every set has a row
            raise rejection
        scored = dict(done)
        rows = [row_of(task, scored[task.key].figures) for task in tasks]
        nearest = [
            row
            for task in tasks
            if task.arm != REAL
            for row in nearest_rows(task, scored[task.key], folders[task.arm].ids(task.method), sets["train"])
        ]
        if draws:
            rows.append(halves(reference[0], item_rng(params.seed, "halves")))
        about = definitions(params.points, classifier.points, params.draws, params.seed)
        about["features"] = {"classes": len(classifier.classes), **read_accuracy(features)}
        write_generation(folder, rows, nearest, about | {"sets": sizes(sets, size, params.points)})


def described(
    classifier: Features,
    category: str,
    params: GenerationParams,
    points: Float[ndarray, "n p 3"],
    failed: Bool[ndarray, " n"],
) -> tuple[Described, float]:
    """Shapes with their features, and the share of them that is recognised."""
    features, classes = classify(classifier.model, classifier.taken(points))
    right = np.array([classifier.category(int(number)) == category for number in classes], bool) & ~failed
    known = category in classifier.categories
    return Described(points[:, : params.points], features, failed), _share(right, 0.0) if known else np.nan


def _share(values: Bool[ndarray, " n"], worst: float) -> float:
    """Share of true values; `worst` if there are none."""
    return float(values.mean()) if len(values) else worst


def stacked(
    points: Mapping[str, Float[ndarray, "m 3"]], least: int
) -> tuple[Float[ndarray, "n p 3"], Bool[ndarray, " n"]]:
    """Clouds as one array, and whether each is empty: an empty one has `least` or more points at the origin."""
    failed = np.array([len(cloud) == 0 for cloud in points.values()], bool)
    count = max([least, *map(len, points.values())])
    clouds = [cloud if len(cloud) else np.zeros((count, 3), np.float32) for cloud in points.values()]
    return np.stack(clouds) if clouds else np.zeros((0, count, 3), np.float32), failed


def real(classifier: Features, category: str, params: GenerationParams, clouds: Clouds) -> tuple[Described, float]:
    """As `described`, of shapes that no network made."""
    if not len(clouds):
        return Described(clouds.points, np.zeros((0, 1)), np.zeros(0, bool)), np.nan
    return described(classifier, category, params, clouds.points, np.zeros(len(clouds), bool))


def tasks_of(
    made: dict[tuple[str, str], tuple[Described, float]],
    train: tuple[Described, float],
    reference: tuple[Described, float],
    draws: Sequence[Draw],
    params: GenerationParams,
) -> Iterator[Task]:
    """Every set of generated shapes; and for comparison training shapes, and each draw of references."""
    for (arm, method), (shapes, recognised) in made.items():
        yield Task(arm, method, 0, shapes, recognised, reference[0], draws)
    size = len(draws[0].rows)
    if len(train[0]) > 1:
        rows = item_rng(params.seed, "training").permutation(len(train[0]))[:size]
        yield Task(REAL, "training", 0, train[0].of(rows), train[1], reference[0], draws)
    for number, draw in enumerate(draws):
        others = np.setdiff1d(np.arange(len(reference[0])), draw.rows)
        rest = [Draw(np.searchsorted(others, other.rows), other.within) for other in draws if other is not draw]
        shapes = reference[0].of(draw.rows)
        yield Task(REAL, "drawn", number, shapes, reference[1], reference[0].of(others), rest)


def score_one(train: Described, task: Task) -> tuple[Key, Scored]:
    """The figures of one set, by its key."""
    return task.key, score(task.shapes, train, task.reference, task.draws)


def row_of(task: Task, figures: dict[str, float]) -> dict[str, Any]:
    """A row of the table."""
    key = {"arm": task.arm, "method": task.method, "draw": task.draw, "shapes": len(task.shapes)}
    return {**key, "failed": _share(task.shapes.failed, 1.0), "recognised": task.recognised, **figures}


def nearest_rows(task: Task, scored: Scored, ids: Sequence[str], train: Clouds) -> Iterator[dict[str, Any]]:
    """One row a generated shape; `ids` are theirs."""
    for shape_id, row, distance, failed in zip(ids, scored.nearest, scored.distance, task.shapes.failed, strict=True):
        nearest = "" if failed else train.ids[row]
        key = {"arm": task.arm, "method": task.method, "shape_id": shape_id}
        yield key | {"nearest": nearest, "distance": float(distance)}


def halves(reference: Described, rng: np.random.Generator) -> dict[str, Any]:
    """The figures of features between two halves of the references, as a row."""
    order = rng.permutation(len(reference))
    one, other = (reference.features[rows] for rows in np.array_split(order, 2))
    key = {"arm": REAL, "method": "halves", "draw": 0, "shapes": len(one), "failed": 0.0, "recognised": np.nan}
    return {**key, **dict.fromkeys(FIGURES, np.nan), **feature_figures(one, other)}


def sizes(sets: dict[str, Clouds], size: int, points: int) -> dict[str, Any]:
    """Sizes of the compared sets, and the noise of their points."""
    references = sets["reference"]
    fresh = sum(shape_id.startswith(FRESH) for shape_id in references.ids)
    return {
        "train": len(sets["train"]),
        "validation": len(references) - fresh,
        "drawn": fresh,
        "shapes_a_draw": size,
        "noise": resampling_noise(references.points, points),
    }


if __name__ == "__main__":
    run_stage(main, InputError)
