"""Measure what needs no network against the true surfaces: the cage's surface, and the true surface itself.

The first is what the networks must beat, the second the noise floor of the measurement (§4.1, §4.2).

python -m stages.evaluate_references data/shapes/chair data/sequences/chair data/scores/chair/references
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cagesdf.cuboid import Sequence
from cagesdf.errors import ShapeRejected
from cagesdf.evaluation.reconstruction import Measured, Truth, definitions, score
from cagesdf.io.scores import write_scores
from cagesdf.io.sequences import read_sequences
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.solid import cage_surface
from pipeline import EvaluateParams, ReferencesParams, artefact, draw, item_rng, parallel_map, run_stage


def main(shapes: Path, sequences: Path, out: Path, params: ReferencesParams) -> None:
    """Read `shapes/` and `sequences/`, write `scores/` of the steps that `extract_meshes` draws."""
    with artefact.write("scores", out, inputs={"shapes": shapes, "sequences": sequences}, params=params) as folder:
        cages, drawn, how = read_sequences(sequences), params.extract_meshes, params.evaluate
        todo = [(cages[shape_id], 0) for shape_id in draw(drawn.seed, cages, drawn.sources)]
        for shape_id in draw(drawn.seed, cages, drawn.held_out):
            todo += [(cages[shape_id], step) for step in np.flatnonzero(cages[shape_id].held_out).tolist()]
        rows, _ = parallel_map(
            partial(score_references, read_shapes(shapes), how),
            todo,
            rejects=ShapeRejected,
            label="evaluate_references",
        )
        about = definitions(how.points, how.volume_points, how.detail, how.seeds)
        write_scores(folder, (row for some in rows for row in some), about)


def score_references(shapes: ShapeFolder, params: EvaluateParams, item: tuple[Sequence, int]) -> list[dict[str, Any]]:
    """One row a reference and seed for one step of one shape."""
    sequence, step = item
    key = {"shape_id": sequence.shape_id, "step": step, "held_out": sequence.held_out[step]}
    truth = Truth.of(shapes.read(sequence.shape_id), sequence, step, params.detail)
    references = {"cage": Measured(cage_surface(sequence.cages[step])), "ground_truth": truth}
    rows = []
    for arm, reference in references.items():
        for seed in params.seeds:
            rng = item_rng(seed, "evaluate", sequence.shape_id, step)
            figures = score(reference, truth, params.points, params.volume_points, rng)
            rows.append({**key, "arm": arm, "seed": seed, **figures})
    return rows


if __name__ == "__main__":
    run_stage(main)
