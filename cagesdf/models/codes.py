"""Codes of the parts of one cage."""

import torch
from jaxtyping import Float
from torch import Tensor

from cagesdf.cuboid import Cage
from cagesdf.models.decoders import Decoder


def part_codes(decoder: Decoder, latent: Float[Tensor, " d"], cage: Cage) -> Float[Tensor, "p k"]:
    """The code of each part, in the cage's order, that a decoder makes of a shape's latent and its canonical cage."""
    cuboids = torch.from_numpy(cage.vectors()).to(latent)
    present = torch.ones(1, len(cage), dtype=torch.bool, device=latent.device)
    return decoder.codes(latent[None], cuboids[None], present)[0]
