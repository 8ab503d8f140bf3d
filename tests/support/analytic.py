"""Signed distances in closed form, negative inside."""

import numpy as np


def sphere_sdf(points: np.ndarray, radius: float) -> np.ndarray:
    """Distance to a sphere about the origin."""
    return np.linalg.norm(points, axis=-1) - radius


def box_sdf(points: np.ndarray, size) -> np.ndarray:
    """Distance to an axis-aligned box about the origin, full lengths `size`."""
    beyond = np.abs(points) - np.asarray(size) / 2
    return np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(axis=-1), 0)
