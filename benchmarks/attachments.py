"""Gaps between attached parts, of decoders whose parts' codes see each other or don't: docs/styles.md, "Context".

    python -m benchmarks.attachments [chair table vase] [--steps 1600] [--seeds 4 5] [--shapes 6]

Each decoder is trained as the arm `cagesdf` is. Parts are attached where the true ones touch. Printed are, of source
shapes and their held-out steps at 128 cells by the shape code alone: the largest gap of a shape's attached parts, mean
over shapes and worst, in % of the truth's longest side (0 where all of them run into each other); the share of attached
pairs with a gap of more than a tenth of a cell; and the share of surfaces with as many pieces as the true one. A part
without surface counts as a gap of 100 %. `data/` is that of `make repro`.
"""

import argparse
import tempfile
from itertools import combinations
from pathlib import Path

import numpy as np
import torch

from benchmarks.parts import CELLS, DETAIL, trained
from cagesdf.deformation.sequences import Trilinear
from cagesdf.evaluation.surfaces import Measured, Truth
from cagesdf.extraction import extract, field_of
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import as_manifold
from cagesdf.io.runs import read_run
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.run import Run
from cagesdf.seeds import draw
from cagesdf.training.precision import processor
from pipeline import load

DECODERS = {
    "OccupancyDecoder": {},
    "TriplaneDecoder": {"decoder": "TriplaneDecoder", "clamp": 0.6},
    "PlainTriplaneDecoder": {"decoder": "PlainTriplaneDecoder", "clamp": 0.6},
    "RelationTriplaneDecoder": {"decoder": "RelationTriplaneDecoder", "clamp": 0.6},
}
TOUCHING = 1e-3  # canonical units: true parts no further apart are attached
SEEN = 0.2 * HALF_EXTENT / CELLS  # canonical units: a tenth of a cell
LOST = 100.0  # % of the side
COLUMNS = ("largest gap, mean %", "worst %", "pairs with a gap", "pieces right")


def gaps_of(run: Run, shapes: ShapeFolder, shape_id: str, step: int) -> tuple[list[float], bool, float]:
    """The gap of each attached pair, canonical; whether the surface has the true number of pieces; longest side."""
    sequence, shape = run.sequences[shape_id], shapes.read(shape_id)
    truth = Truth.of_own_cuboids(shape, sequence, step, DETAIL, Trilinear())
    solids = [as_manifold(mesh) for mesh in Trilinear().own_parts(shape, sequence, step)]
    surface = extract(field_of(run.decoder, run.latent(shape_id, step), sequence.cages[step]), CELLS)
    made = [surface.parts[part_id] for part_id in sequence.cages[step].part_ids]
    gaps = [
        gap(made[a], made[b], truth.side)
        for a, b in combinations(range(len(solids)), 2)
        if solids[a].min_gap(solids[b], 2 * TOUCHING) < TOUCHING
    ]
    pieces = Measured(surface.mesh).topology[0] if len(surface.mesh.faces) else 0
    return gaps, pieces == truth.topology[0], truth.side


def gap(one: Mesh, other: Mesh, side: float) -> float:
    """The least distance of two parts' surfaces, canonical; 0 if they run into each other."""
    if not (len(one.faces) and len(other.faces)):
        return LOST / 100 * side
    return as_manifold(one).min_gap(as_manifold(other), side)


def measured(run: Run, shapes: ShapeFolder, items: list[tuple[str, int]]) -> list[float]:
    """COLUMNS over some surfaces."""
    surfaces = [gaps_of(run, shapes, *item) for item in items]
    largest = [100 * max(gaps, default=0.0) / side for gaps, _, side in surfaces]
    pairs = np.concatenate([gaps for gaps, _, _ in surfaces])
    return [
        float(np.mean(largest)),
        max(largest),
        float((pairs > SEEN).mean()),
        float(np.mean([right for _, right, _ in surfaces])),
    ]


def row(decoder: str, category: str, options: argparse.Namespace) -> str:
    """A row of the table: source shapes and held-out steps, means over seeds."""
    shapes = read_shapes(Path("data/shapes") / category)
    figures = []
    for seed in options.seeds:
        with tempfile.TemporaryDirectory() as name:
            out = Path(name) / "run"
            trained("cagesdf", category, out, **DECODERS[decoder], seed=seed, steps=options.steps)
            run = read_run(out)
        ids = draw(load("extract_meshes").seed, run.sequences, options.shapes)
        items = [(i, s) for i in ids for s in run.steps(i)]
        source = [(i, s) for i, s in items if s == 0]
        held_out = [(i, s) for i, s in items if run.sequences[i].held_out[s]]
        figures.append([measured(run, shapes, source), measured(run, shapes, held_out)])
    cells = [" / ".join(f"{value:.2f}" for value in split) for split in np.mean(figures, axis=0)]
    return f"| `{decoder}` | {category} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("categories", nargs="*", default=["chair", "table", "vase"])
    parser.add_argument("--steps", type=int, default=load("arms.cagesdf").steps)
    parser.add_argument("--seeds", type=int, nargs="+", default=[4, 5])
    parser.add_argument("--shapes", type=int, default=6)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"On {processor()}, float32, one thread, {options.steps} steps.\n")
    print(f"| decoder | category | source: {' / '.join(COLUMNS)} | held-out |\n|---|---|---|---|", flush=True)
    for category in options.categories:
        for decoder in DECODERS:
            print(row(decoder, category, options), flush=True)


if __name__ == "__main__":
    main()
