"""Try all arms on edits whose true outcome is known.

python -m stages.evaluate_edits data/runs/chair data/trials/chair data/edits/chair
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import torch

from cagesdf.editing.script import Details, Mix
from cagesdf.editing.session import Session, state_field
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.edits import Row, edit_row, locality, measure, with_gains
from cagesdf.evaluation.surfaces import Truth
from cagesdf.evaluation.trials import MIXES, Trial
from cagesdf.extraction import LOOSE, CageField, LiveSurface, field_of
from cagesdf.geometry.meshes import Mesh
from cagesdf.io.edits import read_edits, write_edit_surfaces, write_edits
from cagesdf.io.runs import read_run
from cagesdf.io.trials import TrialFolder, read_trials
from cagesdf.run import Run
from cagesdf.seeds import item_rng
from pipeline import EditsParams, artefact, parallel_map, run_stage
from pipeline.cost import Cost, trials

Surfaces = dict[tuple[str, str], Mesh]  # by arm and trial

SHOWN = ("swap", "mix", "mix_keep")  # kinds of trials whose surfaces are kept for the report

COST = Cost("trials", trials)


def main(runs: Path, trials: Path, out: Path, params: EditsParams) -> None:
    """Read the runs of a category and `trials/`, write `edits/`; an arm that has no cuboids to edit gets no row."""
    folders = artefact.inside(runs, params.arms, "run", params.format)
    manifests = {arm: folder / artefact.MANIFEST for arm, folder in folders.items()}
    with artefact.write("edits", out, inputs={"trials": trials}, params=params, foreign=manifests) as folder:
        arms = {arm: run for arm, path in folders.items() if (run := read_run(path)).decoder.trains_on != "cube"}
        source = read_trials(trials)
        of_shape: dict[str, list[str]] = {}
        # Trials of one style follow each other: a swap's surface is asked once for both of its truths.
        for trial_id, row in sorted(source.rows.items(), key=lambda item: (item[1]["style_of"], item[0])):
            of_shape.setdefault(row["shape_id"], []).append(trial_id)
        try_some = partial(try_arms, arms, source, params)
        done, _ = parallel_map(try_some, list(of_shape.values()), rejects=ShapeRejected, label="evaluate_edits")
        references, about = read_edits(trials / "references.parquet")
        write_edits(folder / "edits.parquet", with_gains([row for rows, _ in done for row in rows], references), about)
        write_edit_surfaces(folder, {key: mesh for _, surfaces in done for key, mesh in surfaces.items()})


def try_arms(
    arms: Mapping[str, Run], source: TrialFolder, params: EditsParams, trial_ids: list[str]
) -> tuple[list[Row], Surfaces]:
    """Rows of all arms in all trials of one shape, and their surfaces in its swaps and mixes.

    An arm whose parts have no codes has no mixes.
    """
    torch.set_num_threads(1)  # a thread a process, also where all is done in this one
    about = source.definitions
    trials = [source.read(trial_id) for trial_id in trial_ids]
    # One for all trials of a shape: cuboids that an edit leaves as they are need not be asked again.
    live = {arm: LiveSurface(params.resolution, loose=LOOSE[params.loose]) for arm in arms}
    surfaces = {
        (arm, trial.trial_id): surface_of(run, live[arm], trial)
        for arm, run in arms.items()
        for trial in trials
        if trial.kind not in MIXES or run.decoder.code_dim is not None
    }
    rest = next((trial for trial in trials if trial.kind == "rest"), None)
    rows = []
    for trial in trials:
        truth = Truth(trial.truth, trial.cage, about["detail"])
        for arm in [arm for arm in arms if (arm, trial.trial_id) in surfaces]:
            surface = surfaces[arm, trial.trial_id]
            rng = item_rng(about["seed"], "measure", trial.trial_id)
            figures = measure(surface, trial, truth, about["points"], rng)
            if trial.kind == "local" and rest is not None:
                before = surfaces[arm, rest.trial_id]
                figures |= locality(before, surface, rest.cage, trial, truth, about["points"], rng)
            rows.append(edit_row(arm, trial, figures))
    shown = {trial.trial_id for trial in trials if trial.kind in SHOWN}
    return rows, {(arm, trial_id): mesh for (arm, trial_id), mesh in surfaces.items() if trial_id in shown}


def surface_of(run: Run, live: LiveSurface, trial: Trial) -> Mesh:
    """The surface that an arm gives for a trial's cuboids and style."""
    try:
        return live.surface(trial_field(run, trial)).mesh
    except ValueError as error:
        error.add_note(f"trial {trial.trial_id}")
        raise


def trial_field(run: Run, trial: Trial) -> CageField:
    """The arm's field in a trial: the style of the whole shape, or of the parts that are mixed."""
    if trial.kind in MIXES:
        session = Session(run)
        details: Details = "keep" if trial.kind == "mix_keep" else "stretch"
        mix = Mix(part=trial.part_id, style_of=trial.style_of, mirror=False, repeat=False, details=details)
        return state_field(run, session.edited(session.opened(trial.shape_id), (mix,)).present)
    rest = run.sequences[trial.shape_id].cages[0]  # edits keep the codes that parts have there
    return field_of(run.decoder, run.latent(trial.style_of, 0), trial.cage, rest)


if __name__ == "__main__":
    run_stage(main, InputError)
