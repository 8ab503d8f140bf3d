"""Long work of a tab: in the background, one job at a time, with progress, and cancelled at once."""

import ctypes
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from cagesdf.errors import InputError
from cagesdf.extraction import Part
from cagesdf.viewing.refusals import saying


class Cancelled(BaseException):
    """The work is no longer wanted. Handlers of errors, those of libraries too, let it pass."""


@dataclass(frozen=True)
class Stand:
    """Progress of a job."""

    job: str
    what: str  # the step that is running
    done: float  # from 0 to 1

    def __str__(self) -> str:
        return f"{self.job}: {self.what}" + (f" ({self.done:.0%})" if self.done else "")


class Progress:
    """Handle that a job's work holds: it reports progress, and through it the work is broken off."""

    def __init__(self, job: str, show: Callable[[Stand], None]) -> None:
        self._job, self._show = job, show
        self._cancelled = threading.Event()
        self._lock = threading.Lock()  # held while something is shown: showing is never broken off
        self._thread: int | None = None  # inside `breakable`

    def __call__(self, what: str, done: float = 0.0) -> None:
        """Show the running step and the share of the job that is done. Raises Cancelled once the job is cancelled."""
        with self._lock:
            if self._cancelled.is_set():
                raise Cancelled
            self._show(Stand(self._job, what, done))

    @contextmanager
    def breakable(self) -> Iterator[None]:
        """A context that `cancel` breaks off wherever this thread is: Cancelled is raised at its next instruction.

        A library's call that is running is finished before.
        """
        with self._lock:
            self._thread = threading.get_ident()
        try:
            yield
        finally:
            with self._lock:
                self._thread = None

    def cancel(self) -> None:
        """Break the work off."""
        with self._lock:
            self._cancelled.set()
            if self._thread is not None:
                # Repairing meshes and fitting codes are loops of other modules, which know nothing of jobs.
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._thread), ctypes.py_object(Cancelled))

    @property
    def cancelled(self) -> bool:
        """True once the job is no longer wanted."""
        return self._cancelled.is_set()

    def each(self, what: str) -> Callable[[Callable[[int], Part], Iterable[int]], Iterator[Part]]:
        """A `map` over the cuboids of a surface that says how many are done."""

        def through(work: Callable[[int], Part], cuboids: Iterable[int]) -> Iterator[Part]:
            waiting = list(cuboids)
            for done, cuboid in enumerate(waiting):
                self(what, done / len(waiting))
                yield work(cuboid)

        return through


# Long work. It returns an action that uses the result, called under the tab's lock unless the job was cancelled.
Work = Callable[[Progress], Callable[[], None]]


class Jobs:
    """The long work of one tab."""

    def __init__(
        self,
        show: Callable[[Stand | None], None],
        finish: Callable[[Callable[[], None]], None],
        fail: Callable[[str], None],
    ) -> None:
        """`show` is called with the progress of the job, None once there is none; `finish` with the action that uses
        a result; `fail` with an error's text."""
        self._show, self._finish, self._fail = show, finish, fail
        self._lock = threading.Lock()
        self._running: tuple[str, Progress] | None = None

    def start(self, what: str, work: Work) -> None:
        """Begin a job. Raises InputError while another one is running."""
        progress = Progress(what, lambda stand: self._tell(progress, stand))
        with self._lock:
            if self._running is not None:
                raise InputError(f"{self._running[0]}: wait for its end, or cancel it")
            self._running = what, progress
        self._show(Stand(what, "begins", 0.0))
        threading.Thread(target=self._run, args=(progress, work), name=what, daemon=True).start()

    @property
    def running(self) -> bool:
        """True while a job is running."""
        with self._lock:
            return self._running is not None

    def cancel(self) -> str | None:
        """Break the work off; its end isn't waited for. Returns its name, None without any."""
        with self._lock:
            if self._running is None:
                return None
            what, progress = self._running
            self._running = None
        progress.cancel()
        self._show(None)
        return what

    def _tell(self, progress: Progress, stand: Stand) -> None:
        if not progress.cancelled:
            self._show(stand)

    def _run(self, progress: Progress, work: Work) -> None:
        try:
            with suppress(Cancelled), saying(lambda text: None if progress.cancelled else self._fail(text)):
                with progress.breakable():
                    act = work(progress)
                if self._ended(progress):
                    self._finish(act)
        finally:
            self._ended(progress)

    def _ended(self, progress: Progress) -> bool:
        """Make room for another job. Returns whether this one was still wanted."""
        with self._lock:
            if self._running is None or self._running[1] is not progress:
                return False
            self._running = None
        self._show(None)
        return True
