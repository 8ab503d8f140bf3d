"""Points a second: a plain float32 DeepSDF loop, as anybody would write it, against the arms as they train here.

python -m benchmarks.training chair [seconds]

Of the default run's points, the arms as params.yaml has them, the plain loop as wide and deep as `deepsdf`. All get the
same batches on one thread and take turns, step by step, so that a busy machine slows all alike; the median processor
time of a step counts. Prints a Markdown table
(docs/training.md).
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import torch
from torch import Tensor, nn

from cagesdf.io.points import CHUNK
from cagesdf.io.sequences import read_sequences
from cagesdf.models.arms import make_decoder
from cagesdf.models.decoders import Decoder
from cagesdf.models.latents import LatentTable
from cagesdf.seeds import item_rng
from cagesdf.training.batches import Batch
from cagesdf.training.gradients import Gradients, slice_threads
from cagesdf.training.losses import latent_penalty
from cagesdf.training.points import LoadedPoints
from cagesdf.training.precision import fitting_precision, processor
from pipeline import TrainParams, load


class Plain(nn.Module):
    """DeepSDF's network: latent and point in, ReLU layers, both again halfway."""

    def __init__(self, width: int, layers: int, latent_dim: int) -> None:
        super().__init__()
        inputs = latent_dim + 3
        self.again = layers // 2
        self.hidden = nn.ModuleList(
            nn.Linear(inputs if i == 0 else width + inputs if i == self.again else width, width) for i in range(layers)
        )
        self.out = nn.Linear(width, 1)

    def forward(self, inputs: Tensor) -> Tensor:
        hidden = inputs
        for i, layer in enumerate(self.hidden):
            hidden = torch.relu(layer(torch.cat([hidden, inputs], dim=1) if i == self.again else hidden))
        return self.out(hidden)[:, 0]


@dataclass(frozen=True)
class Loop:
    """One way to train."""

    name: str
    step: Callable[[Batch], None]


def plain_loop(params: TrainParams, latents: LatentTable) -> Loop:
    """Float32, a latent beside each point, torch's own gradient and Adam."""
    network = Plain(params.width, params.layers, params.latent_dim)
    optimiser = torch.optim.Adam([*network.parameters(), latents.values], lr=1e-4)

    def step(batch: Batch) -> None:
        rows = batch.cages.latent[batch.shape].repeat_interleave(CHUNK)
        predicted = network(torch.cat([latents(rows), batch.points.reshape(-1, 3)], dim=1))
        loss = (predicted - batch.sdf.reshape(-1)).abs().mean() + 1e-4 * latent_penalty(latents.values)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()

    return Loop("plain", step)


def our_loop(name: str, params: TrainParams, latents: LatentTable, gradients: Callable[[Decoder], Gradients]) -> Loop:
    """An arm's step, as in `cagesdf.training.loop`."""
    decoder = make_decoder(params.decoder, **params.model_dump(exclude={"decoder"}))
    optimiser = torch.optim.Adam([*decoder.parameters(), latents.values], lr=1e-4, fused=True)
    of = gradients(decoder)

    def step(batch: Batch) -> None:
        optimiser.zero_grad(set_to_none=True)
        of.add(batch, 1.0)
        (1e-4 * latent_penalty(latents.values)).backward()
        optimiser.step()

    return Loop(name, step)


def rates(loops: list[Loop], batches: list[Batch], seconds: float) -> dict[str, float]:
    """Points a second of each loop by its median step; all loops together take `seconds`."""
    for loop in loops:
        for batch in batches[:5]:
            loop.step(batch)
    spent: dict[str, list[float]] = {loop.name: [] for loop in loops}
    end = time.perf_counter() + seconds
    turn = 0
    while time.perf_counter() < end:
        batch = batches[turn % len(batches)]
        for loop in loops:
            start = time.process_time()
            loop.step(batch)
            spent[loop.name].append(time.process_time() - start)
        turn += 1
    return {name: batches[0].sdf.numel() / median(times) for name, times in spent.items()}


def main(category: str, seconds: float = 10) -> None:
    """Print the table."""
    params = {name: load(f"arms.{name}") for name in ("cagesdf", "cagesdf_global", "deepsdf")}
    shared = params["cagesdf"]
    sequences = read_sequences(Path(f"data/sequences/{category}"))
    rng = item_rng(shared.seed, "benchmark")
    data = LoadedPoints(Path(f"data/points/{category}"), sequences, shared.steps_of, "cage", shared.reach, rng)
    table = LatentTable.drawn(data.latent_keys("source"), shared.latent_dim, shared.latent_std, 0)
    source = data.batches(table, shared.batch_chunks, shared.bundle, 0)
    batches = [source.at(step).to("cpu") for step in range(200)]
    precision = fitting_precision(shared.precision, "cpu")
    print(f"Products in {precision}, on {processor()}.\n")
    print("| loop | points/s | times the plain one |\n|---|---|---|")
    torch.set_num_threads(1)
    with slice_threads() as (pool, threads):
        tables = [LatentTable(table.keys, table.values.detach().clone()) for _ in range(len(params) + 1)]
        loops = [plain_loop(params["deepsdf"], tables[-1])]
        for (name, values), latents in zip(params.items(), tables):
            loops.append(
                our_loop(
                    name,
                    values,
                    latents,
                    partial(
                        Gradients, latents=latents, clamp=values.clamp, precision=precision, pool=pool, threads=threads
                    ),
                )
            )
        measured = rates(loops, batches, seconds)
    for name, rate in measured.items():
        print(f"| {name} | {rate:,.0f} | {rate / measured['plain']:.2f} |")


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:]))
