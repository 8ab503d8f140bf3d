"""Speed and memory of sampling shapes, and the distances that it computes a point.

    python -m benchmarks.sampling

prints two Markdown tables, measured on one core, each row in a process of its own. Seconds are processor time. The
first table is of whole shapes, from part meshes to a written shard: repair, union, trees, samples, Parquet. The second
is of importance samples alone, by ours, by plain rejection and by the resampling of Davies et al. 2021 (ten uniform
candidates a point, drawn from with replacement by weight), all with the same distances; p is Kolmogorov and Smirnov's
of |sdf| against plain rejection.
"""

import argparse
import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.stats import ks_2samp

from benchmarks import child
from benchmarks.chair import chair
from cagesdf.cuboid import Cage
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import make_solid, union
from cagesdf.io.points import CHUNK, PointChunks, write_shard
from cagesdf.sampling.shapes import sample_near, sample_points
from cagesdf.training.precision import processor

BETA = 60.0
BATCH = 2**18  # candidates of the two slow ones at once
SIZES = [(39_000, 250_000, 25_000), (200_000, 250_000, 25_000), (39_000, 12_000, 2_000), (5_000, 12_000, 2_000)]
PER_CUBOID = 256
WELD, MIN_THICKNESS = 1e-5, 1e-4  # canonical units


class Counted(SurfaceDistance):
    """Counts the distances that it is asked."""

    asked = 0

    def closest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        self.asked += len(points)
        return super().closest(points)


def shard(parts: list[Mesh], cage: Cage, near: int, uniform: int, folder: Path) -> Counted:
    """Everything from part meshes to a file."""
    surface = Counted(union([make_solid(part, WELD, MIN_THICKNESS).mesh for part in parts]))
    samples = sample_points(surface, cage, near, uniform, PER_CUBOID, BETA, CHUNK, np.random.default_rng(0))
    fields = samples.part, samples.points, samples.sdf, samples.near
    numbers = np.zeros_like(samples.part), np.zeros_like(samples.part)
    chunks = PointChunks(*numbers, *fields, ("chair",), cage.part_ids)
    write_shard(folder / "shape-0000.parquet", [chunks], np.random.default_rng(0))
    return surface


def whole_shape(faces: int, near: int, uniform: int, repetitions: int) -> dict[str, float]:
    """Figures of one size of chair."""
    child.to_one_core()
    meshes, cage = chair(faces)
    parts = list(meshes.values())
    before = child.peak()
    surfaces: list[Counted] = []
    with tempfile.TemporaryDirectory() as folder:

        def work() -> None:
            surfaces[:] = [shard(parts, cage, near, uniform, Path(folder))]

        seconds = child.seconds(work, repetitions)
    points = near + uniform + PER_CUBOID * len(cage)
    return {
        "faces": sum(len(mesh.faces) for mesh in parts),
        "points": points,
        "seconds": seconds,
        "asked": surfaces[0].asked / points,
        "before": before,
        "memory": child.peak(),
    }


def by_octree(surface: SurfaceDistance, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return sample_near(surface, count, BETA, rng)


def by_rejection(surface: SurfaceDistance, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    points, sdf = np.zeros((0, 3)), np.zeros(0)
    while len(points) < count:
        drawn = rng.uniform(-HALF_EXTENT, HALF_EXTENT, (BATCH, 3))
        closest = surface.closest(drawn)
        kept = rng.random(BATCH) < np.exp(-BETA * closest[0])
        behind = surface.behind(drawn[kept], *(column[kept] for column in closest))
        points = np.concatenate([points, drawn[kept]])
        sdf = np.concatenate([sdf, np.where(behind, -1, 1) * closest[0][kept]])
    return points[:count], sdf[:count]


def by_resampling(surface: SurfaceDistance, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    points = rng.uniform(-HALF_EXTENT, HALF_EXTENT, (10 * count, 3))
    sdf = np.concatenate([surface.signed(points[start : start + BATCH]) for start in range(0, len(points), BATCH)])
    weights = np.exp(-BETA * np.abs(sdf))
    drawn = rng.choice(len(points), count, p=weights / weights.sum())
    return points[drawn], sdf[drawn]


Sampler = Callable[[SurfaceDistance, int, np.random.Generator], tuple[np.ndarray, np.ndarray]]
SAMPLERS: dict[str, tuple[str, Sampler]] = {
    "octree": ("ours", by_octree),
    "resampling": ("Davies et al.", by_resampling),
    "rejection": ("plain rejection", by_rejection),
}


def importance(name: str, count: int, repetitions: int, reference: Path) -> dict[str, float]:
    """Figures of one sampler; plain rejection's |sdf| goes to the file that the others' are compared with."""
    child.to_one_core()
    surface = Counted(union(list(chair(SIZES[0][0])[0].values())))
    surface.signed(np.zeros((1, 3)))
    drawn: list[tuple[np.ndarray, np.ndarray]] = []

    def work() -> None:
        surface.asked = 0
        drawn[:] = [SAMPLERS[name][1](surface, count, np.random.default_rng(len(name)))]

    seconds = child.seconds(work, repetitions)
    points, sdf = drawn[0]
    if name == "rejection":
        np.save(reference, np.abs(sdf))
    return {
        "seconds": seconds,
        "asked": surface.asked / count,
        "distinct": len(np.unique(points, axis=0)) / count,
        "p": float(ks_2samp(np.abs(sdf), np.load(reference)).pvalue),
        "memory": child.peak(),
    }


def whole_row(figures: dict[str, float] | str) -> str:
    """A line of the first table."""
    if isinstance(figures, str):
        return f"| {figures} | | | | | | |"
    rate = figures["points"] / figures["seconds"]
    return (
        f"| {figures['faces']:,} | {figures['points']:,} | {figures['seconds']:.2f} | {rate:,.0f} "
        f"| {figures['asked']:.2f} | {figures['before']:.0f} | {figures['memory']:.0f} |"
    )


def importance_row(name: str, count: int, figures: dict[str, float] | str) -> str:
    """A line of the second table."""
    start = f"| {SAMPLERS[name][0]} | "
    if isinstance(figures, str):
        return f"{start}{figures} | | | | | |"
    p = "–" if name == "rejection" else f"{figures['p']:.2g}"
    return (
        f"{start}{figures['seconds']:.2f} | {count / figures['seconds']:,.0f} | {figures['asked']:.2f} "
        f"| {figures['distinct']:.1%} | {p} | {figures['memory']:.0f} |"
    )


def tables(count: int, repetitions: int) -> str:
    """Both tables."""
    options = "--repetitions", repetitions
    whole = [whole_row(child.ask(__file__, *options, "--shape", *size)) for size in SIZES]
    alone = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("rejection", "resampling", "octree"):
            figures = child.ask(__file__, *options, "--sampler", name, count, Path(folder) / "sdf.npy")
            alone.append(importance_row(name, count, figures))
    first = "| faces | points | seconds | points/s | distances a point | peak MB before | peak MB |"
    second = f"| {count:,} points by | seconds | points/s | distances a point | distinct | p | peak MB |"
    return child.table(first, whole) + "\n\n" + child.table(second, alone)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--near", type=int, default=250_000, help="importance samples of the second table")
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--shape", nargs=3, type=int, help=argparse.SUPPRESS)
    parser.add_argument("--sampler", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.shape:
        faces, near, uniform = args.shape
        print(json.dumps(whole_shape(faces, near, uniform, args.repetitions)))
    elif args.sampler:
        name, count, reference = args.sampler
        print(json.dumps(importance(name, int(count), args.repetitions, Path(reference))))
    else:
        print(f"On {processor()}.\n")
        print(tables(args.near, args.repetitions))


if __name__ == "__main__":
    main()
