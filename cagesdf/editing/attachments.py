"""Parts that touch stay in contact: a part that is attached to a changed one follows with the face that is attached.

The other end of a part that follows stays where it is; a board that is attached across its thickness moves as a whole,
so that its thickness stays. Parts that still touch as they did, a leg that slides under the seat, are left alone.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from manifold3d import Manifold
from numpy import ndarray
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.deformation.matching import CONTACT, gaps, touching

LEAST = 1e-3  # canonical: no part that follows gets shorter
PLAY = 1e-6  # canonical: a contact that opens, or a part that is pushed into another, by no more is as it was
BOARD = 0.5  # a cuboid with one length below this share of the others is a board


@dataclass(frozen=True, eq=False)
class Pull:
    """A change of a neighbour, as a cuboid that is attached to it feels it."""

    axis: int  # of the cuboid, along which the attached face looks
    side: int  # -1 or 1: along the axis or against it
    displacement: Float[ndarray, " 3"]  # of the neighbour's material in the middle of the contact, canonical


def attached(before: Cage, after: Cage, changed: Set[str]) -> Cage:
    """The cage `after` in which parts that weren't changed keep the contacts that they have in `before`.

    Parts that don't have to follow stay the same to the last bit. Two parts of `changed` may lose each other: that was
    asked for. Every other contact is at most as open as it was, but for PLAY.
    """
    contacts, moved = Contacts.of(before), set(changed)
    cage = after
    for _ in range(len(before)):
        pulls = _pulls(before, cage, contacts, moved)
        if not pulls:
            break
        cage = Cage.of({part: _pulled(cuboid, pulls.get(part, ())) for part, cuboid in cage.cuboids().items()})
        moved |= pulls.keys()
    return _reaching(cage, contacts.opened(cage), changed)


@dataclass(frozen=True, eq=False)
class Contacts:
    """Which cuboids of a cage touch, and how."""

    touching: Bool[ndarray, "p p"]
    gap: Float[ndarray, "p p"]  # how far apart they are, canonical units, 0 where they overlap
    faces: Float[ndarray, "p p 3"]  # of a cuboid and another: see `_apart`

    @staticmethod
    def of(cage: Cage) -> "Contacts":
        """The contacts of a cage: as `matching.touching` has them."""
        return Contacts(touching(cage), np.maximum(gaps(cage), 0), _apart(cage))

    def opened(self, cage: Cage) -> Bool[ndarray, "p p"]:
        """Which of them are more open in another cage of the same parts."""
        return self.touching & (gaps(cage) > self.gap + PLAY)

    def pushed(self, cage: Cage) -> Bool[ndarray, "p p"]:
        """In which of them one part is pushed into the other."""
        before, after = (np.maximum(side, side.T) for side in (self.faces.max(axis=2), _apart(cage).max(axis=2)))
        return self.touching & (after < np.minimum(before, 0) - PLAY)


def _apart(cage: Cage) -> Float[ndarray, "p p 3"]:
    """How far another cuboid is beyond the nearer face of a cuboid, along each of its axes; negative: how deep in."""
    ways = np.abs(np.einsum("ikx,ijx->ijk", cage.axes, cage.centre[None] - cage.centre[:, None]))
    reach = np.einsum("ijkm,jm->ijk", np.abs(np.einsum("ikx,jmx->ijkm", cage.axes, cage.axes)), cage.size / 2)
    return ways - cage.size[:, None] / 2 - reach


def _pulls(before: Cage, now: Cage, contacts: Contacts, moved: Set[str]) -> dict[str, list[Pull]]:
    """Pulls on each part that hasn't moved yet, from contacts that opened or were pushed into it."""
    worse = contacts.opened(now) | contacts.pushed(now)
    has_moved = np.isin(now.part_ids, list(moved))
    pulls: dict[str, list[Pull]] = {}
    for i, j in np.argwhere(worse & ~has_moved[:, None] & has_moved).tolist():
        cuboid, neighbour = before[before.part_ids[i]], before[before.part_ids[j]]
        point = _middle(cuboid, neighbour)
        displacement = _carried(point, neighbour, now[now.part_ids[j]]) - point
        axis = int(contacts.faces[i, j].argmax())
        side = 1 if cuboid.axes[axis] @ (neighbour.centre - cuboid.centre) > 0 else -1
        pulls.setdefault(now.part_ids[i], []).append(Pull(axis, side, displacement))
    return pulls


def _middle(a: Cuboid, b: Cuboid) -> Float[ndarray, " 3"]:
    """The middle of the intersection of two cuboids that touch, once each is CONTACT longer."""
    common = _solid(a) ^ _solid(b)
    if common.is_empty():  # they just touch
        return (a.centre + b.centre) / 2
    vertices = (common.to_mesh64().vert_properties[:, :3] - a.centre) @ a.axes.T
    return a.centre + (vertices.min(axis=0) + vertices.max(axis=0)) / 2 @ a.axes


def _solid(cuboid: Cuboid) -> Manifold:
    pose = np.concatenate([cuboid.axes.T, cuboid.centre[:, None]], axis=1)
    return Manifold.cube((cuboid.size + CONTACT).tolist(), True).transform(pose)


def _carried(point: Float[ndarray, " 3"], before: Cuboid, after: Cuboid) -> Float[ndarray, " 3"]:
    """Where a cuboid's change takes its material."""
    unit = (point - before.centre) @ before.axes.T / before.size
    return after.centre + (unit * after.size) @ after.axes


def _pulled(cuboid: Cuboid, pulls: Sequence[Pull]) -> Cuboid:
    """The cuboid with its attached faces moved along; several pulls at one face move it by their mean."""
    ends: dict[tuple[int, int], list[Float[ndarray, " 3"]]] = {}
    for pull in pulls:
        ends.setdefault((pull.axis, pull.side), []).append(pull.displacement)
    mean = {face: np.mean(displacements, axis=0) for face, displacements in ends.items()}
    for axis in sorted({axis for axis, _ in mean}):
        low, high = (mean.get((axis, side)) for side in (-1, 1))
        if _is_board(cuboid, axis):
            displacement = np.mean([end for end in (low, high) if end is not None], axis=0)
            cuboid = replace(cuboid, centre=cuboid.centre + displacement)
        else:
            cuboid = _between(cuboid, axis, low, high)
    return cuboid


def _is_board(cuboid: Cuboid, axis: int) -> bool:
    """Whether the cuboid is thin along an axis; a rod is so along two."""
    return bool(cuboid.size[axis] <= BOARD * cuboid.size.max()) and bool(cuboid.size[axis] == cuboid.size.min())


def _between(cuboid: Cuboid, axis: int, low: Float[ndarray, " 3"] | None, high: Float[ndarray, " 3"] | None) -> Cuboid:
    """The cuboid with its two faces along an axis displaced, None: not at all; turned as little as may be."""
    half = cuboid.size[axis] / 2 * cuboid.axes[axis]
    start = cuboid.centre - half + (0 if low is None else low)
    end = cuboid.centre + half + (0 if high is None else high)
    length = float(np.linalg.norm(end - start))
    direction = (end - start) / length if length > LEAST else cuboid.axes[axis]
    size = cuboid.size.copy()
    size[axis] = max(length, LEAST)
    return Cuboid((start + end) / 2, _turned(cuboid.axes, axis, direction), size)


def _turned(axes: Float[ndarray, "3 3"], axis: int, direction: Float[ndarray, " 3"]) -> Float[ndarray, "3 3"]:
    """Axes turned by the least angle so that one of them has a direction."""
    normal = np.cross(axes[axis], direction)
    sine = float(np.linalg.norm(normal))
    if sine < 1e-12:
        return axes
    angle = np.arctan2(sine, axes[axis] @ direction)
    return axes @ Rotation.from_rotvec(angle * normal / sine).as_matrix().T


def _reaching(cage: Cage, opened: Bool[ndarray, "p p"], changed: Set[str]) -> Cage:
    """The cage in which contacts that are still open are closed by the parts that weren't changed, which grow.

    A cuboid that grows loses no contact.
    """
    grown = cage.cuboids()
    for i, j in np.argwhere(opened).tolist():
        part, neighbour = cage.part_ids[i], cage.part_ids[j]
        if part not in changed:
            grown[part] = _grown(grown[part], _nearest(cage[neighbour], cage[part]))
    return Cage.of(grown)


def _nearest(cuboid: Cuboid, other: Cuboid) -> Float[ndarray, " 3"]:
    """The point of a cuboid that is nearest to another one, by projections onto both in turn."""
    point = other.centre
    for _ in range(100):
        point = _clamped(other, _clamped(cuboid, point))
    return _clamped(cuboid, point)


def _clamped(cuboid: Cuboid, point: Float[ndarray, " 3"]) -> Float[ndarray, " 3"]:
    local = (point - cuboid.centre) @ cuboid.axes.T
    return cuboid.centre + local.clip(-cuboid.size / 2, cuboid.size / 2) @ cuboid.axes


def _grown(cuboid: Cuboid, point: Float[ndarray, " 3"]) -> Cuboid:
    """The least cuboid with the same axes that holds this one and a point."""
    local = (point - cuboid.centre) @ cuboid.axes.T
    low, high = np.minimum(-cuboid.size / 2, local), np.maximum(cuboid.size / 2, local)
    return Cuboid(cuboid.centre + (low + high) / 2 @ cuboid.axes, cuboid.axes, high - low)
