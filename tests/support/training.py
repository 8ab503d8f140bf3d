"""Small trainings on the spheres."""

from pathlib import Path
from typing import Any

from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import LatentTable
from cagesdf.training.batches import MemoryBatches, latent_keys, training_set
from cagesdf.training.checkpoint import Checkpoint
from cagesdf.training.distributed import ALONE, Ranks
from cagesdf.training.loop import TrainSettings, train
from stages.train import free_codes
from tests.support import spheres

SETTINGS = TrainSettings(
    steps=20,
    learning_rate=5e-3,
    latent_learning_rate=5e-3,
    code_learning_rate=2e-2,
    codes_first=0.5,
    schedule="cosine",
    halve_every=10,
    clamp=0.0,
    latent_weight=1e-3,
    precision="float32",
    log_every=3,
    checkpoint_every=5,
    snapshots=(7, 20),
)


class Stopped(BaseException):
    """Stands for Ctrl-C, wherever it comes."""


def training(
    folder: Path,
    settings: TrainSettings = SETTINGS,
    stop: int | None = None,
    decoder: str = "TriplaneDecoder",
    batch: int = 4,
    seed: int = 0,
    ranks: Ranks = ALONE,
) -> tuple[dict[str, Any], list[dict[str, int | float]], list[int]]:
    """Train on the spheres; weights and latents, the log, and the steps reported."""
    chunks = spheres.chunks((30, 30, 30, 30))
    table = LatentTable.drawn(latent_keys(chunks, "source"), 4, 0.1, seed=0)
    network = make_decoder(decoder, **spheres.SIZES, seed=0)
    batches = MemoryBatches(training_set(chunks, spheres.sequences(), table), batch, 2, seed)
    reported: list[int] = []

    def report(step: int, loss: float) -> None:
        reported.append(step)
        if stop is not None and step >= stop:
            raise Stopped

    free = free_codes(network, table, spheres.sequences())
    log = train(network, table, free, batches, settings, Checkpoint(folder), report, ranks)
    return {**network.state_dict(), "latents": table.values.detach()}, log, reported
