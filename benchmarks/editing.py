"""Latency from an edit to its surface, as in an editor: operation by operation.

    python -m benchmarks.editing data/runs/chair/cagesdf data/runs/table/cagesdf data/runs/vase/cagesdf [--edits 200]

draws edits of every kind from all runs, ten of each shape after the other, asks cuboids in `--threads` threads, and
prints a Markdown table: milliseconds from the operation to the surface on the clock, and of processor time, which
counts all threads but not what others do on the machine. All checks are included, the first surface of each shape is
not. One cuboid: moved, resized or turned, with what is linked to it. A style: a swap or a blend, all cuboids anew. A
parameter moves as many cuboids as it does. The same edits at the preview's size and at 256 cells.
"""

import argparse
import os
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from cagesdf.editing.operations import apply
from cagesdf.editing.parts import parameters
from cagesdf.editing.script import Blend, Move, Operation, Resize, Rotate, Set, Swap
from cagesdf.editing.session import Session
from cagesdf.editing.state import History, State
from cagesdf.errors import InputError
from cagesdf.extraction import PREVIEW, USUAL
from cagesdf.geometry.meshes import is_closed
from cagesdf.io.runs import read_run
from cagesdf.training.precision import processor
from cagesdf.viewing.worker import PREVIEW_CELLS

EDITS = 10  # of each shape
KINDS = {
    "one cuboid": ("move", "resize", "rotate"),
    "a style": ("swap", "blend"),
    "a parameter": ("set",),
}
AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
OPERATIONS = ("set", "move", "resize", "rotate", "swap", "blend")  # the first, of shapes that have programs
SIZES = ((PREVIEW_CELLS, PREVIEW), (256, USUAL))


def draw(session: Session, state: State, rng: np.random.Generator) -> Operation:
    """An edit as people make them: a tenth of the shape's size, a third of a length, 20 degrees; or another style."""
    part = str(rng.choice(state.cage.part_ids))
    axis = AXES[rng.integers(3)]
    style = str(rng.choice([*session.styles.shapes]))
    placed = state.structure.placed_program()
    match OPERATIONS[rng.integers(placed is None, len(OPERATIONS))]:
        case "move":
            x, y, z = (rng.uniform(-0.1, 0.1, 3) / state.similarity.scale).tolist()
            return Move(part=part, by=(x, y, z))
        case "resize":
            return Resize(part=part, axis=axis, factor=float(rng.uniform(0.7, 1.4)))
        case "rotate":
            return Rotate(part=part, axis=axis, angle=float(rng.uniform(-20, 20)))
        case "set":
            assert placed is not None
            values = parameters(placed[0])
            name = str(rng.choice([name for name, value in values.items() if value > 0]))
            return Set(parameter=name, value=values[name] * float(rng.uniform(0.85, 1.15)))
        case "swap":
            return Swap(style_of=style)
    return Blend(style_of=style, weight=0.5)


def scripts(session: Session, count: int, seed: int) -> list[tuple[str, list[Operation]]]:
    """Shapes, and edits that can be done to them."""
    rng = np.random.default_rng(seed)
    result = []
    for shape_id in rng.permutation([*session.styles.shapes])[: -(-count // EDITS)].tolist():
        history, done = History.of(session.opened(shape_id)), list[Operation]()
        while len(done) < EDITS:
            operation = draw(session, history.present, rng)
            try:
                history = apply(history, operation, session.styles)
            except InputError:
                continue
            done.append(operation)
        result.append((shape_id, done))
    return result


def main(runs: list[Path], threads: int, edits: int, seed: int) -> None:
    torch.set_num_threads(1)  # a cuboid a thread: torch's own would wait for each other
    pool = ThreadPoolExecutor(threads)
    todo = []
    for run in runs:
        session = Session(read_run(run))
        todo += [(session, *script) for script in scripts(session, -(-edits // len(runs)), seed)]
    print(f"On {processor()}, {threads} for cuboids; load {os.getloadavg()[0]:.1f}.\n")
    print("| cells | edit | edits | ms p50 | p95 | largest | processor ms p50 | p95 | evaluations p50 |")
    print("|---|---|---|---|---|---|---|---|---|")
    for resolution, fineness in SIZES:
        times: dict[str, list[tuple[float, float, int]]] = defaultdict(list)
        for session, shape_id, operations in todo:
            history = History.of(session.opened(shape_id))
            live = session.live(resolution, fineness=fineness)
            live.surface(history.present, pool.map)
            for operation in operations:
                wall, begun = time.perf_counter(), time.process_time()
                history = apply(history, operation, session.styles)
                surface = live.surface(history.present, pool.map)
                took = time.perf_counter() - wall, time.process_time() - begun, surface.evaluations
                assert is_closed(surface.mesh), (shape_id, operation)
                times[operation.op].append(took)
        for kind, names in KINDS.items():
            walls, processors, evaluations = np.array([took for name in names for took in times[name]]).T
            cells = [
                *(f"{1000 * np.quantile(walls, q):.0f}" for q in (0.5, 0.95, 1)),
                *(f"{1000 * np.quantile(processors, q):.0f}" for q in (0.5, 0.95)),
                f"{np.median(evaluations):,.0f}",
            ]
            print(f"| {resolution} | {kind} | {len(walls)} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="trained runs whose shapes have programs")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--edits", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    main(arguments.runs, arguments.threads, arguments.edits, arguments.seed)
