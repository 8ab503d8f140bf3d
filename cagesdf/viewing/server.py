"""The editor's address: a page for everyone who opens it, a `Tab` for each."""

import errno
import re
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from http.cookies import CookieError, SimpleCookie
from itertools import count
from types import SimpleNamespace
from typing import Any

import numpy as np
import viser
from viser.infra import _infra as viser_sockets
from websockets.asyncio import server as sockets
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from cagesdf.errors import InputError
from cagesdf.viewing.drafts import DAY, Drafts, Page, is_token, new_token
from cagesdf.viewing.framing import VIEWS, camera_for
from cagesdf.viewing.opening import Opened
from cagesdf.viewing.tab import Tab

COOKIE = "cagesdf-"  # with the port: cookies of one host are those of all its ports
PORTS = range(8080, 8180)  # tried in turn if no port is named
LOOPBACK = ("127.0.0.1", "localhost", "::1")
# Pages of this machine, and clients that are no pages.
OWN_PAGES = (re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?"), None)


_opening = threading.Lock()  # one server at a time


def free_port(host: str, port: int | None) -> int:
    """A port that `host` can listen at: `port`, or the first free one of PORTS if it is None; 0 is any free one.

    Raises InputError if there is none, naming address and port.
    """
    if port is not None and not 0 <= port < 65_536:
        raise InputError(f"--port {port}: wanted a number from 0, for any free one, to 65535")
    if not host:
        raise InputError("--host: got an empty address; wanted one of this machine's, such as 127.0.0.1")
    problem: OSError | UnicodeError | None = None
    for candidate in PORTS if port is None else (port,):
        try:
            for family, *_, place in socket.getaddrinfo(host, candidate, type=socket.SOCK_STREAM):
                socket.create_server(place, family=family).close()
        except (OSError, UnicodeError) as error:
            problem = error
            if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
                continue
            raise InputError(f"--host {host}, port {candidate}: can't listen there ({_reason(error)})") from error
        return candidate
    if port is None:
        raise InputError(f"--host {host}: all ports from {PORTS[0]} to {PORTS[-1]} are in use") from problem
    raise InputError(f"--port {port}: is in use at {host}; name another, or none for a free one") from problem


def _reason(error: OSError | UnicodeError) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


class Server(viser.ViserServer):
    """viser's, for this machine's own pages where it listens to this machine alone.

    A page can't ask it to become public through a stranger's server, and a stranger's page, open in the same browser,
    can't talk to it.
    """

    def __init__(self, host: str, port: int | None) -> None:
        """`port` as `free_port` takes it, and refuses it: viser would wait for ever for a place it can't listen at."""
        port = free_port(host, port)
        with _answering(OWN_PAGES if host in LOOPBACK else None):
            super().__init__(host, port, label="cagesdf", verbose=False)

    def browser_of(self, client: int) -> str:
        """The token of the browser that a page is open in; one that takes no cookies has another with each page."""
        # viser has no public name for a client's request (pinned in constraints.txt).
        connection = self._websock_server._live_connections.get(client)
        request = None if connection is None else connection.request
        return (None if request is None else _token(request.headers, self.get_port())) or new_token()

    def request_share_url(self, verbose: bool = True) -> str | None:
        """There is none."""
        return None


class Editor:
    """A server with one tab per client; a tab's memory is freed when its page is closed."""

    def __init__(self, runs: Mapping[str, Opened], host: str, port: int | None, threads: int) -> None:
        """`port` as `free_port` takes it; networks are evaluated by `threads` threads for all tabs together.

        A page begins with the first of the runs, by name.
        """
        self._runs = runs
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="network")
        self._drafts = Drafts()
        self._numbers = count()
        self._tabs: dict[int, tuple[Page, Tab]] = {}  # by client
        self._lock = threading.Lock()
        self.server = Server(host, port)
        self.server.scene.set_up_direction("+y")
        # Pages frame their shape for their own size; this is what they begin with.
        first, camera = next(iter(runs.values())), self.server.initial_camera
        cage = first.session.opened(first.first).cage
        camera.position, camera.look_at = camera_for(cage, np.array(VIEWS["Perspective"]), camera.fov, 1.0)
        threading.Thread(target=first.codes, name="codes", daemon=True).start()  # nobody shall wait for it later
        self.server.on_client_connect(self._come)
        self.server.on_client_disconnect(self._leave)

    @property
    def address(self) -> str:
        """The address for browsers of this machine."""
        host = self.server.get_host()
        return f"http://{'localhost' if host in ('127.0.0.1', '0.0.0.0') else host}:{self.server.get_port()}"

    @property
    def tabs(self) -> int:
        """The number of open tabs."""
        with self._lock:
            return len(self._tabs)

    def close(self) -> None:
        """End all tabs and the server."""
        with self._lock:
            tabs, self._tabs = list(self._tabs.values()), {}
        for _, tab in tabs:
            tab.close()
        for run in self._runs.values():
            run.thumbnails.close()
        self.server.stop()
        self._pool.shutdown()

    def _come(self, client: viser.ClientHandle) -> None:
        self._open(client, next(iter(self._runs)))

    def _open(self, client: viser.ClientHandle, run: str) -> None:
        """A tab for a run, in the place of the one before."""
        with self._lock:
            before = self._tabs.pop(client.client_id, None)
        if before is not None:
            before[1].close()
            client.scene.remove_click_callback()
            client.gui.reset()
            client.scene.reset()
        page = Page(self._drafts, self.server.browser_of(client.client_id), next(self._numbers), self._open_pages)
        tab = Tab(client, self._runs, run, partial(self._open, client), self._pool, np.random.default_rng(), page)
        with self._lock:
            self._tabs[client.client_id] = page, tab

    def _open_pages(self) -> set[int]:
        with self._lock:
            return {page.number for page, _ in self._tabs.values()}

    def _leave(self, client: viser.ClientHandle) -> None:
        with self._lock:
            left = self._tabs.pop(client.client_id, None)
            others = [tab for page, tab in self._tabs.values() if left and page.browser == left[0].browser]
        if left is not None:
            left[1].close()
        for tab in others:
            tab.offer()


@contextmanager
def _answering(origins: tuple[re.Pattern[str] | None, ...] | None) -> Iterator[None]:
    """Sockets that viser opens meanwhile answer these pages alone, and give each browser a token of its own.

    viser has no setting for it. Its module's name for the library stands for one whose sockets have these origins;
    the library itself, which others in this process may use, stays as it is.
    """
    library = viser_sockets.websockets
    serving_these = SimpleNamespace(**vars(sockets) | {"serve": partial(_serve, origins=origins)})
    asynchronous = SimpleNamespace(**vars(library.asyncio) | {"server": serving_these})
    with _opening:
        viser_sockets.websockets = SimpleNamespace(**vars(library) | {"asyncio": asynchronous})  # type: ignore[assignment]
        try:
            yield
        finally:
            viser_sockets.websockets = library


def _serve(*arguments: Any, process_request: Callable[..., Response | None], **options: Any) -> sockets.serve:
    return sockets.serve(*arguments, process_request=partial(_with_token, process_request), **options)


def _with_token(
    answer: Callable[..., Response | None], connection: sockets.ServerConnection, request: Request
) -> Response | None:
    """The server's answer to a request for a page, which names the browser if it has no name yet."""
    response = answer(connection, request)
    port = connection.local_address[1]
    if response is not None and _token(request.headers, port) is None:
        # Scripts of pages can't read it, and other sites' pages don't send it.
        cookie = f"{COOKIE}{port}={new_token()}; Max-Age={DAY:.0f}; Path=/; HttpOnly; SameSite=Strict"
        response.headers["Set-Cookie"] = cookie
    return response


def _token(headers: Headers, port: int) -> str | None:
    """The token that a browser sends; None if it has none."""
    try:
        cookies = SimpleCookie("; ".join(headers.get_all("Cookie")))
    except CookieError:
        return None
    cookie = cookies.get(f"{COOKIE}{port}")
    return cookie.value if cookie is not None and is_token(cookie.value) else None


@contextmanager
def serving(runs: Mapping[str, Opened], host: str, port: int | None, threads: int) -> Iterator[Editor]:
    """An editor of some runs, by name, for the time of the context."""
    editor = Editor(runs, host, port, threads)
    try:
        yield editor
    finally:
        editor.close()
