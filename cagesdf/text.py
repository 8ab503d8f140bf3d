"""Text that users' programs wrote: UTF-8, UTF-16 or UTF-32, with a byte order mark or without."""

import codecs
from pathlib import Path

from cagesdf.errors import InputError

# UTF-32's mark begins with UTF-16's.
MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
WIDE = ("utf-32-le", "utf-32-be", "utf-16-le", "utf-16-be")
PROBE = 64  # bytes by which these are known without a mark


def read_text(path: Path, most: int) -> str:
    """A file's text. Raises InputError if it is missing, larger than `most` bytes, unreadable or no text."""
    try:
        if not path.is_file():
            raise InputError(f"{path}: is a folder or a device, no file" if path.exists() else f"{path}: no such file")
        if (size := path.stat().st_size) > most:
            raise InputError(f"{path}: {size:,} bytes; wanted at most {most:,}")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror})") from error
    return decode(content, str(path))


def decode(content: bytes, source: str) -> str:
    """The text of a file's bytes, without its byte order mark. Raises InputError, which names `source` and line."""
    encoding = encoding_of(content)
    try:
        return content.decode(encoding).lstrip("\ufeff")
    except UnicodeDecodeError as error:
        line = content[: error.start].decode(encoding).count("\n") + 1
        raise InputError(
            f"{source}, line {line}: is no text in {encoding.upper()} ({error.reason} at byte {error.start:,}); "
            "save it as UTF-8"
        ) from error


def encoding_of(content: bytes) -> str:
    """The encoding by a byte order mark or by bytes of 0 in the first PROBE: "utf-8", or one of WIDE."""
    for mark, encoding in MARKS:
        if content.startswith(mark):
            return encoding
    probe = content[:PROBE]
    return next((encoding for encoding in WIDE if 0 in probe and _is_latin(probe, encoding)), "utf-8")


def _is_latin(probe: bytes, encoding: str) -> bool:
    """Whether at least a quarter of the characters is Latin and none is a zero, as in any list, script or program."""
    text = probe.decode(encoding, errors="replace")
    return "\0" not in text and 4 * sum(character <= "\xff" for character in text) >= len(text)
