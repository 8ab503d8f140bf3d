"""Measure the surfaces that arms would have given while they trained: how long training must be.

python -m stages.evaluate_progress data/runs/chair data/shapes/chair data/sequences/chair data/progress/chair
"""

from functools import partial
from pathlib import Path
from typing import Any

import torch

from cagesdf.deformation.sequences import Transfer
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.metrics import PROGRESS
from cagesdf.evaluation.reconstruction import definitions, point_figures
from cagesdf.evaluation.surfaces import Measured, Truth
from cagesdf.extraction import extract_surface, field_of
from cagesdf.io.points import CHUNK
from cagesdf.io.progress import write_progress
from cagesdf.io.runs import read_run, read_snapshot, snapshots_of
from cagesdf.io.sequences import read_transfers
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.run import Run
from cagesdf.seeds import draw, item_rng
from pipeline import ProgressParams, artefact, parallel_map, run_stage
from pipeline.cost import Cost, Counts, Sections


def surfaces(sections: Sections, arm: str) -> int:
    """Surfaces of an arm: after each snapshot and at the end."""
    shapes = min(sections["evaluate_progress"].shapes, Counts.of(sections).sequences)
    return shapes * (1 + len(sections["train"].snapshots))


COST = Cost("surfaces", surfaces)


def main(runs: Path, shapes: Path, sequences: Path, out: Path, params: ProgressParams) -> None:
    """Read the runs of all arms with their snapshots, `shapes/` and `sequences/`, write `progress/`."""
    arms = artefact.inside(runs, params.arms, "run", params.format)
    manifests = {arm: folder / artefact.MANIFEST for arm, folder in arms.items()}
    inputs = {"shapes": shapes, "sequences": sequences}
    with artefact.write("progress", out, inputs=inputs, foreign=manifests, params=params) as folder:
        drawn = {run: draw(params.seed, read_run(run).sequences, params.shapes) for run in arms.values()}
        transfers = read_transfers(sequences, {shape_id for ids in drawn.values() for shape_id in ids})
        todo = [(run, shape_id, transfers[shape_id]) for run, ids in drawn.items() for shape_id in ids]
        measure = partial(progress_of, read_shapes(shapes), params)
        rows, _ = parallel_map(measure, todo, rejects=ShapeRejected, label="evaluate_progress")
        about = definitions(params.points, params.detail, (params.seed,)) | {"resolution": params.resolution}
        write_progress(folder, (row for batch in rows for row in batch), about)


def progress_of(shapes: ShapeFolder, params: ProgressParams, item: tuple[Path, str, Transfer]) -> list[dict[str, Any]]:
    """One row a snapshot of a run, the last of all its training, for one shape.

    Measured is its first held-out step, or its rest shape where that alone has a latent.
    """
    folder, shape_id, transfer = item
    torch.set_num_threads(1)
    trained = read_run(folder)
    sequence = trained.sequences[shape_id]
    step = next((step for step in trained.steps(shape_id) if sequence.held_out[step]), 0)
    truth = Truth.of(shapes.read(shape_id), sequence, step, params.detail, transfer)
    snapshots = {steps: read_snapshot(folder, steps) for steps in snapshots_of(folder)}
    drawn = truth.drawn(params.points, item_rng(params.seed, "truth", shape_id))
    rows = []
    for steps, run in (snapshots | {trained.params["steps"]: trained}).items():
        predicted = surface(run, shape_id, step, params)
        rng = item_rng(params.seed, "evaluate_progress", shape_id)
        figures = point_figures(predicted, truth, drawn, rng)
        points = steps * trained.params["batch_chunks"] * CHUNK
        key = {
            "arm": folder.name,
            "points": points,
            "shape_id": shape_id,
            "step": step,
            "held_out": sequence.held_out[step],
        }
        rows.append(key | {name: figures[name] for name in PROGRESS})
    return rows


def surface(run: Run, shape_id: str, step: int, params: ProgressParams) -> Measured | None:
    """The run's surface for one step of one shape, ready to be measured; None without faces."""
    field = field_of(run.decoder, run.latent(shape_id, step), run.sequences[shape_id].cages[step])
    mesh = extract_surface(field, params.resolution)
    return Measured(mesh) if len(mesh.faces) else None


if __name__ == "__main__":
    run_stage(main, InputError)
