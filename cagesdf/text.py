"""Text that users' programs wrote: UTF-8 or UTF-16, with a byte order mark or without."""

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
PROBE = 64  # bytes by which UTF-16 without a mark is known


def read_text(path: Path, most: int) -> str:
    """A file's text. Raises InputError if it is missing, larger than `most` bytes, unreadable or no text."""
    if not path.is_file():
        raise InputError(f"{path}: is a folder or a device, no file" if path.exists() else f"{path}: no such file")
    try:
        if path.stat().st_size > most:
            raise InputError(f"{path}: {path.stat().st_size:,} bytes; wanted at most {most:,}")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror})") from error
    return decode(content, str(path))


def decode(content: bytes, source: str) -> str:
    """The text of a file's bytes, without its byte order mark. Raises InputError, which names `source`."""
    encoding = encoding_of(content)
    try:
        return content.decode(encoding).lstrip("\ufeff")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{source}: is no text in {encoding.upper()} ({error.reason} at byte {error.start:,}); save it as UTF-8"
        ) from error


def encoding_of(content: bytes) -> str:
    """The encoding that a byte order mark tells, or every other byte of a Latin text being 0; otherwise UTF-8."""
    for mark, encoding in MARKS:
        if content.startswith(mark):
            return encoding
    even, odd = content[:PROBE:2], content[1:PROBE:2]
    if odd and all(even) and not any(odd):
        return "utf-16-le"
    if odd and all(odd) and not any(even):
        return "utf-16-be"
    return "utf-8"
