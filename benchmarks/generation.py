"""Speed of generation in shapes a second: the table of docs/generation.md.

    OMP_NUM_THREADS=1 python -m benchmarks.generation [--shapes 48] [--cells 64]

reads the default run's data/runs and data/programs. Shapes are drawn, extracted, checked and sampled as the stage does,
with one thread and with two, in turns. On one core seconds are of the processor, on two of the clock on the wall:
there the machine must be quiet.
"""

import argparse
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch

from cagesdf.extraction import LOOSE
from cagesdf.io.cage_generators import read_generator
from cagesdf.io.generated_shapes import index_row
from cagesdf.io.runs import read_run
from cagesdf.shape_generation.cages import draw_cages
from cagesdf.shape_generation.surfaces import (
    STABILITIES,
    Extracting,
    code_source,
    counts,
    has_cuboids,
    make_shape,
    methods_of,
    orders,
)
from cagesdf.training.precision import processor

CATEGORIES, ARMS = ("chair", "table", "vase"), ("cagesdf", "cagesdf_global", "deepsdf")
TURNS = 3


def rng_of(*numbers: int) -> np.random.Generator:
    return np.random.default_rng(numbers)


def rates(data: Path, category: str, arm: str, shapes: int, cells: int) -> list[str]:
    """A line for each method of an arm."""
    run = read_run(data / "runs" / category / arm)
    how = Extracting(cells, LOOSE["keep"], 2048, STABILITIES["support"])
    lines = []
    for method in methods_of(run):
        source = code_source(run, method, None)
        seconds: dict[int, list[float]] = {1: [], 2: []}
        for turn in range(TURNS):
            for threads, spent in seconds.items():
                clock = time.process_time if threads == 1 else time.perf_counter
                start = clock()
                drawn: list[tuple[int, Any]] = [(i, None) for i in range(shapes)]
                if has_cuboids(run):
                    trained = read_generator(data / "programs" / category)
                    samples = draw_cages(trained, rng_of(turn), shapes, 1.0)
                    drawn = list(zip(samples.numbers, samples.kept))
                todo = list(orders(drawn, method, source, turn, partial(rng_of, turn, 1), 1.0))
                with ThreadPoolExecutor(threads) as pool:
                    made = list(
                        pool.map(partial(make_shape, run, how), map(partial(rng_of, turn, 2), range(len(todo))), todo)
                    )
                spent.append((clock() - start) / len(made))
        numbers = counts([index_row(shape) for shape in made])
        faces = np.mean([len(shape.mesh.faces) for shape in made])
        one, two = (1 / median(spent) for spent in seconds.values())
        lines.append(
            f"| {category} | {arm} | {method} | {one:.1f} | {two:.1f} | {faces:,.0f} "
            f"| {numbers['ok']} of {numbers['shapes']} |"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", type=int, default=48)
    parser.add_argument("--cells", type=int, default=64)
    parser.add_argument("--data", type=Path, default=Path("data"))
    given = parser.parse_args()
    torch.set_num_threads(1)
    print(f"On {processor()}.\n")
    print(
        "| category | arm | method | shapes/s, 1 core | 2 cores | faces | with a surface |\n"
        "|---|---|---|---|---|---|---|"
    )
    for category in CATEGORIES:
        for arm in ARMS:
            print("\n".join(rates(given.data, category, arm, given.shapes, given.cells)), flush=True)


if __name__ == "__main__":
    main()
