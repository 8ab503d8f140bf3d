"""Occupancy in place of the distance: the same part model and steps, with either loss (the paper's §5).

    python -m benchmarks.occupancy [chair …] [--steps 2700 8200] [--arms …] [--shapes 4]

The arms are those of profiles/ablations.yaml, on the `data/` of `make repro`. Each is trained on one thread, 60 s and
180 s on a processor with AVX2, and measured by the shape code alone at 128 cells, on source shapes and held-out steps,
against parts that follow their own cuboids: distance (% of the longest side); the same where parts meet, over points
within 1 % of the longest side of two cuboids; signed normals; connected components (without cavities) and handles
beyond the true surface's; the share of surfaces with as many components (and cavities), and handles; and the components
that a sparse extraction loses, as surfaces are extracted densely. Prints a Markdown table.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import torch

from benchmarks.parts import CELLS, DETAIL, POINTS, trained
from cagesdf.cuboid import Cage
from cagesdf.deformation.sequences import Trilinear
from cagesdf.evaluation.reconstruction import compare
from cagesdf.evaluation.surfaces import Measured, Truth, directions
from cagesdf.extraction import METHODS, extract, field_of
from cagesdf.extraction.promises import count_pieces
from cagesdf.geometry.meshes import sample_surface
from cagesdf.io.runs import read_run
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.run import Run
from cagesdf.seeds import draw, item_rng
from cagesdf.training.precision import processor
from pipeline import load
from pipeline.workspace import profile_settings

MEET = 0.01  # of the longest side: points this near to two cuboids are where parts meet
ARMS = profile_settings("ablations")["arms"]  # by name, the differences from the default arm
COLUMNS = ("distance", "where parts meet", "nc_signed", "loose", "handles", "same components", "same genus", "lost")


def meeting_distance(surface: Measured, truth: Truth, cage: Cage, rng: np.random.Generator) -> float:
    """Mean of both directions of the surface distance, % of the longest side, over the points where parts meet."""
    means = []
    for source, other in ((truth, surface), (surface, truth)):
        points = sample_surface(source.mesh, POINTS, rng)[0]
        near = (cage.signed_distance(points) <= MEET * truth.side).sum(axis=1) >= 2
        means.append(100 / truth.side * float(other.distance.unsigned(points[near]).mean()) if near.any() else np.nan)
    return float(np.mean(means))


def measured(run: Run, shapes: ShapeFolder, shape_id: str, step: int) -> list[float]:
    """COLUMNS of one surface."""
    sequence = run.sequences[shape_id]
    cage = sequence.cages[step]
    truth = Truth.of_own_cuboids(shapes.read(shape_id), sequence, step, DETAIL, Trilinear())
    field = field_of(run.decoder, run.latent(shape_id, step), cage)
    sparse, dense = (extract(field, CELLS, METHODS[name]) for name in ("sparse", "dense"))
    rng = item_rng(0, "occupancy", shape_id, step)
    surface = Measured(dense.mesh)
    figures = compare(*directions(surface, truth, truth.drawn(POINTS, rng), rng), truth.side)
    (pieces, genus), (true_pieces, true_genus) = surface.topology, truth.topology
    return [
        figures["surface_distance"],
        meeting_distance(surface, truth, cage, rng),
        figures["nc_signed"],
        dense.components - count_pieces(truth.mesh),
        genus - true_genus,
        pieces == true_pieces,
        genus == true_genus,
        dense.components - sparse.components,
    ]


def row(arm: str, category: str, steps: int, count: int, folder: Path) -> str:
    """A row of the table: source shapes, then held-out steps."""
    shapes = read_shapes(Path("data/shapes") / category)
    out = folder / f"{arm}-{category}-{steps}"
    spent = trained("cagesdf", category, out, steps=steps, **ARMS.get(arm, {}))
    run = read_run(out)
    ids = draw(load("extract_meshes").seed, run.sequences, count)
    cells = []
    for held_out in (False, True):
        items = [(i, s) for i in ids for s in run.steps(i) if run.sequences[i].held_out[s] == held_out]
        items = [(i, s) for i, s in items if held_out or s == 0]
        figures = np.array([measured(run, shapes, *item) for item in items], dtype=float)
        cells.append(" / ".join(f"{value:.3f}" for value in np.nanmean(figures, axis=0)))
    return f"| `{arm}` | {category} | {spent:.0f} | {steps:,} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("categories", nargs="*", default=["chair"])
    parser.add_argument("--steps", type=int, nargs="+", default=[2700, 8200])
    parser.add_argument("--arms", nargs="+", choices=["cagesdf", *ARMS], default=["cagesdf", "cagesdf_distance"])
    parser.add_argument("--shapes", type=int, default=4)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"On {processor()}, float32, one thread.\n")
    print(f"| arm | category | s | steps | source: {' / '.join(COLUMNS)} | held-out |")
    print("|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as name:
        for category in options.categories:
            for steps in options.steps:
                for arm in options.arms:
                    print(row(arm, category, steps, options.shapes, Path(name)), flush=True)


if __name__ == "__main__":
    main()
