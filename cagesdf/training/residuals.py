"""How well a trained arm fits each shape that it was trained on: what a new shape's fit is compared with."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from cagesdf.cuboid import Sequence
from cagesdf.io.points import PointChunks, count_groups, read_groups, shard_paths
from cagesdf.models.decoders import Decoder
from cagesdf.models.latents import LatentTable
from cagesdf.training.batches import Batch, cuboid_distance, kind_of, training_set

CHUNKS = 32  # of each shape that are asked at most: 2048 points


def rest_residuals(
    folder: Path,
    decoder: Decoder,
    latents: LatentTable,
    sequences: Mapping[str, Sequence],
    reach: float,
    clamp: float,
) -> dict[str, float]:
    """Mean |sdf error| of each shape at rest over points such as it was trained on, decoder's unit; by id, sorted.

    Reads a shard's row group at a time. `reach` is that of `training_chunks`, `clamp` that of `Decoder.errors`.
    """
    left: dict[str, int] = {}
    totals: dict[str, list[float]] = {}
    for path in shard_paths(folder, kind_of(decoder.trains_on)):
        for group in range(count_groups(path)):
            chunks = _wanted(read_groups(path, [group]), left)
            if len(chunks) == 0:
                continue
            groups = training_set(chunks, sequences, latents).to(latents.values.device)
            errors = _errors(decoder, latents, groups, clamp)
            keep = np.ones_like(errors, dtype=bool)
            if decoder.trains_on == "cage":
                keep = cuboid_distance(chunks.xyz, groups.cuboid.cpu().numpy()) <= reach
            for shape, error, kept in zip(chunks.shape_id.tolist(), (errors * keep).sum(axis=1), keep.sum(axis=1)):
                total = totals.setdefault(chunks.shape_ids[shape], [0.0, 0])
                total[0] += float(error)
                total[1] += int(kept)
    return {shape_id: error / count for shape_id, (error, count) in sorted(totals.items()) if count}


def _wanted(chunks: PointChunks, left: dict[str, int]) -> PointChunks:
    """Chunks at rest, at most `left` of each shape; these are counted off."""
    rows = []
    for row in np.flatnonzero(chunks.step == 0).tolist():
        shape_id = chunks.shape_ids[chunks.shape_id[row]]
        if left.setdefault(shape_id, CHUNKS):
            left[shape_id] -= 1
            rows.append(row)
    return chunks.take(np.array(rows, np.int64))


@torch.inference_mode()
def _errors(decoder: Decoder, latents: LatentTable, groups: Batch, clamp: float) -> np.ndarray:
    cages = groups.cages
    codes = decoder.codes(latents(cages.latent), cages.cuboids, cages.present)
    predicted = decoder(groups.points, codes[groups.shape, groups.part], groups.cuboid)
    return decoder.errors(predicted, groups.sdf, groups.cuboid, clamp).cpu().numpy()
