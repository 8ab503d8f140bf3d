"""Run the instances of a stage side by side, one a core: a training of this size gains little from two.

    python -m pipeline.lanes train extract_meshes

brings these stages of dvc.yaml up to date, one after the other, and first what they depend on. Each instance
is a `dvc repro` of its own, with one thread; `dvc repro` afterwards does the rest of the graph.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue

from dvc.repo import Repo

from pipeline.executor import device, progress, workers
from pipeline.memory import memory

REPRO = [sys.executable, "-m", "dvc", "--wait-for-lock", "repro"]


def main(names: list[str]) -> int:
    """Bring the stages of these names up to date; returns 1 if one failed, after those that had begun."""
    before, instances = graph(names)
    if not changed([*before, *(address for some in instances.values() for address in some)]):
        return 0
    if before and subprocess.run([*REPRO, *before], check=False).returncode:
        return 1
    for name, addresses in instances.items():
        failed = side_by_side(changed(addresses), lanes(), run, name)
        if failed:
            print(f"failed: {', '.join(failed)}", file=sys.stderr)
            return 1
    return 0


def graph(names: list[str]) -> tuple[list[str], dict[str, list[str]]]:
    """What the stages of these names depend on, but for one another, and each one's instances.

    Raises ValueError for a name that dvc.yaml doesn't have.
    """
    with Repo() as repo:
        stages = {
            name: [stage for stage in repo.index.stages if stage.addressing.split("@")[0] == name] for name in names
        }
        own = [stage for some in stages.values() for stage in some]
        before = {on.addressing for stage in own for on in repo.index.graph.successors(stage) if on not in own}
    for name, some in stages.items():
        if not some:
            raise ValueError(f"dvc.yaml has no stage {name!r}")
    return sorted(before), {name: [stage.addressing for stage in some] for name, some in stages.items()}


def changed(addresses: list[str]) -> list[str]:
    """Those that are not up to date, in their order."""
    with Repo() as repo:
        found = repo.status()  # of all: with targets, DVC reads its files once for each
    return [address for address in addresses if address in found]


def lanes() -> int:
    """How many run at once: one on a GPU, else as many as there are workers."""
    return workers() if device() == "cpu" else 1


def side_by_side(addresses: list[str], count: int, call: Callable[[str, int, int], bool], label: str) -> list[str]:
    """`call(address, lane, count)` of each, `count` at once; those that failed, after which no other begins."""
    free: SimpleQueue[int] = SimpleQueue()
    for lane in range(count):
        free.put(lane)
    failed: list[str] = []

    def one(address: str) -> None:
        lane = free.get()
        if not failed and not call(address, lane, count):
            failed.append(address)
        free.put(lane)

    with ThreadPoolExecutor(count) as pool:
        for _ in progress(pool.map(one, addresses), len(addresses), label):
            pass
    return failed


def run(address: str, lane: int, count: int) -> bool:
    """`dvc repro` of one stage alone, with its share of the machine; whether it succeeded."""
    share = {"CAGESDF_MEMORY": str(memory() // count)}
    if count > 1:
        share |= {"OMP_NUM_THREADS": "1", "CAGESDF_WORKERS": "1", "CAGESDF_LANE": str(lane)}
    command = [*REPRO, "--single-item", address]
    return subprocess.run(command, env=os.environ | share, check=False).returncode == 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
