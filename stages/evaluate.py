"""Measure the surfaces of all arms, and what needs no network, against the true ones (§4.1, §4.2).

The latter are the cage's surface, which the networks must beat, and the true surface itself: the noise floor.

python -m stages.evaluate data/meshes/chair data/shapes/chair data/sequences/chair data/scores/chair
"""

from functools import partial
from pathlib import Path
from typing import Any

from cagesdf.cuboid import Sequence
from cagesdf.deformation.sequences import Transfer
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.reconstruction import as_own, definitions, own_figures, score
from cagesdf.evaluation.surfaces import Measured, Truth
from cagesdf.geometry.solid import cage_surface
from cagesdf.io.meshes import SurfaceFolder, read_surfaces
from cagesdf.io.scores import write_scores
from cagesdf.io.sequences import read_sequences, read_transfers
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.seeds import item_rng
from pipeline import EvaluateParams, artefact, parallel_map, run_stage
from pipeline.cost import Cost, surfaces

COST = Cost("surfaces", surfaces)


def main(meshes: Path, shapes: Path, sequences: Path, out: Path, params: EvaluateParams) -> None:
    """Read each arm's `meshes/`, `shapes/` and `sequences/`, write `scores/`: one row a surface and seed."""
    arms = artefact.inside(meshes, params.arms, "meshes", params.format)
    inputs = {"shapes": shapes, "sequences": sequences}
    manifests = {name: folder / artefact.MANIFEST for name, folder in arms.items()}
    with artefact.write("scores", out, inputs=inputs, params=params, foreign=manifests) as folder:
        surfaces = {name: read_surfaces(path) for name, path in arms.items()}
        cages = read_sequences(sequences)
        transfers = read_transfers(sequences, cages)
        keys = sorted({key for of_arm in surfaces.values() for key in of_arm.rows})
        measure = partial(score_surfaces, surfaces, read_shapes(shapes), params)
        todo = [(cages[shape_id], transfers[shape_id], step) for shape_id, step in keys]
        rows, _ = parallel_map(measure, todo, rejects=ShapeRejected, label="evaluate")
        about = definitions(params.points, params.detail, params.seeds)
        write_scores(folder, (row for batch in rows for row in batch), about)


def score_surfaces(
    arms: dict[str, SurfaceFolder], shapes: ShapeFolder, params: EvaluateParams, item: tuple[Sequence, Transfer, int]
) -> list[dict[str, Any]]:
    """One row an arm or reference and seed for one step of one shape."""
    sequence, transfer, step = item
    shape_id = sequence.shape_id
    key = {"shape_id": shape_id, "step": step, "held_out": sequence.held_out[step]}
    truth = Truth.of(shapes.read(shape_id), sequence, step, params.detail, transfer)
    surfaces: dict[str, Measured | None] = {"cage": Measured(cage_surface(sequence.cages[step])), "ground_truth": truth}
    for arm, folder in arms.items():
        if (shape_id, step) in folder.rows:
            mesh = folder.read(shape_id, step).mesh
            surfaces[arm] = Measured(mesh) if len(mesh.faces) else None
    own_truth = Truth.of_own_cuboids(shapes.read(shape_id), sequence, step, params.detail, transfer) if step else None
    rows = []
    for seed in params.seeds:
        drawn = truth.drawn(params.points, item_rng(seed, "truth", shape_id, step))
        drawn_own = own_truth.drawn(params.points, item_rng(seed, "truth", shape_id, step)) if own_truth else drawn
        for arm, surface in surfaces.items():
            figures = score(surface, truth, drawn, item_rng(seed, "evaluate", shape_id, step))
            own_rng = item_rng(seed, "evaluate", shape_id, step)
            figures |= own_figures(surface, own_truth, drawn_own, own_rng) if own_truth else as_own(figures)
            rows.append({"arm": arm, **key, "seed": seed, **figures})
    return rows


if __name__ == "__main__":
    run_stage(main, InputError)
