"""Signed distance samples of one part, in and around its cuboid, to its own closed surface.

A part is moved by its own cuboid alone: an affine map between unit frames, so that its surface in the unit frame is
the same at every step of a sequence. Points near the surface are spread evenly over it there, and their number follows
its area: a back of many slats has more than a plate, and the body of a vase more than its knob. Where cuboids overlap,
each has its own points there.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.frames import BEYOND, LARGEST_UNIT, LEAST_UNIT
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, face_areas
from cagesdf.geometry.solid import thickness
from cagesdf.sampling.shapes import rounded_up

SPREAD = (0.004, 0.25)  # of points around the surface: standard deviations, in units of the cuboid's smallest length
LEAST_CHUNKS = 2  # of a part at one step
# Number of points of a part: its area in the unit frame (a box has 6), at most LARGEST, times its share, at least
# SMALLEST: a bent wire in a large cuboid may have an area of less than 1, and yet all of the cuboid is to be empty.
SMALLEST, LARGEST = 4.0, 150.0
# Bounds of a part's share. By area in the shape alone a knob would hardly be trained; without it the body of a vase,
# three quarters of the surface, as little as a knob.
FEWEST, MOST = 0.5, 3.0
THINNEST = 3.0  # largest factor for a thin part


@dataclass(frozen=True, eq=False)
class PartSamples:
    """Points of one part at one step, in chunks of `k`."""

    points: Float[ndarray, "c k 3"]  # canonical, float32
    sdf: Float[ndarray, "c k"]  # to the part's own surface at those very positions; canonical, negative inside, float32
    near: Bool[ndarray, "c k"]  # around the surface rather than uniform


def shares(solids: Sequence[Mesh], cage: Cage) -> list[float]:
    """Factor on the number of points of each part, by its area within the shape and its thinness.

    It is the square root of the part's canonical area over the mean of the parts, clamped to FEWEST and MOST, times
    `thinness`. Solids are in the unit frames of their cuboids.
    """
    moved = [solid.with_vertices(cage.from_unit(solid.vertices, part)) for part, solid in enumerate(solids)]
    areas = [float(face_areas(solid).sum()) for solid in moved]
    mean = sum(areas) / len(areas)
    return [
        min(max(math.sqrt(area / mean), FEWEST), MOST) * thinness(solid, size)
        for solid, area, size in zip(moved, areas, cage.size)
    ]


def thinness(solid: Mesh, size: Float[ndarray, " 3"]) -> float:
    """How much thinner a closed part is than its cuboid: 1 if it fills it, more for walls, bent boards and wires.

    It is the `thickness` of a box with the cuboid's lengths, each at most LARGEST_UNIT, over the part's, canonical;
    clamped to 1 and THINNEST. Without it such parts were torn long after all else was smooth (docs/log.md).
    """
    of_box = 1 / float((1 / np.minimum(size, LARGEST_UNIT)).sum())
    return min(max(of_box / thickness(solid), 1.0), THINNEST)


def sample_part(
    solid: Mesh,
    cage: Cage,
    cuboid: int,
    part_near: float,
    part_uniform: float,
    share: float,
    chunk: int,
    rng: np.random.Generator,
) -> PartSamples:
    """Training samples of a closed part, given in the unit frame of cuboid number `cuboid`.

    For each unit of its surface's area there, times `share` (see `shares`), it gets `part_near` points around the
    surface and `part_uniform` others; an area counts as at most LARGEST, its product with `share` as at least SMALLEST.

    Near points are at places of the surface, uniform by area in the unit frame, plus an isotropic normal offset whose
    standard deviation is log-uniform in SPREAD times the cuboid's smallest length. Those that fall beyond the cuboid by
    more than BEYOND of a length are drawn uniformly instead, in the cuboid enlarged by that, like the uniform points.
    """
    areas = face_areas(solid)
    area = max(share * min(float(areas.sum()), LARGEST), SMALLEST)
    near = int(part_near * area)
    total = max(LEAST_CHUNKS, -(-int((part_near + part_uniform) * area) // chunk)) * chunk
    moved = solid.with_vertices(cage.from_unit(solid.vertices, cuboid))
    faces = np.sort(rng.choice(len(areas), near, p=areas / areas.sum()))
    first, second = rng.random((2, near, 1))
    turned = first + second > 1
    first, second = np.where(turned, 1 - first, first), np.where(turned, 1 - second, second)
    a, b, c = moved.corners()[faces].swapaxes(0, 1)
    places = a + first * (b - a) + second * (c - a)
    # Exponentials differ in their last digit from one kind of processor to another.
    ratio = rounded_up(np.exp(rng.uniform(math.log(SPREAD[0]), math.log(SPREAD[1]), near)))
    spread = ratio[:, None] * max(float(cage.size[cuboid].min()), LEAST_UNIT)
    around = cage.to_unit(places + rng.normal(size=(near, 3)) * spread, cuboid)
    filling = rng.uniform(-0.5 - BEYOND, 0.5 + BEYOND, (total, 3))
    beyond = (np.abs(around) > 0.5 + BEYOND).any(axis=1)
    filling[:near][~beyond] = around[~beyond]
    # Distances are measured where the stored point will be.
    points = cage.from_unit(filling, cuboid).astype(np.float32)
    sdf = SurfaceDistance(moved).signed(points.astype(np.float64)).astype(np.float32)
    is_near = np.zeros(total, bool)
    is_near[:near] = ~beyond
    order = rng.permutation(total).reshape(-1, chunk)
    return PartSamples(points[order], sdf[order], is_near[order])
