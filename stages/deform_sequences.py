"""Interpolate each training shape's cage towards its target (§3.3).

python -m stages.deform_sequences data/shapes/chair data/cuboids/chair data/matches/chair data/sequences/chair
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from cagesdf.cuboid import Cage, Sequence
from cagesdf.deformation.matching import Match
from cagesdf.deformation.sequences import (
    KeptDetails,
    ProgramPath,
    Transfer,
    Trilinear,
    cuboid_path,
    detail_lengths,
    make_sequence,
    share_outside,
)
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.io.cuboids import read_assemblies, read_cages
from cagesdf.io.matches import read_matches
from cagesdf.io.rejected import write_rejected
from cagesdf.io.sequences import write_sequences, write_transfers
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.structure.assembly import Assembly
from pipeline import DeformParams, artefact, parallel_map, run_stage
from pipeline.cost import Cost, sequences

TRANSFERS: Mapping[str, type[Transfer]] = {"trilinear": Trilinear, "keep_details": KeptDetails}

COST = Cost("sequences", sequences)


def main(shapes: Path, cuboids: Path, matches: Path, out: Path, params: DeformParams) -> None:
    """Read `shapes/`, `cuboids/` and `matches/`, write `sequences/`; print the share of vertices left outside."""
    inputs = {"shapes": shapes, "cuboids": cuboids, "matches": matches}
    with artefact.write("sequences", out, inputs=inputs, params=params) as folder:
        todo = read_matches(matches)
        assemblies = read_assemblies(cuboids) if params.interpolation == "program" else {}
        deform = partial(deform_one, read_shapes(shapes), read_cages(cuboids), assemblies, params)
        done, rejected = parallel_map(deform, todo, rejects=ShapeRejected, label="deform_sequences", lost=lost)
        sequences = [sequence for sequence, _, _ in done]
        write_sequences(folder, sequences, {sequence.shape_id: share for sequence, _, share in done})
        write_transfers(folder, sequences, {sequence.shape_id: transfer for sequence, transfer, _ in done})
        write_rejected(folder, rejected, len(todo), params.max_rejected)
        mean = np.mean([share[1:].mean() for _, _, share in done])
        print(f"{len(done)} sequences; averaging puts {mean:.1%} of a part's vertices outside their own cuboid")


def deform_one(
    source: ShapeFolder,
    cages: Mapping[str, Cage],
    assemblies: Mapping[str, Assembly],
    params: DeformParams,
    match: Match,
) -> tuple[Sequence, Transfer, np.ndarray]:
    """A sequence, the transfer of surfaces to it, and by step and part the share of vertices outside their cuboid."""
    path: Callable[[float], Cage] = cuboid_path(match, cages)
    if match.shape_id in assemblies and match.target_id is not None:
        path = ProgramPath(assemblies[match.shape_id], assemblies[match.target_id], match.pairs)
    sequence = make_sequence(match, cages, path, params.steps, params.held_out)
    shape, target_id = source.read(sequence.shape_id), sequence.target_id or sequence.shape_id
    details = detail_lengths(sequence, shape.similarity, source.similarity(target_id))
    transfer = TRANSFERS[params.transfer].of(shape, sequence, details)
    moved = [transfer.parts(shape, sequence, step) for step in range(len(sequence.cages))]
    return sequence, transfer, np.array([share_outside(*step) for step in zip(moved, sequence.cages)])


def lost(match: Match, reason: str) -> ShapeRejected:
    """The rejection of a shape that kills its worker."""
    return ShapeRejected(match.shape_id, "deform_sequences", reason)


if __name__ == "__main__":
    run_stage(main, InputError)
