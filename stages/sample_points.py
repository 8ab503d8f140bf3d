"""Sample signed distances of every training step of every sequence (§3.4), to whole shapes and to their parts.

python -m stages.sample_points data/shapes/chair data/sequences/chair data/points/chair
"""

from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np

from cagesdf.cuboid import Sequence
from cagesdf.deformation.sequences import Transfer, solids_in_cuboids
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.solid import union
from cagesdf.io.points import PointChunks, PointsOf, join_chunks, shard_path, write_shard
from cagesdf.io.rejected import write_rejected
from cagesdf.io.sequences import read_sequences, read_transfers
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.sampling.chunks import PointCounts, part_chunks, shape_chunks
from cagesdf.seeds import item_rng
from pipeline import SampleParams, artefact, parallel_groups, run_stage
from pipeline.cost import Cost, Counts

KINDS: tuple[PointsOf, ...] = ("shape", "part")

COST = Cost(
    "deformed shapes",
    lambda sections, arm: Counts.of(sections).deformed,
    {"shards": 1},
    held=lambda sections, size: size // sections["sample_points"].shards,  # a shard is mixed in memory
)


def main(shapes: Path, sequences: Path, out: Path, params: SampleParams) -> None:
    """Read `shapes/` and `sequences/`, write `points/`, a shard at a time."""
    with artefact.write("points", out, inputs={"shapes": shapes, "sequences": sequences}, params=params) as folder:
        of_shape = read_sequences(sequences)
        transfers = read_transfers(sequences, of_shape)
        todo = [(sequence, transfers[shape_id]) for shape_id, sequence in sorted(of_shape.items())]
        # Mixed, so that families that take turns in the data set don't get shards of their own.
        mixed = [todo[i] for i in item_rng(params.seed, "sample_points").permutation(len(todo))]
        shards = [mixed[shard :: params.shards] for shard in range(min(params.shards, len(todo)))]
        sample = partial(sample_sequence, read_shapes(shapes), params)
        rejected: dict[int, list[ShapeRejected]] = {}
        outcomes = parallel_groups(sample, shards, rejects=ShapeRejected, label="sample_points", lost=lost)
        for shard, pieces, rejected[shard] in outcomes:
            for of, chunks in zip(KINDS, zip(*pieces, strict=True)):
                rng = item_rng(params.seed, "sample_points", of, shard)
                write_shard(shard_path(folder, of, shard), chunks, rng, **facts(of, params))
        unusable = [item for shard in sorted(rejected) for item in rejected[shard]]
        write_rejected(folder, unusable, len(todo), params.max_rejected)


def sample_sequence(
    source: ShapeFolder, params: SampleParams, item: tuple[Sequence, Transfer]
) -> tuple[PointChunks, PointChunks]:
    """Chunks of all training steps of one shape, and of its parts.

    Raises ShapeRejected if a step, or a part, has no closed surface.
    """
    sequence, transfer = item
    shape, rest = source.read(sequence.shape_id), sequence.cages[0]
    counts = PointCounts(**params.model_dump(include={field.name for field in fields(PointCounts)}))
    try:
        solids = solids_in_cuboids(shape, rest)
    except ValueError as error:
        raise ShapeRejected(shape.shape_id, "sample_points", str(error)) from error
    of_shape, of_parts = [], []
    for step in np.flatnonzero(~np.array(sequence.held_out)).tolist():
        cage = sequence.cages[step]
        rng = item_rng(params.seed, "sample_points", shape.shape_id, step)
        try:
            surface = SurfaceDistance(union(transfer.parts(shape, sequence, step)))
        except ValueError as error:
            raise ShapeRejected(shape.shape_id, "sample_points", f"step {step}: {error}") from error
        of_shape.append(shape_chunks(shape.shape_id, step, surface, cage, counts, rng))
        of_parts.append(part_chunks(shape.shape_id, step, transfer.in_cuboids(solids, step), cage, counts, rng))
    return join_chunks(of_shape), join_chunks(of_parts)


def lost(item: tuple[Sequence, Transfer], reason: str) -> ShapeRejected:
    """The rejection of a shape that kills its worker."""
    return ShapeRejected(item[0].shape_id, "sample_points", reason)


def facts(of: PointsOf, params: SampleParams) -> dict[str, object]:
    """Facts for the shards' metadata, beside the columns."""
    if of == "part":
        return {
            "of": "part",
            "deformation": "each part by its own cuboid alone",
            "sampler": "normal offsets from the surface, even in the unit frame; uniform in and around the cuboid",
            **params.model_dump(include={"part_near", "part_uniform", "seed"}),
        }
    return {
        "of": "shape",
        "deformation": "vertices by all cuboids that contain them",
        "sampler": "importance (Davies et al. 2021, octree rejection), uniform in the cube and in each cuboid",
        "domain": [-HALF_EXTENT, HALF_EXTENT],
        **params.model_dump(include={"near", "uniform", "per_cuboid", "beta", "seed"}),
    }


if __name__ == "__main__":
    run_stage(main, InputError)
