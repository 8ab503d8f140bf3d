"""Bytes of foreign files: bounded before they are read, and text in one form whatever program wrote it."""

import codecs
from collections.abc import Callable
from pathlib import Path

from cagesdf.errors import InputError
from cagesdf.text import decode, encoding_of

MAX_BYTES = 512 * 2**20
MAX_PARTS = 10_000  # of one file


def read_bounded(path: Path) -> bytes:
    """A file's bytes. Raises InputError if it is missing, unreadable or larger than MAX_BYTES."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: has {path.stat().st_size:,} bytes, at most {MAX_BYTES:,} are read; simplify it")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror}); export it again") from error


def plain_text(content: bytes, source: str) -> bytes:
    r"""Text without byte order mark, its lines ended by \n, in a superset of ASCII; UTF-16 and UTF-32 become UTF-8.

    Raises InputError, which names `source`, if it is broken UTF-16 or UTF-32, or holds a byte of 0.
    """
    if encoding_of(content) != "utf-8":
        content = decode(content, source).encode()
    content = content.removeprefix(codecs.BOM_UTF8)
    if (zero := content.find(0)) >= 0:
        line = content.count(b"\n", 0, zero) + 1
        raise InputError(f"{source}, line {line}: holds a byte of 0, so it is no text; is it damaged? Export it again")
    return content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def names_of(raw: list[bytes]) -> list[str]:
    """Names of one file: UTF-8, or Latin-1 if any of them isn't; either way different bytes stay different names."""
    try:
        return [name.decode("utf-8") for name in raw]
    except UnicodeDecodeError:
        return [name.decode("latin-1") for name in raw]


def quoted(line: bytes) -> str:
    """The beginning of a line as messages show it."""
    return repr(line[:60].decode("utf-8", errors="replace").strip())


def numbers(words: list[bytes]) -> list[float]:
    """Words of a text file as numbers. Raises ValueError that quotes the first wrong word."""
    try:
        if b"_" not in b"".join(words):  # float() would read 1_0
            return [*map(float, words)]
    except ValueError:
        pass
    wrong = next(word for word in words if b"_" in word or not _reads(float, word))
    reason = "a decimal point, not a comma" if b"," in wrong else "a number"
    raise ValueError(f"{quoted(wrong)}: wanted {reason}")


def whole_numbers(words: list[bytes]) -> list[int]:
    """Words of a text file as whole numbers. Raises ValueError that quotes the first wrong word."""
    try:
        if b"_" not in b"".join(words):
            return [*map(int, words)]
    except ValueError:
        pass
    wrong = next(word for word in words if b"_" in word or not _reads(int, word))
    raise ValueError(f"{quoted(wrong)}: wanted a whole number")


def _reads(kind: Callable[[bytes], object], word: bytes) -> bool:
    try:
        kind(word)
    except ValueError:
        return False
    return True
