"""Distance between cages of any structures: the weights of codes are made from it (§4.4)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cage

SIDE = 4  # points along each side of a face
_MIDDLES = (np.arange(SIDE) + 0.5) / SIDE - 0.5
# Points on the faces of [-½, ½]³, and the axis that each one's face is across.
_ACROSS = np.repeat([0, 1, 2], 2 * SIDE**2)
_POINTS = np.array(
    [
        np.roll([end, u, v], axis)
        for axis in range(3)
        for end in (-0.5, 0.5)
        for u in _MIDDLES
        for v in _MIDDLES
    ]
)  # fmt: skip


def cage_distances(cages: Sequence[Cage], others: Sequence[Cage]) -> Float[ndarray, "m n"]:
    """The Chamfer distance of each cage to each of the others, canonical units, not squared.

    Mean distance from the points of one cage's cuboids' surfaces to the nearest cuboid's surface of the other, both
    ways added. Surface counts by its area, also where it lies inside another cuboid; equal cages are 0 apart.
    """
    surfaces, other_surfaces = ([_surface(cage) for cage in row] for row in (cages, others))
    forth = [[_one_way(*surface, other) for other in others] for surface in surfaces]
    back = [[_one_way(*surface, cage) for surface in other_surfaces] for cage in cages]
    return np.array(forth).reshape(len(cages), len(others)) + np.array(back).reshape(len(cages), len(others))


def _one_way(points: Float[ndarray, "n 3"], areas: Float[ndarray, " n"], cage: Cage) -> float:
    return float(np.average(np.abs(cage.signed_distance(points)).min(axis=1), weights=areas))


def _surface(cage: Cage) -> tuple[Float[ndarray, "n 3"], Float[ndarray, " n"]]:
    """Points in the middles of equal cells of each face, and the cells' areas."""
    points = cage.centre[:, None] + (_POINTS * cage.size[:, None]) @ cage.axes
    areas = (cage.size.prod(axis=1, keepdims=True) / cage.size)[:, _ACROSS] / SIDE**2
    return points.reshape(-1, 3), areas.ravel()
