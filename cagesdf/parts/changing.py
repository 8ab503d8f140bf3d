"""Parts of a whole shape, changed by hand: merge several, split one by a plane, give one another name or label.

A change is a line of words, as on a command line: `merge NAME NAME …`, `split NAME x|y|z PLACE`, `rename NAME NEW`,
`label NAME LABEL`. Names with spaces are quoted. PLACE is a coordinate in the file's frame and unit.
"""

import math
import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cagesdf.cage_fitting.boxes import straight_cuboid
from cagesdf.cuboid import Cage
from cagesdf.errors import InputError, NotSolidError, ShapeRejected
from cagesdf.frames import Similarity, canonical_similarity
from cagesdf.geometry.meshes import join
from cagesdf.parts.cutting import MIN_SIZE, SLACK, Fragment, cut
from cagesdf.parts.finding import FoundPart, FoundParts, as_written, find_parts, moved_plane
from cagesdf.shape import RawShape, WrittenParts

STAGE = "parts"
AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class Dissection:
    """A whole shape taken apart."""

    shape_id: str
    result: FoundParts
    placement: Similarity  # raw → canonical

    @staticmethod
    def of(raw: RawShape, up: str, tolerance: float, min_thickness: float) -> "Dissection":
        """The parts that are found in a shape, whatever groups its file has; settings as `import_shape`'s.

        Raises ShapeRejected for a surface that can't be made solid.
        """
        mesh = join([part.mesh for part in raw.parts])
        placement = canonical_similarity(mesh.vertices, up)
        canonical = mesh.with_vertices(placement.to_canonical(mesh.vertices))
        try:
            return Dissection(raw.shape_id, find_parts(canonical, tolerance, min_thickness), placement)
        except NotSolidError as error:
            raise ShapeRejected(raw.shape_id, STAGE, f"its surface {error}") from error

    def changed(self, changes: list[str]) -> "Dissection":
        """After all changes, in turn. Raises InputError as the function of that name."""
        return replace(self, result=changed(self.result, changes, self.placement))

    def written(self) -> WrittenParts:
        """The parts as a file beside the mesh keeps them."""
        return as_written(self.result, self.placement)

    def cage(self) -> Cage:
        """A cuboid around each part, canonical."""
        return Cage.of({part.name: straight_cuboid(part.mesh.vertices, SLACK, MIN_SIZE) for part in self.result.parts})


def changed(found: FoundParts, changes: list[str], placement: Similarity) -> FoundParts:
    """The parts after all changes, in turn; `placement` is raw → canonical.

    Raises InputError that quotes the change: unknown words or parts, a name that is taken, a plane beside the part.
    """
    for line in changes:
        try:
            found = _after(found, line, placement)
        except ValueError as error:
            raise InputError(f"change {line!r}: {error}") from error
    return found


def _after(found: FoundParts, line: str, placement: Similarity) -> FoundParts:
    word, *names = shlex.split(line) or [""]  # raises ValueError for a quote that isn't closed
    if word not in CHANGES or not CHANGES[word][0](len(names)):
        wanted = "; ".join(usage for _, usage, _ in CHANGES.values())
        raise ValueError(f"wanted one of: {wanted}")
    return replace(found, parts=tuple(CHANGES[word][2](list(found.parts), names, placement)))


def _merge(parts: list[FoundPart], names: list[str], _: Similarity) -> list[FoundPart]:
    """The first part takes the others' fragments; its name and label stay."""
    members = [_place(parts, name) for name in dict.fromkeys(names)]
    if len(members) < 2:
        raise ValueError("wanted two different parts or more")
    first = parts[members[0]]
    fragments = tuple(fragment for member in members for fragment in parts[member].fragments)
    parts[members[0]] = FoundPart.of(first.name, first.label, fragments)
    return [part for place, part in enumerate(parts) if place not in members[1:]]


def _split(parts: list[FoundPart], words: list[str], placement: Similarity) -> list[FoundPart]:
    """The lower side keeps the name, the upper one gets a new one after it; both keep the label."""
    name, axis, coordinate = words
    place = _place(parts, name)
    if axis not in AXES:
        raise ValueError(f"wanted x, y or z as axis, got {axis!r}")
    offset = float(coordinate)  # raises ValueError that quotes it
    if not math.isfinite(offset):
        raise ValueError(f"wanted a finite place, got {coordinate!r}")
    normal = np.eye(3)[AXES.index(axis)]
    plane = moved_plane((*normal.tolist(), offset), placement)
    sides: tuple[list[Fragment], list[Fragment]] = ([], [])  # below, above
    for fragment in parts[place].fragments:
        for solid, half in cut(fragment.solid, plane):
            above = half != plane
            sides[above].append(Fragment(solid, fragment.component, (*fragment.planes, half)))
    if not all(sides):
        corners = placement.to_raw(parts[place].mesh.vertices) @ normal
        raise ValueError(f"the plane is beside the part, which reaches from {corners.min():.6g} to {corners.max():.6g}")
    label, taken = parts[place].label, {part.name for part in parts}
    number = next(i for i in range(2, len(parts) + 3) if f"{name}_{i}" not in taken)
    lower, upper = FoundPart.of(name, label, tuple(sides[0])), FoundPart.of(f"{name}_{number}", label, tuple(sides[1]))
    return [*parts[:place], lower, upper, *parts[place + 1 :]]


def _rename(parts: list[FoundPart], names: list[str], _: Similarity) -> list[FoundPart]:
    name, new = names
    place = _place(parts, name)
    if not new.strip() or not new.isprintable():
        raise ValueError(f"wanted a name of printable letters, got {new!r}")
    if new != name and any(part.name == new for part in parts):
        raise ValueError(f"there is a part {new!r} already")
    parts[place] = replace(parts[place], name=new)
    return parts


def _label(parts: list[FoundPart], words: list[str], _: Similarity) -> list[FoundPart]:
    name, label = words
    if label and not label.isprintable():
        raise ValueError(f"wanted a label of printable letters, got {label!r}")
    place = _place(parts, name)
    parts[place] = replace(parts[place], label=label)
    return parts


def _place(parts: list[FoundPart], name: str) -> int:
    """The index of a part. Raises ValueError that lists the names there are."""
    names = [part.name for part in parts]
    if name not in names:
        raise ValueError(f"there is no part {name!r}; the shape has {', '.join(names)}")
    return names.index(name)


Change = Callable[[list[FoundPart], list[str], Similarity], list[FoundPart]]
# By its first word: whether it takes so many more, how it is written, and the change.
CHANGES: dict[str, tuple[Callable[[int], bool], str, Change]] = {
    "merge": (lambda count: count >= 2, "merge NAME NAME …", _merge),
    "split": (lambda count: count == 3, "split NAME x|y|z PLACE", _split),
    "rename": (lambda count: count == 2, "rename NAME NEW", _rename),
    "label": (lambda count: count == 2, "label NAME LABEL", _label),
}
