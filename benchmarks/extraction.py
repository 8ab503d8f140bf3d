"""Cost and accuracy of extraction: the tables of docs/extraction.md.

    OMP_NUM_THREADS=1 python -m benchmarks.extraction methods [--shapes 8]
    OMP_NUM_THREADS=1 python -m benchmarks.extraction memory chair 0
    OMP_NUM_THREADS=1 python -m benchmarks.extraction fineness [--shapes 4]
    OMP_NUM_THREADS=1 python -m benchmarks.extraction latency [--edits 200]

reads the run of the arm `--arm`, cagesdf if it isn't given, in `--runs`, data/runs if it isn't. Seconds are of one
thread's processor time; in `latency`, which edits cuboids alone, they pass on the clock, and manifold3d takes the
threads that it finds.
"""

import argparse
import resource
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cagesdf.cuboid import Cage
from cagesdf.extraction import METHODS, PREVIEW, USUAL, CageField, Fineness, LiveSurface, extract, field_of, marching
from cagesdf.extraction.part import part_of
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, face_normals, sample_surface
from cagesdf.io.runs import read_run
from cagesdf.run import Run
from cagesdf.training.precision import processor

CATEGORIES = ("chair", "table", "vase")
SAMPLES = 20_000  # points on a surface


def timed(work: Callable[..., Any], *given: Any, clock: Callable[[], float] = time.process_time) -> tuple[float, Any]:
    start = clock()
    result = work(*given)
    return clock() - start, result


def drawn(run: Run, count: int) -> list[str]:
    ids = list(run.sequences)
    return ids[:: max(1, len(ids) // count)][:count]


def row(*cells: object) -> None:
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def rest_field(run: Run, shape_id: str) -> CageField:
    return field_of(run.decoder, run.latent(shape_id, 0), run.sequences[shape_id].cages[0])


def methods(runs: list[Path], shapes: int) -> None:
    row("run", "cells", "shapes, equal", "on lattices", "evaluated", "share", "dense s", "sparse s", "faces", "clipped",
        "largest overshoot")  # fmt: skip
    row(*["---"] * 11)
    for path in runs:
        run = read_run(path)
        for resolution in (128, 256):
            ids = drawn(run, shapes)
            figures = np.array([compared(rest_field(run, shape_id), resolution) for shape_id in ids])
            points, evaluations, slow, fast, faces, clipped = figures[:, :6].mean(axis=0)
            row(path.parent.name, resolution, f"{len(ids)}, {int(figures[:, 6].sum())}", f"{points:,.0f}",
                f"{evaluations:,.0f}", f"{evaluations / points:.2f}", f"{slow:.2f}", f"{fast:.2f}", f"{faces:,.0f}",
                f"{clipped:.3f}", f"{figures[:, 7].max():.1g}")  # fmt: skip


def compared(field: CageField, resolution: int) -> tuple[float, ...]:
    """Figures of one shape: points evaluated densely and sparsely, seconds of both, faces, the share that the cage cut
    off, whether the surfaces are equal bit for bit, and how far they leave the cage."""
    slow, dense = timed(lambda: extract(field, resolution, METHODS["dense"]))
    fast, sparse = timed(lambda: extract(field, resolution))
    equal = np.array_equal(dense.mesh.vertices, sparse.mesh.vertices)
    counts = dense.evaluations, sparse.evaluations, slow, fast, len(sparse.mesh.faces)
    return (*counts, sparse.clipped, equal, sparse.overshoot)


def memory(run: Path, shape: int) -> None:
    trained = read_run(run)
    shape_id = list(trained.sequences)[shape]
    seconds, extraction = timed(extract, rest_field(trained, shape_id), 512)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    faces = len(extraction.mesh.faces)
    row(shape_id, f"{peak:.0f} MB", f"{seconds:.1f} s", f"{extraction.evaluations:,}", f"{faces:,}")


def fineness(runs: list[Path], shapes: int) -> None:
    """Parts against themselves on a lattice of 512 cells, 48 at least: what cells, the step to the zero set and fewer
    faces do."""
    row("run", "cells, least", "drawn, sag, even", "normals", "distance (1e-4)", "faces a part", "ms a part")
    row(*["---"] * 7)
    usual = marching.FARTHEST
    for path in runs:
        run = read_run(path)
        fields = [rest_field(run, shape_id) for shape_id in drawn(run, shapes)]
        items = [(field, k) for field in fields for k in range(0, len(field.cage), 3)]
        finest = [
            part_of(field, k, cell_of(512), Fineness(48, 1.0, 0.0, 0.0), METHODS["sparse"]).mesh for field, k in items
        ]
        for resolution, fineness in ((64, PREVIEW), (128, USUAL), (256, USUAL)):
            none, fine, coarse = (0.0, 0.0), (USUAL.sag, USUAL.even), (PREVIEW.sag, PREVIEW.even)
            for farthest, reduced in ((0.0, none), (usual, none), (usual, fine), (usual, coarse)):
                marching.FARTHEST, each = farthest, Fineness(fineness.least, fineness.finer, *reduced)
                start = time.process_time()
                parts = [part_of(*item, cell_of(resolution), each, METHODS["sparse"]) for item in items]
                seconds = time.process_time() - start
                pairs = [(p.mesh, truth) for p, truth in zip(parts, finest) if len(truth.faces) and len(p.mesh.faces)]
                normals, distance = np.mean([agreement(*pair) for pair in pairs], axis=0)
                faces = np.mean([len(part.mesh.faces) for part in parts])
                row(path.parent.name, f"{resolution}, {each.least}", f"{farthest:g}, {each.sag:g}, {each.even:g}",
                    f"{normals:.4f}", f"{1e4 * distance:.2f}", f"{faces:,.0f}",
                    f"{1000 * seconds / len(items):.0f}")  # fmt: skip
        marching.FARTHEST = usual


def cell_of(resolution: int) -> float:
    return 2 * HALF_EXTENT / resolution


def agreement(one: Mesh, other: Mesh) -> np.ndarray:
    """Signed normal consistency and mean distance, both ways."""
    directions, rng = [], np.random.default_rng(0)
    for a, b in ((one, other), (other, one)):
        points, faces = sample_surface(a, SAMPLES, rng)
        away, nearest, _ = SurfaceDistance(b).closest(points)
        normals_a, normals_b = (face_normals(mesh)[indices] for mesh, indices in ((a, faces), (b, nearest)))
        lengths = np.linalg.norm(normals_a, axis=1) * np.linalg.norm(normals_b, axis=1)
        directions.append(((normals_a * normals_b).sum(axis=1) / lengths, away))
    return np.mean(directions, axis=(0, 2))


def latency(runs: list[Path], edits: int) -> None:
    row("run", "cells, least, even", "edits", "p50 ms", "p95 ms", "largest ms", "the first surface ms", "evaluated")
    row(*["---"] * 8)
    for path in runs:
        run = read_run(path)
        for resolution, fineness in ((64, PREVIEW), (128, USUAL), (256, USUAL)):
            rng = np.random.default_rng(0)
            seconds, first, evaluations = [], [], []
            ids = drawn(run, 10)
            for shape_id in ids:
                field = rest_field(run, shape_id)
                live = LiveSurface(resolution, fineness=fineness)
                first.append(timed(live.surface, field, clock=time.perf_counter)[0])
                cage = field.cage
                for _ in range(edits // len(ids)):
                    cage = edited(cage, rng)
                    # Parts keep their codes, as in an editor.
                    given = CageField(run.decoder, field.codes, cage)
                    spent, extraction = timed(live.surface, given, clock=time.perf_counter)
                    seconds.append(spent)
                    evaluations.append(extraction.evaluations)
            p50, p95 = np.percentile(seconds, [50, 95])
            row(path.parent.name, f"{resolution}, {fineness.least}, {fineness.even:g}", len(seconds),
                *(f"{1000 * t:.0f}" for t in (p50, p95, max(seconds), np.median(first))),
                f"{np.median(evaluations):,.0f}")  # fmt: skip


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
    parser.add_argument("--runs", type=Path, default=Path("data/runs"))
    parser.add_argument("--arm", default="cagesdf")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("methods").add_argument("--shapes", type=int, default=8)
    commands.add_parser("fineness").add_argument("--shapes", type=int, default=4)
    commands.add_parser("latency").add_argument("--edits", type=int, default=200)
    of = commands.add_parser("memory", help="in a process of its own, whose peak is the answer")
    of.add_argument("category")
    of.add_argument("shape", type=int)
    given = parser.parse_args()
    torch.set_num_threads(1)
    print(f"On {processor()}.\n")
    runs = [path for category in CATEGORIES if (path := given.runs / category / given.arm).is_dir()]
    match given.command:
        case "methods":
            methods(runs, given.shapes)
        case "fineness":
            fineness(runs, given.shapes)
        case "latency":
            latency(runs, given.edits)
        case "memory":
            memory(given.runs / given.category / given.arm, given.shape)


if __name__ == "__main__":
    main()
