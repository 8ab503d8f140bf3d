"""Frames, the similarity between them, and the sign of the signed distance.

Four frames, and this file alone decides what they are:

    raw        as in the user's file: any unit, y or z up
    canonical  y up, front +z; the shape's bounding box is centred at the origin, its
               farthest vertex lies on the unit sphere. One canonical unit is that radius.
    local      a cuboid's: origin at its centre, axes along its own, canonical units
    unit       a cuboid's, scaled: the cuboid is [-½, ½]³

Signed distances are **negative inside**, in canonical units.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import InputError

OUTSIDE = 0.1  # the value that the paper gives to grid points outside every cuboid (§3.6)
BEYOND = 0.05  # largest distance of a part's points beyond its cuboid, in the cuboid's lengths
LEAST_UNIT = 0.02  # canonical units: where distances are scaled by a cuboid's smallest length, it counts as no thinner
LARGEST_UNIT = 0.1  # and where walls are to be as thin in large cuboids as in small ones, as no thicker
HALF_EXTENT = 1.05  # grids span [-HALF_EXTENT, HALF_EXTENT]³: the unit sphere and a margin

# Rows are the canonical axes in the raw frame.
UP_AXES = {
    "y": np.eye(3),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}


@dataclass(frozen=True, eq=False)
class Similarity:
    """canonical = scale · rotation @ raw + translation."""

    scale: float  # canonical units per raw unit, > 0
    rotation: Float[ndarray, "3 3"]  # proper: determinant +1
    translation: Float[ndarray, " 3"]  # canonical units

    def to_canonical(self, points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Map raw points into the canonical frame."""
        return self.scale * (points @ self.rotation.T) + self.translation

    def to_raw(self, points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Map canonical points back into the user's frame; undoes `to_canonical`."""
        return ((points - self.translation) / self.scale) @ self.rotation

    def then(self, other: "Similarity") -> "Similarity":
        """This similarity, followed by another that starts from its canonical frame."""
        translation = other.to_canonical(self.translation[None])[0]
        return Similarity(self.scale * other.scale, other.rotation @ self.rotation, translation)

    def inverse(self) -> "Similarity":
        """The similarity that undoes this one: canonical → raw."""
        return Similarity(1 / self.scale, self.rotation.T, -(self.translation @ self.rotation) / self.scale)

    def to_numbers(self) -> list[float]:
        """Thirteen numbers: scale, rotation by rows, translation."""
        return [float(self.scale), *map(float, self.rotation.ravel()), *map(float, self.translation)]

    @staticmethod
    def from_numbers(numbers: list[float]) -> "Similarity":
        """Undo `to_numbers`. Raises InputError for anything but thirteen finite numbers, the first above 0."""
        try:
            values = np.asarray(numbers, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            values = np.zeros(0)
        if values.shape != (13,) or not np.isfinite(values).all() or values[0] <= 0:
            raise InputError(f"similarity: wanted 13 finite numbers, a scale above 0 first, got {str(numbers)[:60]}")
        return Similarity(float(values[0]), values[1:10].reshape(3, 3), values[10:13])


def canonical_similarity(vertices: Float[ndarray, "v 3"], up: str) -> Similarity:
    """The similarity that brings a shape with these raw vertices into the canonical frame.

    `up` is "y" or "z". Raises InputError if there is no vertex, one is not finite, or all
    coincide.
    """
    if up not in UP_AXES:
        raise InputError(f"up axis must be one of {', '.join(UP_AXES)}, got {up!r}")
    if len(vertices) == 0 or not np.isfinite(vertices).all():
        raise InputError(f"a shape needs finite vertices, got {len(vertices)} of which some are NaN or infinite")
    rotation = UP_AXES[up]
    turned = vertices @ rotation.T
    centre = (turned.min(0) + turned.max(0)) / 2
    radius = float(np.linalg.norm(turned - centre, axis=1).max())
    # Relative to the coordinates: a thing 1 mm wide, 1 km from the origin, is still a thing.
    if radius <= 1e-9 * max(1.0, float(np.abs(turned).max())):
        raise InputError("all vertices coincide: the shape has no size")
    return Similarity(1.0 / radius, rotation, -centre / radius)
