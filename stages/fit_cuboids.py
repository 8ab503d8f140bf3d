"""Fit one minimum-volume cuboid to every part of every shape (§3.2).

python -m stages.fit_cuboids data/shapes/chair data/cuboids/chair
"""

from functools import partial
from pathlib import Path

import numpy as np

from cagesdf.cuboid import Cage
from cagesdf.errors import ShapeRejected
from cagesdf.fitting import fit_cage
from cagesdf.io.cuboids import write_cuboids
from cagesdf.io.rejected import write_rejected
from cagesdf.io.shapes import ShapeFolder, read_shapes
from pipeline import FitParams, artefact, parallel_map, run_stage


def main(shapes: Path, out: Path, params: FitParams) -> None:
    """Read `shapes/`, write `cuboids/`."""
    with artefact.write("cuboids", out, inputs={"shapes": shapes}, params=params) as folder:
        source = read_shapes(shapes)

        fit = partial(fit_one, source, params)
        fitted, rejected = parallel_map(fit, source.ids, rejects=ShapeRejected, label="fit_cuboids")
        write_cuboids(folder, dict(fitted))
        write_rejected(folder, rejected, len(source), params.max_rejected)


def fit_one(source: ShapeFolder, params: FitParams, shape_id: str) -> tuple[str, tuple[Cage, np.ndarray]]:
    """A shape's id, and its cage with the overshoot of each part."""
    return shape_id, fit_cage(source.read(shape_id), params.slack, params.min_size, params.margin)


if __name__ == "__main__":
    run_stage(main)
