"""From a point, a latent and a cuboid to a signed distance: the paper's network, ours, the baseline.

All have one signature, for groups of points that share one latent and one cuboid. Points and
cuboids are canonical, distances too, negative inside. `cuboid` is the 15-vector of
`Cage.vectors`: centre, axes by rows, full lengths.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from cagesdf.models.film import FilmBackbone, modulated

CUBOID = 15  # numbers that describe a cuboid (§3.1)


TrainsOn = Literal["part", "cage", "cube"]


class Decoder(nn.Module, ABC):
    """A network in three steps: what it is given of points, what groups need once, and the layers."""

    trains_on: ClassVar[TrainsOn] = "cage"

    def codes(
        self, latent: Float[Tensor, "s d"], cuboids: Float[Tensor, "s p 15"], present: Bool[Tensor, "s p"]
    ) -> Float[Tensor, "s p k"]:
        return latent[:, None].expand(-1, cuboids.shape[1], -1)

    def unit(self, cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, " g"]:
        return torch.ones_like(cuboid[:, 0])

    @abstractmethod
    def features(self, points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n i"]:
        """What the layers are given of each point."""

    @abstractmethod
    def condition(self, latent: Float[Tensor, "g d"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g ..."]:
        """What a group's latent and cuboid do to the layers."""

    @abstractmethod
    def at(
        self, features: Float[Tensor, "g n i"], condition: Float[Tensor, "g ..."], products: torch.dtype
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point; matrices are multiplied in the number format `products`."""

    def forward(
        self, points: Float[Tensor, "g n 3"], latent: Float[Tensor, "g d"], cuboid: Float[Tensor, "g 15"]
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point."""
        features = self.features(points, cuboid)
        return self.at(features, self.condition(latent, cuboid), features.dtype)


class CageDecoder(Decoder):
    """The paper's network: points in the shape's frame, FiLM by latent and cuboid (§3.1, Fig. 2).

    With `octaves`, points and cuboids come with sine features, which the paper's did not: in a
    thousandth of its training they teach the network where in the shape's frame a cuboid lies.
    """

    def __init__(self, width: int, layers: int, latent_dim: int, mapping: Sequence[int], octaves: int) -> None:
        super().__init__()
        self.octaves = octaves
        self.backbone = FilmBackbone(3 + 6 * octaves, latent_dim + CUBOID * (1 + 2 * octaves), width, layers, mapping)

    def condition(self, latent: Float[Tensor, "g d"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g ..."]:
        """Scales and shifts of the layers."""
        return self.backbone.mapping(torch.cat([latent, cuboid, sine_features(cuboid, self.octaves)], dim=-1))

    def features(self, points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n i"]:
        """The point and its sines."""
        return torch.cat([points, sine_features(points, self.octaves)], dim=-1)

    def at(
        self, features: Float[Tensor, "g n i"], condition: Float[Tensor, "g ..."], products: torch.dtype
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point."""
        return self.backbone(features, condition, products)


class LocalCageDecoder(Decoder):
    """The same, given the point in its cuboid's unit frame too; sine features are of those coordinates."""

    def __init__(self, width: int, layers: int, latent_dim: int, mapping: Sequence[int], octaves: int) -> None:
        super().__init__()
        self.octaves = octaves
        self.backbone = FilmBackbone(6 + 6 * octaves, latent_dim + CUBOID, width, layers, mapping)

    def condition(self, latent: Float[Tensor, "g d"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g ..."]:
        """Scales and shifts of the layers."""
        return self.backbone.mapping(torch.cat([latent, cuboid], dim=-1))

    def features(self, points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n i"]:
        """The point, and in the cuboid's unit frame once more, with sines."""
        unit = to_unit(points, cuboid)
        return torch.cat([points, unit, sine_features(unit, self.octaves)], dim=-1)

    def at(
        self, features: Float[Tensor, "g n i"], condition: Float[Tensor, "g ..."], products: torch.dtype
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point."""
        return self.backbone(features, condition, products)


class DeepSdfDecoder(Decoder):
    """The baseline (Park et al. 2019): [point, latent] into a plain ReLU network, and again halfway.

    What a latent adds to a layer is the same for all points of its group: a shift. Their weight
    normalisation, dropout and final tanh are left out, as in the other decoders.
    """

    trains_on = "cube"

    def __init__(self, width: int, layers: int, latent_dim: int, mapping: Sequence[int], octaves: int) -> None:
        super().__init__()
        self.octaves = octaves
        self.again = layers // 2
        inputs = 3 + 6 * octaves + latent_dim
        into = [inputs if i == 0 else width + inputs if i == self.again else width for i in range(layers)]
        self.hidden = nn.ModuleList([nn.Linear(size, width) for size in into])
        self.out = nn.Linear(width, 1)

    def condition(self, latent: Float[Tensor, "g d"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g ..."]:
        """Shifts of the layers; the cuboid plays no part."""
        shifts = [layer.get_parameter("bias").expand(len(latent), -1) for layer in self.hidden]
        for i in {0, self.again}:
            shifts[i] = shifts[i] + latent @ self.hidden[i].get_parameter("weight")[:, -latent.shape[1] :].T
        return torch.stack(shifts, dim=1)

    def features(self, points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n i"]:
        """The point and its sines; the cuboid plays no part."""
        return torch.cat([points, sine_features(points, self.octaves)], dim=-1)

    def at(
        self, features: Float[Tensor, "g n i"], condition: Float[Tensor, "g ..."], products: torch.dtype
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point."""
        width, own = self.out.in_features, features.shape[-1]
        weights = [
            layer.get_parameter("weight")[:, : own if i == 0 else width + own if i == self.again else width]
            for i, layer in enumerate(self.hidden)
        ]
        return self.out(modulated(features, None, condition, self.again, weights, products))[..., 0]


def to_unit(points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n 3"]:
    """Canonical points in the unit frame of their group's cuboid: [-½, ½]³ is inside."""
    local = (points - cuboid[:, None, :3]) @ cuboid[:, 3:12].view(-1, 3, 3).mT
    return local / cuboid[:, None, 12:]


def sine_features(numbers: Float[Tensor, "*g d"], octaves: int) -> Float[Tensor, "*g f"]:
    """Sine and cosine of π·2^k times each number, k from 0 to `octaves` − 1: 2 · d · `octaves` features."""
    angles = numbers[..., None, :] * (math.pi * 2.0 ** torch.arange(octaves, device=numbers.device)[:, None])
    return torch.cat([angles.sin(), angles.cos()], dim=-1).flatten(-2)
