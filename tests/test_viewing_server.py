"""Who may talk to the editor: its own page, and no other site's that is open in the same browser."""

from collections.abc import Iterator

import pytest
import viser
from viser.infra import _infra as infra
from websockets.asyncio import server as sockets
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from cagesdf.viewing.server import OWN_PAGES, Server


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    running = Server("127.0.0.1", 18_180)
    yield running
    running.stop()


def speak(server: Server, origin: str | None) -> None:
    socket = connect(
        f"ws://127.0.0.1:{server.get_port()}",
        origin=None if origin is None else Origin(origin),
        subprotocols=["viser-v1"],  # type: ignore[list-item]
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
        seen.append((sockets.serve, infra.websockets.asyncio.server.serve.keywords))

    monkeypatch.setattr(viser.ViserServer, "__init__", opened)
    library = infra.websockets
    Server("127.0.0.1", 0)
    Server("0.0.0.0", 0)
    assert seen == [(plain, {"origins": OWN_PAGES}), (plain, {"origins": None})]
    assert infra.websockets is library


def test_no_page_can_make_it_public(server: Server) -> None:
    assert server.request_share_url() is None
