"""Camera positions from which cuboids fill the view."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cage

FILLED = 0.8  # share of the view's width or height, whichever is filled first
# Directions from the shape to the camera; canonical, y up. None is straight up: the top view is a hair to the front.
VIEWS: dict[str, tuple[float, float, float]] = {
    "Perspective": (0.52, 0.32, 0.79),
    "Front": (0.0, 0.0, 1.0),
    "Side": (1.0, 0.0, 0.0),
    "Top": (0.0, 1.0, 1e-3),
}


def camera_for(
    cage: Cage, direction: Float[ndarray, " 3"], fov: float, aspect: float
) -> tuple[Float[ndarray, " 3"], Float[ndarray, " 3"]]:
    """Position and target, canonical, of a camera that sees all of a cage from a direction.

    `direction` leads from the cage to the camera and is not straight up; `fov` is vertical, in radians; `aspect` is
    width over height.
    """
    corners = cage.corners().reshape(-1, 3)
    target = (corners.min(axis=0) + corners.max(axis=0)) / 2
    towards = direction / np.linalg.norm(direction)
    right = np.cross([0.0, 1.0, 0.0], towards)
    right /= np.linalg.norm(right)
    x, y, z = np.stack([right, np.cross(towards, right), towards]) @ (corners - target).T
    tangent = FILLED * np.tan(fov / 2)
    distance = float((z + np.maximum(np.abs(y) / tangent, np.abs(x) / (tangent * aspect))).max())
    return target + distance * towards, target


def world_per_pixel(distance: float, fov: float, height: int) -> float:
    """The length, at a distance from the camera, that one pixel of a view of that height shows."""
    return 2 * distance * float(np.tan(fov / 2)) / max(height, 1)
