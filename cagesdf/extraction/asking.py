"""Choice of the points of a cuboid's lattice at which the network is evaluated."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from operator import add

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Shaped
from numpy import ndarray

from cagesdf.extraction.lattice import Lattice

# abs(value) / LIPSCHITZ bounds the distance to the surface. 1 would do for an exact SDF; the rest leaves room for
# networks that are steeper.
LIPSCHITZ = 1.5
# Between two neighbours of one sign on the last halving along an axis, the value counts as at most this much
# nearer to 0 than their mean, in steps between points: as if the slope changed by no more than twice that.
# With half of it pieces were lost (docs/log.md).
BEND = 1.0
# A point on a face counts as inside where the surface ends before it by no more than this, in the shortest steps: parts
# that fill their cuboids end there, and rounding would chamfer their edges by a cell.
FILLED = 0.05
SLAB = 16_384  # points of a sublattice that are settled at once: they fit into the processor's cache
INNER = (slice(1, -1),) * 3  # the lattice in arrays that have a layer more around it
POSITIVE = np.float32(1)  # value beyond the faces

Ask = Callable[[Int[ndarray, "n 3"]], Float32[ndarray, " n"]]  # of points of a lattice, by their indices
Triple = tuple[int, ...]  # a number for each axis


@dataclass(frozen=True, eq=False)
class Answers:
    """Values on a lattice, with a layer of points around it that are outside."""

    values: Float32[
        ndarray, "r s t"
    ]  # as `answered` at both ends of edges with two signs, elsewhere with the right sign
    asked: int  # points given to the network


Method = Callable[[Ask, float, Lattice], Answers]


def ask_densely(ask: Ask, reach: float, lattice: Lattice) -> Answers:
    """Evaluate the network at every point."""
    values = np.full(tuple(n + 2 for n in lattice.shape), POSITIVE)
    places = np.argwhere(np.ones(lattice.shape, bool))
    values[INNER] = answered(ask, lattice, places).reshape(lattice.shape)
    return Answers(values, len(places))


def answered(ask: Ask, lattice: Lattice, places: Int[ndarray, "n 3"]) -> Float32[ndarray, " n"]:
    """The network's values at points of the lattice, on the cuboid's faces less FILLED."""
    on_face = np.zeros(len(places), bool)
    for column, cells in zip(places.T, lattice.cells):
        on_face |= (column == 0) | (column == cells)
    return ask(places) - np.float32(FILLED * lattice.steps.min()) * on_face


def ask_sparsely(ask: Ask, reach: float, lattice: Lattice) -> Answers:
    """Evaluate the points that may lie next to the network's surface, coarse to fine; values are at most `reach`.

    The lattice is halved again and again, along each axis so often that its coarsest steps are about as long as what a
    value can settle. A point of it is asked unless an earlier one has settled it: a value v says that the surface is no
    nearer than |v| / LIPSCHITZ. The last halving, most of the points, also concludes from two sides. So for a field
    that is no steeper, only tips and sheets thinner than a cell are overlooked, which asking everywhere finds by
    chance. Wherever the surface is met, it is followed to its end, however steep the network, and no value at
    the surface is ever a guess.
    """
    values = np.full(tuple(n + 2 for n in lattice.shape), POSITIVE)
    known = np.ones(values.shape, bool)  # asked, or beyond the faces
    bound, asked = values[INNER], known[INNER]
    bound[:] = 0  # at most the value's size, with its sign; 0: nothing is known
    asked[:] = False
    for strides, first in sublattices(first_strides(lattice, reach)):
        target = settled(bound, strides, first, lattice.steps)
        open_points = target == 0
        _every(asked, strides, first)[...] = open_points
        flat = np.flatnonzero(open_points)
        places = np.array(
            [
                index * stride + start
                for index, stride, start in zip(np.unravel_index(flat, target.shape), strides, first)
            ]
        ).T
        target.reshape(-1)[flat] = answered(ask, lattice, places)
        _every(bound, strides, first)[...] = target
    follow(ask, lattice, values, known)
    return Answers(values, int(np.count_nonzero(asked)))


METHODS: dict[str, Method] = {"sparse": ask_sparsely, "dense": ask_densely}


def first_strides(lattice: Lattice, reach: float) -> Triple:
    """Cells along each axis between the points asked first: no value says more than `reach`, however far it is."""
    strides = []
    for step, cells in zip(lattice.steps.tolist(), lattice.cells.tolist()):
        stride = 1
        while stride < cells and LIPSCHITZ * stride * 3**0.5 * step < reach:
            stride *= 2
        strides.append(stride)
    return tuple(strides)


def sublattices(strides: Triple) -> Iterator[tuple[Triple, Triple]]:
    """Strides and first point of sublattices that have each point once: all multiples, then points halfway between.

    Of the points halfway along one, two or three axes, the former come first: they settle some of the latter.
    """
    yield strides, (0, 0, 0)
    while max(strides) > 1:
        halfway = product(*((0, stride // 2) if stride > 1 else (0,) for stride in strides))
        for first in sorted(halfway, key=np.count_nonzero)[1:]:
            yield strides, first
        strides = tuple(max(1, stride // 2) for stride in strides)


def settled(
    bound: Float32[ndarray, "r s t"], strides: Triple, first: Triple, steps: Float[ndarray, " 3"]
) -> Float32[ndarray, "a b c"]:
    """Bounds of a sublattice from the points around it, which lie on earlier ones; 0 where nothing is settled.

    A neighbour's bound less what the distance to it may take; on the last halving, along each axis where points lie
    halfway, also the mean of both neighbours, less BEND steps. The farthest from 0 is kept.
    """
    shape = _every(bound, strides, first).shape
    result = np.empty(shape, np.float32)
    for start in range(0, shape[0], height := max(1, SLAB // max(1, shape[1] * shape[2]))):
        slab = result[start : start + height]
        moved = (first[0] + start * strides[0], *first[1:])
        carry = _carried_along if max(strides) == 2 else _carried_around
        high, low = carry(bound, strides, moved, steps, slab.shape)
        slab[...] = np.where(high > -low, high, low)
    return result


def _carried_around(
    bound: Float32[ndarray, "r s t"], strides: Triple, first: Triple, steps: Float[ndarray, " 3"], shape: Triple
) -> tuple[Float32[ndarray, "a b c"], Float32[ndarray, "a b c"]]:
    """The highest and lowest bounds, at least and at most 0, from all neighbours of some points of a sublattice."""
    high, low = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for signs in product(*((-1, 0, 1) if start else (0,) for start in halfway(strides, first))):
        if any(signs):
            offset = [sign * stride // 2 for sign, stride in zip(signs, strides)]
            source, loss = _beside(bound, strides, first, offset, shape), LIPSCHITZ * np.linalg.norm(offset * steps)
            np.maximum(high, source - np.float32(loss), out=high)
            np.minimum(low, source + np.float32(loss), out=low)
    return high, low


def _carried_along(
    bound: Float32[ndarray, "r s t"], strides: Triple, first: Triple, steps: Float[ndarray, " 3"], shape: Triple
) -> tuple[Float32[ndarray, "a b c"], Float32[ndarray, "a b c"]]:
    """The same for the last halving, which costs most: of neighbours along the axes alone, and of their means.

    A twentieth more points is evaluated than with all neighbours. A mean of two signs counts for nothing: where it is
    beyond BEND steps, the larger value alone says more, since LIPSCHITZ is at most 2 BEND.
    """
    high, low = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    buffer = np.empty(shape, np.float32)
    for axis in (k for k, start in enumerate(halfway(strides, first)) if start):
        offset = np.eye(3, dtype=int)[axis]
        below, above = (_beside(bound, strides, first, (side * offset).tolist(), shape) for side in (-1, 1))
        loss, bend = np.float32(LIPSCHITZ * steps[axis]), np.float32(BEND * steps[axis])
        np.maximum(high, np.subtract(np.maximum(below, above, out=buffer), loss, out=buffer), out=high)
        np.minimum(low, np.add(np.minimum(below, above, out=buffer), loss, out=buffer), out=low)
        mean = np.multiply(np.add(below, above, out=below), np.float32(0.5), out=below)
        np.maximum(high, np.subtract(mean, bend, out=buffer), out=high)
        np.minimum(low, np.add(mean, bend, out=buffer), out=low)
    return high, low


def halfway(strides: Triple, first: Triple) -> Triple:
    """For each axis, whether the points of a sublattice lie halfway between those of earlier ones."""
    return tuple(start % stride for stride, start in zip(strides, first))


def _beside(
    bound: Float32[ndarray, "r s t"], strides: Triple, first: Triple, offset: Sequence[int], shape: Triple
) -> Float32[ndarray, "a b c"]:
    """A copy of the bounds of the points at `offset` from a sublattice's first `shape`; 0 beyond the lattice.

    Copies are contiguous: arithmetic on every second number takes several times as long.
    """
    source = _every(bound, strides, tuple(map(add, first, offset)))[tuple(map(slice, shape))]
    if source.shape == shape:
        return np.ascontiguousarray(source)
    beside = np.zeros(shape, np.float32)
    beside[tuple(map(slice, source.shape))] = source
    return beside


def _every(array: Shaped[ndarray, "r s t"], strides: Triple, first: Triple) -> Shaped[ndarray, "a b c"]:
    """A view of the points at `strides` along each axis, from `first` on."""
    return array[tuple(map(slice, first, array.shape, strides))]


def follow(ask: Ask, lattice: Lattice, values: Float32[ndarray, "r s t"], known: Bool[ndarray, "r s t"]) -> None:
    """Evaluate both ends of all edges with two signs, and go on from ends whose sign was concluded wrongly.

    The arrays have a layer of known points around the lattice, and are completed.
    """
    flat, asked, negative = values.reshape(-1), known.reshape(-1), values < 0
    pending = np.flatnonzero(ends(negative) & ~known)
    signs = negative.reshape(-1)
    _, s, t = values.shape
    around = np.array([s * t, -s * t, t, -t, 1, -1])
    while len(pending):
        places = np.array(np.unravel_index(pending, values.shape)).T - 1
        flat[pending] = answered(ask, lattice, places)
        asked[pending] = True
        changed = pending[signs[pending] != (flat[pending] < 0)]
        signs[changed] ^= True
        beside = changed[:, None] + around
        pending = np.unique(beside[(signs[beside] != signs[changed][:, None]) & ~asked[beside]])


def ends(negative: Bool[ndarray, "r s t"]) -> Bool[ndarray, "r s t"]:
    """The points that have a neighbour of the other sign along an axis."""
    crossed = np.zeros(negative.shape, dtype=bool)
    for axis in range(3):
        low, high = (slice(None),) * axis + (slice(None, -1),), (slice(None),) * axis + (slice(1, None),)
        differ = negative[low] != negative[high]
        crossed[low] |= differ
        crossed[high] |= differ
    return crossed
