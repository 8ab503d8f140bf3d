"""Training the programs' autoencoder."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.utils import clip_grad_norm_

from cagesdf.cage_generation.batching import Batch
from cagesdf.cage_generation.program_vae import TERMS, WEIGHTS, ProgramVAE
from cagesdf.cage_generation.tokens import ProgramTokens

LOG_EVERY = 50  # steps
WARM_UP = 0.5  # share of the steps along which the weight of the divergence rises to its own
LARGEST_GRADIENT = 10.0  # its norm is cut to that, a program


@dataclass(frozen=True)
class Settings:
    """Sizes, length and weights of the autoencoder's training."""

    width: int  # of the layers; official: 256
    code: int  # numbers in a program's code; official: 256
    steps: int  # of Adam, whose rate falls to zero along a cosine
    batch: int  # programs a step
    learning_rate: float
    divergence: float  # weight of the divergence; official: 0.1
    hidden: float  # share of the lines that the decoder isn't shown, so that it relies on the code; official: none
    seed: int


def train_programs(
    programs: Sequence[ProgramTokens],
    settings: Settings,
    report: Callable[[int, float], None] = lambda step, loss: None,
) -> tuple[ProgramVAE, list[dict[str, int | float]]]:
    """A trained autoencoder, and its losses along the way: means over the programs of a batch, without weights.

    `report` is called with steps and loss. Same programs, settings and threads give the same weights.
    """
    model = ProgramVAE.drawn(settings.width, settings.code, settings.seed)
    weights = torch.tensor([{**WEIGHTS, "divergence": settings.divergence}[term] for term in TERMS])
    rising = torch.tensor([term == "divergence" for term in TERMS])
    optimiser = torch.optim.Adam(model.parameters(), settings.learning_rate, eps=1e-6, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
    rng = np.random.default_rng(settings.seed)
    generator = torch.Generator().manual_seed(settings.seed)
    log: list[dict[str, int | float]] = []
    for step, batch in enumerate(_batches(programs, settings, rng)):
        noise = torch.randn(batch.count, settings.code, generator=generator)
        shown = (torch.rand(len(batch.targets), generator=generator) >= settings.hidden).float()
        losses = model(batch, noise, shown).mean(dim=0)
        loss = losses @ torch.where(rising, weights * min(1.0, step / (WARM_UP * settings.steps)), weights)
        optimiser.zero_grad()
        loss.backward()
        clip_grad_norm_(model.parameters(), LARGEST_GRADIENT)
        optimiser.step()
        schedule.step()
        if step % LOG_EVERY == 0 or step == settings.steps - 1:
            log.append({"step": step + 1, "loss": loss.item(), **dict(zip(TERMS, losses.tolist()))})
            report(step + 1, loss.item())
    return model.eval().requires_grad_(False), log


def _batches(programs: Sequence[ProgramTokens], settings: Settings, rng: np.random.Generator) -> Iterator[Batch]:
    """Batches, one for each step; every program comes once before any comes again."""
    size = min(settings.batch, len(programs))
    order: list[int] = []
    for _ in range(settings.steps):
        if len(order) < size:
            order += rng.permutation(len(programs)).tolist()
        yield Batch.of([programs[i] for i in order[:size]])
        del order[:size]
