"""Interpolate each training shape's cage towards its target (§3.3).

python -m stages.deform_sequences data/shapes/chair data/cuboids/chair data/matches/chair data/sequences/chair
"""

from functools import partial
from pathlib import Path

import numpy as np

from cagesdf.cuboid import Sequence
from cagesdf.deformation import deform_shape, make_sequence, share_outside
from cagesdf.errors import ShapeRejected
from cagesdf.io.cuboids import read_cages
from cagesdf.io.matches import read_matches
from cagesdf.io.sequences import write_sequences
from cagesdf.io.shapes import ShapeFolder, read_shapes
from pipeline import DeformParams, artefact, parallel_map, run_stage


def main(shapes: Path, cuboids: Path, matches: Path, out: Path, params: DeformParams) -> None:
    """Read `shapes/`, `cuboids/` and `matches/`, write `sequences/`; print the share of vertices left outside."""
    inputs = {"shapes": shapes, "cuboids": cuboids, "matches": matches}
    with artefact.write("sequences", out, inputs=inputs, params=params) as folder:
        source, cages = read_shapes(shapes), read_cages(cuboids)

        sequences = [make_sequence(match, cages, params.steps, params.held_out) for match in read_matches(matches)]
        measure = partial(measure_outside, source)
        shares, _ = parallel_map(measure, sequences, rejects=ShapeRejected, label="deform_sequences")
        write_sequences(folder, sequences, {s.shape_id: share for s, share in zip(sequences, shares)})
        mean = np.mean([share[1:].mean() for share in shares])
        print(f"{len(sequences)} sequences; averaging puts {mean:.1%} of a part's vertices outside their own cuboid")


def measure_outside(source: ShapeFolder, sequence: Sequence) -> np.ndarray:
    """For each step and part, the share of the part's vertices outside their own cuboid."""
    shape, rest = source.read(sequence.shape_id), sequence.cages[0]
    return np.array([share_outside(deform_shape(shape, rest, cage), cage) for cage in sequence.cages])


if __name__ == "__main__":
    run_stage(main)
