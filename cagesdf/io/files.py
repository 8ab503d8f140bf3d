"""Files and folders that commands write: whole or not at all, into folders that exist."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from cagesdf.errors import InputError


def check_folder(out: Path) -> None:
    """Raise InputError if the folder that `out` would be in isn't there."""
    if not out.resolve().parent.is_dir():
        raise InputError(f"{out}: there is no folder {out.parent}; make it first")


@contextmanager
def replacing(out: Path) -> Iterator[Path]:
    """A path beside `out`, which takes its place once its content is whole."""
    partial = out.with_name(f".partial-{out.name}")
    try:
        yield partial
        os.replace(partial, out)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A folder beside `out`, which gets its name once its content is whole."""
    with TemporaryDirectory(prefix=".partial-", dir=out.resolve().parent) as beside:
        folder = Path(beside) / "new"
        folder.mkdir()
        yield folder
        folder.rename(out)
