"""Measure an arm's surfaces against the true ones (§4.1, §4.2).

python -m stages.evaluate data/meshes/chair/cagesdf data/shapes/chair data/sequences/chair data/scores/chair/cagesdf
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
    """Read `meshes/`, `shapes/` and `sequences/`, write `scores/`: one row a surface and seed."""
    inputs = {"meshes": meshes, "shapes": shapes, "sequences": sequences}
    with artefact.write("scores", out, inputs=inputs, params=params) as folder:
        surfaces, cages = read_surfaces(meshes), read_sequences(sequences)
        todo = [(cages[shape_id], step) for shape_id, step in surfaces.rows]
        measure = partial(score_surface, surfaces, read_shapes(shapes), params)
        rows, _ = parallel_map(measure, todo, rejects=ShapeRejected, label="evaluate")
        about = definitions(params.points, params.volume_points, params.detail, params.seeds)
        write_scores(folder, ({"arm": meshes.name, **row} for some in rows for row in some), about)


def score_surface(
    surfaces: SurfaceFolder, shapes: ShapeFolder, params: EvaluateParams, item: tuple[Sequence, int]
) -> list[dict[str, Any]]:
    """One row a seed for one step of one shape."""
    sequence, step = item
    key = {"shape_id": sequence.shape_id, "step": step, "held_out": sequence.held_out[step]}
    truth = Truth.of(shapes.read(sequence.shape_id), sequence, step, params.detail)
    mesh = surfaces.read(sequence.shape_id, step).mesh
    predicted = Measured(mesh) if len(mesh.faces) else None
    rows = []
    for seed in params.seeds:
        rng = item_rng(seed, "evaluate", sequence.shape_id, step)
        rows.append({**key, "seed": seed, **score(predicted, truth, params.points, params.volume_points, rng)})
    return rows


if __name__ == "__main__":
    run_stage(main)
