"""Codes of the parts of training shapes, learnt directly: what the decoder reads while codes come first.

A table of codes is learnt sooner than a transformer that must give them for every cage, for each code moves alone. So
the decoder and the table come first, the transformer learns what the table holds, and only then the decoder reads
the transformer's codes (docs/training.md has the figures). The table isn't kept.

A shape's code is learnt at that shape's own cages. At others it would give codes of no part that was ever seen, and
torn surfaces; so it is also drawn, at each other shape's cages in turn, to the nearest codes of its own shape's parts.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from cagesdf.training.batches import Cages

DRAWN = 1e-3  # weight of the squared distances of the transformer's codes from the table's, in the objective
STYLED = 0.5  # of that, at other shapes' cages; as much as at its own costs a shape's own surface some accuracy


class FreeCodes(nn.Module):
    """A code for each part of each training shape, the same at all of its steps; zero as training starts."""

    present: Tensor  # (s, p), bool: the places that have a part

    def __init__(self, parts: Sequence[int], code_dim: int) -> None:
        """`parts`: how many each shape has, by row of the latent table."""
        super().__init__()
        self.values = nn.Parameter(torch.zeros(len(parts), max(parts), code_dim))
        self.register_buffer("present", torch.arange(max(parts)) < torch.tensor(parts)[:, None])

    def forward(self, cages: Cages) -> Float[Tensor, "s p k"]:
        """Codes of the parts of some cages; absent parts' codes mean nothing."""
        return self.values[cages.latent, : cages.cuboids.shape[1]]

    def others(self, rows: Int[Tensor, " s"], step: int) -> Int[Tensor, " s"]:
        """For each shape another one, by row: each in turn as steps go on. A single shape has itself."""
        count = len(self.values)
        return (rows + 1 + step % max(count - 1, 1)) % count

    def nearest(self, rows: Int[Tensor, " g"], codes: Float[Tensor, "g k"]) -> Float[Tensor, "g k"]:
        """For each code, the nearest one of all codes of the parts of the shape in that row."""
        apart = torch.cdist(codes.detach()[:, None], self.values[rows])[:, 0].masked_fill(
            ~self.present[rows], torch.inf
        )
        return self.values[rows, apart.argmin(dim=1)]


def code_distance(code: Float[Tensor, "g k"], free: Float[Tensor, "g k"]) -> Float[Tensor, ""]:
    """Mean over groups of ‖code − free‖²; only `code` is drawn."""
    return (code - free.detach()).square().sum(dim=-1).mean()
