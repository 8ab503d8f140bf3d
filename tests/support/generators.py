"""Generators of cages."""

import numpy as np

from cagesdf.cage_generation.program_vae import ProgramVAE
from cagesdf.cage_generation.programs import ProgramGenerator
from cagesdf.cage_generation.trained import TrainedGenerator
from cagesdf.cuboid import Cage, Cuboid
from cagesdf.frames import Similarity
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.hierarchy import Node, PartHierarchy
from cagesdf.structure.relations import Reflection
from tests.support import programs


def on_programs() -> TrainedGenerator:
    place = Similarity(1.2, np.eye(3), np.zeros(3))
    structures = {"a": Assembly(programs.CHAIR, place), "b": Assembly(programs.GROWN, place)}
    cages = {name: assembly.cage() for name, assembly in structures.items()}
    return TrainedGenerator(ProgramGenerator(ProgramVAE.drawn(16, 5, 1), 1.1), structures, cages)


def turned(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def jar(seed: int, order: tuple[str, ...] = ("body", "left", "right")) -> tuple[PartHierarchy, Cage]:
    """A body and two tilted handles that mirror each other in x = 0."""
    rng = np.random.default_rng(seed)
    width, height, out, tilt = rng.uniform([0.5, 0.8, 0.1, 0.1], [0.8, 1.2, 0.2, 0.5])
    handle = np.array([out, 0.4 * height, 0.1])
    x = width / 2 + 0.3 * out
    cuboids = {
        "body": Cuboid(np.zeros(3), np.eye(3), np.array([width, height, width])),
        "left": Cuboid(np.array([-x, 0.1, 0.0]), turned(tilt), handle),
        "right": Cuboid(np.array([x, 0.1, 0.0]), turned(-tilt), handle),
    }
    leaves = tuple(Node(name, name if name == "body" else "handle", (), (), cuboids[name]) for name in order)
    mirror = Reflection("left", "right", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    return PartHierarchy(Node("root", "jar", leaves, (mirror,), None)), Cage.of({name: cuboids[name] for name in order})


def jars(count: int) -> tuple[dict[str, PartHierarchy], dict[str, Cage]]:
    made = {f"jar{i}": jar(i, ("body", "left", "right") if i % 2 else ("right", "body", "left")) for i in range(count)}
    return {name: tree for name, (tree, _) in made.items()}, {name: cage for name, (_, cage) in made.items()}
