"""A run without a training: enough for all that doesn't ask how good a surface is."""

from typing import Any

import numpy as np
import torch

from cagesdf.cuboid import Sequence
from cagesdf.editing.session import Session
from cagesdf.frames import UP_AXES, Similarity
from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import LatentTable
from cagesdf.run import Run
from cagesdf.structure.assembly import Assembly
from tests.support import programs

FIGURES: dict[str, Any] = {
    "width": 12,
    "layers": 3,
    "latent_dim": 4,
    "mapping": [8],
    "octaves": 1,
    "code_dim": 6,
    "cells": 4,
    "channels": 3,
    "line_cells": 6,
    "line_channels": 2,
    "context": 8,
    "context_layers": 1,
    "heads": 2,
}


def untrained() -> Session:
    """Two chairs in one cage, and a network that was never trained: what it says differs by cuboid and style."""
    decoder: Any = make_decoder("TriplaneDecoder", **FIGURES, seed=1)
    with torch.no_grad():
        decoder.hidden[0].weight[:, 3 * (decoder.channels + decoder.line_channels) :].mul_(
            8
        )  # of places: the surface goes through cuboids
        decoder.out.weight.mul_(4)
        decoder.out.bias.fill_(-0.2)  # no part is nothing
    labels = {"arm": "arm", "cube4": "arm", "Base/Side/leg": "leg", "Base/cube1/leg": "leg"}
    structure = Assembly(programs.CHAIR, Similarity(0.9, np.eye(3), np.zeros(3)), labels)
    names = ("a", "b")
    return Session(
        Run(
            decoder.eval().requires_grad_(False),
            LatentTable.drawn(tuple((name, -1) for name in names), 4, 3.0, seed=2).requires_grad_(False),
            {name: Sequence(name, None, np.zeros(1), (False,), (structure.cage(),)) for name in names},
            dict.fromkeys(names, structure),
            dict.fromkeys(names, Similarity(0.5, UP_AXES["z"], np.array([0.1, 0.2, 0.3]))),
            {**FIGURES, "decoder": "TriplaneDecoder"},
            {},
        )
    )
