"""A cuboid's rotation as three numbers, and the turns about its own axes that lead to others."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cuboid
from cagesdf.editing.script import Axis
from cagesdf.editing.state import State

AXES: tuple[Axis, ...] = ("x", "y", "z")
ORDER = "XYZ"  # about the user's x, then the turned y, then the z turned twice
LEAST = 1e-3  # degrees


def angles_of(state: State, cuboid: Cuboid) -> Float[ndarray, " 3"]:
    """Degrees; all 0 for a cuboid along the user's axes."""
    return _rotation(state, cuboid).as_euler(ORDER, degrees=True)


def turns(state: State, cuboid: Cuboid, angles: tuple[float, float, float]) -> list[tuple[Axis, float]]:
    """Turns about a cuboid's own axes, in degrees, that one after the other lead it to these angles."""
    wanted = Rotation.from_euler(ORDER, angles, degrees=True)
    steps = (_rotation(state, cuboid).inv() * wanted).as_euler(ORDER, degrees=True)
    return [(axis, float(angle)) for axis, angle in zip(AXES, steps) if abs(angle) > LEAST]


def _rotation(state: State, cuboid: Cuboid) -> Rotation:
    """From the user's axes to the cuboid's, of which each is named after the user's that it was nearest to."""
    columns = []
    for axis in AXES:
        row, sign = state.own_axis(axis)
        columns.append(state.similarity.rotation.T @ (sign * cuboid.axes[row]))
    return Rotation.from_matrix(np.stack(columns, axis=1))
