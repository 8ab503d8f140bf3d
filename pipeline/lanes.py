"""Bring the graph of dvc.yaml up to date, as many stages at once as there are cores.

    python -m pipeline.lanes

A stage begins when those it reads from are done. It is a `dvc repro` of its own, with one worker and one thread: work
of this size gains little from two, and while one starts, another computes. A stage that has nothing beside it gets all
cores. `dvc repro` does the same one after the other.
"""

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

from dvc.repo import Repo

from pipeline.executor import device, progress, workers
from pipeline.memory import memory
from pipeline.params import ParamsError, check

REPRO = ("--wait-for-lock", "repro", "--single-item")  # DVC's arguments, a stage's address after them
PARAMS = Path("params.yaml")
Graph = dict[str, set[str]]  # a stage's address, and those of the stages that it reads from


def main() -> int:
    """Returns 1 if a stage failed, after those that had begun.

    Raises ParamsError before any begins if there is a params.yaml and it is wrong: names in it become words of
    commands.
    """
    if PARAMS.is_file():
        check(PARAMS)
    todo = stale(*graph())
    done = progress(side_by_side(todo, lanes(), run), len(todo), "stages")
    failed = [address for address, succeeded in done if not succeeded]
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def graph() -> tuple[Graph, set[str]]:
    """All stages in dvc.yaml's order, and those of which DVC knows that they are not up to date."""
    with Repo() as repo:
        stages = {
            stage.addressing: {on.addressing for on in repo.index.graph.successors(stage)}
            for stage in repo.index.stages
        }
        return stages, set(repo.status())


def stale(stages: Graph, changed: set[str]) -> Graph:
    """What may have to run: the changed ones and all that follow from them."""
    found = set(changed)
    for address in TopologicalSorter(stages).static_order():
        if stages[address] & found:
            found.add(address)
    return {address: before & found for address, before in stages.items() if address in found}


def lanes() -> int:
    """How many run at once: one on a GPU, else as many as there are workers."""
    return workers() if device() == "cpu" else 1


def side_by_side(stages: Graph, count: int, call: Callable[[str, int, int], bool]) -> Iterator[tuple[str, bool]]:
    """Each stage and whether it succeeded, as they end; after a failure no other begins.

    `call(address, lane, lanes)` runs one of at most `count`; those that are ready begin in the order of `stages`.
    `lanes` is 1 for a stage that nothing can run beside.
    """
    sorter = TopologicalSorter(stages)
    sorter.prepare()
    ready: set[str] = set()
    free = set(range(count))
    running: dict[Future[bool], tuple[str, int]] = {}
    failed = False
    with ThreadPoolExecutor(count) as pool:
        while True:
            ready |= set(sorter.get_ready())
            begin = [] if failed else [address for address in stages if address in ready][: len(free)]
            shared = count if len(begin) + len(running) > 1 else 1
            for address in begin:
                lane = min(free)
                running[pool.submit(call, address, lane, shared)] = address, lane
                free.remove(lane)
            ready -= set(begin)
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                address, lane = running.pop(future)
                free.add(lane)
                if future.result():
                    sorter.done(address)
                else:
                    failed = True
                yield address, future.result()


def run(address: str, lane: int, count: int) -> bool:
    """`dvc repro` of one stage alone, with its share of the machine; whether it succeeded."""
    # The same memory whether alone or not: how training reads its points depends on it.
    share = {"CAGESDF_LANE": str(lane), "CAGESDF_MEMORY": str(memory() // lanes())}
    if count > 1:
        share |= {"OMP_NUM_THREADS": "1", "CAGESDF_WORKERS": "1"}
    process = _starter().Process(target=_repro, args=(address, share))
    process.start()
    process.join()
    return process.exitcode == 0


@cache
def _starter() -> Any:
    """What starts processes: where it can, one that has imported DVC and forks, which saves half of DVC's own time."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["__main__", "dvc.cli.parser", "dvc.commands.repro", "dvc.repo.reproduce"])
    return context


def _repro(address: str, share: Mapping[str, str]) -> None:
    """The process of one stage: DVC, which starts the stage's command."""
    from dvc.cli import main as dvc

    os.environ.update(share)
    sys.exit(dvc([*REPRO, address]))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except ParamsError as error:
        sys.exit(f"lanes: {error}")
