"""Cuboids under the mouse."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cage


def entries(cage: Cage, origin: Float[ndarray, " 3"], direction: Float[ndarray, " 3"]) -> Float[ndarray, " k"]:
    """Distance to each cuboid along a ray, in lengths of `direction`: 0 from inside, inf for a miss."""
    start = np.einsum("kij,kj->ki", cage.axes, origin - cage.centre)
    slope = cage.axes @ direction
    with np.errstate(divide="ignore", invalid="ignore"):  # a ray along a face: ±inf, or NaN in the face itself
        near, far = (-start - cage.size / 2) / slope, (-start + cage.size / 2) / slope
    first = np.fmax.reduce(np.fmin(near, far), axis=1)
    last = np.fmin.reduce(np.fmax(near, far), axis=1)
    return np.where((first <= last) & (last >= 0), np.maximum(first, 0.0), np.inf)


def along(cage: Cage, origin: Float[ndarray, " 3"], direction: Float[ndarray, " 3"]) -> tuple[str, ...]:
    """The cuboids that a ray meets, nearest first."""
    distances = entries(cage, origin, direction)
    order = np.argsort(distances, kind="stable").tolist()
    return tuple(cage.part_ids[i] for i in order if np.isfinite(distances[i]))
