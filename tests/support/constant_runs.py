"""Runs whose network has one value everywhere, so that the cage is the surface or there is none."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from cagesdf.cuboid import Cage, Cuboid, Sequence
from cagesdf.frames import UP_AXES, Similarity
from cagesdf.io.runs import write_run
from cagesdf.models.arms import make_decoder
from cagesdf.models.decoders import Decoder
from cagesdf.models.latents import LatentTable
from cagesdf.run import Run
from cagesdf.structure.hierarchy import PartHierarchy
from pipeline import Params, artefact
from tests.support.untrained import untrained

PARAMS = Params(format=1)


SIZE = np.array([0.8, 0.6, 0.4])


FIGURES: dict[str, Any] = {"width": 4, "layers": 2, "latent_dim": 2, "mapping": [4], "octaves": 0}


def constant(kind: str, value: float) -> Decoder:
    """A network that says `value` everywhere, so that its cuboids are full or empty."""
    decoder: Any = make_decoder(kind, **FIGURES, seed=0)
    out = decoder.out if kind == "DeepSdfDecoder" else decoder.backbone.out
    with torch.no_grad():
        for parameter in decoder.parameters():
            parameter.zero_()
        out.bias.fill_(value)
    return decoder


def write_trained(folder: Path, value: float) -> Path:
    """A run of two boxes whose network says `value` everywhere, so that the cage is the surface."""
    decoder = constant("CageDecoder", value)
    cages = tuple(Cage.of({"a": Cuboid(np.zeros(3), np.eye(3), SIZE * factor)}) for factor in (1.0, 1.2))
    names = ("chair_0001", "chair_0002")
    similarity = Similarity(0.5, UP_AXES["z"], np.array([0.1, 0.2, 0.3]))
    run = Run(
        decoder,
        LatentTable(tuple((name, -1) for name in names), torch.zeros(2, 2)),
        {name: Sequence(name, None, np.array([0.0, 1.0]), (False, True), cages) for name in names},
        {name: PartHierarchy.flat(("a",), ("",), "chair") for name in names},
        dict.fromkeys(names, similarity),
        {**FIGURES, "decoder": "CageDecoder"},
        {"sampled": 1, "used": 1},
    )
    with artefact.write("run", folder, inputs={}, params=PARAMS) as out:
        write_run(out, run, [{"step": 1.0, "loss": 0.5}])
    return folder


def write_program(path: Path, name: str = "seat", height: float = 0.5) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        f"Assembly P {{\nbbox = Cuboid(1, 1, 1, True)\n{name} = Cuboid(0.5, {height}, 0.5, True)\n"
        f"attach({name}, bbox, 0.5, 0, 0.5, 0.5, 0, 0.5)\nreflect({name}, Y)\n}}\n",
        encoding="utf-8",
    )
    return path


def write_parts_run(folder: Path) -> Path:
    """A run of two chairs whose parts have codes, a and b."""
    with artefact.write("run", folder, inputs={}, params=PARAMS) as out:
        write_run(out, untrained().run, [{"step": 1.0, "loss": 0.5}])
    return folder
