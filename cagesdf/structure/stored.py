"""Structures of any kind as text."""

import json

from cagesdf.errors import InputError
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.base import Structure
from cagesdf.structure.hierarchy import PartHierarchy


def read_structure(text: str) -> Structure:
    """The structure, of either class, that `Structure.to_json` wrote. Raises InputError for other text."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"structure: no JSON, or nested too deeply ({error}); got {text[:60]}") from error
    if not isinstance(content, dict):
        raise InputError(f"structure: wanted a JSON object, got {text[:60]}")
    return Assembly.from_json(text) if "program" in content else PartHierarchy.from_json(text)
