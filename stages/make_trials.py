"""Make edits whose true outcome is known, and measure on them what needs no network.

python -m stages.make_trials data/raw/chair data/shapes/chair data/sequences/chair data/trials/chair
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from cagesdf.cuboid import Cage, Sequence
from cagesdf.deformation.sequences import deform_shape
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.edits import Row, definitions, edit_row, measure, with_gains
from cagesdf.evaluation.surfaces import Truth
from cagesdf.evaluation.swaps import keep_warp, kept_parts, mix_trials, swap_trials, swaps_of
from cagesdf.evaluation.trials import Trial, bent_trial, beyond_trials, local_trials, rest_trial
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import union
from cagesdf.io.edits import write_edits
from cagesdf.io.sequences import read_sequences
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.io.trials import write_trials
from cagesdf.seeds import draw, item_rng
from cagesdf.shape import Shape
from cagesdf.synthesis.recipe import Recipe
from cagesdf.synthesis.writing import read_recipes
from pipeline import TrialsParams, artefact, parallel_map, run_stage
from pipeline.cost import Cost, trials

COST = Cost("trials", trials, {"swaps": 0, "mixes": 0})  # so few shapes may have none


def main(raw: Path, shapes: Path, sequences: Path, out: Path, params: TrialsParams) -> None:
    """Read `shapes/`, `sequences/` and the recipes in `raw`, write `trials/`; swaps and mixes need recipes."""
    inputs = {"shapes": shapes, "sequences": sequences}
    with artefact.write("trials", out, inputs=inputs, foreign={"raw": raw}, params=params) as folder:
        source, cages, recipes = read_shapes(shapes), read_sequences(sequences), read_recipes(raw)
        pairs = {f"{a}/{b}": (a, b) for a, b in swaps_of(recipes, cages)}
        swapped = [pairs[name] for name in draw(params.seed, pairs, params.swaps)]
        mixed = [pairs[name] for name in draw(params.seed, pairs, params.mixes)]
        edited = draw(params.seed, cages, params.shapes)
        swap = partial(styled_one, partial(swaps_compared, recipes), source, cages, params)
        mix = partial(styled_one, partial(mixes_compared, recipes), source, cages, params)
        edit = partial(edit_one, source, cages, params)
        swaps, _ = parallel_map(swap, swapped, rejects=ShapeRejected, label="make_trials, swaps")
        mixes, _ = parallel_map(mix, mixed, rejects=ShapeRejected, label="make_trials, mixes")
        edits, _ = parallel_map(edit, edited, rejects=ShapeRejected, label="make_trials, others")
        styled = [item for items in (*swaps, *mixes) for item in items]
        made = [*styled, *(item for items, _ in edits for item in items)]
        skipped = sum(count for _, count in edits)
        about = definitions(params.points, params.detail, params.seed)
        write_trials(folder, [trial for trial, _ in made], about, skipped)
        write_edits(folder / "references.parquet", [row for _, rows in made for row in rows], about)
        drawn = f"{len(swaps)} swaps of {len(pairs)}, {sum(map(bool, mixes))} mixes"
        print(f"{drawn}, {len(made) - len(styled)} other trials; {skipped} left out: too thin")


Compared = list[
    tuple[Trial, dict[str, Mesh]]
]  # trials, and by name the surfaces measured on each beside the unchanged one


def styled_one(
    compared: Callable[[Shape, Cage, Shape, Cage, np.random.Generator], Compared],
    source: ShapeFolder,
    cages: Mapping[str, Sequence],
    params: TrialsParams,
    pair: tuple[str, str],
) -> list[tuple[Trial, list[Row]]]:
    """The trials that `compared` makes of a shape's cuboids and another's style, with their references."""
    shape, styled = (source.read(shape_id) for shape_id in pair)
    cage, styled_cage = (cages[shape_id].cages[0] for shape_id in pair)
    trials = compared(shape, cage, styled, styled_cage, item_rng(params.seed, "mix", *pair))
    if not trials:
        return []
    unchanged = union([part.mesh for part in shape.parts])
    return [(trial, measured(trial, {"unchanged": unchanged, **surfaces}, params)) for trial, surfaces in trials]


def swaps_compared(
    recipes: Mapping[str, Recipe], shape: Shape, cage: Cage, styled: Shape, styled_cage: Cage, rng: np.random.Generator
) -> Compared:
    """The style in all parts, against both truths."""
    swap, warp = swap_trials(shape, cage, styled, styled_cage, recipes)
    kept = union(keep_warp(styled, styled_cage, shape, cage)[0])
    return [(swap, {"box_warp": warp.truth, "keep_warp": kept}), (warp, {})]


def mixes_compared(
    recipes: Mapping[str, Recipe], shape: Shape, cage: Cage, styled: Shape, styled_cage: Cage, rng: np.random.Generator
) -> Compared:
    """The style in the parts of one label, which is drawn, and once more with details that keep their size."""
    trials = mix_trials(shape, cage, styled, styled_cage, recipes, rng)
    if not trials:
        return []
    mix, warp, keep = trials
    kept = union(list(kept_parts(styled, styled_cage, shape, cage, keep.part_id.split("|"))))
    return [(mix, {"box_warp": warp.truth}), (warp, {}), (keep, {"keep_warp": kept})]


def edit_one(
    source: ShapeFolder, cages: Mapping[str, Sequence], params: TrialsParams, shape_id: str
) -> tuple[list[tuple[Trial, list[Row]]], int]:
    """All trials of a shape in its own style, with their references, and how many were left out."""
    shape, sequence = source.read(shape_id), cages[shape_id]
    rest = rest_trial(shape, sequence.cages[0])
    rng = item_rng(params.seed, "local", shape_id)
    local = local_trials(shape, sequence.cages[0], params.local, params.resize, params.move, rng)
    beyond, skipped = beyond_trials(shape, sequence, params.beyond)
    bent = bent_trial(shape, sequence, params.blend)
    warped = union(deform_shape(shape, sequence.cages[0], bent.cage))
    # For local edits and sequences box_warp is the truth, which is measured once, at rest.
    compared: Compared = [
        (rest, {"ground_truth": rest.truth}),
        *((trial, {}) for trial in local),
        *((trial, {"unchanged": rest.truth}) for trial in beyond),
        (bent, {"unchanged": rest.truth, "box_warp": warped}),
    ]
    return [(trial, measured(trial, surfaces, params)) for trial, surfaces in compared], skipped


def measured(trial: Trial, surfaces: Mapping[str, Mesh], params: TrialsParams) -> list[Row]:
    """One row per surface, by the name of its method."""
    truth = Truth(trial.truth, trial.cage, params.detail)
    rows = []
    for arm, surface in surfaces.items():
        rng = item_rng(params.seed, "measure", trial.trial_id)
        rows.append(edit_row(arm, trial, measure(surface, trial, truth, params.points, rng)))
    return with_gains(rows, rows)


if __name__ == "__main__":
    run_stage(main, InputError)
