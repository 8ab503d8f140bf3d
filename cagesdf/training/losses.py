"""The terms of the training objective (§3.5)."""

from jaxtyping import Float
from torch import Tensor


def shape_mean(errors: Float[Tensor, "g n"], weight: Float[Tensor, " g"]) -> Float[Tensor, ""]:
    """Mean over groups of weight × mean error.

    With the weights of `batches.shape_weights` it estimates the error averaged over each
    deformed shape, then over shapes.
    """
    return (weight * errors.mean(dim=1)).mean()


def latent_penalty(latents: Float[Tensor, "r d"]) -> Float[Tensor, ""]:
    """Mean squared norm of all latents, not of a batch's alone: exactly the paper's (1/N) Σ‖z‖²."""
    return latents.square().sum(dim=1).mean()
