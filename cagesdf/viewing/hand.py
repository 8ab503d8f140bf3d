"""Operations of the hand: a gizmo that is dragged, a face that is pulled, numbers that are typed, buttons."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.editing.links import linked, repeats
from cagesdf.editing.operations import SMALLEST
from cagesdf.editing.parts import part_names
from cagesdf.editing.script import Add, Axis, Duplicate, End, Move, Resize, Rotate, Split
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.viewing.angles import AXES, angles_of, turns
from cagesdf.viewing.fields import Typed
from cagesdf.viewing.snapping import snapped

GAP = 1.2  # from a part to its copy, in extents of the part
NEW_PART = 0.25  # canonical: lengths of a cuboid that is added
STRAIGHT = 0.02  # of a row's length: how far from a line its parts stand


@dataclass(frozen=True, eq=False)
class Hand:
    """Cuboids of a state, held by a hand."""

    state: State
    parts: tuple[str, ...]  # ids
    pattern: str  # names of these, for operations
    followers: Mapping[str, Any]  # fields of operations that move or stretch: who follows, and what details do

    @property
    def only_part(self) -> str:
        """The id of the only cuboid. Raises InputError if it isn't the only one."""
        if len(self.parts) != 1:
            raise InputError(f"wanted one cuboid selected, not {len(self.parts)}")
        return self.parts[0]

    @property
    def one(self) -> Cuboid:
        """The only cuboid. Raises InputError if it isn't the only one."""
        return self.state.cage[self.only_part]

    def dragged(self, centre: Float[ndarray, " 3"], axes: Float[ndarray, "3 3"], snap: bool) -> Move | Rotate | None:
        """The operation of a dragged gizmo: a turn about one axis, or a move; None without a change.

        With `snap` a cuboid that comes near another one comes into contact with it.
        """
        before, axes_before = gizmo_frame(self.state, self.parts)
        if before is None:
            return None
        turn = _turn(axes_before, axes)
        if turn is not None:
            row, degrees = turn
            if len(self.parts) == 1:
                axis, sign = _named(self.state, row)
                return Rotate(part=self.pattern, axis=axis, angle=sign * degrees, **self.followers)
            return Rotate(part=self.pattern, axis=AXES[row], angle=degrees, frame="shape", **self.followers)
        displacement = centre - before
        if not displacement.any():
            return None
        if snap:
            cage = self.state.cage
            held = only(cage, self.parts)
            moved = Cage(held.part_ids, held.centre + displacement, held.axes, held.size)
            others = only(cage, [part for part in cage.part_ids if part not in self.parts])
            displacement = displacement + snapped(moved, others) * (np.abs(displacement) > 1e-9)
        return self._move(displacement)

    def pulled(self, axis: int, side: int, distance: float) -> Resize:
        """The operation of a face that is pulled outwards by a canonical distance; the face across stays."""
        length = float(self.one.size[axis])
        name, sign = _named(self.state, axis)
        factor = float(np.clip((length + distance) / length, 0.02, 50))
        keep: End = "low" if side * sign > 0 else "high"
        return Resize(part=self.pattern, axis=name, factor=factor, keep=keep, **self.followers)

    def placed(self, centre: Typed) -> Move:
        """The move of the gizmo's centre to a place in the user's frame; along axes with None it stays where it is."""
        before, _ = gizmo_frame(self.state, self.parts)
        if before is None:
            raise InputError("no part is selected; click those that are meant")
        [start] = self.state.similarity.to_raw(before[None])
        x, y, z = (0.0 if end is None else end - float(was) for end, was in zip(centre, start, strict=True))
        return Move(part=self.pattern, by=(x, y, z), **self.followers)

    def resized(self, lengths: Typed) -> Iterator[Resize]:
        """The operations that give the only cuboid these lengths, in the user's unit; those with None stay.

        Raises InputError for lengths that can't be.
        """
        scale = self.state.similarity.scale
        if any(length is not None and length < SMALLEST / scale for length in lengths):
            raise InputError(f"lengths are at least {SMALLEST / scale:.1g}")
        for axis, length in zip(AXES, lengths, strict=True):
            if length is None:
                continue
            row, _ = self.state.own_axis(axis)
            factor = length * scale / float(self.one.size[row])
            if abs(factor - 1) > 1e-4:
                yield Resize(part=self.pattern, axis=axis, factor=factor, **self.followers)

    def turned(self, angles: Typed) -> Iterator[Rotate]:
        """The operations that turn the only cuboid to these angles (`angles.angles_of`); those with None stay."""
        now = angles_of(self.state, self.one).tolist()
        x, y, z = (was if angle is None else angle for angle, was in zip(angles, now, strict=True))
        for axis, angle in turns(self.state, self.one, (x, y, z)):
            yield Rotate(part=self.pattern, axis=axis, angle=angle, **self.followers)

    def duplicate(self) -> Duplicate:
        """Copies beside the parts: along the axis along which these are shortest, as slats and books stand."""
        corners = only(self.state.cage, self.parts).corners().reshape(-1, 3)
        extent = np.ptp(self.state.similarity.to_raw(corners), axis=0)
        displacement = [0.0, 0.0, 0.0]
        displacement[int(extent.argmin())] = GAP * float(extent.min())
        x, y, z = displacement
        return Duplicate(part=self.pattern, by=(x, y, z), mirror=self.followers["mirror"])

    def row(self) -> list[str]:
        """Ids of the parts that stand in a line with the only one, from one end to the other.

        They repeat it or, where the structure knows of none that does, have its label. Raises InputError without any.
        """
        cage, part, labels = self.state.cage, self.only_part, self.state.structure.labels()
        members = linked((part,), [repeats(self.state)])
        if len(members) == 1:
            members = tuple(other for other in cage.part_ids if other == part or labels[other] == labels[part] != "")
        centres = np.array([cage[member].centre for member in members])
        from_first = centres - centres[0]
        apart = np.linalg.norm(from_first, axis=1)
        if not apart.any():
            raise InputError("no other part repeats it; Duplicate copies it, and the copy repeats it")
        line = from_first[apart.argmax()] / apart.max()
        along = from_first @ line
        if np.linalg.norm(from_first - along[:, None] * line, axis=1).max() > STRAIGHT * np.ptp(along):
            raise InputError("the parts that repeat it don't stand in a row; Duplicate copies it alone")
        return [members[i] for i in np.argsort(along, kind="stable")]

    def one_more(self) -> list[Move | Duplicate]:
        """One more part in the row of the only one: the row's ends stay, and all between stand evenly.

        Raises InputError where there is no row, and where it would stand closer than its parts are thick.
        """
        row, cage = self.row(), self.state.cage
        first, last = cage[row[0]].centre, cage[row[-1]].centre
        step = (last - first) / len(row)
        thick = float(np.abs(cage[row[0]].axes @ step / np.linalg.norm(step)) @ cage[row[0]].size)
        if np.linalg.norm(step) < thick:
            scale = self.state.similarity.scale
            apart = f"{np.linalg.norm(step) / scale:.3g} apart, {thick / scale:.3g} thick"
            raise InputError(f"no room in the row: {len(row) + 1} would stand {apart}; make them thinner first")
        names = part_names(self.state.structure)
        inner = [(part, first + place * step) for place, part in enumerate(row[1:-1], start=1)]
        moves = [self._alone(names[part], to - cage[part].centre) for part, to in inner]
        copied, at = inner[-1] if inner else (row[0], first)
        displacement = self._in_file_units(first + (len(row) - 1) * step - at)
        return [*moves, Duplicate(part=names[copied], by=displacement, mirror=False, repeat=False)]

    def split(self) -> Split:
        """The only cuboid in two halves, across its longest axis."""
        axis, _ = _named(self.state, int(self.one.size.argmax()))
        follow = {name: self.followers[name] for name in ("mirror", "repeat")}
        return Split(part=self.pattern, axis=axis, **follow)

    def _move(self, displacement: Float[ndarray, " 3"]) -> Move:
        return Move(part=self.pattern, by=self._in_file_units(displacement), **self.followers)

    def _alone(self, name: str, displacement: Float[ndarray, " 3"]) -> Move:
        return Move(part=name, by=self._in_file_units(displacement), mirror=False, repeat=False)

    def _in_file_units(self, displacement: Float[ndarray, " 3"]) -> tuple[float, float, float]:
        """A canonical displacement in the user's frame and unit."""
        similarity = self.state.similarity
        x, y, z = (similarity.rotation.T @ displacement / similarity.scale).tolist()
        return x, y, z


def on_top(state: State) -> Add:
    """A new cuboid on the top of a shape."""
    corners = state.cage.corners().reshape(-1, 3)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    middle[1] = corners[:, 1].max() + NEW_PART / 2
    x, y, z = state.similarity.to_raw(middle[None])[0].tolist()
    length = NEW_PART / state.similarity.scale
    return Add(name="part", centre=(x, y, z), lengths=(length, length, length))


def gizmo_frame(state: State, parts: Sequence[str]) -> tuple[Float[ndarray, " 3"] | None, Float[ndarray, "3 3"]]:
    """The gizmo's centre and axes: the cuboid's, or, around several, those of the user's frame. None without any."""
    if len(parts) == 1:
        return state.cage[parts[0]].centre, state.cage[parts[0]].axes
    corners = only(state.cage, parts).corners().reshape(-1, 3)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2 if len(corners) else None
    return middle, state.similarity.rotation.T


def decimals_of(state: State) -> int:
    """Decimals of lengths in the user's unit: a ten-thousandth of the shape's longest side, or less; below 0: tens."""
    side = float(np.ptp(state.cage.corners().reshape(-1, 3), axis=0).max()) / state.similarity.scale
    return int(4 - np.floor(np.log10(side)))


def only(cage: Cage, parts: Sequence[str]) -> Cage:
    """Some cuboids of a cage."""
    return Cage.of({part: cage[part] for part in parts})


def _turn(before: Float[ndarray, "3 3"], after: Float[ndarray, "3 3"]) -> tuple[int, float] | None:
    """The axis (row) about which a frame has turned most, and degrees; None without a turn."""
    vector = Rotation.from_matrix(before @ after.T).as_rotvec(degrees=True)
    row = int(np.abs(vector).argmax())
    return (row, float(vector[row])) if abs(vector[row]) > 1e-3 else None


def _named(state: State, row: int) -> tuple[Axis, float]:
    """The user's axis that one of the cuboids' axes is named after, and its sign, 1 or -1."""
    for axis in AXES:
        row_of_axis, sign = state.own_axis(axis)
        if row_of_axis == row:
            return axis, sign
    raise AssertionError(f"no axis is named {row}")
