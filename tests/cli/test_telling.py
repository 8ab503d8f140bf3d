"""How commands speak: sentences to people, JSON to programs, and of long work while it lasts."""

import json
import sys
import threading

import pytest

from cagesdf.cli import telling
from cagesdf.cli.telling import Count, tell, working


@pytest.mark.parametrize(("terminal", "as_json", "sentence"), [
    (True, False, True), (True, True, False), (False, False, False), (False, True, False),
])  # fmt: skip
def test_a_terminal_gets_a_sentence_and_everything_else_or_who_asks_gets_json(
    terminal: bool, as_json: bool, sentence: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal, raising=False)
    tell({"out": "ö.ply", "faces": 12}, "ö.ply: 12 faces", as_json)
    out = capsys.readouterr().out
    assert out == "ö.ply: 12 faces\n" if sentence else json.loads(out) == {"out": "ö.ply", "faces": 12}


def test_only_work_that_takes_long_is_spoken_of_and_its_time_is_noted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seconds: dict[str, float] = {}
    with working("reading", seconds, "read"):
        pass
    monkeypatch.setattr(telling, "PATIENCE", 0.0)
    said = threading.Event()

    def say(text: str) -> None:
        print(text, file=sys.stderr)
        said.set()

    monkeypatch.setattr(telling, "_say", say)
    with working("asking"):
        assert said.wait(60)
    assert capsys.readouterr().err == "asking …\n"
    assert 0 <= seconds["read"] < 1


def test_many_things_are_counted_from_time_to_time(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    times = iter([0.0, 0.5, 1.5, 2.0, 2.6])
    monkeypatch.setattr(telling.time, "perf_counter", lambda: next(times))
    done = Count("shapes", 4)
    for _ in range(4):
        done()
    assert capsys.readouterr().err == "cagesdf: shapes: 2 of 4\ncagesdf: shapes: 4 of 4\n"
