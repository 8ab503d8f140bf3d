"""Operations of the hand: a gizmo that is dragged, a face that is pulled, numbers that are typed, buttons."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.editing.operations import SMALLEST
from cagesdf.editing.script import Add, Axis, Duplicate, End, Move, Resize, Rotate, Split
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.viewing.angles import AXES, turns
from cagesdf.viewing.snapping import snapped

GAP = 1.2  # from a part to its copy, in extents of the part
NEW_PART = 0.25  # canonical: lengths of a cuboid that is added

Numbers = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Hand:
    """Cuboids of a state, held by a hand."""

    state: State
    parts: tuple[str, ...]  # ids
    pattern: str  # names of these, for operations
    followers: Mapping[str, Any]  # fields of operations that move or stretch: who follows, and what details do

    @property
    def one(self) -> Cuboid:
        """The only cuboid. Raises InputError if it isn't the only one."""
        if len(self.parts) != 1:
            raise InputError(f"wanted one cuboid selected, not {len(self.parts)}")
        return self.state.cage[self.parts[0]]

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

    def placed(self, centre: Numbers) -> Move:
        """The move of the only cuboid's centre to a place in the user's frame."""
        return self._move(self.state.similarity.to_canonical(np.array([centre]))[0] - self.one.centre)

    def resized(self, lengths: Numbers) -> Iterator[Resize]:
        """The operations that give the only cuboid these lengths, in the user's unit. Raises InputError for some."""
        scale = self.state.similarity.scale
        if min(lengths) < SMALLEST / scale:
            raise InputError(f"lengths are at least {SMALLEST / scale:.1g}")
        for axis, length in zip(AXES, lengths):
            row, _ = self.state.own_axis(axis)
            factor = length * scale / float(self.one.size[row])
            if abs(factor - 1) > 1e-4:
                yield Resize(part=self.pattern, axis=axis, factor=factor, **self.followers)

    def turned(self, angles: Numbers) -> Iterator[Rotate]:
        """The operations that turn the only cuboid to these angles (`angles.angles_of`)."""
        for axis, angle in turns(self.state, self.one, angles):
            yield Rotate(part=self.pattern, axis=axis, angle=angle, **self.followers)

    def duplicate(self) -> Duplicate:
        """Copies beside the parts: along the axis along which these are shortest, as slats and books stand."""
        corners = only(self.state.cage, self.parts).corners().reshape(-1, 3)
        extent = np.ptp(self.state.similarity.to_raw(corners), axis=0)
        displacement = [0.0, 0.0, 0.0]
        displacement[int(extent.argmin())] = GAP * float(extent.min())
        x, y, z = displacement
        return Duplicate(part=self.pattern, by=(x, y, z), mirror=self.followers["mirror"])

    def split(self) -> Split:
        """The only cuboid in two halves, across its longest axis."""
        axis, _ = _named(self.state, int(self.one.size.argmax()))
        follow = {name: self.followers[name] for name in ("mirror", "repeat")}
        return Split(part=self.pattern, axis=axis, **follow)

    def _move(self, displacement: Float[ndarray, " 3"]) -> Move:
        similarity = self.state.similarity
        x, y, z = (similarity.rotation.T @ displacement / similarity.scale).tolist()
        return Move(part=self.pattern, by=(x, y, z), **self.followers)


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
