"""Calling a function of many items in other processes: this machine's, or a Dask cluster's.

Each item is called in a process that calls nothing else meanwhile, so that a process that dies tells which item
it died of. A watchdog ends a process that is busy with one item for too long: what hangs has died, too.
"""

import contextlib
import faulthandler
import hashlib
import os
import pickle
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import cloudpickle
from loky import FIRST_COMPLETED, ProcessPoolExecutor, wait
from loky.process_executor import TerminatedWorkerError

from pipeline.errors import WorkerError

ROOT = Path(__file__).parent.parent
# Each item has one thread: processes share the cores, and sums in another order would be other numbers.
ONE_THREAD = dict.fromkeys(
    ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "IGL_NUM_THREADS"], "1"
)
POLL = 0.1  # seconds between looks at the results
WORKER = 60  # seconds to wait for one: at first, and after the last has gone


class Died(Exception):
    """The process that called the function ended before it returned; the message has what is known."""


class Processes(Protocol):
    """Where items are called."""

    def outcomes(self, call: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Each item's number and its result, or Died, as they come. What `call` raises stops all."""


class ThisProcess:
    """No other process: for a debugger, for little memory, and for items that take no time."""

    def outcomes(self, call: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """As `Processes.outcomes`, but for Died: what kills a process kills this one."""
        os.environ["IGL_NUM_THREADS"] = "1"
        for number, item in enumerate(items):
            yield number, call(item)


class LocalProcesses:
    """Processes of this machine, which stay for later calls: a start takes as long as importing the library."""

    _idle: list[ProcessPoolExecutor] = []  # of one process each

    def __init__(self, count: int, seconds: float) -> None:
        self.count = count
        self.seconds = seconds

    def outcomes(self, call: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """As `Processes.outcomes`. The function is read from a file once by each process, whatever its size."""
        todo = deque(enumerate(items))
        running: dict[Any, tuple[int, ProcessPoolExecutor]] = {}
        with tempfile.TemporaryDirectory() as folder:
            stored = Path(folder) / "function"
            stored.write_bytes(cloudpickle.dumps(call))
            try:
                while todo or running:
                    while todo and len(running) < self.count:
                        number, item = todo.popleft()
                        executor = self._idle.pop() if self._idle else _one_process()
                        try:
                            future = executor.submit(_call_stored, stored, self.seconds, item)
                        except TerminatedWorkerError as error:  # it died when it had nothing to do
                            yield number, Died(str(error))
                        else:
                            running[future] = number, executor
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        number, executor = running[future]
                        try:
                            result: Any = future.result()
                        except TerminatedWorkerError as error:
                            result = Died(str(error))
                        else:
                            self._idle.append(executor)
                        del running[future]
                        yield number, result
            finally:
                for _, executor in running.values():
                    executor.shutdown(wait=False, kill_workers=True)


def _one_process() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(max_workers=1, timeout=300, env=ONE_THREAD)


class DaskProcesses:
    """The workers of the Dask scheduler at `address`, which see this folder under the same path.

    What a lost worker left undone is done elsewhere; an item has died when several workers did in turn, as the
    scheduler's `allowed-failures` says. Raises WorkerError where there is no cluster, or it runs other code.
    """

    def __init__(self, address: str, seconds: float) -> None:
        self.address = address
        self.seconds = seconds

    def outcomes(self, call: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """As `Processes.outcomes`; a result leaves the cluster once it is here."""
        try:
            from distributed import Client, KilledWorker
        except ImportError as error:
            raise WorkerError("CAGESDF_DASK is set, but Dask is not installed: pip install 'cagesdf[dask]'") from error
        try:
            client = Client(self.address, timeout=WORKER, set_as_default=False)
            client.wait_for_workers(1, timeout=WORKER)
        except (OSError, TimeoutError, ValueError) as error:
            raise WorkerError(
                f"CAGESDF_DASK={self.address}: no scheduler with a worker there ({error}); see docs/cluster.md"
            ) from error
        with client:
            # A task of its own, so that the function isn't sent with every item and comes back when a worker is lost.
            function = client.submit(_Function, cloudpickle.dumps(call), Path.cwd(), code_digest(), pure=False)
            futures = client.map(_call_function, items, function=function, seconds=self.seconds, pure=False)
            numbers = {future.key: number for number, future in enumerate(futures)}
            for future in self._done(client, futures):
                try:
                    result: Any = future.result()
                except KilledWorker as error:
                    result = Died(str(error))
                except CancelledError as error:
                    raise WorkerError(
                        f"CAGESDF_DASK={self.address}: lost the scheduler; run the stage again"
                    ) from error
                yield numbers[future.key], result

    def _done(self, client: Any, futures: list[Any]) -> Iterator[Any]:
        """The futures as they are done, each forgotten then. Dask alone would wait for ever for a first worker."""
        from distributed import as_completed

        waiting = as_completed(futures, loop=client.loop)
        futures.clear()
        seen = time.monotonic()
        while waiting.count():
            done = waiting.next_batch(block=False)
            yield from done
            if done or client.nthreads():
                seen = time.monotonic()
            elif time.monotonic() > seen + WORKER:
                raise WorkerError(
                    f"CAGESDF_DASK={self.address}: no worker for {WORKER} s; start workers, then run the stage again"
                )
            if not done:
                time.sleep(POLL)


class _Function:
    """The function on a Dask worker, which checks first that it would do there what it does here."""

    def __init__(self, stored: bytes, folder: Path, digest: str) -> None:
        self.stored = stored
        self.folder = folder
        self.digest = digest

    def __call__(self, item: Any) -> Any:
        # Only now: an exception here would be the item's, which is how one reaches the stage.
        if _first_digest() != self.digest:
            raise WorkerError("a Dask worker was started with other code than this stage's; restart the workers")
        if Path.cwd() != self.folder:
            if not self.folder.is_dir():
                raise WorkerError(f"{self.folder}: a Dask worker has no such folder; wanted a shared file system")
            os.chdir(self.folder)
        return _loaded(self.stored)(item)


def code_digest() -> str:
    """Digest of the Python files that workers run, as they are now."""
    total = hashlib.sha256()
    for package in ("cagesdf", "pipeline", "stages"):
        for path in sorted((ROOT / package).rglob("*.py")):
            total.update(f"{path.relative_to(ROOT).as_posix()}\0".encode() + path.read_bytes())
    return total.hexdigest()


@lru_cache(maxsize=1)
def _first_digest() -> str:
    """The digest when this process first needed it, which is when it imported the library."""
    return code_digest()


@lru_cache(maxsize=1)
def _loaded(stored: bytes | Path) -> Callable[[Any], Any]:
    return pickle.loads(stored if isinstance(stored, bytes) else stored.read_bytes())  # noqa: S301


def _call_stored(stored: Path, seconds: float, item: Any) -> Any:
    function = _loaded(stored)  # its imports don't count as the item's time
    with _watched(seconds):
        return function(item)


def _call_function(item: Any, function: _Function, seconds: float) -> Any:
    os.environ.update(ONE_THREAD)  # Dask's nanny sets all but libigl's, which reads its own when first used
    with _watched(seconds):
        return function(item)


@contextlib.contextmanager
def _watched(seconds: float) -> Iterator[None]:
    """End this process after `seconds`, having shown where it was.

    A thread in C does it, so that it also works where compiled code hangs and holds Python's lock.
    """
    faulthandler.dump_traceback_later(seconds, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
