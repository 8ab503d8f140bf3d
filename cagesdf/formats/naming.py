"""Part ids from the names that files give their parts, and names of files as messages list them."""

import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence

UNNAMED = "part"
MAX_NAME = 120  # characters of a name that are kept
UNPRINTABLE = {"Cc", "Cs"}  # Unicode's categories of control characters and of halves of surrogate pairs


def part_name(text: str) -> str:
    """A name on one line, composed (NFC), without control characters; `UNNAMED` if nothing is left of it."""
    printable = "".join(" " if unicodedata.category(letter) in UNPRINTABLE else letter for letter in text)
    return " ".join(unicodedata.normalize("NFC", printable).split())[:MAX_NAME].rstrip() or UNNAMED


def distinct_names(texts: Iterable[str]) -> list[str]:
    """A name for each text, no two equal: the first of several that share one keeps it, the others get _2, _3 …"""
    names = [part_name(text) for text in texts]
    taken, counts = set(names), Counter[str]()
    result = []
    for name in names:
        counts[name] += 1
        unique = name
        while counts[name] > 1 and unique in taken:
            unique = f"{name}_{counts[name]}"
            counts[name] += unique in taken
        taken.add(unique)
        result.append(unique)
    return result


def ambiguity(files: Sequence[str], name: str) -> str:
    """The complaint about files or folders that would all be called `name`; those that look alike by code points."""
    alike = len({unicodedata.normalize("NFC", file) for file in files}) < len(files)
    *others, last = map(ascii, files) if alike else files
    return f"{', '.join(others)} and {last} would have one name, {name!r}; keep one of them or rename the others"
