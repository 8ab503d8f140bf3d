"""From a point, a code and a cuboid to a signed distance: the paper's network and the baseline.

All have one signature, for groups of points that share one code and one cuboid. Points and
cuboids are canonical, distances too, negative inside. `cuboid` is the 15-vector of
`Cage.vectors`: centre, axes by rows, full lengths. What a part's code is, is the decoder's: the
latent of its shape itself, or what a network makes of that and the whole cage.
"""

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar, Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from cagesdf.errors import InputError
from cagesdf.frames import OUTSIDE
from cagesdf.models.film import FilmBackbone, modulated
from cagesdf.models.sines import sine_features

CUBOID = 15  # numbers that describe a cuboid (§3.1)

# part: around each part, distances to the part's own surface; cage: of the whole shape, near the points' cuboid;
# cube: of the whole shape, anywhere in the cube. The first two know cuboids.
TrainsOn = Literal["part", "cage", "cube"]


class Decoder(nn.Module, ABC):
    """A network in four steps: codes of a cage's parts, conditions of groups, features of points, layers.

    Parts move with their cuboids: values of a decoder that trains on parts depend on the code, on the cuboid's lengths
    and on the point in the cuboid's local frame alone (`check_placement`).
    """

    trains_on: ClassVar[TrainsOn]
    trusted: ClassVar[float] = OUTSIDE  # largest value that is a distance, in the decoder's unit; beyond, a sign alone
    code_dim: int | None = None  # numbers of a part's code where a network makes it; None: it is the latent itself

    def codes(
        self, latent: Float[Tensor, "s d"], cuboids: Float[Tensor, "s p 15"], present: Bool[Tensor, "s p"]
    ) -> Float[Tensor, "s p k"]:
        """The code of each part of whole cages: here the latent of its shape. Absent parts' codes mean nothing."""
        return latent[:, None].expand(-1, cuboids.shape[1], -1)

    def unit(self, cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, " g"]:
        """The length that distances are measured in as they are learnt, canonical units: here 1."""
        return torch.ones_like(cuboid[:, 0])

    def errors(
        self, predicted: Float[Tensor, "g n"], sdf: Float[Tensor, "g n"], cuboid: Float[Tensor, "g 15"], clamp: float
    ) -> Float[Tensor, "g n"]:
        """Loss of each point, in the decoder's unit; 0 where prediction and truth agree.

        Here |predicted − sdf|, both canonical. Where `clamp` is not 0, both are clamped to ±`clamp` units first, as in
        DeepSDF: beyond it only the sign matters.
        """
        unit = self.unit(cuboid)[:, None]
        predicted, sdf = predicted / unit, sdf / unit
        if clamp:
            predicted, sdf = predicted.clamp(-clamp, clamp), sdf.clamp(-clamp, clamp)
        return (predicted - sdf).abs()

    @abstractmethod
    def features(self, points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n i"]:
        """Inputs of the first layer for each point."""

    @abstractmethod
    def condition(self, code: Float[Tensor, "g k"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g ..."]:
        """Each group's numbers that act on the layers, from its code and cuboid: scales, shifts, planes, lines."""

    @abstractmethod
    def evaluate(
        self, features: Float[Tensor, "g n i"], condition: Float[Tensor, "g ..."], compute_dtype: torch.dtype
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point; matrices are multiplied in the number format `compute_dtype`."""

    def on_lattice(
        self, condition: Float[Tensor, "1 ..."], cuboid: Float[Tensor, "1 15"], axes: Sequence[Float[Tensor, " _"]]
    ) -> Callable[[Int[Tensor, "n 3"]], Float[Tensor, " n"]]:
        """From nodes of a lattice, by their indices along the axes of one cuboid, to signed distances.

        `axes` are the nodes' coordinates along each axis in the unit frame. Equal to `evaluate` but for rounding; a
        decoder that knows more of lattices can be faster.
        """

        def at_nodes(nodes: Int[Tensor, "n 3"]) -> Float[Tensor, " n"]:
            unit = torch.stack([axis[index] for axis, index in zip(axes, nodes.T)], dim=1)
            points = from_unit(unit[None], cuboid)
            return self.evaluate(self.features(points, cuboid), condition, points.dtype)[0]

        return at_nodes

    def forward(
        self, points: Float[Tensor, "g n 3"], code: Float[Tensor, "g k"], cuboid: Float[Tensor, "g 15"]
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point."""
        features = self.features(points, cuboid)
        return self.evaluate(features, self.condition(code, cuboid), features.dtype)


def check_placement(decoder: Decoder, latent_dim: int) -> None:
    """Check that the values of a decoder that trains on parts move with the cuboid.

    Extraction asks each part with its cuboid at the origin. Raises InputError for a decoder that sees where it stands.
    """
    if decoder.trains_on != "part":
        return
    exact = copy.deepcopy(decoder).cpu().double().requires_grad_(False)
    generator = torch.Generator().manual_seed(0)
    for parameter in exact.parameters():
        if not parameter.any():  # zeros would hide what they are multiplied by
            parameter.normal_(0, 0.1, generator=generator)
    code = torch.randn(1, decoder.code_dim or latent_dim, generator=generator, dtype=torch.float64)
    unit = torch.rand(1, 64, 3, generator=generator, dtype=torch.float64) - 0.5
    # The second is moved, and turned by a third of a turn about (1, 1, 1).
    cuboids = (
        [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0.4, 0.9, 0.15],
        [0.2, -0.3, 0.1, 0, 1, 0, 0, 0, 1, 1, 0, 0, 0.4, 0.9, 0.15],
    )
    placed = [torch.tensor([numbers], dtype=torch.float64) for numbers in cuboids]
    here, there = (exact(from_unit(unit, cuboid), code, cuboid) for cuboid in placed)
    if (here - there).abs().max() > 1e-3 * (here.max() - here.min()):
        raise InputError(
            f"{type(decoder).__name__}: trains on parts, but its values depend on where the cuboid stands; wanted "
            'those of to_unit(points, cuboid), the code and the lengths alone, or trains_on = "cage"'
        )


class CageDecoder(Decoder):
    """The paper's network: points in the shape's frame, FiLM by latent and cuboid (§3.1, Fig. 2).

    With `octaves`, points and cuboids come with sine features, which the paper's did not: in a
    thousandth of its training they teach the network where in the shape's frame a cuboid lies.
    """

    trains_on = "cage"

    def __init__(self, width: int, layers: int, latent_dim: int, mapping: Sequence[int], octaves: int) -> None:
        super().__init__()
        self.octaves = octaves
        self.backbone = FilmBackbone(3 + 6 * octaves, latent_dim + CUBOID * (1 + 2 * octaves), width, layers, mapping)

    def condition(self, code: Float[Tensor, "g k"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g ..."]:
        """Scales and shifts of the layers."""
        return self.backbone.mapping(torch.cat([code, cuboid, sine_features(cuboid, self.octaves)], dim=-1))

    def features(self, points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n i"]:
        """The point and its sines."""
        return torch.cat([points, sine_features(points, self.octaves)], dim=-1)

    def evaluate(
        self, features: Float[Tensor, "g n i"], condition: Float[Tensor, "g ..."], compute_dtype: torch.dtype
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point."""
        return self.backbone(features, condition, compute_dtype)


class DeepSdfDecoder(Decoder):
    """The baseline (Park et al. 2019): [point, latent] into a plain ReLU network, and again halfway.

    What a latent adds to a layer is the same for all points of its group: a shift. Their weight
    normalisation, dropout and final tanh are left out, as in the other decoders.
    """

    trains_on = "cube"

    def __init__(self, width: int, layers: int, latent_dim: int, mapping: Sequence[int], octaves: int) -> None:
        super().__init__()
        self.octaves = octaves
        self.skip_layer = layers // 2
        inputs = 3 + 6 * octaves + latent_dim
        into = [inputs if i == 0 else width + inputs if i == self.skip_layer else width for i in range(layers)]
        self.hidden = nn.ModuleList([nn.Linear(size, width) for size in into])
        self.out = nn.Linear(width, 1)

    def condition(self, code: Float[Tensor, "g k"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g ..."]:
        """Shifts of the layers; the cuboid plays no part."""
        shifts = [layer.get_parameter("bias").expand(len(code), -1) for layer in self.hidden]
        for i in {0, self.skip_layer}:
            shifts[i] = shifts[i] + code @ self.hidden[i].get_parameter("weight")[:, -code.shape[1] :].T
        return torch.stack(shifts, dim=1)

    def features(self, points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n i"]:
        """The point and its sines; the cuboid plays no part."""
        return torch.cat([points, sine_features(points, self.octaves)], dim=-1)

    def evaluate(
        self, features: Float[Tensor, "g n i"], condition: Float[Tensor, "g ..."], compute_dtype: torch.dtype
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point."""
        width, inputs = self.out.in_features, features.shape[-1]
        weights = [
            layer.get_parameter("weight")[:, : inputs if i == 0 else width + inputs if i == self.skip_layer else width]
            for i, layer in enumerate(self.hidden)
        ]
        return self.out(modulated(features, None, condition, self.skip_layer, weights, compute_dtype))[..., 0]


def to_unit(points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n 3"]:
    """Canonical points in the unit frame of their group's cuboid: [-½, ½]³ is inside."""
    local = (points - cuboid[:, None, :3]) @ cuboid[:, 3:12].view(-1, 3, 3).mT
    return local / cuboid[:, None, 12:]


def from_unit(unit: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n 3"]:
    """Undo `to_unit`."""
    return (unit * cuboid[:, None, 12:]) @ cuboid[:, 3:12].view(-1, 3, 3) + cuboid[:, None, :3]
