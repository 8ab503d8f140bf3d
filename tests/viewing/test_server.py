"""Who may talk to the editor: its own page, and no other site's that is open in the same browser."""

import queue
import socket
from collections.abc import Iterator
from email.message import Message
from functools import partial
from pathlib import Path
from urllib.request import Request, urlopen

import pytest
import viser
from viser.infra import _infra as infra
from websockets.asyncio import server as sockets
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from cagesdf.errors import InputError
from cagesdf.viewing.drafts import is_token, new_token
from cagesdf.viewing.server import OWN_PAGES, PORTS, Server, free_port
from tests.support.commands import Command


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    running = Server("127.0.0.1", 0)
    yield running
    running.stop()


def speak(server: Server, origin: str | None, headers: dict[str, str] | None = None) -> None:
    socket = connect(
        f"ws://127.0.0.1:{server.get_port()}",
        origin=None if origin is None else Origin(origin),
        subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
        additional_headers=headers,
    )
    socket.close()


@pytest.mark.parametrize("origin", [None, "http://localhost:18180", "http://127.0.0.1:9000", "http://[::1]:18180"])
def test_pages_of_this_machine_are_answered(server: Server, origin: str | None) -> None:
    speak(server, origin)


@pytest.mark.parametrize(
    "origin",
    ["http://example.org", "https://localhost.example.org", "http://example.org:18180", "null", "http://127.0.0.11"],
)
def test_other_sites_are_refused(server: Server, origin: str) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        speak(server, origin)


def test_other_sockets_of_the_process_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    plain, seen = sockets.serve, []

    def opened(self: viser.ViserServer, *arguments: object, **options: object) -> None:
        theirs: partial = infra.websockets.asyncio.server.serve  # type: ignore[assignment]
        seen.append((sockets.serve, theirs.keywords))

    monkeypatch.setattr(viser.ViserServer, "__init__", opened)
    library = infra.websockets
    Server("127.0.0.1", 0)
    Server("0.0.0.0", 0)
    assert seen == [(plain, {"origins": OWN_PAGES}), (plain, {"origins": None})]
    assert infra.websockets is library


def test_a_port_that_is_named_is_taken_or_refused_and_otherwise_a_free_one_is_found() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"--port {port}: is in use at 127.0.0.1"):
            free_port("127.0.0.1", port)
    assert free_port("127.0.0.1", port) == port
    assert free_port("127.0.0.1", 0) == 0
    first = free_port("127.0.0.1", None)
    with socket.create_server(("127.0.0.1", first)):
        assert first < free_port("127.0.0.1", None) <= PORTS[-1]


@pytest.mark.parametrize(
    ("host", "port", "said"),
    [
        ("127.0.0.1", 70_000, "--port 70000: wanted a number"),
        ("127.0.0.1", -1, "--port -1: wanted a number"),
        ("", 0, "--host: got an empty address"),
        ("203.0.113.7", 0, "--host 203.0.113.7, port 0: can't listen there"),
        ("no such host", None, "--host no such host, port 8080: can't listen there"),
        ("a" * 70 + ".example", 0, "can't listen there"),
        ("256.1.1.1", 0, "can't listen there"),
    ],
)
def test_a_place_that_can_not_be_listened_at_is_refused_before_anything_waits(
    host: str, port: int | None, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        Server(host, port)


@pytest.mark.parametrize("options", [("--port", "70000"), ("--host", "203.0.113.7")])
def test_the_command_says_so_in_one_line_with_status_one(command: Command, options: tuple[str, str]) -> None:
    assert command.complaint("view", "--demo", *options).startswith(f"cagesdf: {' '.join(options)}")


def test_a_folder_that_is_no_run_is_called_so_and_not_by_a_file_that_it_lacks(command: Command, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "nope", tmp_path / "empty"):
        complaint = command.complaint("view", folder)
        assert complaint.startswith(f"cagesdf: {folder}: ")
        assert "wanted a run, a folder that the train stage wrote" in complaint
        assert "is missing" not in complaint


def page_of(server: Server, cookie: str = "") -> Message:
    """The headers that come with the page."""
    address = f"http://127.0.0.1:{server.get_port()}/"
    with urlopen(Request(address, headers={"Cookie": cookie} if cookie else {})) as answer:
        return answer.headers


def test_a_browser_gets_a_token_of_its_own_with_the_page_which_no_script_reads_and_keeps_it(server: Server) -> None:
    first, second = (page_of(server)["Set-Cookie"] for _ in range(2))
    name, _, token = first.partition(";")[0].partition("=")
    assert name == f"cagesdf-{server.get_port()}"
    assert is_token(token)
    assert token not in second
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(first.split("; "))
    assert page_of(server, f"other=1; {name}={token}")["Set-Cookie"] is None
    assert page_of(server, f"{name}=short")["Set-Cookie"] is not None


def test_a_page_is_known_by_the_token_that_its_browser_sends(server: Server) -> None:
    token, seen = new_token(), queue.Queue()  # type: ignore[var-annotated]
    # The callback of viser itself waits for a real page.
    server._websock_server.on_client_connect(lambda client: seen.put(server.browser_of(client.client_id)))
    cookie = {"Cookie": f"cagesdf-{server.get_port()}={token}"}
    for headers in (cookie, cookie, None):
        speak(server, None, headers)
    found = [seen.get(timeout=60) for _ in range(3)]
    assert found[:2] == [token, token]
    assert is_token(found[2])
    assert found[2] != token


def test_no_page_can_make_it_public(server: Server) -> None:
    assert server.request_share_url() is None
