"""Numbers that are typed digit by digit: taken once they stay as they are."""

import threading
from collections.abc import Callable

PAUSE = 0.5  # seconds without a change, after which a number is meant


class Settling:
    """An action that waits until a value has settled; whatever else is done comes after it (`flush`)."""

    def __init__(self, act: Callable[[], None], later: Callable[[Callable[[], None]], threading.Timer]) -> None:
        """`later` calls a function after PAUSE; see `after_pause`."""
        self._act, self._later = act, later
        self._timer: threading.Timer | None = None

    @property
    def waits(self) -> bool:
        """Whether the value changed and the action wasn't done yet."""
        return self._timer is not None

    def touch(self) -> None:
        """The value changed."""
        self.drop()
        self._timer = self._later(self.flush)

    def flush(self) -> None:
        """Do the action at once if it waits."""
        if self.waits:
            self.drop()
            self._act()

    def drop(self) -> None:
        """Forget the action."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def after_pause(guard: Callable[[Callable[[], None]], None], act: Callable[[], None]) -> threading.Timer:
    """A timer, started, by which `guard` calls an action after PAUSE."""
    timer = threading.Timer(PAUSE, guard, (act,))
    timer.daemon = True
    timer.start()
    return timer
