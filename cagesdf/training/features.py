"""Training of the classifier whose features shapes are compared in, and these features."""

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from torch import Tensor
from torch.nn.functional import cross_entropy

from cagesdf.models.pointnet import PointNet
from cagesdf.training.gradients import slice_threads

SLICE = 8  # clouds that one thread works on at once


@dataclass(frozen=True)
class ClassifierSettings:
    """How long, how fast, on how much of each cloud."""

    steps: int  # optimiser steps
    batch: int  # clouds a step
    batch_points: int  # of each cloud
    learning_rate: float  # as training starts; falls to zero along half a cosine
    seed: int


def train_classifier(
    model: PointNet,
    points: Float[Tensor, "n p 3"],
    classes: Int[Tensor, " n"],
    settings: ClassifierSettings,
    report: Callable[[int, float], None],
) -> None:
    """Train in place; `report` is called with (steps done, loss) after each.

    A step sees some of the clouds, and of each some consecutive points, as independent of each other as all are.
    """
    optimiser = torch.optim.Adam(model.parameters(), settings.learning_rate)
    with _pool() as pool:
        for step in range(settings.steps):
            rng = np.random.default_rng([settings.seed, step])
            rows = torch.from_numpy(rng.permutation(len(points))[: settings.batch])
            starts = torch.from_numpy(rng.integers(points.shape[1], size=(len(rows), 1)))
            columns = (starts + torch.arange(settings.batch_points)) % points.shape[1]
            loss = add_gradients(model, points[rows[:, None], columns], classes[rows], pool)
            for group in optimiser.param_groups:
                group["lr"] = settings.learning_rate * (1 + math.cos(math.pi * step / settings.steps)) / 2
            optimiser.step()
            report(step + 1, loss)


def add_gradients(
    model: PointNet, points: Float[Tensor, "b p 3"], classes: Int[Tensor, " b"], pool: ThreadPoolExecutor
) -> float:
    """Set the gradients of the batch's mean cross-entropy, which is returned.

    The batch is cut into slices whose gradients are summed in order, so the bits don't depend on the threads.
    """
    parameters = list(model.parameters())

    def of(start: int) -> tuple[float, tuple[Tensor, ...]]:
        part = slice(start, start + SLICE)
        loss = cross_entropy(model(points[part]), classes[part], reduction="sum") / len(classes)
        return loss.item(), torch.autograd.grad(loss, parameters)

    results = list(pool.map(of, range(0, len(classes), SLICE)))
    for i, parameter in enumerate(parameters):
        parameter.grad = torch.stack([gradients[i] for _, gradients in results]).sum(0)
    return sum(loss for loss, _ in results)


def classify(model: PointNet, points: Float[ndarray, "n p 3"]) -> tuple[Float[ndarray, "n f"], Int[ndarray, " n"]]:
    """Features, float64, and most probable class of each cloud."""

    def of(start: int) -> tuple[Tensor, Tensor]:
        with torch.no_grad():  # is a thread's own
            features = model.features(torch.from_numpy(points[start : start + SLICE]))
            return features, model.head(features).argmax(dim=1)

    with _pool() as pool:
        slices = list(pool.map(of, range(0, max(1, len(points)), SLICE)))
    features, classes = (torch.cat(parts) for parts in zip(*slices, strict=True))
    return features.double().numpy(), classes.numpy()


@contextmanager
def _pool() -> Iterator[ThreadPoolExecutor]:
    """As many threads as torch would use, each operation with one."""
    with slice_threads() as (_, threads), ThreadPoolExecutor(threads) as pool:
        yield pool
