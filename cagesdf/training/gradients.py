"""The gradient of one batch, in slices, on several threads."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from itertools import pairwise

import torch
from torch import Tensor

from cagesdf.models.decoders import Decoder
from cagesdf.models.latents import LatentTable
from cagesdf.training.batches import Batch
from cagesdf.training.free_codes import DRAWN, STYLED, FreeCodes, code_distance
from cagesdf.training.losses import shape_mean
from cagesdf.training.precision import Precision

SLICE = {"cpu": 32}  # groups whose activations are held at once; elsewhere LARGE
LARGE = 1024


class Gradients:
    """Gradients of the data term with respect to a decoder and latents.

    The codes of whole cages are computed once for all. The groups are cut into slices; each slice is one thread's,
    and their gradients are summed in order. So the memory for activations doesn't grow with the batch, and the
    bits don't depend on the number of threads.
    """

    def __init__(
        self,
        decoder: Decoder,
        latents: LatentTable,
        clamp: float,
        precision: Precision,
        pool: ThreadPoolExecutor,
        threads: int,
    ) -> None:
        self.decoder, self.latents, self.clamp = decoder, latents, clamp
        self.compute_dtype = getattr(torch, precision)
        self.pool, self.threads = pool, threads
        self.parameters = list(decoder.parameters())

    def add(self, batch: Batch, weight: float, free: FreeCodes | None = None, step: int = 0) -> Tensor:
        """Add the gradient of `weight` × `shape_mean` to those of parameters and latents; returns that value.

        The batch has the cages of its own groups alone. With `free` the decoder reads those codes, and its own are
        drawn to them: at their own cages, and at those of others, which `step` chooses.
        """
        total = torch.zeros((), device=batch.sdf.device)
        if free is None:
            cages = batch.cages
            codes = self.decoder.codes(self.latents(cages.latent), cages.cuboids, cages.present)
            code, apart = codes[batch.shape, batch.part], None
        else:
            code, apart = self._first(batch, free, step)
        to_code = []
        runs = slices(len(batch.weight), SLICE.get(batch.sdf.device.type, LARGE))
        for first in range(0, len(runs), self.threads):  # no more gradients are held than there are threads
            of = partial(self._of, batch, code.detach(), weight)
            others = [self.pool.submit(of, run) for run in runs[first + 1 : first + self.threads]]
            for l1, gradients, gradient_of_codes in [of(runs[first]), *(other.result() for other in others)]:
                total += l1
                to_code.append(gradient_of_codes)
                for parameter, gradient in zip(self.parameters, gradients, strict=True):
                    _add(parameter, gradient)
        code.backward(torch.cat(to_code) if to_code else torch.zeros_like(code))
        if apart is not None and len(batch.weight):
            (weight * DRAWN * apart).backward()
        return total

    def _first(self, batch: Batch, free: FreeCodes, step: int) -> tuple[Tensor, Tensor]:
        """The groups' free codes, and how far the transformer's are from what they are drawn to."""
        cages = batch.cages
        others = free.others(cages.latent, step)
        latent = torch.cat([self.latents(cages.latent), self.latents(others).detach()])
        codes = self.decoder.codes(latent, cages.cuboids.repeat(2, 1, 1), cages.present.repeat(2, 1))
        made, styled = (half[batch.shape, batch.part] for half in codes.chunk(2))
        code = free(cages)[batch.shape, batch.part]
        nearest = free.nearest(others[batch.shape], styled)
        return code, code_distance(made, code) + STYLED * code_distance(styled, nearest)

    def _of(
        self, batch: Batch, code: Tensor, weight: float, run: slice
    ) -> tuple[Tensor, tuple[Tensor | None, ...], Tensor]:
        groups = batch.run(run)
        codes, cuboid = code[run].requires_grad_(), groups.cuboid
        with torch.autocast(cuboid.device.type, torch.bfloat16, enabled=self.compute_dtype == torch.bfloat16):
            condition = self.decoder.condition(codes, cuboid)
        predicted = self.decoder.evaluate(self.decoder.features(groups.points, cuboid), condition, self.compute_dtype)
        errors = self.decoder.errors(predicted, groups.sdf, cuboid, self.clamp)
        l1 = shape_mean(errors, groups.weight)
        l1 = l1 * (weight * len(groups.weight) / len(batch.weight))
        *gradients, to_code = torch.autograd.grad(l1, [*self.parameters, codes], allow_unused=True)
        return l1.detach(), tuple(gradients), to_code


def _add(parameter: Tensor, gradient: Tensor | None) -> None:
    """Add a gradient to a parameter's; None for parameters that only make codes, whose gradients come last."""
    if gradient is None:
        return
    if parameter.grad is None:
        parameter.grad = gradient
    else:
        parameter.grad += gradient


def slices(groups: int, most: int) -> list[slice]:
    """The fewest runs of nearly equal length, each at most `most`, that cover `groups` groups."""
    count = -(-groups // most)
    ends = [groups * i // count for i in range(count + 1)] if count else []
    return [slice(start, stop) for start, stop in pairwise(ends)]


@contextmanager
def slice_threads() -> Iterator[tuple[ThreadPoolExecutor, int]]:
    """Helper threads, and their number with this one: the number that torch would use for one operation.

    Meanwhile each operation has one thread: operations are short, and threads that share one wait for each
    other at its end, on a busy machine many times as long as it takes.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with ThreadPoolExecutor(max(threads - 1, 1)) as pool:
            yield pool, threads
    finally:
        torch.set_num_threads(threads)
