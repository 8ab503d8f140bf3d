"""The auto-decoder's latents: a table with ids beside its rows (§3.5)."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cagesdf.errors import InputError

SHARED = -1  # in place of a step: the latent of all deformations of a source shape


class LatentTable(nn.Module):
    """One latent a source shape, shared by its deformations, or one a deformed shape."""

    def __init__(self, keys: tuple[tuple[str, int], ...], values: Float[Tensor, "r d"]) -> None:
        """`keys` are (shape id, step), the step SHARED where all deformations share the row."""
        super().__init__()
        self.keys = keys
        self.values = nn.Parameter(values)
        self._rows = {key: row for row, key in enumerate(keys)}

    @staticmethod
    def drawn(keys: tuple[tuple[str, int], ...], dim: int, std: float, seed: int) -> "LatentTable":
        """Normal latents of `dim` numbers whose root-mean-square norm is `std`."""
        generator = torch.Generator().manual_seed(seed)
        return LatentTable(keys, torch.randn(len(keys), dim, generator=generator) * (std / dim**0.5))

    def __len__(self) -> int:
        return len(self.keys)

    def has(self, shape_id: str, step: int) -> bool:
        """Whether there is a latent for this step of this shape."""
        return (shape_id, SHARED) in self._rows or (shape_id, step) in self._rows

    def row(self, shape_id: str, step: int) -> int:
        """The row of one deformed shape's latent. Raises InputError if there is none."""
        if not self.has(shape_id, step):
            steps = [str(key[1]) for key in self.keys if key[0] == shape_id]
            known = f"it has one of its own for steps {', '.join(steps)}" if steps else "it was not trained on"
            raise InputError(f"shape {shape_id}, step {step}: there is no latent; {known}")
        return self._rows.get((shape_id, SHARED), self._rows.get((shape_id, step), -1))

    def forward(self, rows: Tensor) -> Tensor:
        """Latents by row."""
        return self.values[rows]
