"""Bring the graph of dvc.yaml up to date, one stage per core at a time.

    python -m pipeline.lanes

A stage begins when those it reads from are done, with one worker and one thread: work of this size gains little from
two, and while one starts, another computes. A stage that has nothing beside it gets all cores. `dvc repro` does the
same one after the other.

What decides whether a stage runs, and what is recorded of it, is DVC's. Two things are done at once here that it does
for every stage: stages run in forks of a process that has imported what they need, and dvc.lock is written at the end.
"""

import multiprocessing
import os
import runpy
import shlex
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from functools import partial
from graphlib import TopologicalSorter
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from dvc.exceptions import DvcException
from dvc.repo import Repo, lock_repo
from dvc.stage import PipelineStage
from dvc.stage import run as commands
from dvc.stage.exceptions import StageCmdFailedError
from dvc.stage.serialize import to_lockfile
from dvc.utils.serialize import modify_yaml

from pipeline.executor import device, progress, workers
from pipeline.memory import memory
from pipeline.params import ParamsError, check
from pipeline.processes import ONE_THREAD

PARAMS = Path("params.yaml")
LOCK = "dvc.lock"
FORKS = sys.platform == "linux"  # whether what has imported torch may fork: macOS's libraries don't promise it
LATER = "torch._dynamo"  # what torch imports when it makes an optimiser, for a second and a half
run_command = commands.cmd_run
Graph = dict[str, set[str]]  # a stage's address, and those of the stages that it reads from


def main() -> int:
    """Returns 1 if a stage failed, after those that had begun.

    Raises ParamsError before any begins if there is a params.yaml and it is wrong: names in it become words of
    commands.
    """
    if PARAMS.is_file():
        check(PARAMS)
    with Repo() as repo:
        stages = list(repo.index.stages)
        named = sorted({f"stages.{name}" for stage in stages for name in words_of(stage.cmd)[:1]})
        context = starter([*named, LATER] if FORKS and workers() > 1 else [])
        always = {stage.addressing for stage in stages if stage.always_changed}
        try:
            for address in sorted(always):  # they take a second, and decide on the others
                repo.reproduce(address, single_item=True)
        except DvcException as error:
            print(f"failed: {error}: {error.__cause__}", file=sys.stderr)
            return 1
        reads, changed = graph(repo)
        todo = stale(reads, changed - always)
    with lock_file() as entries:
        call = partial(run, context=context, entries=entries)
        done = progress(side_by_side(todo, lanes(), call), len(todo), "stages")
        failed = [address for address, succeeded in done if not succeeded]
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def graph(repo: Repo) -> tuple[Graph, set[str]]:
    """The stages that each stage reads from, by address, and those that are no longer what dvc.lock says."""
    successors = repo.index.graph.successors
    reads = {stage.addressing: {on.addressing for on in successors(stage)} for stage in repo.index.stages}
    return reads, set(repo.status())


def words_of(command: str) -> list[str]:
    """The name of the file in `stages/` that a command runs, and its arguments; nothing for other commands."""
    words = shlex.split(command)
    if words[:2] != ["python", "-m"] or not words[2].startswith("stages."):
        return []
    return [words[2].removeprefix("stages."), *words[3:]]


def starter(modules: Sequence[str]) -> Any:
    """A context that starts processes: where it can, forks of one that has imported DVC and `modules`, with one thread.

    That takes as long as ten stages are computed; it begins at once, beside what the caller does next.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["__main__", "dvc.repo.reproduce", *modules])
    environment = dict(os.environ)
    os.environ.update(ONE_THREAD)  # libraries read it when they are loaded
    forkserver.ensure_running()
    os.environ.clear()
    os.environ.update(environment)
    return context


def stale(stages: Graph, changed: set[str]) -> Graph:
    """The stages that may have to run: the changed ones and all that follow from them."""
    reached = set(changed)
    for address in TopologicalSorter(stages).static_order():
        if stages[address] & reached:
            reached.add(address)
    return {address: before & reached for address, before in stages.items() if address in reached}


def lanes() -> int:
    """Number of stages that run at once: one on a GPU, otherwise the number of workers."""
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


@contextmanager
def lock_file() -> Iterator[dict[str, Any]]:
    """Yield a mapping of the stages' entries, by name, which are in dvc.lock when the block ends, however it ends.

    Stages that dvc.yaml no longer has leave the file. DVC would read and write all of it after every stage, a second
    each time; what a killed process didn't write, the next one finds in DVC's run cache.
    """
    entries: dict[str, Any] = {}
    try:
        yield entries
    finally:
        if entries:
            with Repo(_wait_for_lock=True) as repo, lock_repo(repo), modify_yaml(LOCK, fs=repo.fs) as lock:
                names = {stage.name for stage in repo.index.stages}
                known = {**lock.get("stages", {}), **entries}
                lock.update(schema="2.0", stages={name: entry for name, entry in known.items() if name in names})


def run(address: str, lane: int, count: int, context: Any, entries: dict[str, Any]) -> bool:
    """One stage by DVC, with its share of the machine, and its entry of the lock file; whether it succeeded."""
    # The same memory whether alone or not: how training reads its points depends on it.
    share = {"CAGESDF_LANE": str(lane), "CAGESDF_MEMORY": str(memory() // lanes())}
    if count > 1:
        share |= ONE_THREAD | {"CAGESDF_WORKERS": "1"}
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(target=_repro, args=(address, {**os.environ, **share}, FORKS and count > 1, sending))
    process.start()
    sending.close()
    with suppress(EOFError):  # it was up to date, or failed
        entries.update(receiving.recv())
    process.join()
    return process.exitcode == 0


def _repro(address: str, environment: Mapping[str, str], beside: bool, sending: Connection) -> None:
    """The process of one stage. `beside` others it has one thread, and does without a new interpreter."""
    if beside:
        commands.cmd_run = _run_forked
    else:
        os.environ.clear()  # of what was set for one thread, and as stages were imported
    os.environ.update(environment)
    try:
        with Repo(_wait_for_lock=True) as repo:
            done = repo.reproduce(address, single_item=True, repro_fn=PipelineStage.reproduce)
            for stage in done:
                sending.send(to_lockfile(stage))
    except DvcException as error:
        sys.exit(f"lanes: {error}: {error.__cause__}")


def _run_forked(stage: PipelineStage, **_: Any) -> None:
    """DVC's way to run a stage's command: one of `stages/` in a fork of this process, anything else as DVC does."""
    words = words_of(stage.cmd)
    if not words:
        run_command(stage)
        return
    print(f"Running stage '{stage.addressing}':\n> {stage.cmd}", flush=True)
    process = multiprocessing.get_context("fork").Process(target=_run_stage, args=(words,))
    process.start()
    interrupt = signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is the stage's to end
    process.join()
    signal.signal(signal.SIGINT, interrupt)
    if process.exitcode:
        raise StageCmdFailedError(stage.cmd, process.exitcode)


def _run_stage(words: list[str]) -> None:
    """As `python -m stages.<name>` does."""
    sys.argv = words
    sys.modules.pop(f"stages.{words[0]}", None)  # it is imported, but runs as __main__
    runpy.run_module(f"stages.{words[0]}", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except ParamsError as error:
        sys.exit(f"lanes: {error}")
