"""The editor's address: a page for everyone who opens it, a `Tab` for each."""

import re
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace

import numpy as np
import viser
from viser.infra import _infra as viser_sockets
from websockets.asyncio import server as sockets

from cagesdf.viewing.tab import Opened, Tab

CAMERA = ((1.25, 0.75, 2.05), (0.0, 0.0, 0.0))  # from where, to where; canonical
LOOPBACK = ("127.0.0.1", "localhost", "::1")
# Pages of this machine, and what is no page.
OWN_PAGES = (re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?"), None)


_opening = threading.Lock()  # one server at a time


class Server(viser.ViserServer):
    """viser's, for this machine's own pages where it listens to this machine alone.

    A page can't ask it to become public through a stranger's server, and a stranger's page, open in the same browser,
    can't talk to it.
    """

    def __init__(self, host: str, port: int) -> None:
        with _answering(OWN_PAGES if host in LOOPBACK else None):
            super().__init__(host, port, label="cagesdf", verbose=False)

    def request_share_url(self, verbose: bool = True) -> str | None:
        """There is none."""
        return None


class Editor:
    """A server with one tab a client; what a tab holds is freed when its page is closed."""

    def __init__(self, opened: Opened, host: str, port: int, threads: int) -> None:
        """`port` is the first that is tried; the network is asked by `threads` threads for all tabs together."""
        self._opened = opened
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="network")
        self._tabs: dict[int, Tab] = {}
        self._lock = threading.Lock()
        self.server = Server(host, port)
        self.server.scene.set_up_direction("+y")
        self.server.initial_camera.position, self.server.initial_camera.look_at = CAMERA
        self.server.on_client_connect(self._come)
        self.server.on_client_disconnect(self._leave)

    @property
    def address(self) -> str:
        """Where a browser finds it."""
        host = self.server.get_host()
        return f"http://{'localhost' if host in ('127.0.0.1', '0.0.0.0') else host}:{self.server.get_port()}"

    @property
    def tabs(self) -> int:
        """How many there are."""
        with self._lock:
            return len(self._tabs)

    def close(self) -> None:
        """End all tabs and the server."""
        with self._lock:
            tabs, self._tabs = list(self._tabs.values()), {}
        for tab in tabs:
            tab.close()
        self.server.stop()
        self._pool.shutdown()

    def _come(self, client: viser.ClientHandle) -> None:
        tab = Tab(client, self._opened, self._pool, np.random.default_rng())
        with self._lock:
            self._tabs[client.client_id] = tab

    def _leave(self, client: viser.ClientHandle) -> None:
        with self._lock:
            tab = self._tabs.pop(client.client_id, None)
        if tab is not None:
            tab.close()


@contextmanager
def _answering(origins: tuple[re.Pattern[str] | None, ...] | None) -> Iterator[None]:
    """Sockets that viser opens meanwhile answer these pages alone.

    viser has no setting for it. Its module's name for the library stands for one whose sockets have these origins;
    the library itself, which others in this process may use, stays as it is.
    """
    library = viser_sockets.websockets
    serving_these = SimpleNamespace(**vars(sockets) | {"serve": partial(sockets.serve, origins=origins)})
    asynchronous = SimpleNamespace(**vars(library.asyncio) | {"server": serving_these})
    with _opening:
        viser_sockets.websockets = SimpleNamespace(**vars(library) | {"asyncio": asynchronous})  # type: ignore[assignment]
        try:
            yield
        finally:
            viser_sockets.websockets = library


@contextmanager
def serving(opened: Opened, host: str, port: int, threads: int) -> Iterator[Editor]:
    """An editor for the time of the context."""
    editor = Editor(opened, host, port, threads)
    try:
        yield editor
    finally:
        editor.close()
