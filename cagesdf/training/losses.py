"""The terms of the training objective (§3.5)."""

from jaxtyping import Float
from torch import Tensor


def shape_l1(
    predicted: Float[Tensor, "g n"], sdf: Float[Tensor, "g n"], weight: Float[Tensor, " g"], clamp: float
) -> Float[Tensor, ""]:
    """Mean over groups of weight × mean absolute error, in the unit of the distances (`Decoder.unit`).

    With the weights of `batches.shape_weights` it estimates the error averaged over each
    deformed shape, then over shapes. Where `clamp` is not 0, prediction and truth are clamped to
    ±`clamp` first, as in DeepSDF: beyond it only the sign matters.
    """
    if clamp:
        predicted, sdf = predicted.clamp(-clamp, clamp), sdf.clamp(-clamp, clamp)
    return (weight * (predicted - sdf).abs().mean(dim=1)).mean()


def latent_penalty(latents: Float[Tensor, "r d"]) -> Float[Tensor, ""]:
    """Mean squared norm of all latents, not of a batch's alone: exactly the paper's (1/N) Σ‖z‖²."""
    return latents.square().sum(dim=1).mean()
