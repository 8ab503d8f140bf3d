"""Runs: trained arms with the shapes that they know."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jaxtyping import Float
from torch import Tensor

from cagesdf.cuboid import Sequence
from cagesdf.frames import Similarity
from cagesdf.models.decoders import Decoder
from cagesdf.models.latents import LatentTable
from cagesdf.structure.base import Structure


@dataclass(frozen=True, eq=False)
class Run:
    """A trained arm and the shapes it was trained on."""

    decoder: Decoder  # in eval mode, its parameters without gradients
    latents: LatentTable
    sequences: Mapping[str, Sequence]  # by shape id, held-out steps too
    structures: Mapping[str, Structure]  # by shape id
    similarities: Mapping[str, Similarity]  # by shape id, raw → canonical
    params: Mapping[str, Any]  # the arm's section of params.yaml
    points: Mapping[str, int]  # how many points were "sampled", and "used" (by decoder, reach, steps_of)

    def latent(self, shape_id: str, step: int) -> Float[Tensor, " d"]:
        """The latent of one step of one shape. Raises InputError if it has none."""
        return self.latents.values[self.latents.row(shape_id, step)].detach()

    def steps(self, shape_id: str) -> tuple[int, ...]:
        """The steps of a shape that have a latent: all, or those trained on where each has its own."""
        return tuple(s for s in range(len(self.sequences[shape_id].cages)) if self.latents.has(shape_id, s))
