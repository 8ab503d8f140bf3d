"""What extraction costs and keeps: the tables of docs/extraction.md.

    OMP_NUM_THREADS=1 python benchmarks/extraction.py methods [--shapes 8]
    OMP_NUM_THREADS=1 python benchmarks/extraction.py memory chair 0
    OMP_NUM_THREADS=1 python benchmarks/extraction.py overlaps [--shapes 8]
    OMP_NUM_THREADS=1 python benchmarks/extraction.py latency [--edits 200]

reads the default run's data/runs and data/shapes. Seconds are of one thread's processor time. `methods` compares all
shapes at 128 cells and `--shapes` of each category, evenly drawn, at 256, in five minutes; `latency` edits cuboids
alone, editing.py everything.
"""

import argparse
import resource
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from cagesdf.extraction.joining import Joined, Part, part_of
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from cagesdf.cuboid import Cage
from cagesdf.distance import SurfaceDistance
from cagesdf.evaluation.reconstruction import Measured, Truth, score
from cagesdf.extraction import FIELDS, METHODS, OUTSIDES, OVERLAPS, CageField, LiveSurface, extract
from cagesdf.extraction.surface import march
from cagesdf.frames import HALF_EXTENT
from cagesdf.io.runs import Run, read_run
from cagesdf.io.shapes import read_shapes
from cagesdf.meshes import Mesh, sample_surface
from cagesdf.training.precision import processor

CATEGORIES = ("chair", "table", "vase")
RUNS, SHAPES = Path("data/runs"), Path("data/shapes")
WHOLE = 2**19  # points of the whole grid that are asked; its time is scaled from them
NEAR = 1e-3  # canonical units: surface this near to two cuboids lies where they overlap


def timed(work: Callable[..., Any], *given: Any) -> tuple[float, Any]:
    start = time.process_time()
    result = work(*given)
    return time.process_time() - start, result


def drawn(run: Run, count: int) -> list[str]:
    ids = list(run.sequences)
    return ids[:: max(1, len(ids) // count)][:count]


def row(*cells: object) -> None:
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def field_of(run: Run, shape_id: str, step: int = 0, overlap: str = "blend") -> CageField:
    cage = run.sequences[shape_id].cages[step]
    return CageField(run.decoder, run.latent(shape_id, step), cage, OUTSIDES["union"], OVERLAPS[overlap])


def apart(a: Mesh, b: Mesh) -> float:
    """The largest distance from a vertex of one mesh to the nearest of the other, both ways."""
    return max(float(np.max(cKDTree(q.vertices).query(p.vertices)[0])) for p, q in ((a, b), (b, a)))


def whole_grid(field: CageField, resolution: int) -> float:
    """Seconds to ask the network at every point of the grid (of WHOLE, scaled), and for marching cubes of all of it."""
    axis = np.linspace(-HALF_EXTENT, HALF_EXTENT, resolution + 1)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    some = points[:: max(1, len(points) // WHOLE)]
    asking, _ = timed(field.ask, some, 0)
    ball = (np.linalg.norm(points, axis=1) - 0.5).reshape((resolution + 1,) * 3).astype(np.float32)
    marching, _ = timed(marching_cubes, ball, 0.0)
    return asking * len(points) / len(some) + marching


def methods(shapes: int) -> None:
    row("category", "cells", "shapes", "equal", "in cuboids", "dense", "sparse", "sparse ÷ in cuboids", "dense s",
        "sparse s", "dense ÷ sparse", "whole grid ÷ sparse", "vertices apart", "overshoot before", "after")  # fmt: skip
    row(*["---"] * 15)
    for resolution, sample in ((128, None), (256, shapes)):
        means = []
        for category in CATEGORIES:
            run = read_run(RUNS / category / "cagesdf")
            ids = drawn(run, sample or len(run.sequences))
            whole = whole_grid(field_of(run, ids[0]), resolution)
            figures = np.array([compared(field_of(run, shape_id), resolution) for shape_id in ids])
            covered, many, few, slow, fast = figures[:, :5].mean(axis=0)
            far, before, after = figures[:, 6:].max(axis=0)
            row(category, resolution, len(ids), int(figures[:, 5].sum()), *counts(covered, many, few, slow, fast),
                f"{whole / fast:.0f}", f"{far:.1g}", f"{before:.2f}", f"{after:.1g}")  # fmt: skip
            means.append((covered, many, few, slow, fast))
        row("all", resolution, "", "", *counts(*np.mean(means, axis=0)), "", "", "", "")


def counts(covered: float, many: float, few: float, slow: float, fast: float) -> list[str]:
    points = [f"{count:,.0f}" for count in (covered, many, few)]
    return [*points, f"{few / covered:.2f}", f"{slow:.2f}", f"{fast:.2f}", f"{slow / fast:.1f}"]


def compared(field: CageField, resolution: int) -> tuple[float, ...]:
    """Of one shape: lattice points in cuboids, points asked densely and sparsely, seconds of both; whether the surfaces
    are equal bit for bit, and else how far apart; cells by which marching cubes alone leaves the cage, and the result.
    """
    slow, dense = timed(extract, field, resolution, METHODS["dense"])
    parts: list[Part] = []
    fast, sparse = timed(partial(extract, field, resolution, each=lambda ask, cuboids: noted(map(ask, cuboids), parts)))
    one, other = dense.mesh, sparse.mesh
    equal = np.array_equal(one.vertices, other.vertices) and np.array_equal(one.faces, other.faces)
    cell = 2 * HALF_EXTENT / resolution
    covered = int(Joined(field, parts, cell).covered.sum())  # the parts know all that is asked: no network here
    before = float(field.cage.assign(march(field, parts, cell).mesh.vertices)[1].max()) / cell
    return (covered, dense.asked, sparse.asked, slow, fast, equal, 0 if equal else apart(one, other), before,
            sparse.overshoot)  # fmt: skip


def noted(parts: Iterable[Part], notes: list[Part]) -> list[Part]:
    """The parts, of which a note is taken."""
    notes.extend(parts)
    return notes


def memory(category: str, shape: int) -> None:
    run = read_run(RUNS / category / "cagesdf")
    shape_id = list(run.sequences)[shape]
    seconds, found = timed(extract, field_of(run, shape_id), 512)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    row(shape_id, f"{peak:.0f} MB", f"{seconds:.1f} s", f"{found.asked:,}", f"{len(found.mesh.faces):,}")


def overlaps(shapes: int) -> None:
    row("category", "arm", "overlap", "surface distance %", "signed normals", "where cuboids overlap: mean %", "p99 %",
        "jump at switches: mean", "p99", "largest (cells)", "pieces")  # fmt: skip
    row(*["---"] * 11)
    for category in CATEGORIES:
        truths = read_shapes(SHAPES / category)
        for arm in ("cagesdf", "cagesdf_global"):
            run = read_run(RUNS / category / arm)
            figures: dict[str, list[tuple[float, ...]]] = {name: [] for name in OVERLAPS}
            for shape_id in drawn(run, shapes):
                for step in (0, 3):
                    if step in run.steps(shape_id):
                        truth = Truth.of(truths.read(shape_id), run.sequences[shape_id], step, 0.005)
                        for name in OVERLAPS:
                            figures[name].append(seam(field_of(run, shape_id, step, name), truth))
            for name, some in figures.items():
                row(category, arm, name, *(f"{value:.3f}" for value in np.nanmean(some, axis=0)))


def seam(field: CageField, truth: Truth) -> tuple[float, ...]:
    found, rng = extract(field, 128), np.random.default_rng(0)
    figures = score(Measured(found.mesh), truth, truth.drawn(15_000, rng), rng)
    here, there = (sample_surface(mesh, 20_000, rng)[0] for mesh in (found.mesh, truth.mesh))
    errors = []
    for points, other in ((here, truth.distance), (there, SurfaceDistance(found.mesh))):
        shared = (field.cage.signed_distance(points) <= NEAR).sum(axis=1) > 1
        errors.append(other.unsigned(points[shared]))
    error = 100 / truth.side * np.concatenate(errors)
    jump = np.concatenate(list(jumps(field, 128)))
    return (figures["surface_distance"], figures["nc_signed"], error.mean(), np.percentile(error, 99), jump.mean(),
            np.percentile(jump, 99), jump.max(), found.components)  # fmt: skip


def jumps(field: CageField, resolution: int) -> Iterator[np.ndarray]:
    """|difference| in cells of the field at neighbouring lattice points near the surface, in other cuboids each."""
    cell = 2 * HALF_EXTENT / resolution
    parts = [part_of(field, k, cell, METHODS["dense"]) for k in range(len(field.cage))]
    joined = Joined(field, parts, cell)
    places = np.argwhere(joined.covered)
    values = np.full(joined.covered.shape, np.nan)
    values[joined.covered] = joined.field_at(np.flatnonzero(joined.covered))
    distance = field.cage.signed_distance(joined.lattice.points(places))
    row_at = np.full(joined.covered.shape, -1)
    row_at[joined.covered] = np.arange(len(places))
    for axis in range(3):
        low, high = (np.moveaxis(row_at, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        both = (low >= 0) & (high >= 0)
        a, b = low[both], high[both]
        switch = ((distance[a] <= 0) != (distance[b] <= 0)).any(axis=1) | (
            distance[a].argmin(axis=1) != distance[b].argmin(axis=1)
        )
        one, other = values[tuple(places[a[switch]].T)], values[tuple(places[b[switch]].T)]
        yield np.abs(one - other)[np.minimum(np.abs(one), np.abs(other)) < 0.02] / cell


def latency(edits: int) -> None:
    row("cells", "edits", "p50 ms", "p95 ms", "largest ms", "first ms", "asked (median)")
    row(*["---"] * 7)
    run = read_run(RUNS / "chair" / "cagesdf")
    for resolution in (96, 256):
        rng = np.random.default_rng(0)
        seconds, first, asked = [], [], []
        ids = drawn(run, 10)
        for shape_id in ids:
            cage, latent = run.sequences[shape_id].cages[0], run.latent(shape_id, 0)
            live = LiveSurface(run.decoder, resolution, FIELDS["cage"])
            first.append(timed(live.surface, latent, cage)[0])
            for _ in range(edits // len(ids)):
                cage = edited(cage, rng)
                spent, found = timed(live.surface, latent, cage)
                seconds.append(spent)
                asked.append(found.asked)
        p50, p95 = np.percentile(seconds, [50, 95])
        row(resolution, len(seconds), *(f"{1000 * t:.0f}" for t in (p50, p95, max(seconds), np.median(first))),
            f"{np.median(asked):,.0f}")  # fmt: skip


def edited(cage: Cage, rng: np.random.Generator) -> Cage:
    """One cuboid moved, resized or turned a little."""
    k = rng.integers(len(cage))
    centre, size, axes = cage.centre.copy(), cage.size.copy(), cage.axes.copy()
    match rng.integers(3):
        case 0:
            centre[k] += rng.normal(size=3) * 0.03
        case 1:
            size[k] *= rng.uniform(0.85, 1.2, 3)
        case 2:
            angle, (i, j) = rng.uniform(-0.15, 0.15), rng.permutation(3)[:2]
            turn = np.eye(3)
            turn[[i, j], [i, j]], turn[i, j], turn[j, i] = np.cos(angle), -np.sin(angle), np.sin(angle)
            axes[k] = axes[k] @ turn
    return replace(cage, centre=centre, size=size, axes=axes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("methods").add_argument("--shapes", type=int, default=8)
    commands.add_parser("overlaps").add_argument("--shapes", type=int, default=8)
    commands.add_parser("latency").add_argument("--edits", type=int, default=200)
    of = commands.add_parser("memory", help="in a process of its own, whose peak is the answer")
    of.add_argument("category")
    of.add_argument("shape", type=int)
    given = vars(parser.parse_args())
    torch.set_num_threads(1)
    print(f"On {processor()}.\n")
    tables: dict[str, Callable[..., None]] = {
        "methods": methods,
        "overlaps": overlaps,
        "latency": latency,
        "memory": memory,
    }
    tables[given.pop("command")](**given)


if __name__ == "__main__":
    main()
