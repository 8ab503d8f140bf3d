"""Numbers in a form in which layers can tell near ones apart (Tancik et al. 2020)."""

import math

import torch
from jaxtyping import Float
from torch import Tensor


def sine_features(numbers: Float[Tensor, "*g d"], octaves: int) -> Float[Tensor, "*g f"]:
    """Sine and cosine of π·2^k times each number, k from 0 to `octaves` − 1: 2 · d · `octaves` features."""
    angles = numbers[..., None, :] * (math.pi * 2.0 ** torch.arange(octaves, device=numbers.device)[:, None])
    return torch.cat([angles.sin(), angles.cos()], dim=-1).flatten(-2)
