"""Choice of the points of a cuboid's lattice at which the network is evaluated."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from operator import add

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
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
    on_face = ((places == 0) | (places == lattice.cells)).any(axis=1)
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
        settle(bound, strides, first, lattice.steps)
        places = np.argwhere(_every(bound, strides, first) == 0) * strides + first
        where = tuple(places.T)
        bound[where] = answered(ask, lattice, places)
        asked[where] = True
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


def settle(bound: Float32[ndarray, "r s t"], strides: Triple, first: Triple, steps: Float[ndarray, " 3"]) -> None:
    """Carry bounds to a sublattice from the points around it, which lie on earlier ones.

    A neighbour's bound less what the distance to it may take; on the last halving, along each axis where points lie
    halfway, also the mean of two neighbours of one sign, less BEND steps. The farthest from 0 is kept.
    """
    target = _every(bound, strides, first)
    high, low = np.zeros(target.shape, np.float32), np.zeros(target.shape, np.float32)
    for signs in product(*((-1, 0, 1) if start else (0,) for start in first)):
        if not any(signs) or (max(strides) == 2 and np.count_nonzero(signs) > 1):
            continue  # on the last halving, which costs most, along the axes alone: a twentieth more points is asked
        offset = [sign * stride // 2 for sign, stride in zip(signs, strides)]
        source = _every(bound, strides, tuple(map(add, first, offset)))[tuple(map(slice, target.shape))]
        part, loss = tuple(map(slice, source.shape)), np.float32(LIPSCHITZ * np.linalg.norm(offset * steps))
        np.maximum(high[part], source - loss, out=high[part])
        np.minimum(low[part], source + loss, out=low[part])
    for axis in (k for k in range(3) if strides[k] == 2 and first[k] == 1):
        below, above = (
            _every(bound, strides, tuple(start + offset * (k == axis) for k, start in enumerate(first)))
            for offset in (-1, 1)
        )
        part = tuple(map(slice, above.shape))
        below, loss = below[part], np.float32(BEND * steps[axis])
        mean, agree = (below + above) / 2, below * above > 0
        np.maximum(high[part], mean - loss, out=high[part], where=agree)
        np.minimum(low[part], mean + loss, out=low[part], where=agree)
    target[...] = np.where(high > -low, high, low)


def _every(bound: Float32[ndarray, "r s t"], strides: Triple, first: Triple) -> Float32[ndarray, "a b c"]:
    """A view of the points at `strides` along each axis, from `first` on."""
    return bound[tuple(map(slice, first, bound.shape, strides))]


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
        places = np.stack(np.unravel_index(pending, values.shape), axis=1) - 1
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
