"""Measure the surfaces of all arms against the true ones (§4.1, §4.2).

python -m stages.evaluate data/meshes/chair data/shapes/chair data/sequences/chair data/scores/chair/arms
"""

from functools import partial
from pathlib import Path
from typing import Any

from cagesdf.cuboid import Sequence
from cagesdf.errors import ShapeRejected
from cagesdf.evaluation.reconstruction import Measured, Truth, definitions, score
from cagesdf.io.meshes import SurfaceFolder, read_surfaces
from cagesdf.io.scores import write_scores
from cagesdf.io.sequences import read_sequences
from cagesdf.io.shapes import ShapeFolder, read_shapes
from pipeline import EvaluateParams, artefact, item_rng, parallel_map, run_stage


def main(meshes: Path, shapes: Path, sequences: Path, out: Path, params: EvaluateParams) -> None:
    """Read all `meshes/`, `shapes/` and `sequences/` of a category, write `scores/`: one row a surface and seed."""
    arms = artefact.inside(meshes, "meshes")
    inputs = {"shapes": shapes, "sequences": sequences}
    manifests = {name: folder / artefact.MANIFEST for name, folder in arms.items()}
    with artefact.write("scores", out, inputs=inputs, params=params, foreign=manifests) as folder:
        surfaces = {name: read_surfaces(path) for name, path in arms.items()}
        cages = read_sequences(sequences)
        keys = sorted({key for of_arm in surfaces.values() for key in of_arm.rows})
        measure = partial(score_surfaces, surfaces, read_shapes(shapes), params)
        todo = [(cages[shape_id], step) for shape_id, step in keys]
        rows, _ = parallel_map(measure, todo, rejects=ShapeRejected, label="evaluate")
        about = definitions(params.points, params.volume_points, params.detail, params.seeds)
        write_scores(folder, (row for some in rows for row in some), about)


def score_surfaces(
    surfaces: dict[str, SurfaceFolder], shapes: ShapeFolder, params: EvaluateParams, item: tuple[Sequence, int]
) -> list[dict[str, Any]]:
    """One row an arm and seed for one step of one shape."""
    sequence, step = item
    key = {"shape_id": sequence.shape_id, "step": step, "held_out": sequence.held_out[step]}
    truth = Truth.of(shapes.read(sequence.shape_id), sequence, step, params.detail)
    rows = []
    for arm, folder in surfaces.items():
        if (sequence.shape_id, step) in folder.rows:
            mesh = folder.read(sequence.shape_id, step).mesh
            predicted = Measured(mesh) if len(mesh.faces) else None
            for seed in params.seeds:
                rng = item_rng(seed, "evaluate", sequence.shape_id, step)
                figures = score(predicted, truth, params.points, params.volume_points, rng)
                rows.append({"arm": arm, **key, "seed": seed, **figures})
    return rows


if __name__ == "__main__":
    run_stage(main)
