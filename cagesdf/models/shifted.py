"""A decoder of which a part of a shape has its own version: the same weights, another FiLM."""

from copy import deepcopy
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cagesdf.models.decoders import Decoder


class ShiftedMapping(nn.Module):
    """A mapping network and what is added to all that it says."""

    def __init__(self, mapping: nn.Module, shift: Tensor) -> None:
        super().__init__()
        self.mapping = mapping
        self.shift = shift

    def forward(self, condition: Float[Tensor, "g c"]) -> Float[Tensor, "g l 2 h"]:
        """As MappingNetwork's."""
        return self.mapping(condition) + self.shift


class ShiftedDecoder(Decoder):
    """A decoder by latent and cuboid with its FiLM shifted; weights are shared, the decoder stays as it is."""

    def __init__(self, decoder: nn.Module, shift: Float[Tensor, "*g l 2 h"]) -> None:
        """`shift` is added to the scales and shifts of each unit, of each group or of all."""
        super().__init__()
        shared: Any = deepcopy(decoder, {id(weight): weight for weight in decoder.parameters()})
        shared.backbone.mapping = ShiftedMapping(shared.backbone.mapping, shift)
        self.decoder: Decoder = shared

    def features(self, points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n i"]:
        """As the decoder's."""
        return self.decoder.features(points, cuboid)

    def condition(self, latent: Float[Tensor, "g d"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g ..."]:
        """The decoder's, shifted."""
        return self.decoder.condition(latent, cuboid)

    def at(
        self, features: Float[Tensor, "g n i"], condition: Float[Tensor, "g ..."], products: torch.dtype
    ) -> Float[Tensor, "g n"]:
        """As the decoder's."""
        return self.decoder.at(features, condition, products)


def film_size(decoder: nn.Module) -> tuple[int, int, int]:
    """Numbers that FiLM has for a group: layers, scale and shift, width."""
    mapping: Any = decoder.get_submodule("backbone.mapping")
    return int(mapping.layers), 2, int(mapping.width)
