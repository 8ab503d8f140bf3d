"""Surfaces in the background: the newest state wins, what is wrong is said, and nothing outlives its tab."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from cagesdf.editing.operations import edited
from cagesdf.editing.script import Move
from cagesdf.editing.session import Session
from cagesdf.editing.state import State
from cagesdf.viewing.worker import FINE_CELLS, PREVIEW_CELLS, Made, Worker

PATIENCE = 600.0  # seconds: only a broken worker takes them


class Seen:
    """What a worker showed and said."""

    def __init__(self) -> None:
        self.made: list[Made] = []
        self.failed: list[str] = []
        self.told: list[float | None] = []
        self._changed = threading.Condition()

    def show(self, made: Made) -> None:
        with self._changed:
            self.made.append(made)
            self._changed.notify()

    def tell(self, done: float | None) -> None:
        with self._changed:
            self.told.append(done)
            self._changed.notify()

    def fail(self, text: str) -> None:
        with self._changed:
            self.failed.append(text)
            self._changed.notify()

    def until(self, condition) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: condition(self), timeout=PATIENCE)


@pytest.fixture
def seen() -> Seen:
    return Seen()


@pytest.fixture
def worker(session: Session, seen: Seen) -> Iterator[Worker]:
    with ThreadPoolExecutor(2) as pool:
        worker = Worker(session, pool, seen.show, seen.tell, seen.fail)
        yield worker
        worker.close()


def at(session: Session, x: float) -> State:
    return edited(session.opened("a"), (Move(part="seat", by=(x, 0.0, 0.0)),), session.styles).present


def test_a_coarse_surface_comes_first_and_the_fine_one_is_that_of_the_command(
    session: Session, worker: Worker, seen: Seen
) -> None:
    state = session.opened("a")
    worker.want(state)
    seen.until(lambda s: len(s.made) == 2)
    assert [made.cells for made in seen.made] == [PREVIEW_CELLS, FINE_CELLS]
    expected = session.live(FINE_CELLS).surface(state).mesh
    np.testing.assert_array_equal(seen.made[1].extraction.mesh.vertices, expected.vertices)
    np.testing.assert_array_equal(seen.made[1].extraction.mesh.faces, expected.faces)


def test_the_last_of_many_states_is_the_one_that_stays(session: Session, worker: Worker, seen: Seen) -> None:
    states = [at(session, x) for x in np.linspace(0, 0.1, 12)]
    for state in states:
        worker.want(state)
    seen.until(lambda s: bool(s.made) and s.made[-1].cells == FINE_CELLS)
    assert seen.made[-1].state is states[-1]
    assert sum(made.cells == FINE_CELLS for made in seen.made) == 1


def test_a_state_that_has_no_surface_is_said_and_the_next_one_is_made(
    session: Session, worker: Worker, seen: Seen
) -> None:
    state = session.opened("a")
    worker.want(replace(state, latent=np.full_like(state.latent, np.nan)))
    seen.until(lambda s: bool(s.failed))
    assert "finite" in seen.failed[0]
    worker.want(state)
    seen.until(lambda s: bool(s.made))


def test_the_share_that_is_done_grows_to_all_of_it_and_ends(session: Session, worker: Worker, seen: Seen) -> None:
    worker.want(session.opened("a"))
    seen.until(lambda s: bool(s.told) and s.told[-1] is None)
    shares = [share for share in seen.told if share is not None]
    assert shares == sorted(shares)
    assert shares[-1] == 1


def test_a_fine_surface_that_is_given_up_is_not_shown_and_a_newer_state_is(
    session: Session, worker: Worker, seen: Seen
) -> None:
    worker.want(session.opened("a"))
    seen.until(lambda s: bool(s.made))
    worker.rest()
    worker.want(at(session, 0.05))
    seen.until(lambda s: s.made[-1].cells == FINE_CELLS)
    assert [made.cells for made in seen.made] == [PREVIEW_CELLS, PREVIEW_CELLS, FINE_CELLS]


def test_closing_ends_the_thread(session: Session, seen: Seen) -> None:
    before = threading.active_count()
    with ThreadPoolExecutor(1) as pool:
        workers = [Worker(session, pool, seen.show, seen.tell, seen.fail) for _ in range(3)]
        for worker in workers:
            worker.want(session.opened("a"))
        for worker in workers:
            worker.close()
    assert threading.active_count() <= before
