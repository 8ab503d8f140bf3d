"""Scripts: lists of operations as JSON, the same for the command and for an editor.

    [{"op": "resize", "part": "leg_*", "axis": "y", "factor": 1.3}, {"op": "swap", "style_of": "chair_0007"}]

Lengths, axes and directions are the user's: those of the shape's own file. A cuboid's own axes are
named after the user's axes that they were nearest to when the cuboid was fitted. What the operations do
is `operations.py`'s.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from cagesdf.errors import SHOWN, InputError

MAX_CHARACTERS = 1_000_000
MAX_BYTES = 4 * MAX_CHARACTERS  # of a script's file: at most four bytes a character
MAX_OPERATIONS = 1_000
MAX_PATTERN = 20_000  # characters that name parts: the names of all parts that a shape may have
MAX_STRUCTURE = 200_000  # characters
_WANTED = f'wanted a list of at most {MAX_OPERATIONS:,} operations: [{{"op": ...}}, ...]'

_Length = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
_Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Factor = Annotated[float, Field(allow_inf_nan=False, ge=0.01, le=100)]

# Each type's description is what a message says was wanted.
Part = Annotated[
    str, Field(min_length=1, max_length=MAX_PATTERN, description="a part's name, or several: leg_*, seat|back")
]
Source = Annotated[
    Annotated[str, Field(min_length=1, max_length=MAX_PATTERN)] | None,
    Field(description="the name of the other shape's part, or of several: leg_*, seat|back; or null"),
]
Vector = Annotated[
    tuple[_Length, _Length, _Length], Field(description="three numbers [x, y, z], each from -1e12 to 1e12")
]
Angle = Annotated[_Number, Field(description="degrees, a number from -1e6 to 1e6")]
Value = Annotated[_Number, Field(description="a number from -1e6 to 1e6")]
Factor = Annotated[_Factor, Field(description="a number from 0.01 to 100")]
Factors = Annotated[
    tuple[_Factor, _Factor, _Factor], Field(description="three numbers [x, y, z], each from 0.01 to 100")
]
Weight = Annotated[float, Field(allow_inf_nan=False, ge=0, le=1, description="a number from 0 to 1")]
Share = Annotated[float, Field(allow_inf_nan=False, gt=0, lt=1, description="a number between 0 and 1")]
Like = Annotated[
    Annotated[str, Field(min_length=1, max_length=MAX_PATTERN)] | None,
    Field(description="the name of a part, or null"),
]
PartName = Annotated[str, Field(min_length=1, max_length=100, description="a name of at most 100 characters")]
_Positive = Annotated[float, Field(allow_inf_nan=False, gt=0, le=1e12)]
Lengths = Annotated[
    tuple[_Positive, _Positive, _Positive], Field(description="three numbers [x, y, z] above 0, at most 1e12")
]
Parameter = Annotated[str, Field(min_length=1, max_length=1000, description="a parameter's name, as inspect lists it")]
ShapeId = Annotated[str, Field(min_length=1, max_length=1000, description="the id of a shape")]
Axis = Annotated[Literal["x", "y", "z"], Field(description="x, y or z")]
Frame = Annotated[Literal["shape", "cuboid"], Field(description="shape or cuboid")]
End = Annotated[Literal["low", "centre", "high"], Field(description="low, centre or high")]
Details = Annotated[Literal["stretch", "keep"], Field(description="stretch or keep")]
Switch = Annotated[bool, Field(description="true or false")]
Code = Annotated[tuple[_Number, ...], Field(min_length=1, max_length=4096, description="the numbers of a latent code")]
Residuals = Annotated[
    dict[str, Annotated[tuple[_Number, ...], Field(max_length=4096)]] | None,
    Field(description="by part, as many numbers as a part's code has; or null"),
]
PartCodes = Annotated[
    dict[str, Annotated[tuple[_Number, ...], Field(max_length=4096)]] | None,
    Field(description="by part, the numbers of a latent code; or null"),
]
Placement = Annotated[
    Annotated[tuple[_Finite, ...], Field(min_length=13, max_length=13)] | None,
    Field(description="13 finite numbers: scale, rotation by rows, translation; or null"),
]
StructureText = Annotated[
    str,
    Field(max_length=MAX_STRUCTURE, description=f"a structure as JSON text, at most {MAX_STRUCTURE:,} characters"),
]


class _Operation(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, serialize_by_alias=True)


class Move(_Operation):
    """Move cuboids."""

    op: Literal["move"] = "move"
    part: Part  # id, name or label, with *, ? and | (or)
    by: Vector  # along x, y, z, the user's unit
    frame: Frame = "shape"  # whose axes these are: the user's, or each cuboid's own
    mirror: Switch = True  # parts that mirror these do the mirrored thing
    repeat: Switch = False  # parts that repeat these do the same thing in their places
    attach: Switch = False  # parts that touch these stay in contact: their attached faces follow
    details: Details = "stretch"  # of cuboids that change their lengths: they stretch along, or keep their size


class Resize(_Operation):
    """Stretch cuboids: each along its own axis, or all together along the shape's."""

    op: Literal["resize"] = "resize"
    part: Part  # id, name or label, with *, ? and | (or)
    axis: Axis
    factor: Factor
    keep: End = "centre"  # what stays where it is, along the axis: of each cuboid, or of their common box
    frame: Frame = "cuboid"
    mirror: Switch = True  # parts that mirror these do the mirrored thing
    repeat: Switch = False  # parts that repeat these do the same thing in their places
    attach: Switch = False  # parts that touch these stay in contact: their attached faces follow
    details: Details = "stretch"  # of cuboids that change their lengths: they stretch along, or keep their size


class Rotate(_Operation):
    """Turn cuboids: each about its centre and an axis of its own, or all together about the centre of their box."""

    op: Literal["rotate"] = "rotate"
    part: Part  # id, name or label, with *, ? and | (or)
    axis: Axis
    angle: Angle  # degrees, counter-clockwise seen from the axis's tip
    frame: Frame = "cuboid"
    mirror: Switch = True  # parts that mirror these do the mirrored thing
    repeat: Switch = False  # parts that repeat these do the same thing in their places
    attach: Switch = False  # parts that touch these stay in contact: their attached faces follow
    details: Details = "stretch"  # of cuboids that change their lengths: they stretch along, or keep their size


class Add(_Operation):
    """Add a cuboid along x, y, z, with the style of one of the other parts."""

    op: Literal["add"] = "add"
    name: PartName  # its label
    centre: Vector  # the user's frame
    lengths: Lengths  # along x, y, z, the user's unit
    like: Like = None  # the part whose style it has; None: the one whose lengths are most alike


class Duplicate(_Operation):
    """Repeat cuboids in another place: the copies look as their originals do, and repeat them from then on."""

    op: Literal["duplicate"] = "duplicate"
    part: Part  # id, name or label, with *, ? and | (or)
    by: Vector  # to where, along x, y, z, the user's unit
    mirror: Switch = True  # parts that mirror these are duplicated, mirrored
    repeat: Switch = False  # parts that repeat these are duplicated, too


class Delete(_Operation):
    """Take cuboids away."""

    op: Literal["delete"] = "delete"
    part: Part  # id, name or label, with *, ? and | (or)
    mirror: Switch = True  # parts that mirror these go, too
    repeat: Switch = False  # parts that repeat these go, too


class Split(_Operation):
    """Cut cuboids in two: the lower end keeps id and place in the structure, the other one is a new part."""

    op: Literal["split"] = "split"
    part: Part  # id, name or label, with *, ? and | (or)
    axis: Axis  # of the cuboid, across which it is cut
    at: Share = 0.5  # of its length, from its low end
    mirror: Switch = True  # parts that mirror these are cut, mirrored
    repeat: Switch = False  # parts that repeat these are cut, too


class Scale(_Operation):
    """Stretch the whole cage about the centre of the shape's box at rest."""

    op: Literal["scale"] = "scale"
    factors: Factors  # along x, y, z
    details: Details = "stretch"  # of cuboids that change their lengths: they stretch along, or keep their size


class Set(_Operation):
    """Give a number of the shape's program another value; what is attached to it, or repeats it, follows."""

    op: Literal["set"] = "set"
    parameter: Parameter  # as `cagesdf inspect RUN --shape ID` lists them
    value: Value  # lengths in the program's unit, places as shares
    details: Details = "stretch"  # of cuboids that change their lengths: they stretch along, or keep their size


class Swap(_Operation):
    """Take another shape's style: its latent code."""

    op: Literal["swap"] = "swap"
    style_of: ShapeId  # id of a shape


class Blend(_Operation):
    """Go from the current style towards another shape's."""

    op: Literal["blend"] = "blend"
    style_of: ShapeId  # id of a shape
    weight: Weight  # 0: the style stays, 1: it becomes the other's


class Mix(_Operation):
    """Take the style of another shape's parts in some parts; the others stay as they are."""

    op: Literal["mix"] = "mix"
    part: Part  # id, name or label, with *, ? and | (or)
    style_of: ShapeId  # id of a shape
    source: Source = Field(default=None, alias="from")  # its parts to take; None: those that correspond
    weight: Weight = 1.0  # 0: the style stays, 1: it becomes the other's
    mirror: Switch = True  # parts that mirror these take the style of the parts that correspond to them
    repeat: Switch = True  # parts that repeat these do so, too
    details: Details = "stretch"  # they stretch with the cuboid, or keep the size that they have in the other shape


class Style(_Operation):
    """Take a style by its latent code, and what single parts' codes differ from those that the network makes of it."""

    op: Literal["style"] = "style"
    code: Code
    residuals: Residuals = (
        None  # by part (id, name or label, with *, ? and |): what is added to its code; None: nothing
    )
    # By part: another latent code whose style it has; all others have this one. None: mixed parts stay as they are.
    parts: PartCodes = None


class Build(_Operation):
    """Go on with another structure around cuboids of its own, in the canonical frame; the style stays."""

    op: Literal["build"] = "build"
    # The user's frame from here on, raw → canonical: scale, rotation by rows, translation; None: the canonical one.
    frame: Placement = None
    structure: StructureText  # JSON: a program and its place, or a hierarchy with cuboids


class Harmonise(_Operation):
    """Let the network see the cage as it is: all parts get the codes that it has for them in these cuboids."""

    op: Literal["harmonise"] = "harmonise"


class Undo(_Operation):
    """Take the last operation back that is not taken back yet."""

    op: Literal["undo"] = "undo"


class Redo(_Operation):
    """Do again what was taken back last."""

    op: Literal["redo"] = "redo"


# The operations that lead from state to state.
Step = (
    Move
    | Resize
    | Rotate
    | Add
    | Duplicate
    | Delete
    | Split
    | Scale
    | Set
    | Swap
    | Blend
    | Mix
    | Style
    | Build
    | Harmonise
)
Operation = Step | Undo | Redo
Script = tuple[Operation, ...]
KINDS: dict[str, type[BaseModel]] = {kind.model_fields["op"].default: kind for kind in get_args(Operation)}

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
    if not text.strip():
        raise InputError(f"script: is empty; {_WANTED}")
    try:
        script = _SCRIPT.validate_json(text)
    except ValidationError as error:
        raise InputError(f"script: {_refusal(error)}") from error
    _check_keys(text)
    return script


def dump(script: Iterable[Operation]) -> str:
    """The script as JSON, an operation a line; `parse` reads it back as it was."""
    lines = [operation.model_dump_json() for operation in script]
    return "[\n " + ",\n ".join(lines) + "\n]\n" if lines else "[]\n"


@contextmanager
def refusing() -> Iterator[None]:
    """Operations that are made inside of numbers which can't be raise InputError, in the words of `parse`."""
    try:
        yield
    except ValidationError as error:
        if error.title.lower() not in KINDS:
            raise
        raise InputError(_refusal(error)) from error


def _refusal(failure: ValidationError) -> str:
    """The first thing that is wrong, in words: of a script, or of a single operation."""
    error = failure.errors(include_url=False)[0]
    where, came, context = error["loc"], error["input"], error.get("ctx", {})
    if failure.title.lower() in KINDS:
        return _field(failure.title.lower(), where, error["type"], came)
    if error["type"] == "json_invalid":
        return f"is no JSON: {context['error']}; {_WANTED}"
    if not where:
        got = f"{len(came):,} operations" if error["type"] == "too_long" else _short(came)
        return f"got {got}; {_WANTED}"
    if len(where) == 1:
        kind = context.get("tag")
        got = f"op {_short(kind)}" if kind else f"got {_short(came)}"
        return f'operation {where[0]}: {got}; wanted {{"op": ...}} with one of {", ".join(KINDS)}'
    return f"operation {where[0]}: {_field(str(where[1]), where[2:], error['type'], came)}"


def _field(kind: str, where: tuple[int | str, ...], error: str, came: Any) -> str:
    """Problem of a field of an operation, in words."""
    fields = {field.alias or name: field for name, field in KINDS[kind].model_fields.items()}
    path = _short(".".join(map(str, where)), _printable)
    field = fields.get(str(where[0])) if where else None
    if field is None or (error == "missing" and len(where) == 1):
        known = ", ".join(name for name in fields if name != "op")
        return f"{kind}: {path} is {'missing' if field else 'not known'}; it has {known or 'nothing else'}"
    came = "missing" if error == "missing" else _short(came)
    return f"{kind}: {path} is {came}; wanted {field.description}"


def _check_keys(text: str) -> None:
    """Raise InputError for an operation of a valid script that names a field twice: readers differ on which counts."""
    number = -1

    def check(pairs: list[tuple[str, Any]]) -> None:
        nonlocal number
        number += 1
        keys = [key for key, _ in pairs]
        for i, key in enumerate(keys):
            if key in keys[:i]:
                raise InputError(f"script: operation {number}: {_short(key)} is given twice; wanted it once")

    # Integers of any length, of fields that a later one hides, are no reason to fail.
    json.loads(text, object_pairs_hook=check, parse_int=float)


def _printable(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _short(value: Any, write: Callable[[Any], str] = repr) -> str:
    text = write(value)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}…"
