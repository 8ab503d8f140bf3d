"""States of shapes whose parts touch, and edits of them."""

import numpy as np
from scipy.spatial.transform import Rotation as Turn

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.editing.operations import edited
from cagesdf.editing.script import Operation
from cagesdf.editing.state import State
from cagesdf.editing.styles import Styles
from cagesdf.frames import Similarity
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.hierarchy import Node, PartHierarchy
from cagesdf.structure.relations import Reflection
from tests.support import programs

IDENTITY = Similarity(1.0, np.eye(3), np.zeros(3))


LABELS = {"Base/Side/leg": "leg", "Base/cube1/leg": "leg", "seat": "seat", "arm": "arm", "cube4": "arm"}


STYLES = Styles({}, code_dim=6)


def box(centre: tuple[float, float, float], size: tuple[float, float, float], degrees: float = 0) -> Cuboid:
    return Cuboid(
        np.array(centre, float), Turn.from_euler("z", degrees, degrees=True).as_matrix().T, np.array(size, float)
    )


def state_of(cuboids: dict[str, Cuboid], *relations: Reflection) -> State:
    leaves = tuple(Node(part, part.partition("_")[0], (), (), None) for part in cuboids)
    structure = PartHierarchy(Node("root", "thing", leaves, relations, None))
    return State.opened(Cage.of(cuboids), structure, np.zeros(2, np.float32), IDENTITY)


def stool() -> State:
    """A seat on four upright legs, a back that stands on it, and a lamp beside."""
    legs = {f"leg_{i}": box((x, -0.3, z), (0.06, 0.5, 0.06)) for i, (x, z) in enumerate(CORNERS)}
    seat = {"seat": box((0, -0.02, 0), (0.6, 0.06, 0.6)), "back": box((0, 0.26, -0.27), (0.5, 0.5, 0.05))}
    mirror = Reflection("leg_0", "leg_1", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    return state_of({**legs, **seat, "lamp": box((0, -0.3, 0), (0.1, 0.1, 0.1))}, mirror)


CORNERS = [(-0.25, 0.25), (0.25, 0.25), (-0.25, -0.25), (0.25, -0.25)]


def chair() -> State:
    structure = Assembly(programs.CHAIR, IDENTITY, LABELS)
    return State.opened(structure.cage(), structure, np.zeros(2, np.float32), IDENTITY)


def do(state: State, *script: Operation) -> State:
    return edited(state, script, STYLES).present


def vector(state: State, part: str) -> tuple[float, ...]:
    return tuple(Cage.of({"": state.cage[part]}).vectors()[0].tolist())
