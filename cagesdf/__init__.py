"""Neural implicit shapes with explicit bounding cuboids; docs/api.md has examples.

What a name needs, such as torch, is imported when it is used first. `__init__.pyi` has the names for type checkers.
"""

from importlib import import_module
from typing import Any

# The module of each public name.
PLACES = {
    "EditableShape": "api.shapes",
    "FittedShape": "api.shapes",
    "InputError": "errors",
    "ShapeCheck": "api.sources",
    "ShapeRejected": "errors",
    "TrainedRun": "api.runs",
    "check": "api.sources",
    "load_run": "api.runs",
    "signed_distance": "api.sources",
}
__all__ = [*PLACES]


def __getattr__(name: str) -> Any:
    if name not in PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"cagesdf.{PLACES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *PLACES})
