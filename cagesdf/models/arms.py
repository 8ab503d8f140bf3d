"""The networks an arm may name."""

from inspect import signature
from typing import Any

import torch

from cagesdf.errors import InputError
from cagesdf.models.decoders import CageDecoder, Decoder, DeepSdfDecoder
from cagesdf.models.occupancy import OccupancyDecoder
from cagesdf.models.triplane import PlainTriplaneDecoder, RelationTriplaneDecoder, TriplaneDecoder

DECODERS: dict[str, type[Decoder]] = {
    decoder.__name__: decoder
    for decoder in (
        TriplaneDecoder,
        PlainTriplaneDecoder,
        RelationTriplaneDecoder,
        OccupancyDecoder,
        CageDecoder,
        DeepSdfDecoder,
    )
}


def decoder_class(name: str) -> type[Decoder]:
    """The decoder of a name. Raises InputError for a name that none has."""
    if name not in DECODERS:
        raise InputError(f"no decoder {name!r}; there are {', '.join(DECODERS)}")
    return DECODERS[name]


def sizes_of_decoder(name: str) -> dict[str, Any]:
    """The sizes that a decoder is made with, and their types. Raises InputError as `decoder_class` does."""
    return {size: argument.annotation for size, argument in signature(decoder_class(name)).parameters.items()}


def make_decoder(name: str, seed: int, **sizes: Any) -> Decoder:
    """A decoder with weights drawn from `seed`; sizes that it doesn't have play no part.

    Raises InputError as `decoder_class` does, for a size that is missing, and for sizes that don't go together.
    """
    needed = sizes_of_decoder(name)
    if missing := [size for size in needed if size not in sizes]:
        raise InputError(f"{name}: no {', '.join(missing)}; wanted all of {', '.join(needed)}")
    # Layers draw from torch's global generator; it is left as it was.
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return decoder_class(name)(**{size: sizes[size] for size in needed})
