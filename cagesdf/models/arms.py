"""The networks an arm may name."""

from collections.abc import Sequence

import torch

from cagesdf.errors import InputError
from cagesdf.models.decoders import CageDecoder, Decoder, DeepSdfDecoder, LocalCageDecoder

DECODERS: dict[str, type[Decoder]] = {
    decoder.__name__: decoder for decoder in (CageDecoder, LocalCageDecoder, DeepSdfDecoder)
}


def make_decoder(
    name: str, width: int, layers: int, latent_dim: int, mapping: Sequence[int], octaves: int, seed: int
) -> Decoder:
    """A decoder with weights drawn from `seed`. Raises InputError for a name that no decoder has."""
    if name not in DECODERS:
        raise InputError(f"no decoder {name!r}; there are {', '.join(DECODERS)}")
    # Layers draw from torch's global generator; it is left as it was.
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return DECODERS[name](width, layers, latent_dim, mapping, octaves)
