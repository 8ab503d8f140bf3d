"""Speed and quality of fitting programs, beside the paper's appendix to the letter.

    python -m benchmarks.fit_programs --programs FOLDER --shapes 100 --adam 12

takes programs (*.txt) of a folder, by default those of `make repro`, and makes parts for them: each leaf's
cuboid is scaled and moved by some per cent, and a rounded body put into it that touches its six faces. It
prints a Markdown table. One process; the appendix's Adam is the slow, obvious one of the tests, which
executes and differentiates programs by the same code as ours.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cagesdf.cage_fitting.programs import bound_program, fit_program, fitting_loss, match_axes
from cagesdf.cuboid import Cage
from cagesdf.errors import ProgramError
from cagesdf.structure.executor import execute
from cagesdf.structure.parsing import read_program
from cagesdf.structure.program import AssemblyProgram
from cagesdf.training.precision import processor
from tests.support.adam import fit_by_adam

TOLERANCE = 1e-4  # of the points that count as outside, the program's unit
ROUND = 8  # exponent of the superellipsoids that the parts are


@dataclass(frozen=True)
class Result:
    """One program's figures."""

    leaves: int
    parameters: int
    seconds: float  # of fitting
    growing: float  # seconds, of bounding
    loss_before: float
    loss: float
    before: float  # share of points outside their cuboid
    fitted: float
    after: float
    unbounded: int  # parts with more than half a per cent outside
    volume: float  # mean of the cuboids' over the boxes'
    adam_seconds: float  # NaN where the reference wasn't run
    adam_last: float  # loss where the reference ends
    adam_best: float  # the lowest that it passed through


def parts_of(cage: Cage, points: int, noise: float, rng: np.random.Generator) -> tuple[Cage, np.ndarray]:
    """Boxes near the leaves' cuboids, and points on the rounded parts in them."""
    size = cage.size * np.exp(noise * rng.normal(size=cage.size.shape))
    boxes = Cage(cage.part_ids, cage.centre + noise * rng.normal(size=size.shape) * size / 2, cage.axes, size)
    surface = rng.uniform(-1, 1, (len(cage), points, 3))
    face = rng.integers(0, 3, (len(cage), points, 1))
    np.put_along_axis(surface, face, rng.choice([-1.0, 1.0], face.shape), axis=2)
    surface /= (np.abs(surface) ** ROUND).sum(axis=2, keepdims=True) ** (1 / ROUND)
    surface[:, :6] = np.concatenate([np.eye(3), -np.eye(3)])
    return boxes, np.array([boxes.from_unit(body / 2, i) for i, body in enumerate(surface)])


def outside(cage: Cage, points: np.ndarray) -> np.ndarray:
    """Share of each part's points outside its cuboid."""
    each = (Cage.of({"": cuboid}).signed_distance(surface) for cuboid, surface in zip(cage.cuboids().values(), points))
    return np.array([(distance > TOLERANCE).mean() for distance in each])


def measured(program: AssemblyProgram, args: argparse.Namespace, rng: np.random.Generator, adam: bool) -> Result:
    """Fit one program, grow it, and run the reference."""
    given = execute(program)
    boxes, points = parts_of(given, args.points, args.noise, rng)
    targets = match_axes(boxes, given)
    start = time.perf_counter()
    fitted = fit_program(program, targets, points)
    fitting = time.perf_counter()
    grown = bound_program(fitted, targets, list(points))
    growing = time.perf_counter()
    losses = [np.nan]
    if adam:
        _, losses = fit_by_adam(program, targets, points)
    last = time.perf_counter()
    left = outside(execute(grown), points)
    return Result(
        len(given),
        len(program.parameters()),
        fitting - start,
        growing - fitting,
        fitting_loss(given, targets, points),
        fitting_loss(execute(fitted), targets, points),
        outside(given, points).mean(),
        outside(execute(fitted), points).mean(),
        left.mean(),
        int((left > 0.005).sum()),
        float((execute(grown).size.prod(axis=1) / targets.size.prod(axis=1)).mean()),
        last - growing if adam else np.nan,
        losses[-1],
        min(losses),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--programs", type=Path, default=Path("data/raw/chair/chair_programs"))
    parser.add_argument("--shapes", type=int, default=100)
    parser.add_argument("--adam", type=int, default=12, help="shapes that the reference fits, too: half a minute each")
    parser.add_argument("--points", type=int, default=10_000, help="on each part")
    parser.add_argument("--noise", type=float, default=0.05, help="parts' sizes and places differ by, relatively")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    paths = sorted(args.programs.glob("*.txt"))
    if not paths:
        parser.error(f"{args.programs}: no *.txt there")
    order = np.random.default_rng(args.seed).permutation(len(paths))[: args.shapes]
    results: list[Result] = []
    for number, i in enumerate(order):
        try:
            rng = np.random.default_rng([args.seed, int(i)])
            results.append(measured(read_program(paths[i]), args, rng, number < args.adam))
        except ProgramError as error:
            print(f"left out: {error}", file=sys.stderr)
        print(f"\r{number + 1}/{len(order)}", end="", file=sys.stderr, flush=True)
    print(f"On {processor()}.\n")
    print(file=sys.stderr)
    print(table(results))


def table(results: list[Result]) -> str:
    """The figures of all programs, as Markdown."""
    column = {name: np.array([getattr(result, name) for result in results]) for name in Result.__annotations__}
    ran = ~np.isnan(column["adam_seconds"])
    seconds, adam = column["seconds"], column["adam_seconds"][ran]
    rows = {
        "programs; leaves, parameters (median)": f"{len(results)}; {np.median(column['leaves']):g}, "
        f"{np.median(column['parameters']):g}",
        "fitting, s a shape": spread(seconds),
        "growing, s a shape": spread(column["growing"]),
        "loss as given, fitted (mean)": f"{column['loss_before'].mean():.4f}, {column['loss'].mean():.4f}",
        "points outside as given, fitted, grown (mean over parts)": f"{shares(column)}",
        "parts over 0.5 % outside after growing": f"{column['unbounded'].sum()} of {column['leaves'].sum()}",
        "volume over the minimum-volume box's, grown": spread(column["volume"]),
    }
    if ran.any():
        rows |= {
            f"Adam ({ran.sum()} of these programs), s a shape": spread(adam),
            "Adam's seconds over ours": spread(adam / seconds[ran]),
            "our loss over Adam's last": spread(column["loss"][ran] / column["adam_last"][ran]),
            "our loss over Adam's lowest": spread(column["loss"][ran] / column["adam_best"][ran]),
        }
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows.items())])


def shares(column: dict[str, np.ndarray]) -> str:
    """Means weighted by parts."""
    return ", ".join(
        f"{np.average(column[name], weights=column['leaves']):.3%}" for name in ("before", "fitted", "after")
    )


def spread(values: np.ndarray) -> str:
    """Median, ninth decile and largest."""
    return f"median {np.median(values):.3g}, p90 {np.quantile(values, 0.9):.3g}, largest {values.max():.3g}"


if __name__ == "__main__":
    main()
