"""Gains of details that keep their size, against the recipe's truth: the tables of docs/styles.md, "Details".

    OMP_NUM_THREADS=1 python -m benchmarks.keeping [--category chair] [--swaps 40] [--seed 101]
    OMP_NUM_THREADS=1 python -m benchmarks.keeping data [--category chair] [--resolution 64] [--taught RUN …]

The first is without a network. It draws shapes that no run has (the default run's are drawn by another generator), and
swaps of cuboids and styles among them. The gain is that of docs/metrics.md: on the detail of the parts whose style
changes, 1 is the truth and 0 the shape that was left alone. Measured are

box_warp         the other shape's parts deformed into the cuboids (§3.3): what `transfer: trilinear` teaches
keep_warp        the same with details that keep their size in the files' unit: `transfer: keep_details`
keep, canonical  the same in canonical units, in which each shape's radius is 1

The second measures the default run's arm `cagesdf` on its own swaps, beside both warps:

stretch          the other shape's latent in these cuboids: `swap`
keep             all parts of the other shape, resized with their details kept: `mix` with `details: keep`
taught           the latents of runs that were trained on sequences which keep details, by folder
"""

import argparse
from collections.abc import Iterable
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch

from cagesdf.cuboid import Cage, Sequence
from cagesdf.editing.script import Mix, Operation, Swap
from cagesdf.editing.session import Session
from cagesdf.evaluation.edits import measure
from cagesdf.evaluation.surfaces import Truth
from cagesdf.evaluation.swaps import box_warp, keep_warp, swap_trials, swaps_of
from cagesdf.evaluation.trials import Trial
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import union
from cagesdf.importing import import_shape
from cagesdf.io.edits import read_edits
from cagesdf.io.runs import read_run
from cagesdf.io.trials import read_trials
from cagesdf.shape import RawShape, Shape
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


def network_gains(data: Path, category: str, resolution: int, taught: Iterable[Path]) -> list[dict[str, float]]:
    """For each swap of a run's trials the gains of both warps, of the arm `cagesdf`, and of the runs `taught`."""
    trials = read_trials(data / "trials" / category)
    rows, about = read_edits(data / "trials" / category / "references.parquet")
    references = {(row["arm"], row["trial_id"]): row for row in rows}
    arms = {"": data / "runs" / category / "cagesdf", **{folder.name: folder for folder in taught}}
    sessions = {name: Session(read_run(folder)) for name, folder in arms.items()}
    live = {name: session.live(resolution) for name, session in sessions.items()}

    def gain(name: str, operation: Operation, trial: Trial) -> float:
        session = sessions[name]
        surface = live[name].surface(session.edited(session.opened(trial.shape_id), (operation,)).present).mesh
        truth = Truth(trial.truth, trial.cage, about["detail"])
        figures = measure(surface, trial, truth, about["points"], np.random.default_rng(0))
        return 1 - figures["distance_detail"] / references["unchanged", trial.trial_id]["distance_detail"]

    result = []
    for trial_id in [trial_id for trial_id, row in trials.rows.items() if row["kind"] == "swap"]:
        trial = trials.read(trial_id)
        swap = Swap(style_of=trial.style_of)
        row = {name: references[name, trial_id]["gain"] for name in ("box_warp", "keep_warp")}
        row["stretch"] = gain("", swap, trial)
        row["keep"] = gain("", Mix(part="*", style_of=trial.style_of, details="keep"), trial)
        result.append(row | {f"taught: {name}": gain(name, swap, trial) for name in sessions if name})
    return result


def warp_gains(category: str, swaps: int, seed: int) -> list[dict[str, float]]:
    """The gains of warps in swaps of freshly drawn shapes."""
    rng = np.random.default_rng(seed)
    recipes = {recipe.shape_id: recipe for recipe in draw_recipes(category, TRAIN, 0, rng)}
    no_steps = {name: Sequence(name, None, np.zeros(1), (False,), (Cage.of({}),)) for name in recipes}
    shape_of = cache(lambda name: imported(recipes[name]))
    return [
        gains(*shape_of(a), *shape_of(b), recipes)
        for a, b in rng.permutation(swaps_of(recipes, no_steps)).tolist()[:swaps]
    ]


def show(category: str, rows: list[dict[str, float]]) -> None:
    """Print the table."""
    print(f"{category}: {len(rows)} swaps\n")
    print("| warp | median | quartiles | nearer than the unchanged shape | than box_warp |")
    print("|---|---|---|---|---|")
    for name in rows[0]:
        of_warp, of_box = (np.array([row[key] for row in rows]) for key in (name, "box_warp"))
        low, middle, high = np.quantile(of_warp, [0.25, 0.5, 0.75])
        nearer = int((of_warp > 0).sum()), int((of_warp > of_box).sum())
        print(f"| {name} | {middle:.2f} | {low:.2f} to {high:.2f} | {nearer[0]} | {nearer[1]} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--category", default="chair")
    parser.add_argument("--swaps", type=int, default=40)
    parser.add_argument("--seed", type=int, default=101)
    parser.add_argument("--resolution", type=int, default=64)
    parser.add_argument("--taught", type=Path, nargs="+", default=[])
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.data:
        show(options.category, network_gains(options.data, options.category, options.resolution, options.taught))
    else:
        show(options.category, warp_gains(options.category, options.swaps, options.seed))
