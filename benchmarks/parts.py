"""Quality of surfaces after given processor seconds of training: the part model beside the baselines.

    python -m benchmarks.parts [chair table vase] [--seconds 60 180 600] [--seeds 4 5 6] [--arms cagesdf …] [--shapes 4]

Each arm is trained for as many steps as this machine does in that time on one thread, its schedule ending there, and
measured by the shape code alone at 128 cells, on source shapes and their held-out steps: distance (% of the longest
side), of the detail alone, signed normals, and the share of surfaces with as many pieces and handles as the true one.
For the part model the truth of a held-out step is of parts that follow their own cuboids; for the others, that of
vertices that follow all cuboids around them: what each was taught. `data/` is that of `make repro`. Prints a Markdown
table; on processors that have more than AVX2, three variables make them plain ones (docs/training.md).
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cagesdf.deformation.sequences import Trilinear
from cagesdf.evaluation.reconstruction import score
from cagesdf.evaluation.surfaces import Measured, Truth
from cagesdf.extraction import extract_surface, field_of
from cagesdf.io.runs import read_run
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.run import Run
from cagesdf.seeds import draw, item_rng
from cagesdf.training.precision import processor
from pipeline import load
from stages import train

CELLS = 128
POINTS = 20_000
DETAIL = 0.005
TRIAL = 200  # steps that are timed first
ARMS = ("cagesdf", "cagesdf_global", "deepsdf_sine")
COLUMNS = ("surface_distance", "surface_distance_detail", "nc_signed", "same_components", "same_genus")


def trained(arm: str, category: str, out: Path, **changes: Any) -> float:
    """Train an arm with other parameters into `out`; returns the processor seconds."""
    points, shapes, cuboids, sequences = (
        Path("data") / name / category for name in ("points", "shapes", "cuboids", "sequences")
    )
    params = load(f"arms.{arm}").model_copy(update={"snapshots": (), "precision": "float32", **changes})
    begun = time.process_time()
    train.main(points, shapes, cuboids, sequences, out, params)
    return time.process_time() - begun


def steps_in(seconds: float, arm: str, category: str, folder: Path) -> int:
    """Steps of an arm that this machine does in `seconds`."""
    trained(arm, category, folder / f"trial-{arm}-warm", steps=1)  # what the first training alone takes
    few, many = (trained(arm, category, folder / f"trial-{arm}-{n}", steps=n) for n in (1, 1 + TRIAL))
    return max(int(seconds * TRIAL / (many - few)), 1)


def measured(run: Run, shapes: ShapeFolder, shape_id: str, step: int) -> dict[str, float]:
    """COLUMNS of one surface."""
    sequence, shape = run.sequences[shape_id], shapes.read(shape_id)
    cage = sequence.cages[step]
    if run.decoder.trains_on == "part":
        truth = Truth.of_own_cuboids(shape, sequence, step, DETAIL, Trilinear())
    else:
        truth = Truth.of(shape, sequence, step, DETAIL, Trilinear())
    mesh = extract_surface(field_of(run.decoder, run.latent(shape_id, step), cage), CELLS)
    rng = item_rng(0, "parts", shape_id, step)
    return score(Measured(mesh) if len(mesh.faces) else None, truth, truth.drawn(POINTS, rng), rng)


def row(arm: str, category: str, seconds: float, steps: int, seeds: list[int], count: int, folder: Path) -> str:
    """A row of the table: source shapes and held-out steps, the mean over seeds ± its spread."""
    shapes = read_shapes(Path("data/shapes") / category)
    by_split: dict[bool, list[list[float]]] = {False: [], True: []}
    for seed in seeds:
        out = folder / f"{arm}-{category}-{seconds:g}-{seed}"
        trained(arm, category, out, steps=steps, seed=seed)
        run = read_run(out)
        ids = draw(load("extract_meshes").seed, run.sequences, count)
        for held_out in (False, True):
            items = [(i, s) for i in ids for s in run.steps(i) if run.sequences[i].held_out[s] == held_out]
            items = [(i, s) for i, s in items if held_out or s == 0]
            if items:
                figures = [measured(run, shapes, *item) for item in items]
                by_split[held_out].append([float(np.nanmean([f[name] for f in figures])) for name in COLUMNS])
    cells = []
    for by_seed in by_split.values():
        if not by_seed:
            cells.append("–")
            continue
        mean, spread = np.mean(by_seed, axis=0), np.ptp(by_seed, axis=0)
        cells.append(" / ".join(f"{value:.3f}" for value in mean) + f" (distance ± {spread[0] / 2:.3f})")
    return f"| `{arm}` | {category} | {seconds:g} | {steps:,} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("categories", nargs="*", default=["chair", "table", "vase"])
    parser.add_argument("--seconds", type=float, nargs="+", default=[60, 180, 600])
    parser.add_argument("--seeds", type=int, nargs="+", default=[4, 5, 6])
    parser.add_argument("--arms", nargs="+", default=list(ARMS))
    parser.add_argument("--shapes", type=int, default=4)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"On {processor()}, float32, one thread.\n")
    print(f"| arm | category | s | steps | source: {' / '.join(COLUMNS)} | held-out |")
    print("|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as name:
        for category in options.categories:
            for arm in options.arms:
                each = steps_in(1, arm, category, Path(name))
                for seconds in options.seconds:
                    steps = int(each * seconds)
                    print(row(arm, category, seconds, steps, options.seeds, options.shapes, Path(name)), flush=True)


if __name__ == "__main__":
    main()
