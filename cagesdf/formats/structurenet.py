"""StructureNet's hierarchies: `<category>_hier/<shape>.json`, labels, nesting, boxes and relations of PartNet parts."""

import json
from pathlib import Path
from typing import Any

from cagesdf.errors import InputError
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.text import read_text

SUFFIX = "_hier"
MAX_BYTES = 16 * 2**20  # of a JSON file; lists of its size still fit into memory


def read_hierarchy(path: Path) -> PartHierarchy:
    """A hierarchy file; its boxes and relations are in the raw frame.

    Raises InputError if it is no JSON or no hierarchy, as `PartHierarchy.from_dict` does.
    """
    try:
        return PartHierarchy.from_dict(read_json(path))
    except InputError as error:
        raise InputError(f"{path}: {error}" if str(path) not in str(error) else str(error)) from error


def read_json(path: Path) -> Any:
    """A JSON file in any encoding that `text.read_text` knows.

    Raises InputError naming it if it is missing, broken, larger than MAX_BYTES, or has strings that are no text.
    """
    text = read_text(path, MAX_BYTES)
    try:
        content = json.loads(text)
        # Half of a surrogate pair can be written as JSON, but not be stored as text.
        json.dumps(content, ensure_ascii=False).encode("utf-8")
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is no readable JSON ({error}); download it again") from error
    return content
