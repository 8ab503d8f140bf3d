"""Codes of the parts of training shapes, learnt directly: what the decoder reads while codes come first.

A table of codes is learnt sooner than a transformer that must give them for every cage, for each code moves alone. So
the decoder and the table come first, the transformer learns what the table holds, and only then the decoder reads
the transformer's codes (docs/training.md has the figures). The table isn't kept.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cagesdf.training.batches import Cages

DRAWN = 1e-3  # weight of the squared distance of the transformer's codes from the table's, in the objective


class FreeCodes(nn.Module):
    """A code for each part of each training shape, the same at all of its steps; zero as training starts."""

    def __init__(self, shapes: int, parts: int, code_dim: int) -> None:
        """For `shapes` rows of the latent table, of at most `parts` parts each."""
        super().__init__()
        self.values = nn.Parameter(torch.zeros(shapes, parts, code_dim))

    def forward(self, cages: Cages) -> Float[Tensor, "s p k"]:
        """Codes of the parts of some cages; absent parts' codes mean nothing."""
        return self.values[cages.latent, : cages.cuboids.shape[1]]


def code_distance(code: Float[Tensor, "g k"], free: Float[Tensor, "g k"]) -> Float[Tensor, ""]:
    """Mean over groups of ‖code − free‖²; only `code` is drawn."""
    return (code - free.detach()).square().sum(dim=-1).mean()
