"""Cost a shape of the stages from shapes to points: three sizes, one worker and all cores.

    python -m benchmarks.scale [--sizes 8 16 32] [--category chair]

prints a table of processor seconds, and the cost of 20,000 deformed shapes by the line through the three sizes:
its slope is a shape's cost, its start that of starting processes. Processor seconds are of all processes of a
stage together and hardly depend on what else the machine does; wall seconds do.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from cagesdf.training.precision import processor

ROOT = Path(__file__).parent.parent
STAGES = {
    "synthesize": "{category} raw",
    "import_shapes": "raw shapes",
    "fit_cuboids": "shapes cuboids",
    "match_targets": "shapes cuboids matches",
    "deform_sequences": "shapes cuboids matches sequences",
    "sample_points": "shapes sequences points",
}
DEFORMED = 20_000  # shapes with points in the paper's data


class Cost(NamedTuple):
    """Cost of one run of one stage."""

    processor: float  # seconds of all its processes
    wall: float  # seconds


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs=3, default=(8, 16, 32))
    parser.add_argument("--category", default="chair")
    options = parser.parse_args()
    sizes = sorted(options.sizes)
    defaults = yaml.safe_load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    paper = yaml.safe_load((ROOT / "profiles" / "paper.yaml").read_text(encoding="utf-8"))["sample_points"]
    dense = defaults | {"sample_points": defaults["sample_points"] | paper}
    training = defaults["deform_sequences"]["steps"] - len(defaults["deform_sequences"]["held_out"])
    with tempfile.TemporaryDirectory() as root:
        one = [run(Path(root, str(size)), defaults, options.category, size, 1) for size in sizes]
        largest = Path(root, str(sizes[-1]))
        all_cores = run(Path(root, "all"), defaults, options.category, sizes[-1], os.cpu_count() or 1)
        points = bytes_below(largest / "points")
        write_params(largest, dense, sizes[-1])
        at_paper = stage(largest, "sample_points", options.category, 1)
        dense_points = bytes_below(largest / "points")
    heads = [f"{size} shapes" for size in sizes] + [f"wall, {os.cpu_count()} workers", "a shape", "20,000 deformed"]
    print(f"On {processor()}.\n")
    print("| stage | " + " | ".join(heads) + " |\n|---|" + "---|" * len(heads))
    sources = DEFORMED / training
    for name in STAGES:
        costs = [each[name] for each in one]
        slope = float(np.polyfit(sizes, [cost.processor for cost in costs], 1)[0])
        cells = [f"{cost.processor:.1f} s" for cost in costs]
        cells += [f"{all_cores[name].wall:.1f} s", f"{slope:.2f} s", f"{slope * sources / 3600:.1f} h"]
        print(f"| `{name}` | " + " | ".join(cells) + " |")
    each = at_paper.processor / sizes[-1]
    cells = ["", "", f"{at_paper.processor:.1f} s", "", f"{each:.2f} s", f"{each * sources / 3600:.1f} h"]
    print("| `sample_points`, the paper's points | " + " | ".join(cells) + " |")
    for what, size in (("default", points), ("paper's", dense_points)):
        print(f"{what} points: {size / sizes[-1] * sources / 1e9:.1f} GB on disk for 20,000")
    largest_process = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"largest process: {largest_process:.0f} MB")


def run(folder: Path, params: dict, category: str, size: int, workers: int) -> dict[str, Cost]:
    """All stages in turn, in a folder of their own."""
    folder.mkdir()
    write_params(folder, params, size)
    return {name: stage(folder, name, category, workers) for name in STAGES}


def write_params(folder: Path, params: dict, size: int) -> None:
    """Write the parameters with `size` training shapes and no others."""
    changed = params | {"synthesize": params["synthesize"] | {"train": size, "val": 0}}
    changed["match_targets"] = params["match_targets"] | {"unmatched": "scale"}  # so that none is dropped
    (folder / "params.yaml").write_text(yaml.safe_dump(changed), encoding="utf-8")


def stage(folder: Path, name: str, category: str, workers: int) -> Cost:
    """One stage in a process of its own."""
    arguments = STAGES[name].format(category=category).split()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "CAGESDF_WORKERS": str(workers), "OMP_NUM_THREADS": "1"}
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", f"stages.{name}", *arguments], cwd=folder, env=environment, check=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Cost(processor, time.perf_counter() - start)


def bytes_below(folder: Path) -> int:
    """The size of all files of a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


if __name__ == "__main__":
    main()
