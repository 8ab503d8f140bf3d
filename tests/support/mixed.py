"""Structures to mix, and sessions that know more shapes."""

from dataclasses import replace

import numpy as np

from cagesdf.cuboid import Cuboid, Sequence
from cagesdf.editing.session import Session
from cagesdf.frames import Similarity
from cagesdf.models.latents import LatentTable
from cagesdf.structure.hierarchy import PartHierarchy


def stool(legs: dict[str, float], label: str = "leg") -> PartHierarchy:
    """A seat on legs at these x."""
    cuboids = {name: Cuboid(np.array([x, -0.4, 0.0]), np.eye(3), np.array([0.1, 0.6, 0.1])) for name, x in legs.items()}
    cuboids["top"] = Cuboid(np.zeros(3), np.eye(3), np.array([1.0, 0.2, 0.5]))
    names = tuple(cuboids)
    return PartHierarchy.flat(names, (*(label for _ in legs), "seat"), "stool").with_cuboids(cuboids)


def with_shapes(session: Session, **others: PartHierarchy) -> Session:
    """The same network with more shapes, each with a latent of its own."""
    run = session.run
    names = (*run.sequences, *others)
    structures = {**run.structures, **others}
    return Session(
        replace(
            run,
            latents=LatentTable.drawn(tuple((name, -1) for name in names), 4, 3.0, seed=2).requires_grad_(False),
            sequences={name: Sequence(name, None, np.zeros(1), (False,), (structures[name].cage(),)) for name in names},
            structures=structures,
            similarities=dict.fromkeys(names, Similarity(1.0, np.eye(3), np.zeros(3))),
        )
    )
