"""Extract the surfaces of a trained arm: source shapes, and held-out steps of others (§3.6).

python -m stages.extract_meshes data/runs/chair/cagesdf data/meshes/chair/cagesdf
"""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import torch

from cagesdf.errors import InputError
from cagesdf.extraction import LOOSE, extract, field_of
from cagesdf.io.meshes import Surface, write_surfaces
from cagesdf.io.runs import read_run
from cagesdf.run import Run
from cagesdf.seeds import draw
from pipeline import ExtractParams, artefact, progress, run_stage
from pipeline.cost import Cost, surfaces
from pipeline.executor import workers

COST = Cost("surfaces", surfaces, {"sources": 1, "held_out": 1})


def main(run: Path, out: Path, params: ExtractParams) -> None:
    """Read `run`, write `meshes/`: every surface closed, manifold and within its cuboids, or without faces."""
    with artefact.write("meshes", out, inputs={"run": run}, params=params) as folder:
        trained = read_run(run)
        todo = [(shape_id, 0) for shape_id in draw(params.seed, trained.sequences, params.sources)]
        for shape_id in draw(params.seed, trained.sequences, params.held_out):
            held_out = trained.sequences[shape_id].held_out
            # Where each deformed shape has its own latent, there is none for a step that was not trained on.
            todo += [(shape_id, step) for step in trained.steps(shape_id) if held_out[step]]
        torch.set_num_threads(1)  # a thread a surface: torch's own would wait for each other on a busy machine
        with ThreadPoolExecutor(workers()) as pool:
            surfaces = pool.map(partial(surface_of, trained, params), todo)
            write_surfaces(folder, iter(progress(surfaces, len(todo), "extract_meshes")))


def surface_of(run: Run, params: ExtractParams, item: tuple[str, int]) -> Surface:
    """The surface of one step of one shape."""
    shape_id, step = item
    sequence = run.sequences[shape_id]
    field = field_of(run.decoder, run.latent(shape_id, step), sequence.cages[step])
    try:
        extraction = extract(field, params.resolution, loose=LOOSE[params.loose])
    except ValueError as error:
        error.add_note(f"shape {shape_id}, step {step}")
        raise
    return Surface(
        shape_id,
        step,
        sequence.held_out[step],
        extraction.mesh,
        extraction.clipped,
        extraction.evaluations,
        run.similarities[shape_id],
        extraction.components,
        extraction.dropped,
        extraction.overshoot,
    )


if __name__ == "__main__":
    run_stage(main, InputError)
