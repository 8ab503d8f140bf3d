"""Featurewise linear modulation (FiLM): what a latent and a cuboid do to a network (§3.1).

All points of a group share one latent and one cuboid, so scales and shifts are computed once
for a group, never for a point.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable


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
        self.skip_layer = layers // 2
        into = [inputs if i == 0 else width + inputs if i == self.skip_layer else width for i in range(layers)]
        self.hidden = nn.ModuleList([nn.Linear(size, width, bias=False) for size in into])  # the shifts are the biases
        self.out = nn.Linear(width, 1)

    def forward(
        self, features: Float[Tensor, "g n i"], film: Float[Tensor, "g l 2 h"], compute_dtype: torch.dtype
    ) -> Float[Tensor, "g n"]:
        """One number a point; `film` is what `mapping` gives for the groups, `compute_dtype` as in `modulated`."""
        weights = [layer.get_parameter("weight") for layer in self.hidden]
        return self.out(modulated(features, 1 + film[:, :, 0], film[:, :, 1], self.skip_layer, weights, compute_dtype))[
            ..., 0
        ]


def modulated(
    features: Float[Tensor, "g n i"],
    scales: Float[Tensor, "g l h"] | None,
    shifts: Float[Tensor, "g l h"],
    skip_layer: int,
    weights: Sequence[Tensor],
    compute_dtype: torch.dtype,
) -> Float[Tensor, "g n h"]:
    """The last of the layers h = relu(scale ∘ (W x) + shift); `features` enter once more before layer `skip_layer`.

    `scales` None stands for ones. Matrices are multiplied, and kept, in the number format `compute_dtype`;
    what comes out is of the features'. The gradient is written by hand: a quarter of autograd's
    operations, and less to keep for it.
    """
    if torch.is_grad_enabled():
        return _Modulated.apply(features, scales, shifts, skip_layer, compute_dtype, *weights)
    for _, _, hidden in _layers(*_cast(features, scales, shifts, compute_dtype, weights), skip_layer):
        last = hidden
    return last.to(features.dtype)


class _Modulated(torch.autograd.Function):
    """`modulated` and its gradient."""

    @staticmethod
    def forward(
        ctx: Any,
        features: Tensor,
        scales: Tensor | None,
        shifts: Tensor,
        skip_layer: int,
        dtype: torch.dtype,
        *weights: Tensor,
    ) -> Tensor:
        kind = features.dtype
        features, scales, shifts, cast = _cast(features, scales, shifts, dtype, weights)
        inputs, products, outputs = zip(*_layers(features, scales, shifts, cast, skip_layer), strict=True)
        ctx.skip_layer = skip_layer
        # A layer's input is the output of the one before, except where features enter.
        ctx.save_for_backward(
            scales, inputs[0], inputs[skip_layer], *(products if scales is not None else ()), *outputs, *cast
        )
        return outputs[-1].to(kind)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (gradient,) = gradients
        scales, features, joined, *rest = ctx.saved_tensors
        count = len(ctx.needs_input_grad) - 5
        outputs, weights = rest[-2 * count : -count], rest[-count:]
        gradient = gradient.to(features.dtype)
        inputs = [features, *outputs[:-1]]
        inputs[ctx.skip_layer] = joined
        width = gradient.shape[-1]
        to_scales, to_shifts, to_weights = [], [], []
        to_features = torch.zeros_like(features) if ctx.needs_input_grad[0] else None
        scaled = torch.empty_like(gradient)  # one buffer for all layers: new ones cost a fifth of a step in float32
        for i in reversed(range(count)):
            gradient = torch.ops.aten.threshold_backward(gradient, outputs[i], 0)
            to_shifts.append(gradient.sum(dim=1))
            if scales is not None:
                to_scales.append(torch.mul(gradient, rest[i], out=scaled).sum(dim=1))
                gradient.mul_(scales[:, i, None])
            if ctx.needs_input_grad[5 + i]:
                to_weights.append(gradient.flatten(0, 1).T @ inputs[i].flatten(0, 1))
            else:
                to_weights.append(None)
            if to_features is not None and i in (0, ctx.skip_layer):
                to_features += gradient @ (weights[i][:, width:] if i else weights[i])
            if i:
                gradient = gradient @ weights[i][:, :width]
        return (
            to_features,
            torch.stack(to_scales[::-1], dim=1) if scales is not None else None,
            torch.stack(to_shifts[::-1], dim=1),
            None,
            None,
            *to_weights[::-1],
        )


def _cast(
    features: Tensor, scales: Tensor | None, shifts: Tensor, dtype: torch.dtype, weights: Sequence[Tensor]
) -> tuple[Tensor, Tensor | None, Tensor, list[Tensor]]:
    scales = None if scales is None else scales.to(dtype)
    return features.to(dtype), scales, shifts.to(dtype), [weight.to(dtype) for weight in weights]


def _layers(
    features: Tensor, scales: Tensor | None, shifts: Tensor, weights: Sequence[Tensor], skip_layer: int
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Input of each layer, product of input and weights, output."""
    hidden = features
    for i, weight in enumerate(weights):
        inputs = torch.cat([hidden, features], dim=-1) if 0 < i == skip_layer else hidden
        product = inputs @ weight.T
        shift = shifts[:, i, None]
        # Without scales the product isn't needed again.
        moved = product.add_(shift) if scales is None else torch.addcmul(shift, product, scales[:, i, None])
        hidden = moved.relu_()
        yield inputs, product, hidden
