"""How long an edit takes until its surface is there, as an editor makes it: operation by operation.

    python benchmarks/editing.py data/runs/chair/cagesdf [--threads 2] [--edits 200] [--resolutions 96 256]

draws edits of every kind, ten of each shape after the other, asks cuboids in `--threads` threads, and prints a Markdown
table: seconds from the operation to the surface on the wall, and of processor time, which counts all threads but not
what others do on the machine. The first surface of each shape is not counted. The same edits at every resolution.
"""

import argparse
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch

from cagesdf.editing.operations import apply
from cagesdf.editing.parts import parameters
from cagesdf.editing.script import Blend, Move, Operation, Resize, Rotate, Set, Swap
from cagesdf.editing.session import Session
from cagesdf.editing.state import History, State
from cagesdf.errors import InputError
from cagesdf.io.runs import read_run
from cagesdf.meshes import is_closed
from cagesdf.training.precision import processor

EDITS = 10  # of each shape
KINDS = ("move", "resize", "rotate", "set", "swap", "blend")


def draw(session: Session, state: State, rng: np.random.Generator) -> Operation:
    """An edit as people make them: a tenth of the shape's size, a third of a length, 20 degrees; or another style."""
    part = str(rng.choice(state.cage.part_ids))
    axis = "xyz"[rng.integers(3)]
    style = str(rng.choice([*session.styles.shapes]))
    match KINDS[rng.integers(len(KINDS))]:
        case "move":
            x, y, z = (rng.uniform(-0.1, 0.1, 3) / state.similarity.scale).tolist()
            return Move(part=part, by=(x, y, z))
        case "resize":
            return Resize(part=part, axis=axis, factor=float(rng.uniform(0.7, 1.4)))
        case "rotate":
            return Rotate(part=part, axis=axis, angle=float(rng.uniform(-20, 20)))
        case "set":
            placed = state.structure.placed_program()
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
    found = []
    for shape_id in rng.permutation([*session.styles.shapes])[: -(-count // EDITS)].tolist():
        history, done = History.of(session.opened(shape_id)), list[Operation]()
        while len(done) < EDITS:
            operation = draw(session, history.present, rng)
            try:
                history = apply(history, operation, session.styles)
            except InputError:
                continue
            done.append(operation)
        found.append((shape_id, done))
    return found


def main(run: Path, threads: int, edits: int, resolutions: list[int], seed: int) -> None:
    torch.set_num_threads(1)  # a cuboid a thread: torch's own would wait for each other
    pool = ThreadPoolExecutor(threads)
    session = Session(read_run(run))
    todo = scripts(session, edits, seed)
    print(f"On {processor()}.\n")
    print("| cells | edits | | wall p50 | p95 | largest | processor p50 | p95 | asked p50 | first p50 |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for resolution in resolutions:
        times: dict[str, list[tuple[float, float, int]]] = defaultdict(list)
        first = []
        for shape_id, operations in todo:
            history = History.of(session.opened(shape_id))
            live = session.live(resolution, each=pool.map)
            start = time.perf_counter()
            live.surface(history.present)
            first.append(time.perf_counter() - start)
            for operation in operations:
                wall, begun = time.perf_counter(), time.process_time()
                history = apply(history, operation, session.styles)
                found = live.surface(history.present)
                took = time.perf_counter() - wall, time.process_time() - begun, found.asked
                assert is_closed(found.mesh), (shape_id, operation)
                times[operation.op].append(took)
                times["all"].append(took)
        for kind in ("all", *KINDS):
            walls, processors, asked = np.array(times[kind]).T
            cells = [
                *(f"{np.quantile(walls, q):.3f}" for q in (0.5, 0.95, 1)),
                *(f"{np.quantile(processors, q):.3f}" for q in (0.5, 0.95)),
                f"{np.median(asked):,.0f}",
                f"{np.median(first):.3f}" if kind == "all" else "",
            ]
            print(f"| {resolution} | {len(walls)} | {kind} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="a trained run whose shapes have programs")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--edits", type=int, default=200)
    parser.add_argument("--resolutions", type=int, nargs="+", default=[96, 256])
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    main(arguments.run, arguments.threads, arguments.edits, arguments.resolutions, arguments.seed)
