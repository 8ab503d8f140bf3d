"""The points' part of the appendix's loss: how far surface points stick out of their cuboids.

A point costs max(signed distance + ROOM, 0). Nearly all points of a part are either too deep to cost
anything, or cost their distance to one face's plane, and both stay so while the cuboid moves a
little. The first are left out, the second are summed up by their mean, which is exact; only the
points near an edge, or near ROOM within, are reckoned with one by one.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

ROOM = 0.01  # points should lie this deep, the program's unit
REACH = 0.004  # how far a cuboid's faces may move at its points until these are sorted again, the program's unit


@dataclass(frozen=True, eq=False)
class _Sorted:
    """A part's points as they lie about one cuboid."""

    vector: Float[ndarray, " 15"]  # the cuboid
    near: Float[ndarray, "3 k"]  # points that may change sides, float32
    axes: Int[ndarray, " g"]  # of the faces that all the others lie at
    sides: Float[ndarray, " g"]  # -1 or 1: which of the axis' two faces
    counts: Float[ndarray, " g"]  # points at that face
    means: Float[ndarray, "g 3"]  # their mean


class Hinge:
    """Mean over parts and points of max(signed distance + ROOM, 0).

    float32 is exact enough for single points of such a large sum; sums are float64.
    """

    def __init__(self, points: Float[ndarray, "p n 3"]) -> None:
        self._points = [np.ascontiguousarray(part.T, dtype=np.float32) for part in points]
        self._radii = [float(np.linalg.norm(part - part.mean(axis=0), axis=1).max()) for part in points]
        self._middles = points.mean(axis=1)
        self._sorted: list[_Sorted | None] = [None] * len(points)

    def __call__(self, vectors: Float[ndarray, "p 15"]) -> tuple[float, Float[ndarray, "p 15"]]:
        """Value, and slope by the cuboids' numbers (`Cage.vectors`)."""
        value, slope = 0.0, np.zeros(vectors.shape)
        for i, vector in enumerate(vectors):
            at = self._sorted[i]
            if at is None or self._motion(i, at.vector, vector) > REACH:
                at = self._sorted[i] = _sort(self._points[i], vector)
            share = 1 / (self._points[i].shape[1] * len(vectors))
            cost, slope[i] = _cost(at, vector)
            value, slope[i] = value + share * cost, share * slope[i]
        return value, slope

    def _motion(self, i: int, old: Float[ndarray, " 15"], new: Float[ndarray, " 15"]) -> float:
        """Upper bound of the movement of a face, at any point of part i, along the face's axis."""
        by = new - old
        turn = by[3:12].reshape(3, 3)
        axes = old[3:12].reshape(3, 3)
        # new axes @ (x - new centre) - old axes @ (x - old centre), and x = middle + at most the radius
        shift = turn @ (self._middles[i] - new[:3]) - axes @ by[:3]
        return float((np.abs(shift) + np.linalg.norm(turn, axis=1) * self._radii[i] + np.abs(by[12:]) / 2).max())


def _local(points: Float[ndarray, "3 n"], vector: Float[ndarray, " 15"]) -> tuple[ndarray, ndarray, ndarray]:
    """Offsets from the centre, the same along the cuboid's axes, and the distances of these beyond the faces."""
    numbers = vector.astype(np.float32)
    offsets = points - numbers[:3, None]
    along = numbers[3:12].reshape(3, 3) @ offsets
    return offsets, along, np.abs(along) - numbers[12:, None] / 2


def _sort(points: Float[ndarray, "3 n"], vector: Float[ndarray, " 15"]) -> _Sorted:
    _, along, beyond = _local(points, vector)
    x, y, z = beyond
    higher, lower = np.maximum(x, y), np.minimum(x, y)
    deepest, second = np.maximum(higher, z), np.maximum(lower, np.minimum(higher, z))
    axis = np.where(z == deepest, 2, np.where(y == deepest, 1, 0))
    height = along[axis, np.arange(len(axis))]
    # Whatever moves by REACH: its distance is that to one face, on this side of the cuboid, and counts.
    at_face = (deepest > REACH - ROOM) & (second < np.minimum(deepest - 2 * REACH, -REACH)) & (np.abs(height) > REACH)
    near: Bool[ndarray, " n"] = (deepest >= -ROOM - REACH) & ~at_face
    faces, facing = (2 * axis + (height > 0))[at_face], points[:, at_face]
    counts = np.bincount(faces, minlength=6)
    sums = np.array([np.bincount(faces, weights=row, minlength=6) for row in facing])
    kept = np.flatnonzero(counts)
    return _Sorted(
        vector,
        points[:, near],
        kept // 2,
        kept % 2 * 2.0 - 1.0,
        counts[kept].astype(np.float64),
        (sums[:, kept] / counts[kept]).T,
    )


def _cost(at: _Sorted, vector: Float[ndarray, " 15"]) -> tuple[float, Float[ndarray, " 15"]]:
    """Sum of a part's hinges, and its slope by the cuboid's numbers."""
    offsets, along, beyond = _local(at.near, vector)
    deepest = beyond.max(axis=0)
    outside = np.maximum(beyond, 0)
    distance = np.where(deepest > 0, np.sqrt(np.einsum("in,in->n", outside, outside)), deepest)
    costs = distance > -ROOM
    # The distance's slope by `beyond`, then by `along`.
    pull = np.where(deepest > 0, outside / np.maximum(distance, 1e-30), beyond == deepest) * costs
    push = np.copysign(pull, along)
    turn, shift, grow = push @ offsets.T, push.sum(axis=1), pull.sum(axis=1)
    value = float((distance[costs] + np.float32(ROOM)).sum(dtype=np.float64))

    axes, half = vector[3:12].reshape(3, 3), vector[12:] / 2
    means = at.means - vector[:3]
    weights = np.zeros((len(means), 3))
    weights[np.arange(len(means)), at.axes] = at.counts
    signed = weights * at.sides[:, None]
    value += float((signed * (means @ axes.T)).sum() - (weights @ half).sum() + ROOM * at.counts.sum())
    turn, shift, grow = turn + signed.T @ means, shift + signed.sum(axis=0), grow + weights.sum(axis=0)
    return value, np.concatenate([-axes.T @ shift, turn.ravel(), -grow / 2])
