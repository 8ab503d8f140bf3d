"""Likeness of parts of different shapes, whatever their structures: by their boxes, relative to the whole."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cage


def relative_boxes(cage: Cage) -> Float[ndarray, "p 6"]:
    """Centre and lengths of the box along the axes around each cuboid, the box around all being [-½, ½]³."""
    corners = cage.corners()
    low, high = corners.reshape(-1, 3).min(axis=0), corners.reshape(-1, 3).max(axis=0)
    first, last = corners.min(axis=1), corners.max(axis=1)
    return np.concatenate([(first + last) / 2 - (low + high) / 2, last - first], axis=1) / np.tile(high - low, 2)
