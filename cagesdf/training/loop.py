"""Training of a decoder and its latents together: the auto-decoder (§3.5)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor, nn

from cagesdf.errors import InputError
from cagesdf.models.latents import LatentTable
from cagesdf.training.batches import Batches
from cagesdf.training.checkpoint import Checkpoint
from cagesdf.training.losses import latent_penalty, shape_l1


@dataclass(frozen=True)
class TrainSettings:
    """How long, how fast, towards what."""

    steps: int  # optimiser steps
    learning_rate: float  # of the decoder, as training starts
    latent_learning_rate: float  # of the latents, as training starts
    schedule: Literal["cosine", "halve"]  # see `rate`
    halve_every: int  # steps; for the schedule of that name
    clamp: float  # canonical units; 0: none
    latent_weight: float  # λ
    precision: Literal["float32", "bfloat16"]  # of matrix products; weights and losses are float32
    log_every: int  # steps
    checkpoint_every: int  # steps


def train(
    decoder: nn.Module,
    latents: LatentTable,
    batches: Batches,
    settings: TrainSettings,
    checkpoint: Checkpoint,
    report: Callable[[int, float], None],
) -> list[dict[str, int | float]]:
    """Train in place, from where `checkpoint` stopped if it did; returns the log.

    A resumed training ends with the same bits as one that was never stopped. The log's rows hold
    the means since the row before: step, loss, l1 (both canonical units) and the latents'
    root-mean-square norm. `report` is called with (steps done, loss) at each row, and first
    with where it starts from.

    Raises InputError when the loss is no longer finite.
    """
    device = latents.values.device
    optimiser = torch.optim.Adam([{"params": list(decoder.parameters())}, {"params": [latents.values]}], fused=True)
    sums = torch.zeros(2, device=device)
    log: list[dict[str, int | float]] = []
    start = _resume(decoder, latents, optimiser, sums, log, checkpoint)
    report(start, log[-1]["loss"] if log else math.nan)
    for step in range(start, settings.steps):
        rates = (settings.learning_rate, settings.latent_learning_rate)
        for group, learning_rate in zip(optimiser.param_groups, rates):
            group["lr"] = learning_rate * rate(step, settings)
        batch = batches.at(step).to(device)
        with torch.autocast(device.type, torch.bfloat16, enabled=settings.precision == "bfloat16"):
            predicted = decoder(batch.points, latents(batch.latent), batch.cuboid)
        l1 = shape_l1(predicted.float(), batch.sdf, batch.weight, settings.clamp)
        loss = l1 + settings.latent_weight * latent_penalty(latents.values)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        sums += torch.stack([loss, l1]).detach()
        done = step + 1
        if done % settings.log_every == 0 or done == settings.steps:
            log.append(_row(done, sums, done - (int(log[-1]["step"]) if log else 0), latents))
            sums.zero_()
            report(done, log[-1]["loss"])
        if done % settings.checkpoint_every == 0 and done < settings.steps:
            _save(decoder, latents, optimiser, sums, log, done, checkpoint)
    return log


def rate(step: int, settings: TrainSettings) -> float:
    """The learning rate of one step over the first one's.

    "cosine" falls to 0 along half a cosine; "halve" halves every `halve_every` steps (§3.5).
    """
    if settings.schedule == "cosine":
        return (1 + math.cos(math.pi * step / settings.steps)) / 2
    return 0.5 ** (step // settings.halve_every)


def _row(step: int, sums: Tensor, steps: int, latents: LatentTable) -> dict[str, int | float]:
    loss, l1 = (sums / steps).tolist()
    norm = float(latent_penalty(latents.values.detach()).sqrt())
    if not all(map(math.isfinite, (loss, l1, norm))):
        raise InputError(
            f"the loss became {loss} in steps {step - steps} to {step}; "
            "lower learning_rate or latent_learning_rate, and see that the points are finite"
        )
    return {"step": step, "loss": loss, "l1": l1, "latent_norm": norm}


def _save(
    decoder: nn.Module,
    latents: LatentTable,
    optimiser: torch.optim.Optimizer,
    sums: Tensor,
    log: list[dict[str, int | float]],
    step: int,
    checkpoint: Checkpoint,
) -> None:
    tensors = {"sums": sums}
    for name, parameter in _parameters(decoder, latents):
        if not torch.isfinite(parameter).all():
            raise InputError(f"{name} is no longer finite at step {step}; lower learning_rate")
        tensors[name] = parameter
        tensors |= {f"adam.{key}.{name}": value for key, value in optimiser.state[parameter].items()}
    checkpoint.save(tensors, {"step": step, "log": log})


def _resume(
    decoder: nn.Module,
    latents: LatentTable,
    optimiser: torch.optim.Optimizer,
    sums: Tensor,
    log: list[dict[str, int | float]],
    checkpoint: Checkpoint,
) -> int:
    saved = checkpoint.load()
    if saved is None:
        return 0
    tensors, facts = saved
    with torch.no_grad():
        sums.copy_(tensors["sums"])
        for name, parameter in _parameters(decoder, latents):
            parameter.copy_(tensors[name])
            optimiser.state[parameter] = {
                key: tensors[f"adam.{key}.{name}"].to(parameter.device) for key in ("step", "exp_avg", "exp_avg_sq")
            }
    log.extend(facts["log"])
    return int(facts["step"])


def _parameters(decoder: nn.Module, latents: LatentTable) -> list[tuple[str, Any]]:
    named = [(f"decoder.{name}", parameter) for name, parameter in decoder.named_parameters()]
    return [*named, ("latents", latents.values)]
