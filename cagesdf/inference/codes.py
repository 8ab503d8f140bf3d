"""The code of a shape that was not trained on: auto-decoder inference (Park et al. 2019, §4.2), part by part.

The decoder is frozen. First one code for the whole shape is optimised, from several starts at once. Then each part's
code gets a residual, for what no code of the shape says of it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cagesdf.models.decoders import Decoder
from cagesdf.training.batches import Batch

BLOCK = 64  # groups that go through the network together where nothing is learnt


@dataclass(frozen=True)
class InferenceSettings:
    """How long, how fast, from where."""

    tried: int  # groups that all candidates are compared on
    starts: int  # candidates that are optimised
    code_steps: int  # optimiser steps of the code
    residual_steps: int  # of the residual
    batch: int  # groups a step
    code_rate: float  # learning rate as the steps begin; it falls to 0 along half a cosine
    residual_rate: float  # the same of the residual
    code_weight: float  # of the code's squared norm
    residual_weight: float  # of the squared norm of a part's residual, in the mean over parts


@dataclass(frozen=True, eq=False)
class Inferred:
    """A code and a residual, and how well the decoder fits the shape: mean |sdf error|, in the decoder's unit."""

    code: Float[Tensor, " d"]
    residual: Float[Tensor, "p k"]  # by part, added to its code
    start: int  # the candidate that the code was optimised from
    code_error: float  # with the code alone
    error: float  # with the residual


Predict = Callable[[Tensor], Tensor]  # from the numbers of some groups to the distances of their points
Loss = Callable[[Tensor, Tensor], Tensor]  # from the variables and the numbers of one step's groups


def infer(
    decoder: Decoder,
    candidates: Float[Tensor, "r d"],
    groups: Batch,
    clamp: float,
    settings: InferenceSettings,
    seed: int,
) -> Inferred:
    """The code and the residual with which a decoder fits a shape's points.

    The best of `candidates`, such as training codes and their mean, are the starts. `groups` are of one cage; their
    latent rows and weights play no part. `decoder` knows cuboids, its parameters are without gradients; errors are in
    its unit, clamped as in its training. The result is no worse than the best start, and than the code alone; the
    candidates' order plays no part but for ties.
    """
    generator = torch.Generator().manual_seed(seed)
    count = len(groups.sdf)
    shape = OneShape(decoder, groups, clamp)
    tried = OneShape(
        decoder,
        groups.take(torch.randperm(count, generator=generator)[: settings.tried].to(groups.sdf.device)),
        clamp,
    )
    first = torch.tensor([tried.mean_error(code) for code in tried.codes(candidates)])
    starts = first.argsort(stable=True)[: settings.starts]
    begun = candidates[starts.to(candidates.device)]

    def code_loss(codes: Tensor, rows: Tensor) -> Tensor:
        """Sum of the losses of several codes, so that the gradient of each doesn't depend on the others."""
        errors = [shape.error(of_parts, rows) for of_parts in shape.codes(codes)]
        return torch.stack(errors).sum() + settings.code_weight * codes.square().sum()

    ended = _descend(begun, code_loss, count, settings.code_steps, settings.batch, settings.code_rate, generator)
    finalists = torch.cat([ended, begun])
    errors = [shape.mean_error(of_parts) for of_parts in shape.codes(finalists)]
    best = min(range(len(errors)), key=errors.__getitem__)
    code, code_error = finalists[best], errors[best]

    with torch.no_grad():
        (of_parts,) = shape.codes(code[None])

    def residual_loss(residual: Tensor, rows: Tensor) -> Tensor:
        penalty = settings.residual_weight * residual.square().sum() / len(residual)
        return shape.error(of_parts + residual, rows) + penalty

    none = torch.zeros_like(of_parts)
    steps, rate = settings.residual_steps, settings.residual_rate
    residual = _descend(none, residual_loss, count, steps, settings.batch, rate, generator)
    error = shape.mean_error(of_parts + residual)
    if error >= code_error:
        residual, error = none, code_error
    return Inferred(code, residual, int(starts[best % len(starts)]), code_error, error)


@dataclass(frozen=True, eq=False)
class OneShape:
    """A decoder and the points of one shape."""

    decoder: Decoder
    groups: Batch  # of one cage
    clamp: float  # of distances, in the decoder's unit; 0: none

    def codes(self, latents: Float[Tensor, "r d"]) -> Float[Tensor, "r p k"]:
        """Codes of the cage's parts for each of these latents."""
        cages, count = self.groups.cages, len(latents)
        return self.decoder.codes(latents, cages.cuboids.expand(count, -1, -1), cages.present.expand(count, -1))

    def errors(self, codes: Float[Tensor, "p k"], rows: Tensor) -> Float[Tensor, "g n"]:
        """|sdf error| of these groups with these codes of the parts, in the decoder's unit, clamped as in training."""
        batch = self.groups.take(rows)
        predicted = self.decoder(batch.points, codes[batch.part], batch.cuboid)
        return self.decoder.errors(predicted, batch.sdf, batch.cuboid, self.clamp)

    def error(self, codes: Float[Tensor, "p k"], rows: Tensor) -> Float[Tensor, ""]:
        """Mean of these."""
        return self.errors(codes, rows).mean()

    @torch.inference_mode()
    def mean_error(self, codes: Float[Tensor, "p k"]) -> float:
        """Mean of all groups, in the decoder's unit."""
        pieces = torch.arange(len(self.groups.sdf), device=self.groups.sdf.device).split(BLOCK)
        return float(torch.cat([self.errors(codes, rows).mean(dim=1) for rows in pieces]).mean())


def _descend(
    start: Tensor, loss: Loss, count: int, steps: int, batch: int, rate: float, generator: torch.Generator
) -> Tensor:
    """Where Adam takes the variables, with `batch` random groups out of `count` in each step."""
    variables = nn.Parameter(start.detach().clone())
    optimiser = torch.optim.Adam([variables], betas=(0.9, 0.99))
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = rate * (1 + math.cos(math.pi * step / steps)) / 2
        rows = torch.randint(count, (batch,), generator=generator).to(variables.device)
        optimiser.zero_grad(set_to_none=True)
        loss(variables, rows).backward()
        optimiser.step()
    return variables.detach()
