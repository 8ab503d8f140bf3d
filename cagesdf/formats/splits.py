"""`train.txt` and `val.txt`: the shapes to train on, and those held out.

A line is an id: a shape's name as it is in the folder, spaces included. Read alike are

- UTF-8, UTF-16 and UTF-32, with a byte order mark or without, and all line ends;
- composed and decomposed letters (macOS writes "ü" as two characters): ids are in Unicode's form NFC;
- an id with space around it, a comment after it (" # …"), or the suffix of a mesh file ("a.obj").

Blank lines and lines that begin with "#" are skipped, unless a shape is called so. The first of these spellings that
a shape has counts. What no shape is called is noted with its line, and changes nothing else.

With a train list, the shapes that it doesn't name are held out, since they may be of a test set. Otherwise the shapes
of the val list are held out; without lists, none. A shape in both lists is held out, which is noted.
"""

import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path

from cagesdf.formats.parts_folder import MESH_SUFFIXES
from cagesdf.text import read_text

TRAIN, VAL = "train.txt", "val.txt"
MAX_BYTES = 16 * 2**20
SHOWN = 20  # ids that a note names


@dataclass(frozen=True)
class IdList:
    """The lines of one or several files that list ids."""

    source: str  # names of the files
    ids: Mapping[str, str]  # place of the first line, by shape id
    unknown: tuple[str, ...]  # lines that name no shape, each with its place and the nearest id


def composed(name: str) -> str:
    """A name as an id: in Unicode's form NFC, whatever the file system makes of it."""
    return unicodedata.normalize("NFC", name)


def several(names: Iterable[str]) -> str:
    """At most SHOWN names, separated by commas, and the number of the others."""
    listed = list(names)
    return ", ".join(listed[:SHOWN]) + (f" and {len(listed) - SHOWN:,} more" if len(listed) > SHOWN else "")


def read_list(files: Sequence[Path], known: Set[str]) -> IdList:
    """The ids in the files; `known` are the ids of all shapes that there are.

    Raises InputError naming a file that can't be read, is no text, or has more than MAX_BYTES bytes.
    """
    ids: dict[str, str] = {}
    unknown = []
    alike = {_letters(shape_id): shape_id for shape_id in sorted(known)}
    for file in files:
        # Joined files have byte order marks inside too.
        text = composed(read_text(file, MAX_BYTES).replace("\ufeff", ""))
        for number, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1):
            place = f"{file.name} line {number}"
            shape_id = next((name for name in _spellings(line) if name in known), None)
            if shape_id is not None:
                ids.setdefault(shape_id, place)
            elif line.strip() and not line.lstrip().startswith("#"):
                unknown.append(f"{line.strip()!r} ({place}{_hint(line, known, alike)})")
    return IdList(" and ".join(f"{file.parent.name}/{file.name}" for file in files), ids, tuple(unknown))


def splits(
    shapes: Sequence[str], known: Set[str], train: Sequence[Path], val: Sequence[Path]
) -> tuple[dict[str, str], list[str]]:
    """ "train" or "val" for each of `shapes`, and notes on contradictions and gaps of the lists.

    `known` are the ids of all shapes that there are, a superset of `shapes`. No file in `train` or `val` means
    that there is no such list. Raises InputError as `read_list` does.
    """
    to_train, to_hold = read_list(train, known), read_list(val, known)
    both = [shape_id for shape_id in to_train.ids if shape_id in to_hold.ids]
    listed = {*to_train.ids, *to_hold.ids}
    unlisted = [shape_id for shape_id in shapes if shape_id not in listed] if train else []
    held_out = {*to_hold.ids, *unlisted}
    notes = [
        f"{names.source}: no shape is called {several(names.unknown)}" for names in (to_train, to_hold) if names.unknown
    ]
    if train and not to_train.ids:
        notes.append(f"{to_train.source}: names no shape that is here, so all are held out")
    if to_hold.unknown and not to_hold.ids:
        notes.append(f"{to_hold.source}: names no shape that is here, so it holds none out")
    if both:
        places = several(f"{shape_id} ({to_train.ids[shape_id]}, {to_hold.ids[shape_id]})" for shape_id in both)
        notes.append(f"in both lists, so held out for validation: {places}")
    if unlisted:
        notes.append(
            f"{to_train.source}: {len(unlisted):,} shapes that it doesn't list are held out for validation: "
            + several(unlisted)
        )
    return {shape_id: "val" if shape_id in held_out else "train" for shape_id in shapes}, notes


def _spellings(line: str) -> Iterator[str]:
    """The ids that a line may mean, the most literal first."""
    text = line.strip()
    bare = re.split(r"\s#", text, maxsplit=1)[0].rstrip()
    for name in (line, text, bare):
        yield name
        stem, dot, suffix = name.rpartition(".")
        if dot + suffix.lower() in MESH_SUFFIXES:
            yield stem


def _letters(name: str) -> str:
    return "".join(character for character in name.casefold() if character.isalnum())


def _hint(line: str, known: Set[str], alike: Mapping[str, str]) -> str:
    words = re.split(r"[\s,;]+", line.strip())
    if len(words) > 1 and set(words) <= known:
        return f": {len(words)} ids, wanted one a line"
    near = alike.get(_letters(line))
    return f": there is {near!r}" if near else ""
