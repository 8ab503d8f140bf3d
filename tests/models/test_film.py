"""The hand-written gradient of modulated layers against autograd's."""

import pytest
import torch
from torch import Tensor

from cagesdf.models.arms import DECODERS, make_decoder
from cagesdf.models.decoders import Decoder
from cagesdf.models.film import modulated
from tests.support.spheres import SIZES


def plain(
    features: Tensor, scales: Tensor | None, shifts: Tensor, again: int, weights: list[Tensor], *_: object
) -> Tensor:
    """The slow obvious version."""
    hidden = features
    for i, weight in enumerate(weights):
        inputs = torch.cat([hidden, features], dim=-1) if 0 < i == again else hidden
        product = inputs @ weight.T
        scaled = product if scales is None else product * scales[:, i, None]
        hidden = torch.relu(scaled + shifts[:, i, None])
    return hidden


def drawn(layers: int, again: int, width: int = 6, dtype: torch.dtype = torch.float64) -> list[Tensor]:
    """Features, scales, shifts and weights of three groups of four points."""
    generator = torch.Generator().manual_seed(layers)
    into = [5 if i == 0 else width + 5 if i == again else width for i in range(layers)]
    shapes = [(3, 4, 5), (3, layers, width), (3, layers, width), *((width, size) for size in into)]
    return [torch.randn(shape, generator=generator, dtype=dtype).requires_grad_() for shape in shapes]


@pytest.mark.parametrize(("layers", "again"), [(1, 0), (2, 1), (5, 2)])
@pytest.mark.parametrize("scaled", [True, False])
def test_the_gradient_by_hand_is_that_of_finite_differences(layers: int, again: int, scaled: bool) -> None:
    features, scales, shifts, *weights = drawn(layers, again)
    given = [features, *([scales] if scaled else []), shifts, *weights]

    def called(features: Tensor, *rest: Tensor) -> Tensor:
        shifts, *weights = rest[1:] if scaled else rest
        return modulated(features, rest[0] if scaled else None, shifts, again, weights, torch.float64)

    assert torch.autograd.gradcheck(called, given)


@pytest.mark.parametrize("scaled", [True, False])
def test_value_and_gradient_are_those_of_the_obvious_version(scaled: bool) -> None:
    features, scales, shifts, *weights = drawn(6, 3)
    used = scales if scaled else None
    given = [features, *([scales] if scaled else []), shifts, *weights]
    results = [function(features, used, shifts, 3, weights, torch.float64) for function in (modulated, plain)]
    torch.testing.assert_close(*results)
    along = torch.randn(results[0].shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    fast, slow = (torch.autograd.grad(result, given, along) for result in results)
    torch.testing.assert_close(fast, slow)


def test_nothing_is_computed_for_what_needs_no_gradient_and_the_rest_is_the_same() -> None:
    features, scales, shifts, *weights = drawn(4, 2)
    whole = torch.autograd.grad(modulated(features, scales, shifts, 2, weights, torch.float64).sum(), [scales, shifts])
    fixed = [tensor.detach() for tensor in (features, *weights)]
    part = torch.autograd.grad(modulated(fixed[0], scales, shifts, 2, fixed[1:], torch.float64).sum(), [scales, shifts])
    torch.testing.assert_close(whole, part)


def test_without_gradients_the_values_are_the_same_bits() -> None:
    features, scales, shifts, *weights = drawn(4, 2, dtype=torch.float32)
    trained = modulated(features, scales, shifts, 2, weights, torch.float32)
    with torch.inference_mode():
        assert torch.equal(trained, modulated(features, scales, shifts, 2, weights, torch.float32))


def obvious(decoder: Decoder, monkeypatch: pytest.MonkeyPatch, given: tuple[Tensor, ...]) -> Tensor:
    with monkeypatch.context() as patch:
        for module in ("film", "decoders", "triplane"):
            patch.setattr(f"cagesdf.models.{module}.modulated", plain)
        return decoder(*given)


def codes(decoder: Decoder, latent: Tensor, cuboid: Tensor) -> Tensor:
    """The codes of cages of one part each."""
    return decoder.codes(latent, cuboid[:, None], torch.ones(len(latent), 1, dtype=torch.bool))[:, 0]


@pytest.mark.parametrize("name", sorted(DECODERS))
def test_in_bfloat16_a_decoder_gives_what_float32_gives_within_rounding(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = {"width": 64, "layers": 6, "latent_dim": 8, "mapping": (32,), "octaves": 2, "code_dim": 8, "cells": 4}
    sizes |= {"line_cells": 6, "context": 16}
    decoder = make_decoder(name, **SIZES | sizes, seed=0)
    generator = torch.Generator().manual_seed(1)
    points = torch.rand((4, 64, 3), generator=generator) - 0.5
    latent = torch.randn((4, 8), generator=generator)
    cuboid = torch.cat([torch.zeros(4, 3), torch.eye(3).flatten().expand(4, 9), torch.ones(4, 3)], dim=1)
    exact = obvious(decoder, monkeypatch, (points, codes(decoder, latent, cuboid), cuboid))
    expected = torch.autograd.grad(exact.abs().sum(), list(decoder.parameters()))
    condition = decoder.condition(codes(decoder, latent, cuboid), cuboid)
    rounded = decoder.evaluate(decoder.features(points, cuboid), condition, torch.bfloat16)
    assert rounded.dtype == torch.float32
    assert (rounded - exact).abs().max() < 2**-6 * exact.abs().max()
    found = torch.autograd.grad(rounded.abs().sum(), list(decoder.parameters()))
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == torch.float32
        if other.any():
            assert torch.cosine_similarity(one.flatten(), other.flatten(), dim=0) > 0.995
        else:  # relations of a part that is alone
            assert not one.any()
