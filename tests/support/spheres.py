"""Training data in closed form: spheres in their cubes, each at two sizes, a step each."""

from typing import Any

import numpy as np

from cagesdf.cuboid import Cage, Cuboid, Sequence
from cagesdf.frames import Similarity
from cagesdf.io.points import CHUNK, PointChunks
from cagesdf.models.arms import DECODERS, sizes_of_decoder
from cagesdf.structure.hierarchy import PartHierarchy

RADII = {"large": (0.6, 0.5), "small": (0.4, 0.3)}
PARTS = ("body",)
# Sizes of a small network of any kind. Those that a decoder alone has, which aren't named here, are OWN's by type.
OWN = {int: 2, float: 0.5}
SIZES: dict[str, Any] = {
    size: OWN[kind] for name in DECODERS for size, kind in sizes_of_decoder(name).items() if kind in OWN
} | {
    "width": 24,
    "layers": 3,
    "latent_dim": 4,
    "mapping": (16,),
    "octaves": 1,
    "code_dim": 6,
    "cells": 5,
    "channels": 4,
    "line_cells": 8,
    "line_channels": 2,
    "context": 8,
    "context_layers": 1,
    "heads": 2,
}


def sequences() -> dict[str, Sequence]:
    return {
        shape_id: Sequence(
            shape_id,
            None,
            np.linspace(0, 1, len(radii)),
            (False,) * len(radii),
            tuple(Cage.of({"body": Cuboid(np.zeros(3), np.eye(3), np.full(3, 2 * radius))}) for radius in radii),
        )
        for shape_id, radii in RADII.items()
    }


def structures() -> dict[str, PartHierarchy]:
    return {shape_id: PartHierarchy.flat(PARTS, ("ball",), "toy") for shape_id in RADII}


def similarities() -> dict[str, Similarity]:
    return {shape_id: Similarity(2.0, np.eye(3), np.array([0.0, 1.0, 0.0])) for shape_id in RADII}


def chunks(counts: tuple[int, ...] = (6, 4, 3, 5), reach: float = 1.05, seed: int = 0) -> PointChunks:
    """`counts` chunks of large/0, large/1, small/0, small/1; uniform points in [-reach, reach]³."""
    rng = np.random.default_rng(seed)
    names = tuple(sorted(RADII))
    places = [(names.index(name), step, radius) for name, radii in RADII.items() for step, radius in enumerate(radii)]
    rows = [place for place, count in zip(places, counts) for _ in range(count)]
    xyz = rng.uniform(-reach, reach, (len(rows), CHUNK, 3)).astype(np.float32)
    radii = np.array([radius for _, _, radius in rows])
    return PointChunks(
        np.array([shape for shape, _, _ in rows], np.int32),
        np.array([step for _, step, _ in rows], np.int32),
        np.zeros(len(rows), np.int32),
        xyz,
        (np.linalg.norm(xyz, axis=2) - radii[:, None]).astype(np.float32),
        np.zeros((len(rows), CHUNK), bool),
        names,
        PARTS,
    )
