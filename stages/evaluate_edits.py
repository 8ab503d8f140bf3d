"""Try an arm on edits whose true outcome is known.

python -m stages.evaluate_edits data/runs/chair/cagesdf data/trials/chair data/edits/chair/cagesdf
"""

import time
from functools import partial
from pathlib import Path

import torch

from cagesdf.errors import ShapeRejected
from cagesdf.evaluation.edits import Row, edit_row, locality, measure, with_gains
from cagesdf.evaluation.reconstruction import Truth
from cagesdf.evaluation.trials import Trial
from cagesdf.extraction import FIELDS, LOOSE, METHODS, OUTSIDES, OVERLAPS, extract
from cagesdf.io.edits import read_edits, write_edit_surfaces, write_edits
from cagesdf.io.runs import Run, read_run
from cagesdf.io.trials import TrialFolder, read_trials
from cagesdf.meshes import Mesh
from pipeline import EditsParams, artefact, item_rng, parallel_map, run_stage


def main(run: Path, trials: Path, out: Path, params: EditsParams) -> None:
    """Read `run` and `trials/`, write `edits/`; an arm that has no cuboids to edit gets no row."""
    started = time.perf_counter()
    with artefact.write("edits", out, inputs={"run": run, "trials": trials}, params=params) as folder:
        trained, source = read_run(run), read_trials(trials)
        shapes: dict[str, list[str]] = {}
        for trial_id, row in source.rows.items():
            shapes.setdefault(row["shape_id"], []).append(trial_id)
        todo = list(shapes.values()) if trained.params["points_of"] == "cage" else []
        try_some = partial(try_arm, run.name, trained, source, params)
        torch.set_num_threads(1)  # a thread a process, also where all is done in this one
        done, _ = parallel_map(try_some, todo, rejects=ShapeRejected, label="evaluate_edits")
        references, about = read_edits(trials / "references.parquet")
        rows = with_gains([row for some, _ in done for row in some], references)
        write_edits(folder / "edits.parquet", rows, about)
        write_edit_surfaces(folder, {name: mesh for _, some in done for name, mesh in some.items()})
    print(f"{run.name}: {len(rows)} trials in {time.perf_counter() - started:.1f} s")


def try_arm(
    arm: str, run: Run, source: TrialFolder, params: EditsParams, trial_ids: list[str]
) -> tuple[list[Row], dict[str, Mesh]]:
    """Rows of all trials of one shape, and the surfaces of its swaps."""
    about = source.definitions
    trials = [source.read(trial_id) for trial_id in trial_ids]
    surfaces = {trial.trial_id: surface_of(run, params, trial) for trial in trials}
    rest = next((trial for trial in trials if trial.kind == "rest"), None)
    rows = []
    for trial in trials:
        surface = surfaces[trial.trial_id]
        truth = Truth(trial.truth, trial.cage, about["detail"])
        rng = item_rng(about["seed"], "measure", trial.trial_id)
        figures = measure(surface, trial, truth, about["points"], rng)
        if trial.kind == "local" and rest is not None:
            figures |= locality(surfaces[rest.trial_id], surface, rest.cage, trial, truth, about["points"], rng)
        rows.append(edit_row(arm, trial, figures))
    return rows, {trial.trial_id: surfaces[trial.trial_id] for trial in trials if trial.kind == "swap"}


def surface_of(run: Run, params: EditsParams, trial: Trial) -> Mesh:
    """What the arm makes of a trial's cuboids and style."""
    make_field, outside, overlap = FIELDS[run.params["points_of"]], OUTSIDES[params.outside], OVERLAPS[params.overlap]
    field = make_field(run.decoder, run.latent(trial.style_of, 0), trial.cage, outside, overlap)
    try:
        return extract(field, params.resolution, METHODS["sparse"], LOOSE[params.loose]).mesh
    except ValueError as error:
        error.add_note(f"trial {trial.trial_id}")
        raise


if __name__ == "__main__":
    run_stage(main)
