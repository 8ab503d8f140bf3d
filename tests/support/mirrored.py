"""States of shapes with mirrored and repeated parts, and edits of them."""

from dataclasses import replace

import numpy as np

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.editing.links import mirrors
from cagesdf.editing.operations import edited
from cagesdf.editing.script import (
    Operation,
)
from cagesdf.editing.state import State
from cagesdf.editing.styles import Styles
from cagesdf.frames import UP_AXES, Similarity
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.hierarchy import Node, PartHierarchy
from cagesdf.structure.relations import Reflection
from tests.support import programs

# The user's z is up, and the unit is a tenth of the canonical one.
Z_UP = Similarity(0.1, UP_AXES["z"], np.array([0.1, 0.2, 0.3]))


LATENTS = {"a": np.array([0, 1], np.float32), "b": np.array([2, -1], np.float32)}


LABELS = {"Base/Side/leg": "leg", "Base/cube1/leg": "leg", "seat": "seat", "arm": "arm", "cube4": "arm"}


def chair() -> State:
    structure = Assembly(programs.CHAIR, Similarity(0.9, np.eye(3), np.array([0.02, -0.03, 0.01])), LABELS)
    return State.opened(structure.cage(), structure, LATENTS["a"], Z_UP)


STYLES = Styles({name: replace(chair(), latent=latent) for name, latent in LATENTS.items()}, code_dim=3)


def turned(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def jug() -> State:
    """A body with two handles that mirror each other in an oblique plane; the left one's axes have other names."""
    normal = np.array([0.6, 0, 0.8])
    right = Cuboid(np.array([0.3, 0.1, 0.4]), turned(20), np.array([0.1, 0.5, 0.05]))
    flip = np.eye(3) - 2 * np.outer(normal, normal)
    naming = np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, -1]])  # improper, as the flip
    left = Cuboid(flip @ right.centre, naming @ right.axes @ flip, np.abs(naming) @ right.size)
    body = Cuboid(np.zeros(3), np.eye(3), np.array([0.4, 0.8, 0.4]))
    leaves = tuple(Node(name, label, (), (), None) for name, label in (("1", "body"), ("2", "handle"), ("3", "handle")))
    relation = Reflection("2", "3", (0.0, 0.0, 0.0), tuple(normal.tolist()))
    structure = PartHierarchy(Node("0", "jug", leaves, (relation,), None))
    return State.opened(Cage.of({"1": body, "2": right, "3": left}), structure, LATENTS["b"], Z_UP)


def do(state: State, *script: Operation) -> State:
    return edited(state, script, STYLES).present


def is_mirrored(state: State, a: str, b: str) -> None:
    """Corner for corner, whatever their order."""
    mirror = mirrors(state)[a][b]
    images = np.array([mirror(corner) for corner in Cage.of({a: state.cage[a]}).corners()[0]])
    corners = Cage.of({b: state.cage[b]}).corners()[0]
    np.testing.assert_allclose(np.linalg.norm(images[:, None] - corners, axis=2).min(axis=1), 0, atol=1e-12)
