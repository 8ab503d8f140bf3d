"""Long work of a tab: in the background, one at a time; it says how far it is, and can be cancelled."""

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
    """How far some work is."""

    job: str
    what: str  # of it is being done
    done: float  # from 0 to 1

    def __str__(self) -> str:
        return f"{self.job}: {self.what}" + (f" ({self.done:.0%})" if self.done else "")


class Progress:
    """The end of a job that its work holds: it says how far it is, and is broken off here or elsewhere."""

    def __init__(self, job: str, show: Callable[[Stand], None]) -> None:
        self._job, self._show = job, show
        self._cancelled = threading.Event()
        self._lock = threading.Lock()  # held while something is shown: showing is never broken off
        self._thread: int | None = None  # inside `breakable`

    def __call__(self, what: str, done: float = 0.0) -> None:
        """Say what is being done, and which share of it is done. Raises Cancelled once the job is cancelled."""
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
        """Whether the job is no longer wanted."""
        return self._cancelled.is_set()

    def each(self, what: str) -> Callable[[Callable[[int], Part], Iterable[int]], Iterator[Part]]:
        """A `map` over the cuboids of a surface that says how many are done."""

        def through(work: Callable[[int], Part], cuboids: Iterable[int]) -> Iterator[Part]:
            waiting = list(cuboids)
            for done, cuboid in enumerate(waiting):
                self(what, done / len(waiting))
                yield work(cuboid)

        return through


# Long work: it returns what is to be done with its result, under the tab's lock, unless it is cancelled meanwhile.
Work = Callable[[Progress], Callable[[], None]]


class Jobs:
    """The long work of one tab."""

    def __init__(
        self,
        show: Callable[[Stand | None], None],
        finish: Callable[[Callable[[], None]], None],
        fail: Callable[[str], None],
    ) -> None:
        """`show` is called with the stand of the work, None once there is none; `finish` with what is to be done
        with a result; `fail` with what went wrong."""
        self._show, self._finish, self._fail = show, finish, fail
        self._lock = threading.Lock()
        self._running: tuple[str, Progress] | None = None

    def start(self, what: str, work: Work) -> None:
        """Begin some work. Raises InputError while there is other work."""
        progress = Progress(what, lambda stand: self._tell(progress, stand))
        with self._lock:
            if self._running is not None:
                raise InputError(f"{self._running[0]}: wait for its end, or cancel it")
            self._running = what, progress
        self._show(Stand(what, "begins", 0.0))
        threading.Thread(target=self._run, args=(progress, work), name=what, daemon=True).start()

    @property
    def running(self) -> bool:
        """Whether there is work."""
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
        """Make room for other work; whether this was still wanted."""
        with self._lock:
            if self._running is None or self._running[1] is not progress:
                return False
            self._running = None
        self._show(None)
        return True
