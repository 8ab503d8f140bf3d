"""How well a trained arm fits each shape that it was trained on: what a new shape's fit is compared with."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import nn

from cagesdf.cuboid import Sequence
from cagesdf.io.points import PointChunks, count_groups, read_groups, shard_paths
from cagesdf.models.latents import LatentTable
from cagesdf.training.batches import cuboid_distance, own_cuboids

CHUNKS = 32  # of each shape that are asked at most: 2048 points


def rest_residuals(
    folder: Path,
    decoder: nn.Module,
    latents: LatentTable,
    sequences: Mapping[str, Sequence],
    points_of: Literal["cage", "cube"],
    reach: float,
) -> dict[str, float]:
    """Mean |sdf error| of each shape at rest over points such as it was trained on, canonical units; sorted by id.

    Reads a shard's row group at a time. `points_of` and `reach` are those of `training_chunks`.
    """
    left: dict[str, int] = {}
    totals: dict[str, list[float]] = {}
    for path in shard_paths(folder):
        for group in range(count_groups(path)):
            chunks = _wanted(read_groups(path, [group]), left)
            if len(chunks) == 0:
                continue
            cuboids = own_cuboids(chunks, sequences)
            errors = _errors(decoder, latents, chunks, cuboids)
            keep = np.ones_like(errors, dtype=bool)
            if points_of == "cage":
                keep = cuboid_distance(chunks.xyz, cuboids) <= reach
            for shape, error, kept in zip(chunks.shape_id.tolist(), (errors * keep).sum(axis=1), keep.sum(axis=1)):
                total = totals.setdefault(chunks.shape_ids[shape], [0.0, 0])
                total[0] += float(error)
                total[1] += int(kept)
    return {shape_id: error / count for shape_id, (error, count) in sorted(totals.items()) if count}


def _wanted(chunks: PointChunks, left: dict[str, int]) -> PointChunks:
    """Chunks at rest, of each shape no more than are left; these are counted off."""
    rows = []
    for row in np.flatnonzero(chunks.step == 0).tolist():
        shape_id = chunks.shape_ids[chunks.shape_id[row]]
        if left.setdefault(shape_id, CHUNKS):
            left[shape_id] -= 1
            rows.append(row)
    return chunks.take(np.array(rows, np.int64))


@torch.inference_mode()
def _errors(decoder: nn.Module, latents: LatentTable, chunks: PointChunks, cuboids: np.ndarray) -> np.ndarray:
    device = latents.values.device
    rows = torch.tensor([latents.row(chunks.shape_ids[shape], 0) for shape in chunks.shape_id.tolist()])
    points = torch.from_numpy(chunks.xyz).to(device)
    predicted = decoder(points, latents(rows.to(device)), torch.from_numpy(cuboids).to(device))
    return np.abs(predicted.cpu().numpy() - chunks.sdf)
