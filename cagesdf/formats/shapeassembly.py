"""ShapeAssembly programs: files and folders of them, and `<category>_programs/<shape>.txt` beside the shapes."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from cagesdf.errors import InputError
from cagesdf.formats.alignment import Candidate, align
from cagesdf.formats.splits import MAX_BYTES, TRAIN, VAL
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.shape import RawPart, RawShape
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.parsing import read_program
from cagesdf.text import read_text

SUFFIX = "_programs"

# A published folder holds train.txt and val.txt beside its programs, or within: an id on each line.
IDS = re.compile(r"[\r\n]*[\w.@-][\w.@\r\n-]*")


def read_assembly(
    program: Path, shape_id: str, split: str, candidates: Sequence[Candidate], meshes: Mapping[str, Mesh]
) -> RawShape:
    """One shape whose parts are the leaves of its program; each has all meshes that `align` gives to it.

    `candidates` and the raw `meshes`, by name, come from the shape's own files. Raises
    InputError, ProgramError among them, if the program is broken, doesn't execute, or has a leaf
    that no mesh belongs to.
    """
    assembled = read_program(program)
    try:
        alignment = align(assembled, candidates, meshes)
    except InputError as error:
        raise InputError(f"{program}: {error}") from error
    parts = tuple(
        RawPart(part.part_id, part.label, join([meshes[name] for name in (*part.objs, *part.leftovers)]))
        for part in alignment.parts
    )
    return RawShape(shape_id, split, parts, Assembly(assembled, alignment.placement), alignment.parts)


def list_programs(paths: Iterable[Path]) -> list[Path]:
    """The files given, and all .txt files below each folder, sorted; lists of ids such as train.txt are left out.

    Raises InputError for a path that isn't there and a folder without programs.
    """
    programs: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InputError(f"{path}: no such file or folder; wanted ShapeAssembly programs")
        if path.is_file():
            programs.append(path)
            continue
        files = (file for file in sorted(path.rglob("*.txt")) if file.is_file() and not file.name.startswith("."))
        inside = [file for file in files if not _is_list(file)]
        if not inside:
            raise InputError(f"{path}: no programs in it; wanted .txt files that begin with Assembly NAME {{")
        programs += inside
    return programs


def _is_list(file: Path) -> bool:
    if file.name.casefold() in (TRAIN, VAL):
        return True
    try:
        return IDS.fullmatch(read_text(file, MAX_BYTES)) is not None
    except InputError:  # reading it as a program says so
        return False
