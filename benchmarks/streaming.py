"""Speed and memory of reading training points from shards that don't fit into memory.

    python -m benchmarks.streaming 40 500        # million points, limit in MB

writes a generated data set of that many points (spheres of random sizes in sixteen cuboids each) below a temporary
folder, opens it under that limit, reads batches of 1,024 and of 262,144 points alone and beside a training of the
default network, and prints a Markdown table. Peak memory is the resident set above what the process held after
its imports, the highest of samples taken every 10 ms by another thread.
"""

import os
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

os.environ.setdefault("GOMP_SPINCOUNT", "0")

import numpy as np
import torch

from cagesdf.cuboid import Cage, Sequence
from cagesdf.io.points import CHUNK, PointChunks, write_shard
from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import LatentTable
from cagesdf.training.checkpoint import Checkpoint
from cagesdf.training.loop import TrainSettings, train
from cagesdf.training.points import StreamedPoints, open_points
from cagesdf.training.precision import fitting_precision, processor

SHAPES, STEPS, PARTS, SHARDS = 500, 4, 16, 16
SECONDS = 8.0
NETWORK = {"width": 128, "layers": 6, "latent_dim": 32, "mapping": (256, 256), "octaves": 4}
PAGE = os.sysconf("SC_PAGE_SIZE")


def resident() -> float:
    """Resident memory of this process, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 1e6


@contextmanager
def peak(base: float) -> Iterator[list[float]]:
    """The highest resident memory above `base` while the block runs, MB, as the list's only item."""
    highest, stop = [0.0], threading.Event()

    def watch() -> None:
        while not stop.wait(0.01):
            highest[0] = max(highest[0], resident() - base)

    thread = threading.Thread(target=watch)
    thread.start()
    yield highest
    stop.set()
    thread.join()


def sequences() -> dict[str, Sequence]:
    rng = np.random.default_rng(0)
    parts = tuple(f"part_{part:02d}" for part in range(PARTS))
    return {
        f"shape_{i:05d}": Sequence(
            f"shape_{i:05d}",
            None,
            np.linspace(0, 1, STEPS),
            (False,) * STEPS,
            tuple(
                Cage(
                    parts,
                    rng.uniform(-0.6, 0.6, (PARTS, 3)),
                    np.tile(np.eye(3), (PARTS, 1, 1)),
                    rng.uniform(0.1, 0.5, (PARTS, 3)),
                )
                for _ in range(STEPS)
            ),
        )
        for i in range(SHAPES)
    }


def write(folder: Path, cages: dict[str, Sequence], points: int) -> None:
    """Shards of points about the cuboids; a sixth of them further than 0.02 outside, as in the default run."""
    names = tuple(cages)
    each = points // CHUNK // SHARDS
    for shard in range(SHARDS):
        rng = np.random.default_rng([1, shard])
        shape, step, part = (rng.integers(0, count, each) for count in (SHAPES, STEPS, PARTS))
        places = zip(shape.tolist(), step.tolist(), part.tolist())
        vectors = np.array([cages[names[a]].cages[b].vectors()[c] for a, b, c in places], np.float32)
        reach = np.where(rng.random((each, CHUNK)) < 0.84, 0.5, 2.0).astype(np.float32)
        xyz = rng.uniform(-1, 1, (each, CHUNK, 3)).astype(np.float32) * reach[..., None] * vectors[:, None, 12:]
        sdf = np.linalg.norm(xyz, axis=2) - vectors[:, None, 12] / 2
        chunks = PointChunks(
            shape, step, part, xyz + vectors[:, None, :3], sdf, reach < 1, names, cages[names[0]].cages[0].part_ids
        )
        write_shard(folder / f"shape-{shard:04d}.parquet", [chunks], rng)


def alone(data: StreamedPoints, batch: int) -> float:
    """Points a second of the reader on an idle machine."""
    latents = LatentTable.drawn(data.latent_keys("source"), 32, 0.01, 0)
    batches = data.batches(latents, batch, 1, 0)
    batches.at(0)
    begun, step = time.perf_counter(), 0
    while time.perf_counter() - begun < SECONDS:
        step += 1
        batches.at(step)
    return step * batch * CHUNK / (time.perf_counter() - begun)


def beside(data: StreamedPoints, batch: int, held: bool) -> float:
    """Points a second that a training takes: from the reader, or (`held`) the same batch over and over."""
    latents = LatentTable.drawn(data.latent_keys("source"), 32, 0.01, 0)
    decoder = make_decoder("CageDecoder", **NETWORK, seed=0)
    batches = data.batches(latents, batch, 1, 0)
    first = batches.at(0)
    if held:
        batches.at = lambda step: first  # type: ignore[method-assign]
    steps = max(int(300_000 * SECONDS / (batch * CHUNK)), 3)
    settings = TrainSettings(
        steps, 1e-3, 1e-2, 1e-2, 0.0, "cosine", 1, 0.0, 1e-4, fitting_precision("auto", "cpu"), steps, steps, ()
    )
    begun = time.perf_counter()
    train(decoder, latents, None, batches, settings, Checkpoint(Path("nowhere")), lambda step, loss: None)
    return steps * batch * CHUNK / (time.perf_counter() - begun)


def main(millions: float, limit: int) -> None:
    print(f"On {processor()}.\n")
    with tempfile.TemporaryDirectory() as name:
        folder, cages = Path(name), sequences()
        begun = time.perf_counter()
        write(folder, cages, int(millions * 1e6))
        size = sum(path.stat().st_size for path in folder.iterdir()) / 1e6
        print(f"{millions:g} million points, {size:,.0f} MB in {SHARDS} shards, {time.perf_counter() - begun:.0f} s")
        base = resident()
        begun = time.perf_counter()
        with peak(base) as first:
            data = open_points(folder, cages, "all", "cage", 0.02, np.random.default_rng(0), limit * 10**6)
        assert isinstance(data, StreamedPoints), "fits into the limit: ask for more points"
        rate = data.sampled / (time.perf_counter() - begun)
        print(f"limit {limit} MB; {data.used / data.sampled:.0%} of the points are trained on\n")
        print("| what | points/s | peak MB |\n|---|---|---|")
        print(f"| first pass: counting | {rate:,.0f} | {first[0]:,.0f} |", flush=True)
        for batch in (16, 4096):
            points = f"{batch * CHUNK:,}"
            with peak(base) as high:
                rate = alone(data, batch)
            print(f"| reader alone, batches of {points} | {rate:,.0f} | {high[0]:,.0f} |", flush=True)
            for held, text in (
                (True, "training, the same batch again and again"),
                (False, "training, from the reader"),
            ):
                with peak(base) as high:
                    rate = beside(data, batch, held)
                print(f"| {text}, {points} | {rate:,.0f} | {high[0]:,.0f} |", flush=True)
        print(f"\n{torch.get_num_threads()} threads of torch, {os.cpu_count()} cores")


if __name__ == "__main__":
    main(*(convert(given) for convert, given in zip((float, int), sys.argv[1:] or ("40", "500"))))
