"""Training of a decoder and its latents together: the auto-decoder (§3.5)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor, nn

from cagesdf.errors import InputError
from cagesdf.models.decoders import Decoder
from cagesdf.models.latents import LatentTable
from cagesdf.training.batches import Batches
from cagesdf.training.checkpoint import Checkpoint
from cagesdf.training.distributed import ALONE, Ranks
from cagesdf.training.free_codes import FreeCodes
from cagesdf.training.gradients import Gradients, slice_threads
from cagesdf.training.losses import latent_penalty
from cagesdf.training.precision import Precision

Learnt = list[tuple[str, nn.Parameter]]  # trained parameters, by name

DIVERGED = 10  # times the loss of the log's first row; learning only lowers it
SPIKE = 4.0  # times the usual norm of a gradient: a larger one is scaled down to it


@dataclass(frozen=True)
class TrainSettings:
    """How long, how fast, towards what."""

    steps: int  # optimiser steps
    learning_rate: float  # of the decoder, as training starts
    latent_learning_rate: float  # of the latents, as training starts
    code_learning_rate: float  # of free codes of parts, as training starts
    codes_first: float  # share of the steps in which the decoder reads those
    schedule: Literal["cosine", "halve"]  # see `rate`
    halve_every: int  # steps; for the schedule of that name
    clamp: float  # of distances, in the decoder's unit; 0: none
    latent_weight: float  # λ
    precision: Precision  # of matrix products; weights and losses are float32
    log_every: int  # steps
    checkpoint_every: int  # steps
    snapshots: tuple[int, ...]  # steps after which the checkpoint keeps weights and latents; the last is not among them


def train(
    decoder: Decoder,
    latents: LatentTable,
    free: FreeCodes | None,
    batches: Batches,
    settings: TrainSettings,
    checkpoint: Checkpoint,
    report: Callable[[int, float], None],
    ranks: Ranks = ALONE,
) -> list[dict[str, int | float]]:
    """Train in place, from where `checkpoint` stopped if it did; returns the log.

    With `free` codes those come first, zero as they are given: see `FreeCodes`.

    Several `ranks` call this alike, each with the whole of every batch, of which it takes its share;
    the first one's checkpoint is read and written, and all end with the same bits. A resumed training
    ends with the same bits as one that was never stopped. The log's rows hold
    the means since the row before: step, loss, l1 (that of `Decoder.errors` alone), both in the decoder's unit, and
    the latents' root-mean-square norm. `report` is called with (steps done, loss) at each row, and first
    with where it starts from.

    Raises InputError when the loss is no longer finite, or has grown tenfold; what was saved before stays.
    """
    device = latents.values.device
    tables = [latents.values] if free is None else [latents.values, free.values]
    groups = [list(decoder.parameters()), *([table] for table in tables)]
    optimiser = torch.optim.Adam([{"params": group} for group in groups], fused=True)
    rates = (settings.learning_rate, settings.latent_learning_rate, settings.code_learning_rate)
    first = round(settings.codes_first * settings.steps)
    learnt = _parameters(decoder, latents, free)
    sums = torch.zeros(2, device=device)
    log: list[dict[str, int | float]] = []
    start = _resume(learnt, optimiser, sums, log, ranks.broadcast(checkpoint.load() if ranks.first else None))
    report(start, log[-1]["loss"] if log else math.nan)
    with slice_threads() as (pool, threads):
        gradients = Gradients(decoder, latents, settings.clamp, settings.precision, pool, threads)
        for step in range(start, settings.steps):
            for group, learning_rate in zip(optimiser.param_groups, rates):
                group["lr"] = learning_rate * rate(step, settings)
            optimiser.zero_grad(set_to_none=True)
            batch = batches.at(step)
            mine = ranks.share(len(batch.weight))
            rank_batch = batch.run(slice(mine.start, mine.stop)).to(device)
            l1 = gradients.add(rank_batch, len(mine) / len(batch.weight), free if step < first else None, step)
            _add_ranks(learnt, l1, ranks)
            penalty = settings.latent_weight * latent_penalty(latents.values)
            penalty.backward()  # after the sum over ranks: each would add it
            flatten_spike(optimiser)
            optimiser.step()
            sums += torch.stack([l1 + penalty.detach(), l1])
            done = step + 1
            if done % settings.log_every == 0 or done == settings.steps:
                log.append(_row(done, sums, log, latents, checkpoint))
                sums.zero_()
                report(done, log[-1]["loss"])
            if done in settings.snapshots and done < settings.steps and ranks.first:
                checkpoint.keep(done, dict(_parameters(decoder, latents, None)))
            if done % settings.checkpoint_every == 0 and done < settings.steps:
                tensors = _state(learnt, optimiser, sums, done, checkpoint)
                if ranks.first:
                    checkpoint.save(tensors, {"step": done, "log": log})
    return log


def _add_ranks(learnt: Learnt, l1: Tensor, ranks: Ranks) -> None:
    """Gradients and value of all ranks' shares together."""
    if ranks.size > 1:
        gradients = []
        for _, parameter in learnt:
            if parameter.grad is None:  # a rank without groups has none
                parameter.grad = torch.zeros_like(parameter)
            gradients.append(parameter.grad)
        ranks.all_reduce([*gradients, l1])


def flatten_spike(optimiser: torch.optim.Adam) -> None:
    """Scale down a gradient whose norm, over all parameters, is more than SPIKE times the usual one.

    The usual norm follows from Adam's second moments. One batch's norm has been a thousand times it; Adam's next steps
    would all point there, and undo what the decoder has learnt.
    """
    parameters = [p for group in optimiser.param_groups for p in group["params"] if p.grad is not None]
    states = [optimiser.state[parameter] for parameter in parameters]
    if not all(states):  # a parameter's first gradient
        return
    _, decay = optimiser.param_groups[0]["betas"]
    taken = min(float(state["step"]) for state in states)
    squares = torch.stack([state["exp_avg_sq"].sum() for state in states]).sum() / (1 - decay**taken)
    norm = nn.utils.get_total_norm([p.grad for p in parameters if p.grad is not None])
    limit = SPIKE * squares.sqrt()
    if norm > limit > 0:
        nn.utils.clip_grads_with_norm_(parameters, float(limit), norm)


def rate(step: int, settings: TrainSettings) -> float:
    """The learning rate of one step over the first one's.

    "cosine" falls to 0 along half a cosine; "halve" halves every `halve_every` steps (§3.5).
    """
    if settings.schedule == "cosine":
        return (1 + math.cos(math.pi * step / settings.steps)) / 2
    return 0.5 ** (step // settings.halve_every)


def _row(
    step: int, sums: Tensor, log: list[dict[str, int | float]], latents: LatentTable, checkpoint: Checkpoint
) -> dict[str, int | float]:
    since = int(log[-1]["step"]) if log else 0
    loss, l1 = (sums / (step - since)).tolist()
    norm = float(latent_penalty(latents.values.detach()).sqrt())
    if not all(map(math.isfinite, (loss, l1, norm))) or (log and loss > DIVERGED * log[0]["loss"]):
        raise InputError(
            f"the loss became {loss:.3g} in steps {since} to {step}; "
            "lower learning_rate or latent_learning_rate, and see that the points are finite; " + _last_good(checkpoint)
        )
    return {"step": step, "loss": loss, "l1": l1, "latent_norm": norm}


def _state(
    learnt: Learnt,
    optimiser: torch.optim.Optimizer,
    sums: Tensor,
    step: int,
    checkpoint: Checkpoint,
) -> dict[str, Tensor]:
    """All tensors that the rest of the training depends on. Raises InputError if one is not finite."""
    tensors = {"sums": sums}
    for name, parameter in learnt:
        tensors[name] = parameter
        tensors |= {f"adam.{key}.{name}": value for key, value in optimiser.state[parameter].items()}
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise InputError(
                f"{name} is no longer finite at step {step}; lower learning_rate or latent_learning_rate; "
                + _last_good(checkpoint)
            )
    return tensors


def _last_good(checkpoint: Checkpoint) -> str:
    step = checkpoint.step()
    return "no checkpoint was saved before" if step is None else f"step {step} is kept in {checkpoint.path}"


def _resume(
    learnt: Learnt,
    optimiser: torch.optim.Optimizer,
    sums: Tensor,
    log: list[dict[str, int | float]],
    saved: tuple[dict[str, Tensor], dict[str, Any]] | None,
) -> int:
    if saved is None:
        return 0
    tensors, facts = saved
    with torch.no_grad():
        sums.copy_(tensors["sums"])
        for name, parameter in learnt:
            parameter.copy_(tensors[name])
            optimiser.state[parameter] = {
                key: tensors[f"adam.{key}.{name}"].to(parameter.device) for key in ("step", "exp_avg", "exp_avg_sq")
            }
    log.extend(facts["log"])
    return int(facts["step"])


def _parameters(decoder: Decoder, latents: LatentTable, free: FreeCodes | None) -> Learnt:
    named = [(f"decoder.{name}", parameter) for name, parameter in decoder.named_parameters()]
    return [*named, ("latents", latents.values), *([] if free is None else [("codes", free.values)])]
