"""Sample signed distances of every training step of every sequence (§3.4).

python -m stages.sample_points data/shapes/chair data/sequences/chair data/points/chair
"""

from functools import partial
from pathlib import Path

import numpy as np

from cagesdf.cuboid import Sequence
from cagesdf.deformation import deform_shape
from cagesdf.distance import SurfaceDistance
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.frames import HALF_EXTENT
from cagesdf.io.points import CHUNK, PointChunks, join_chunks, write_shard
from cagesdf.io.rejected import write_rejected
from cagesdf.io.sequences import read_sequences
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.sampling import sample_points
from cagesdf.solid import union
from pipeline import SampleParams, artefact, item_rng, parallel_groups, run_stage


def main(shapes: Path, sequences: Path, out: Path, params: SampleParams) -> None:
    """Read `shapes/` and `sequences/`, write `points/`, a shard at a time."""
    with artefact.write("points", out, inputs={"shapes": shapes, "sequences": sequences}, params=params) as folder:
        todo = [sequence for _, sequence in sorted(read_sequences(sequences).items())]
        # Mixed, so that families that take turns in the data set don't get shards of their own.
        mixed = [todo[i] for i in item_rng(params.seed, "sample_points").permutation(len(todo))]
        shards = [mixed[shard :: params.shards] for shard in range(min(params.shards, len(todo)))]
        sample = partial(sample_sequence, read_shapes(shapes), params)
        rejected: dict[int, list[ShapeRejected]] = {}
        outcomes = parallel_groups(sample, shards, rejects=ShapeRejected, label="sample_points", lost=lost)
        for shard, pieces, rejected[shard] in outcomes:
            if pieces:
                rng = item_rng(params.seed, "sample_points", shard)
                write_shard(folder / f"shard-{shard:04d}.parquet", pieces, rng, **facts(params))
        unusable = [item for shard in sorted(rejected) for item in rejected[shard]]
        write_rejected(folder, unusable, len(todo), params.max_rejected)


def sample_sequence(source: ShapeFolder, params: SampleParams, sequence: Sequence) -> PointChunks:
    """Chunks of all training steps of one shape. Raises ShapeRejected if a step has no closed surface."""
    shape, rest = source.read(sequence.shape_id), sequence.cages[0]
    pieces = []
    for step in np.flatnonzero(~np.array(sequence.held_out)).tolist():
        cage = sequence.cages[step]
        meshes = deform_shape(shape, rest, cage)
        try:
            surface = SurfaceDistance(union(meshes))
        except ValueError as error:
            raise ShapeRejected(shape.shape_id, "sample_points", f"step {step}: {error}") from error
        rng = item_rng(params.seed, "sample_points", shape.shape_id, step)
        samples = sample_points(surface, cage, params.near, params.uniform, params.per_cuboid, params.beta, CHUNK, rng)
        numbers = np.zeros_like(samples.part), np.full_like(samples.part, step)
        fields = samples.part, samples.points, samples.sdf, samples.near
        pieces.append(PointChunks(*numbers, *fields, (shape.shape_id,), cage.part_ids))
    return join_chunks(pieces)


def lost(sequence: Sequence, reason: str) -> ShapeRejected:
    """What becomes of a shape that kills its worker."""
    return ShapeRejected(sequence.shape_id, "sample_points", reason)


def facts(params: SampleParams) -> dict[str, object]:
    """What the shards' metadata say beside the columns."""
    return {
        "sampler": "importance (Davies et al. 2021, octree rejection), uniform in the cube and in each cuboid",
        "domain": [-HALF_EXTENT, HALF_EXTENT],
        **params.model_dump(include={"near", "uniform", "per_cuboid", "beta", "seed"}),
    }


if __name__ == "__main__":
    run_stage(main, InputError)
