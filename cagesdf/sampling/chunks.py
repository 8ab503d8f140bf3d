"""Chunks of points of one shape at one step: of the whole shape, and of its parts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cagesdf.cuboid import Cage
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh
from cagesdf.io.points import CHUNK, PointChunks, join_chunks
from cagesdf.sampling.parts import sample_part, shares
from cagesdf.sampling.shapes import sample_points


@dataclass(frozen=True)
class PointCounts:
    """Numbers of points to draw, and their distribution."""

    near: int  # these four as `sample_points`'
    uniform: int
    per_cuboid: int
    beta: float
    part_near: float  # these two as `sample_part`'s
    part_uniform: float


def shape_chunks(
    shape_id: str, step: int, surface: SurfaceDistance, cage: Cage, counts: PointCounts, rng: np.random.Generator
) -> PointChunks:
    """Distances to the whole shape's surface, each point beside the part whose cuboid most contains it (§3.4)."""
    samples = sample_points(surface, cage, counts.near, counts.uniform, counts.per_cuboid, counts.beta, CHUNK, rng)
    numbers = np.zeros_like(samples.part), np.full_like(samples.part, step)
    fields = samples.part, samples.points, samples.sdf, samples.near
    return PointChunks(*numbers, *fields, (shape_id,), cage.part_ids)


def part_chunks(
    shape_id: str, step: int, solids: Sequence[Mesh], cage: Cage, counts: PointCounts, rng: np.random.Generator
) -> PointChunks:
    """Distances to each part's own surface; `solids` are the parts in the unit frames of their cuboids."""
    pieces = []
    for part, (solid, share) in enumerate(zip(solids, shares(solids, cage), strict=True)):
        samples = sample_part(solid, cage, part, counts.part_near, counts.part_uniform, share, CHUNK, rng)
        zeros = np.zeros(len(samples.sdf), np.int64)
        fields = samples.points, samples.sdf, samples.near
        pieces.append(PointChunks(zeros, zeros + step, zeros + part, *fields, (shape_id,), cage.part_ids))
    return join_chunks(pieces)
