"""The code of a shape that was not trained on: auto-decoder inference (Park et al. 2019, §4.2), part by part.

The decoder is frozen. First one code for the whole shape is optimised, from several starts at once. Then each part gets
a residual: a shift of its FiLM, for what no code says of it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from cagesdf.models.shifted import ShiftedDecoder, film_size
from cagesdf.training.batches import Batch

BLOCK = 64  # groups that go through the network together where nothing is learnt


@dataclass(frozen=True)
class InferenceSettings:
    """How long, how fast, from where."""

    tried: int  # groups that all candidates are compared on
    starts: int  # candidates that are optimised
    code_steps: int  # optimiser steps of the code
    film_steps: int  # of the residual
    batch: int  # groups a step
    code_rate: float  # learning rate as the steps begin; it falls to 0 along half a cosine
    film_rate: float  # the same of the residual
    code_weight: float  # of the code's squared norm
    film_weight: float  # of the squared norm of a part's residual, in the mean over parts


@dataclass(frozen=True, eq=False)
class Inferred:
    """A code and a residual, and how well the decoder fits the shape: mean |sdf error|, canonical units."""

    code: Float[Tensor, " d"]
    film: Float[Tensor, "p l 2 h"]  # by part, what is added to FiLM's scales and shifts
    start: int  # the candidate that the code was optimised from
    code_error: float  # with the code alone
    error: float  # with the residual


Predict = Callable[[Tensor], Tensor]  # from the numbers of some groups to the distances of their points
Loss = Callable[[Tensor, Tensor], Tensor]  # from the variables and the numbers of one step's groups


def infer(
    decoder: nn.Module,
    candidates: Float[Tensor, "r d"],
    groups: Batch,
    part: Int[Tensor, " g"],
    parts: int,
    settings: InferenceSettings,
    seed: int,
) -> Inferred:
    """The code and the residual with which a decoder fits a shape's points.

    The best of `candidates`, such as training codes and their mean, are the starts. `part` numbers the part of each
    group, below `parts`; the groups' latent rows and weights play no part. `decoder` is by latent and cuboid, its
    parameters without gradients. What is found is no worse than the best start, and than the code alone; the
    candidates' order plays no part but for ties.
    """
    generator = torch.Generator().manual_seed(seed)
    count = len(groups.sdf)
    tried = groups.take(torch.randperm(count, generator=generator)[: settings.tried].to(groups.sdf.device))
    first = torch.tensor([mean_error(with_code(decoder, tried, code), tried) for code in candidates])
    starts = first.argsort(stable=True)[: settings.starts]
    begun = candidates[starts.to(candidates.device)]
    loss = _code_loss(decoder, groups, settings.code_weight)
    ended = _descend(begun, loss, count, settings.code_steps, settings.batch, settings.code_rate, generator)
    found = torch.cat([ended, begun])
    errors = [mean_error(with_code(decoder, groups, code), groups) for code in found]
    best = min(range(len(errors)), key=errors.__getitem__)
    code, code_error = found[best], errors[best]

    none = torch.zeros(parts, *film_size(decoder), device=code.device)
    loss = _film_loss(decoder, groups, part, code, settings.film_weight)
    film = _descend(none, loss, count, settings.film_steps, settings.batch, settings.film_rate, generator)
    error = mean_error(with_film(decoder, groups, part, code, film), groups)
    if error >= code_error:
        film, error = none, code_error
    return Inferred(code, film, int(starts[best % len(starts)]), code_error, error)


def with_code(decoder: nn.Module, groups: Batch, code: Float[Tensor, " d"]) -> Predict:
    """What the decoder says of a shape with one code."""
    return lambda rows: decoder(groups.points[rows], code.expand(len(rows), -1), groups.cuboid[rows])


def with_film(
    decoder: nn.Module, groups: Batch, part: Int[Tensor, " g"], code: Float[Tensor, " d"], film: Tensor
) -> Predict:
    """The same with a residual of each part."""
    return lambda rows: with_code(ShiftedDecoder(decoder, film[part[rows]]), groups, code)(rows)


@torch.inference_mode()
def mean_error(predict: Predict, groups: Batch) -> float:
    """Mean |sdf error| of all groups, canonical units."""
    pieces = torch.arange(len(groups.sdf), device=groups.sdf.device).split(BLOCK)
    return float(torch.cat([(predict(rows) - groups.sdf[rows]).abs().mean(dim=1) for rows in pieces]).mean())


def _code_loss(decoder: nn.Module, groups: Batch, weight: float) -> Loss:
    """Of several codes at once; their sum, so that none of them feels the others."""

    def loss(codes: Tensor, rows: Tensor) -> Tensor:
        some = groups.take(rows.repeat(len(codes)))
        predicted = decoder(some.points, codes.repeat_interleave(len(rows), dim=0), some.cuboid)
        return (predicted - some.sdf).abs().mean() * len(codes) + weight * codes.square().sum()

    return loss


def _film_loss(decoder: nn.Module, groups: Batch, part: Tensor, code: Tensor, weight: float) -> Loss:
    def loss(film: Tensor, rows: Tensor) -> Tensor:
        predicted = with_film(decoder, groups, part, code, film)(rows)
        return (predicted - groups.sdf[rows]).abs().mean() + weight * film.square().sum() / len(film)

    return loss


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
