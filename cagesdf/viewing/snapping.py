"""Contact: a part that is dragged near another one comes to touch it, or to end where it ends."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cage

NEAR = 0.025  # canonical units: gaps and overlaps up to this are closed


def snapped(moving: Cage, others: Cage, near: float = NEAR) -> Float[ndarray, " 3"]:
    """By how much to move the cuboids of `moving`, canonical, so that they touch others or end where they end.

    Along each axis it is the smallest shift, at most `near`, at which an end of their common box meets an end of
    another cuboid's box; 0 along axes where none is so near. Only cuboids are met whose box is at most `near` away
    along the two other axes: those far beside don't attract.
    """
    if not len(moving) or not len(others):
        return np.zeros(3)
    low, high = (end(moving.corners().reshape(-1, 3), axis=0) for end in (np.min, np.max))
    lows, highs = others.corners().min(axis=1), others.corners().max(axis=1)
    beside = (lows <= high + near) & (low - near <= highs)  # by cuboid and axis
    shift = np.zeros(3)
    for axis in range(3):
        others_too = np.delete(beside, axis, axis=1).all(axis=1)
        ends = np.concatenate([lows[others_too, axis], highs[others_too, axis]])
        gaps = np.concatenate([ends - low[axis], ends - high[axis]])
        if len(gaps) and np.abs(gaps).min() <= near:
            shift[axis] = gaps[np.abs(gaps).argmin()]
    return shift
