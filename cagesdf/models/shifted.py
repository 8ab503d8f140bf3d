"""A decoder of which a part of a shape has its own version: the same weights, another FiLM."""

from copy import deepcopy
from typing import Any

from jaxtyping import Float
from torch import Tensor, nn


class ShiftedMapping(nn.Module):
    """A mapping network and what is added to all that it says."""

    def __init__(self, mapping: nn.Module, shift: Tensor) -> None:
        super().__init__()
        self.mapping = mapping
        self.shift = shift

    def forward(self, condition: Float[Tensor, "g c"]) -> Float[Tensor, "g l 2 h"]:
        """As MappingNetwork's."""
        return self.mapping(condition) + self.shift


class ShiftedDecoder(nn.Module):
    """A decoder by latent and cuboid with its FiLM shifted; weights are shared, the decoder stays as it is."""

    def __init__(self, decoder: nn.Module, shift: Float[Tensor, "*g l 2 h"]) -> None:
        """`shift` is added to the scales and shifts of each unit, of each group or of all."""
        super().__init__()
        shared: Any = deepcopy(decoder, {id(weight): weight for weight in decoder.parameters()})
        shared.backbone.mapping = ShiftedMapping(shared.backbone.mapping, shift)
        self.decoder: nn.Module = shared

    def forward(
        self, points: Float[Tensor, "g n 3"], latent: Float[Tensor, "g d"], cuboid: Float[Tensor, "g 15"]
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point."""
        return self.decoder(points, latent, cuboid)


def film_size(decoder: nn.Module) -> tuple[int, int, int]:
    """Numbers that FiLM has for a group: layers, scale and shift, width."""
    mapping: Any = decoder.get_submodule("backbone.mapping")
    return int(mapping.layers), 2, int(mapping.width)
