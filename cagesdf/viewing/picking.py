"""Cuboids under the mouse."""

from collections.abc import Sequence

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


def clicked(parts: Sequence[str], selected: Sequence[str], more: bool) -> tuple[str, ...]:
    """The selection after a click on `parts`, nearest first.

    The nearest one; when that alone was selected already, the next behind it, so that what is hidden can be reached.
    With `more` the nearest is added to the others, or taken from them. Nothing, where nothing was clicked.
    """
    if not parts:
        return tuple(selected) if more else ()
    if more:
        rest = tuple(part for part in selected if part != parts[0])
        return rest if parts[0] in selected else (*rest, parts[0])
    if len(selected) == 1 and selected[0] in parts:
        return (parts[(parts.index(selected[0]) + 1) % len(parts)],)
    return (parts[0],)
