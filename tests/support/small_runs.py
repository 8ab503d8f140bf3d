"""A small run of the spheres."""

from typing import Any

import torch

from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import SHARED, LatentTable
from cagesdf.run import Run
from tests.support import spheres

PARAMS: dict[str, Any] = {
    "decoder": "TriplaneDecoder",
    **spheres.SIZES,
    "mapping": [8],
    "reach": 0.02,
    "clamp": 0.0,
}


def make_run(keys: tuple[tuple[str, int], ...] = (("large", SHARED), ("small", SHARED))) -> Run:
    return Run(
        make_decoder("TriplaneDecoder", **{name: PARAMS[name] for name in spheres.SIZES}, seed=1),
        LatentTable.drawn(keys, 4, 1.0, seed=2),
        spheres.sequences(),
        spheres.structures(),
        spheres.similarities(),
        PARAMS,
        {"sampled": 128, "used": 64},
    )


def tensors(run: Run) -> dict[str, torch.Tensor]:
    decoder = {f"decoder.{name}": tensor for name, tensor in run.decoder.state_dict().items()}
    return {**decoder, "latents": run.latents.values.detach()}
