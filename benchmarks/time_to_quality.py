"""How good a minute of training is: held-out steps of the default run's chairs, three training seeds.

    python benchmarks/time_to_quality.py [--seconds 60] [--seeds 4 5 6] [--arm cagesdf] [--category chair]

measures how many steps this machine does in that time, trains an arm for as many (its schedule ends there), and
measures it on the data of `make repro` with 128 and 256 cells: surface_distance (% of the longest side) and the signed
normal consistency, means over the held-out steps. The last row is marching cubes of the exact distance, with as many
cells: better than that no network can be.
"""

import argparse
import tempfile
import time
from functools import partial
from pathlib import Path
from statistics import mean
from typing import Any

import torch
from torch import Tensor

from cagesdf.evaluation.reconstruction import Measured, Truth, score
from cagesdf.evaluation.tables import gather_tables
from cagesdf.extraction import extract_surface, field_of
from cagesdf.io.scores import read_scores
from cagesdf.io.sequences import read_sequences
from cagesdf.io.shapes import read_shapes
from cagesdf.models.decoders import Decoder
from cagesdf.training.precision import processor
from pipeline import draw, item_rng, load, parallel_map
from stages import evaluate, extract_meshes, train

CELLS = (128, 256)
METRICS = ("surface_distance", "surface_distance_detail", "nc_signed")
TRIAL = 2000  # steps that are timed first


class ExactDecoder(Decoder):
    """The true distance in place of a network."""

    def __init__(self, truth: Truth) -> None:
        super().__init__()
        self.truth = truth

    def features(self, points: Tensor, cuboid: Tensor) -> Tensor:
        """The points themselves, canonical."""
        return points

    def condition(self, latent: Tensor, cuboid: Tensor) -> Tensor:
        """Nothing."""
        return latent

    def at(self, features: Tensor, condition: Tensor, products: torch.dtype) -> Tensor:
        """Exact signed distances, canonical."""
        distances = self.truth.distance.signed(features.reshape(-1, 3).double().numpy())
        return torch.from_numpy(distances).float().view(features.shape[:-1])


def steps_in(seconds: float, arm: str, category: str) -> int:
    """How many steps of an arm this machine does in so many seconds."""
    with tempfile.TemporaryDirectory() as work:
        times = []
        for steps in (1, 1 + TRIAL):
            begun = time.perf_counter()
            trained(arm, category, {"steps": steps}, Path(work) / str(steps))
            times.append(time.perf_counter() - begun)
    return int(seconds * TRIAL / (times[1] - times[0]))


def trained(arm: str, category: str, changes: dict[str, Any], run: Path) -> None:
    """Train one arm with other parameters."""
    names = ("points", "shapes", "cuboids", "sequences")
    points, shapes, cuboids, sequences = (Path("data") / name / category for name in names)
    params = load(f"arms.{arm}").model_copy(update={"snapshots": (), **changes})
    train.main(points, shapes, cuboids, sequences, run, params)


def measured(arm: str, category: str, run: Path, cells: int, work: Path) -> dict[str, float]:
    """METRICS of a run's held-out steps."""
    shapes, sequences = (Path("data") / kind / category for kind in ("shapes", "sequences"))
    meshes, scores = work / "meshes" / arm, work / "scores" / arm
    extract_meshes.main(run, meshes, load("extract_meshes").model_copy(update={"resolution": cells, "sources": 1}))
    evaluate.main(meshes.parent, shapes, sequences, scores, load("evaluate"))
    row = gather_tables({category: read_scores(scores)})["table2"][category][arm]
    return {metric: row[metric]["mean"] for metric in METRICS}


def exact(category: str, cells: int) -> dict[str, float]:
    """METRICS of the true distance, on the same held-out steps."""
    sequences = read_sequences(Path("data/sequences") / category)
    ids = draw(load("extract_meshes").seed, sequences, load("extract_meshes").held_out)
    items = [(sequences[i], step) for i in ids for step, held_out in enumerate(sequences[i].held_out) if held_out]
    rows, _ = parallel_map(partial(exact_row, category, cells), items, rejects=OverflowError, label="exact")
    return {metric: mean(row[metric] for row in rows) for metric in METRICS}


def exact_row(category: str, cells: int, item: tuple[Any, int]) -> dict[str, float]:
    """METRICS of one step."""
    sequence, step = item
    params = load("evaluate")
    truth = Truth.of(read_shapes(Path("data/shapes") / category).read(sequence.shape_id), sequence, step, params.detail)
    field = field_of(ExactDecoder(truth), torch.zeros(1), sequence.cages[step])
    predicted = Measured(extract_surface(field, cells))
    rng = item_rng(params.seeds[0], "exact", sequence.shape_id, step)
    return score(predicted, truth, truth.drawn(params.points, rng), rng)


def line(name: str, steps: str, seconds: str, cells: int, row: dict[str, float]) -> str:
    """A row of the table."""
    figures = " | ".join(f"{row[metric]:.3f}" for metric in METRICS)
    return f"| {name} | {steps} | {seconds} | {cells} | {figures} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seeds", type=int, nargs="+", default=(4, 5, 6))
    parser.add_argument("--arm", default="cagesdf")
    parser.add_argument("--category", default="chair")
    options = parser.parse_args()
    print(f"On {processor()}.\n")
    print(f"| training | steps | s | cells | {' | '.join(METRICS)} |\n|---|---|---|---|---|---|---|", flush=True)
    steps = steps_in(options.seconds, options.arm, options.category)
    for seed in options.seeds:
        with tempfile.TemporaryDirectory() as name:
            run = Path(name) / options.arm
            begun = time.perf_counter()
            trained(options.arm, options.category, {"steps": steps, "seed": seed}, run)
            took = time.perf_counter() - begun
            for cells in CELLS:
                row = measured(options.arm, options.category, run, cells, Path(name) / str(cells))
                print(line(f"seed {seed}", f"{steps:,}", f"{took:.0f}", cells, row), flush=True)
    for cells in CELLS:
        print(line("exact distance", "–", "–", cells, exact(options.category, cells)), flush=True)


if __name__ == "__main__":
    main()
