"""Agreement of the two tests of stability on published programs: the table of docs/generation.md.

    python -m benchmarks.stability FOLDER [--shapes 500]

FOLDER has programs as text, of which some are drawn, always the same. Needs the extra `physics`.
"""

import argparse
import time
from collections import Counter
from pathlib import Path

import numpy as np

from cagesdf.shape_generation.static_stability import rooted
from cagesdf.shape_generation.surfaces import STABILITIES
from cagesdf.structure.executor import execute
from cagesdf.structure.parsing import read_program
from cagesdf.training.precision import processor


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--shapes", type=int, default=500)
    arguments = parser.parse_args()
    paths = sorted(arguments.folder.glob("*.txt"))
    chosen = np.random.default_rng(0).permutation(len(paths))[: arguments.shapes].tolist()
    cages = [execute(read_program(paths[i])) for i in chosen]
    standing = [cage for cage in cages if rooted(cage)]
    verdicts, seconds = {}, {}
    for name, stable in STABILITIES.items():
        start = time.process_time()
        verdicts[name] = [stable(cage) for cage in standing]
        seconds[name] = 1000 * (time.process_time() - start) / max(len(standing), 1)
    print(f"On {processor()}.\n")
    print(f"{len(cages)} programs, {len(standing)} rooted; ms of processor time a shape: {seconds}\n")
    print("| by support | by simulation | shapes |\n|---|---|---|")
    for (support, simulation), count in sorted(Counter(zip(verdicts["support"], verdicts["simulation"])).items()):
        print(f"| {'stands' if support else 'falls'} | {'stands' if simulation else 'falls'} | {count} |")


if __name__ == "__main__":
    main()
