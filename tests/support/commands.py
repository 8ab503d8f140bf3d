"""The `cagesdf` command, run in the tests' process."""

import sys

import pytest

from cagesdf import cli


class Command:
    """Runs the command in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
        self.capsys = capsys
        self.monkeypatch = monkeypatch

    def on_terminal(self) -> None:
        """From here on standard output is a terminal."""
        self.monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)

    def __call__(self, *arguments: object) -> str:
        """Standard output of a run that must succeed."""
        self.monkeypatch.setattr(sys, "argv", ["cagesdf", *map(str, arguments)])
        with pytest.raises(SystemExit) as exit_:
            cli.run()
        assert not exit_.value.code, exit_.value.code
        return self.capsys.readouterr().out

    def complaint(self, *arguments: object) -> str:
        """The one line that a run must end with."""
        self.monkeypatch.setattr(sys, "argv", ["cagesdf", *map(str, arguments)])
        with pytest.raises(SystemExit) as exit_:
            cli.run()
        text = str(exit_.value.code)
        assert text.startswith("cagesdf: "), "a text as exit code: status 1, the text on standard error"
        assert "\n" not in text
        return text
