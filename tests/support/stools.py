"""Stools: arms of constant networks and a generator of cages."""

from pathlib import Path

import numpy as np

from cagesdf.cage_generation.novelty import reach_of
from cagesdf.cage_generation.proportions import ProportionGenerator, families
from cagesdf.cage_generation.trained import TrainedGenerator
from cagesdf.cuboid import Cage, Cuboid, Sequence
from cagesdf.frames import Similarity
from cagesdf.io.cage_generators import write_generator
from cagesdf.io.runs import write_run
from cagesdf.models.latents import LatentTable
from cagesdf.run import Run
from cagesdf.structure.hierarchy import PartHierarchy
from pipeline import artefact
from tests.support import constant_runs

NAMES = ("stool_0", "stool_1", "stool_2", "stool_3")


def stool(width: float, height: float) -> Cage:
    """A seat on a block that reaches into it; canonical enough."""
    seat = Cuboid(np.array([0, height / 2, 0]), np.eye(3), np.array([width, 0.2, width]))
    block = Cuboid(np.array([0, -0.05, 0]), np.eye(3), np.array([0.3, height, 0.3]))
    return Cage.of({"seat": seat, "block": block})


CAGES = {name: stool(0.6 + 0.1 * i, 0.7 + 0.02 * i) for i, name in enumerate(NAMES)}


STRUCTURES = {name: PartHierarchy.flat(("seat", "block"), ("seat", "block"), "stool") for name in NAMES}


def write_arm(folder: Path, value: float, trains_on: str = "cage") -> Path:
    """A run whose network says `value` everywhere, so that the cage is the surface, or there is none."""
    kind = {"cage": "CageDecoder", "cube": "DeepSdfDecoder"}[trains_on]
    run = Run(
        constant_runs.constant(kind, value),
        LatentTable.drawn(tuple((name, -1) for name in NAMES), 2, 1.0, seed=0),
        {name: Sequence(name, None, np.zeros(1), (False,), (cage,)) for name, cage in CAGES.items()},
        STRUCTURES,
        dict.fromkeys(NAMES, Similarity(1.0, np.eye(3), np.zeros(3))),
        {**constant_runs.FIGURES, "decoder": kind},
        {"sampled": 1, "used": 1},
    )
    with artefact.write("run", folder, inputs={}, params=constant_runs.PARAMS) as out:
        write_run(out, run, [])
    return folder


def write_programs(folder: Path) -> Path:
    generator = ProportionGenerator(families(STRUCTURES, CAGES), reach_of(CAGES.values()))
    with artefact.write("programs", folder, inputs={}, params=constant_runs.PARAMS) as out:
        write_generator(out, TrainedGenerator(generator, STRUCTURES, CAGES), [], {})
    return folder
