"""Speed of reading, executing and differentiating ShapeAssembly programs, and agreement with the published cuboids.

    python -m benchmarks.programs --programs FOLDER [--cuboids FILE.jsonl.gz]

prints a Markdown table of one row, measured on one core: medians over repetitions. `--cuboids` has a JSON object with
id and cuboids on each line, as `cagesdf execute` prints them; then each program that is off by more than 1e-4 in any
of a cuboid's 15 numbers follows below the table.
"""

import argparse
import gzip
import json
import resource
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from cagesdf.formats.shapeassembly import list_programs
from cagesdf.structure.executor import differentiate, execute
from cagesdf.structure.parsing import parse
from cagesdf.training.precision import processor

TOLERANCE = 1e-4
REPETITIONS = 5
DIFFERENTIATED = 300  # programs, evenly chosen


def seconds(work: Callable[[Any], object], items: list[Any]) -> float:
    """Seconds of `work` for one item, median over repetitions."""
    times = []
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        for item in items:
            work(item)
        times.append(time.perf_counter() - start)
    return median(times) / len(items)


def peak() -> float:
    """Largest memory that this process has had, MB."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def errors(texts: dict[str, str], lines: Iterable[str]) -> dict[str, float]:
    """Largest difference of each program's cuboids from the given ones; infinite for another number of cuboids."""
    wanted = {row["id"]: np.array(row["cuboids"]) for row in map(json.loads, lines)}
    result = {}
    for name, text in texts.items():
        if name in wanted:
            vectors = execute(parse(text)).vectors()
            same = vectors.shape == wanted[name].shape
            result[name] = float(np.abs(vectors - wanted[name]).max()) if same else float("inf")
    return result


def main(folder: Path, cuboids: Path | None) -> None:
    texts = {file.stem: file.read_text(encoding="utf-8") for file in list_programs([folder])}
    written = list(texts.values())
    programs = [parse(text) for text in written]
    leaves = median(len(execute(program)) for program in programs)
    rates = [
        1 / seconds(work, items)
        for work, items in ((parse, written), (execute, programs), (lambda text: execute(parse(text)), written))
    ]
    chosen = programs[:: -(-len(programs) // DIFFERENTIATED)]
    slope = 1000 * seconds(differentiate, chosen)
    cells = [folder.name, f"{len(programs):,}", f"{leaves:.0f}", *(f"{rate:,.0f}" for rate in rates), f"{slope:.2f}"]
    heads = ["set", "programs", "leaves, median", "parse /s", "execute /s", "both /s", "differentiate, ms", "peak, MB"]
    cells.append(f"{peak():.0f}")
    outside: dict[str, float] = {}
    if cuboids is not None:
        with gzip.open(cuboids, "rt", encoding="utf-8") as lines:
            differences = errors(texts, lines)
        outside = {name: error for name, error in differences.items() if error > TOLERANCE}
        heads.append("within 1e-4")
        cells.append(f"{1 - len(outside) / len(differences):.2%} of {len(differences):,}")
    print(f"On {processor()}.\n")
    print("\n".join(f"| {' | '.join(row)} |" for row in (heads, ["---"] * len(heads), cells)))
    for name, error in outside.items():
        print(f"\n{name}: {error:.2g}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--programs", type=Path, required=True, help="a folder of .txt files")
    parser.add_argument("--cuboids", type=Path, help="what they must give, .jsonl.gz")
    arguments = parser.parse_args()
    main(arguments.programs, arguments.cuboids)
