"""From a point, a latent and a cuboid to a signed distance: the paper's network, ours, the baseline.

All have one signature, for groups of points that share one latent and one cuboid. Points and
cuboids are canonical, distances too, negative inside. `cuboid` is the 15-vector of
`Cage.vectors`: centre, axes by rows, full lengths.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cagesdf.models.film import FilmBackbone

CUBOID = 15  # numbers that describe a cuboid (§3.1)


class CageDecoder(nn.Module):
    """The paper's network: points in the shape's frame, FiLM by latent and cuboid (§3.1, Fig. 2).

    With `octaves`, points and cuboids come with sine features, which the paper's did not: in a
    thousandth of its training they teach the network where in the shape's frame a cuboid lies.
    """

    def __init__(self, width: int, layers: int, latent_dim: int, mapping: Sequence[int], octaves: int) -> None:
        super().__init__()
        self.octaves = octaves
        self.backbone = FilmBackbone(3 + 6 * octaves, latent_dim + CUBOID * (1 + 2 * octaves), width, layers, mapping)

    def forward(
        self, points: Float[Tensor, "g n 3"], latent: Float[Tensor, "g d"], cuboid: Float[Tensor, "g 15"]
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point."""
        features = torch.cat([points, sine_features(points, self.octaves)], dim=-1)
        condition = torch.cat([latent, cuboid, sine_features(cuboid, self.octaves)], dim=-1)
        return self.backbone(features, condition)


class LocalCageDecoder(nn.Module):
    """The same, given the point in its cuboid's unit frame too; sine features are of those coordinates."""

    def __init__(self, width: int, layers: int, latent_dim: int, mapping: Sequence[int], octaves: int) -> None:
        super().__init__()
        self.octaves = octaves
        self.backbone = FilmBackbone(6 + 6 * octaves, latent_dim + CUBOID, width, layers, mapping)

    def forward(
        self, points: Float[Tensor, "g n 3"], latent: Float[Tensor, "g d"], cuboid: Float[Tensor, "g 15"]
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point."""
        unit = to_unit(points, cuboid)
        features = torch.cat([points, unit, sine_features(unit, self.octaves)], dim=-1)
        return self.backbone(features, torch.cat([latent, cuboid], dim=-1))


class DeepSdfDecoder(nn.Module):
    """The baseline (Park et al. 2019): [latent, point] into a plain ReLU network, and again halfway.

    Their weight normalisation, dropout and final tanh are left out, as in the other decoders.
    """

    def __init__(self, width: int, layers: int, latent_dim: int, mapping: Sequence[int], octaves: int) -> None:
        super().__init__()
        self.octaves = octaves
        self.again = layers // 2
        inputs = 3 + 6 * octaves + latent_dim
        into = [inputs if i == 0 else width + inputs if i == self.again else width for i in range(layers)]
        self.hidden = nn.ModuleList([nn.Linear(size, width) for size in into])
        self.out = nn.Linear(width, 1)

    def forward(
        self, points: Float[Tensor, "g n 3"], latent: Float[Tensor, "g d"], cuboid: Float[Tensor, "g 15"]
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point; the cuboid plays no part."""
        shared = latent[:, None].expand(-1, points.shape[1], -1)
        inputs = torch.cat([points, sine_features(points, self.octaves), shared], dim=-1)
        hidden = inputs
        for i, layer in enumerate(self.hidden):
            hidden = torch.relu(layer(torch.cat([hidden, inputs], dim=-1) if 0 < i == self.again else hidden))
        return self.out(hidden)[..., 0]


def to_unit(points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n 3"]:
    """Canonical points in the unit frame of their group's cuboid: [-½, ½]³ is inside."""
    local = (points - cuboid[:, None, :3]) @ cuboid[:, 3:12].view(-1, 3, 3).mT
    return local / cuboid[:, None, 12:]


def sine_features(numbers: Float[Tensor, "*g d"], octaves: int) -> Float[Tensor, "*g f"]:
    """Sine and cosine of π·2^k times each number, k from 0 to `octaves` − 1: 2 · d · `octaves` features."""
    angles = numbers[..., None, :] * (math.pi * 2.0 ** torch.arange(octaves, device=numbers.device)[:, None])
    return torch.cat([angles.sin(), angles.cos()], dim=-1).flatten(-2)
