"""Scripts: lists of operations as JSON, the same for the command and for an editor.

    [{"op": "resize", "part": "leg_*", "axis": "y", "factor": 1.3}, {"op": "swap", "style_of": "chair_0007"}]

Lengths, axes and directions are the user's: those of the shape's own file. A cuboid's own axes are
named after the user's axes that they were nearest to when the cuboid was fitted. What the operations do
is `operations.py`'s.
"""

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from cagesdf.errors import SHOWN, InputError

MAX_CHARACTERS = 1_000_000
MAX_OPERATIONS = 1_000

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Factor = Annotated[float, Field(allow_inf_nan=False, ge=0.01, le=100)]
Name = Annotated[str, Field(min_length=1, max_length=200)]
Axis = Literal["x", "y", "z"]
Frame = Literal["shape", "cuboid"]
End = Literal["low", "centre", "high"]


class _Operation(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Move(_Operation):
    """Move cuboids."""

    op: Literal["move"] = "move"
    part: Name  # id, name or label, with *, ? and | (or)
    by: tuple[Number, Number, Number]  # along x, y, z, the user's unit
    frame: Frame = "shape"  # whose axes these are: the user's, or each cuboid's own
    mirror: bool = True  # parts that mirror these do the mirrored thing
    repeat: bool = False  # parts that repeat these do the same thing in their places


class Resize(_Operation):
    """Stretch cuboids: each along its own axis, or all together along the shape's."""

    op: Literal["resize"] = "resize"
    part: Name  # id, name or label, with *, ? and | (or)
    axis: Axis
    factor: Factor
    keep: End = "centre"  # what stays where it is, along the axis: of each cuboid, or of their common box
    frame: Frame = "cuboid"
    mirror: bool = True  # parts that mirror these do the mirrored thing
    repeat: bool = False  # parts that repeat these do the same thing in their places


class Rotate(_Operation):
    """Turn cuboids: each about its centre and an axis of its own, or all together about the centre of their box."""

    op: Literal["rotate"] = "rotate"
    part: Name  # id, name or label, with *, ? and | (or)
    axis: Axis
    angle: Number  # degrees, counter-clockwise seen from the axis's tip
    frame: Frame = "cuboid"
    mirror: bool = True  # parts that mirror these do the mirrored thing
    repeat: bool = False  # parts that repeat these do the same thing in their places


class Scale(_Operation):
    """Stretch the whole cage about the centre of the shape's box at rest."""

    op: Literal["scale"] = "scale"
    factors: tuple[Factor, Factor, Factor]  # along x, y, z


class Set(_Operation):
    """Give a number of the shape's program another value; what is attached to it, or repeats it, follows."""

    op: Literal["set"] = "set"
    parameter: Name  # as `cagesdf inspect RUN --shape ID` lists them
    value: Number  # lengths in the program's unit, places as shares


class Swap(_Operation):
    """Take another shape's style: its latent code."""

    op: Literal["swap"] = "swap"
    style_of: Name  # id of a shape


class Blend(_Operation):
    """Go from the current style towards another shape's."""

    op: Literal["blend"] = "blend"
    style_of: Name  # id of a shape
    weight: Annotated[float, Field(allow_inf_nan=False, ge=0, le=1)]  # 0: the style stays, 1: it becomes the other's


class Style(_Operation):
    """Take a style by its latent code."""

    op: Literal["style"] = "style"
    code: Annotated[tuple[Number, ...], Field(min_length=1, max_length=4096)]


class Build(_Operation):
    """Go on with another structure around cuboids of its own, in the canonical frame; the style stays."""

    op: Literal["build"] = "build"
    # The user's frame from here on, raw → canonical: scale, rotation by rows, translation; None: the canonical one.
    frame: Annotated[tuple[Number, ...], Field(min_length=13, max_length=13)] | None = None
    structure: Annotated[str, Field(max_length=200_000)]  # JSON: a program and its place, or a hierarchy with cuboids


class Undo(_Operation):
    """Take the last operation back that is not taken back yet."""

    op: Literal["undo"] = "undo"


class Redo(_Operation):
    """Do again what was taken back last."""

    op: Literal["redo"] = "redo"


Operation = Move | Resize | Rotate | Scale | Set | Swap | Blend | Style | Build | Undo | Redo
Script = tuple[Operation, ...]
KINDS: dict[str, type[BaseModel]] = {
    kind.model_fields["op"].default: kind
    for kind in (Move, Resize, Rotate, Scale, Set, Swap, Blend, Style, Build, Undo, Redo)
}

_SCRIPT: TypeAdapter[Script] = TypeAdapter(
    Annotated[
        tuple[Annotated[Operation, Field(discriminator="op")], ...],
        Field(max_length=MAX_OPERATIONS),
    ]
)


def parse(text: str) -> Script:
    """The operations of a script. Raises InputError that names the first bad entry, what came and what was wanted."""
    if len(text) > MAX_CHARACTERS:
        raise InputError(f"script: {len(text):,} characters; wanted at most {MAX_CHARACTERS:,}")
    try:
        return _SCRIPT.validate_json(text)
    except ValidationError as error:
        raise InputError(f"script: {_said(error)}") from error


def dump(script: Iterable[Operation]) -> str:
    """The script as JSON, an operation a line; `parse` reads it back as it was."""
    lines = [operation.model_dump_json() for operation in script]
    return "[\n " + ",\n ".join(lines) + "\n]\n" if lines else "[]\n"


def _said(failure: ValidationError) -> str:
    """The first thing that is wrong, in words."""
    errors = failure.errors(include_url=False)
    error = errors[0]
    where, came, context = error["loc"], error["input"], error.get("ctx", {})
    if not where:
        return f'{error["msg"]}; wanted a list of at most {MAX_OPERATIONS:,} operations: [{{"op": ...}}, ...]'
    if error["type"] in ("union_tag_not_found", "union_tag_invalid"):
        kind = context.get("tag")
        got = f"op {kind!r}" if kind else f"got {_short(came)}"
        return f'operation {where[0]}: {got}; wanted {{"op": ...}} with one of {", ".join(KINDS)}'
    if len(where) == 1:
        return f"operation {where[0]}: {error['msg']}; got {_short(came)}"
    kind, path = str(where[1]), ".".join(map(str, where[2:]))
    known = ", ".join(name for name in KINDS[kind].model_fields if name != "op")
    match error["type"]:
        case "missing":
            said = f"{path} is missing"
        case "extra_forbidden":
            said = f"{path} is not known"
        case _:
            return f"operation {where[0]}: {kind}: {path}: {error['msg']}; got {_short(came)}"
    return f"operation {where[0]}: {kind}: {said}; it has {known or 'nothing else'}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}…"
