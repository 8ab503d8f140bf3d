"""Featurewise linear modulation (FiLM): what a latent and a cuboid do to a network (§3.1).

All points of a group share one latent and one cuboid, so scales and shifts are computed once
for a group, never for a point.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn


class MappingNetwork(nn.Module):
    """From a condition, [latent, cuboid], to a scale and a shift for every unit of every layer."""

    def __init__(self, condition: int, hidden: Sequence[int], layers: int, width: int) -> None:
        """`condition` numbers in; a ReLU layer for each width in `hidden`; 2 · `layers` · `width` numbers out."""
        super().__init__()
        self.layers = layers
        self.width = width
        widths = [condition, *hidden]
        self.hidden = nn.ModuleList([nn.Linear(a, b) for a, b in pairwise(widths)])
        self.out = nn.Linear(widths[-1], 2 * layers * width)

    def forward(self, condition: Float[Tensor, "g c"]) -> Float[Tensor, "g l 2 h"]:
        """By group and layer: scale − 1, then shift. A scale is near 1 as training starts."""
        for layer in self.hidden:
            condition = torch.relu(layer(condition))
        return self.out(condition).view(-1, self.layers, 2, self.width)


class FilmBackbone(nn.Module):
    """DeepSDF's network, modulated: ReLU layers from point features to one number, FiLM before each ReLU.

    As there, the features enter a second time halfway.
    """

    def __init__(self, inputs: int, condition: int, width: int, layers: int, mapping: Sequence[int]) -> None:
        """`inputs` features a point, `condition` numbers a group, `layers` hidden layers of `width` units."""
        super().__init__()
        self.mapping = MappingNetwork(condition, mapping, layers, width)
        self.again = layers // 2
        into = [inputs if i == 0 else width + inputs if i == self.again else width for i in range(layers)]
        self.hidden = nn.ModuleList([nn.Linear(size, width, bias=False) for size in into])  # the shifts are the biases
        self.out = nn.Linear(width, 1)

    def forward(self, features: Float[Tensor, "g n i"], condition: Float[Tensor, "g c"]) -> Float[Tensor, "g n"]:
        """One number a point."""
        film = self.mapping(condition)[:, :, :, None]
        hidden = features
        for i, layer in enumerate(self.hidden):
            inputs = torch.cat([hidden, features], dim=-1) if 0 < i == self.again else hidden
            hidden = torch.relu(layer(inputs) * (1 + film[:, i, 0]) + film[:, i, 1])
        return self.out(hidden)[..., 0]
