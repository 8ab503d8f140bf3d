"""StructureNet's hierarchies: `<category>_hier/<shape>.json`, labels, nesting, boxes and relations of PartNet parts."""

import json
from pathlib import Path
from typing import Any

from cagesdf.errors import InputError
from cagesdf.formats.content import read_bounded
from cagesdf.structure.hierarchy import PartHierarchy

SUFFIX = "_hier"


def find_hierarchy(category: Path, shape_id: str) -> Path | None:
    """The hierarchy of a shape, in a folder `<anything>_hier` beside the shapes'; None if there is none."""
    paths = sorted(category.glob(f"*{SUFFIX}/{shape_id}.json"))
    return paths[0] if paths else None


def read_hierarchy(path: Path) -> PartHierarchy:
    """A hierarchy file; its boxes and relations are in the raw frame.

    Raises InputError if it is no JSON or no hierarchy, as `PartHierarchy.from_dict` does.
    """
    try:
        return PartHierarchy.from_dict(read_json(path))
    except InputError as error:
        raise InputError(f"{path}: {error}" if str(path) not in str(error) else str(error)) from error


def read_json(path: Path) -> Any:
    """A JSON file. Raises InputError naming it if it is missing or broken."""
    try:
        return json.loads(read_bounded(path))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is no readable JSON ({error}); download it again") from error
