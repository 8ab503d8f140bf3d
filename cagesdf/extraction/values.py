"""Values of a network on a cuboid's lattice, evaluated everywhere or only where the surface can be."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from math import prod

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Shaped
from numpy import ndarray

from cagesdf.extraction.lattice import Lattice

# abs(value) / LIPSCHITZ bounds the distance to the surface. 1 would do for an exact SDF; the rest leaves room for
# networks that are steeper.
LIPSCHITZ = 1.5
# Between points on the last halving, the value counts as at most this much nearer to 0 than their mean, times the
# distance to them: as if the slope changed by no more than twice that. With half of it pieces were lost (docs/log.md).
BEND = 1.0
# Before the last halving, points whose bound is no more than this, in steps of the next halving, are evaluated too:
# it would settle nothing there.
WEAK = 1.0
# A point on a face counts as inside where the surface ends before it by no more than this, in the shortest steps: parts
# that fill their cuboids end there, and rounding would chamfer their edges by a cell.
FILLED = 0.05
AT_ONCE = 6_000  # a lattice of no more points is evaluated everywhere, which takes less time than choosing
INNER = (slice(1, -1),) * 3  # the lattice in arrays that have a layer more around it
POSITIVE = np.float32(1)  # value beyond the faces

Evaluate = Callable[[Int[ndarray, "n 3"]], Float32[ndarray, " n"]]  # of points of a lattice, by their indices
Triple = tuple[int, ...]  # a number for each axis


@dataclass(frozen=True, eq=False)
class LatticeValues:
    """Values on a lattice, with a layer of points around it that are outside."""

    values: Float32[
        ndarray, "r s t"
    ]  # as `values_at` at both ends of edges with two signs, elsewhere with the right sign
    evaluations: int  # points given to the network


Method = Callable[[Evaluate, float, Lattice], LatticeValues]


def dense_values(evaluate: Evaluate, reach: float, lattice: Lattice) -> LatticeValues:
    """Evaluate the network at every point."""
    values = np.full(tuple(n + 2 for n in lattice.shape), POSITIVE)
    places = np.argwhere(np.ones(lattice.shape, bool))
    values[INNER] = values_at(evaluate, lattice, places).reshape(lattice.shape)
    return LatticeValues(values, len(places))


def values_at(evaluate: Evaluate, lattice: Lattice, places: Int[ndarray, "n 3"]) -> Float32[ndarray, " n"]:
    """The network's values at points of the lattice, on the cuboid's faces less FILLED."""
    on_face = np.zeros(len(places), bool)
    for column, cells in zip(places.T, lattice.cells):
        on_face |= (column == 0) | (column == cells)
    return evaluate(places) - np.float32(FILLED * lattice.steps.min()) * on_face


def sparse_values(evaluate: Evaluate, reach: float, lattice: Lattice) -> LatticeValues:
    """Evaluate the points that may lie next to the network's surface, coarse to fine; values are at most `reach`.

    The lattice is halved again and again, along each axis so often that its coarsest steps are about as long as what a
    value can settle. A point of it is evaluated unless an earlier one has settled it: a value v says that the surface
    is no nearer than |v| / LIPSCHITZ. The last halving, most of the points, also concludes from both sides. So for a
    field that is no steeper, only tips and sheets thinner than a cell are overlooked, which evaluating everywhere finds
    by chance. Wherever the surface is met, it is followed to its end, however steep the network, and no value at
    the surface is ever a guess.
    """
    values = np.full(tuple(n + 2 for n in lattice.shape), POSITIVE)
    known = np.ones(values.shape, bool)  # evaluated, or beyond the faces
    bound = values[INNER]
    bound[:] = 0  # at most the value's size, with its sign; 0: nothing is known
    known[INNER] = False
    for strides, firsts in halvings(first_strides(lattice, reach)):
        unsettled = list[Int[ndarray, "3 n"]]()
        for first in firsts:
            target = settled(bound, strides, first, lattice.steps)
            _every(bound, strides, first)[...] = target
            indices = np.unravel_index(np.flatnonzero(target == 0), target.shape)
            unsettled.append(np.array([i * stride + k for i, stride, k in zip(indices, strides, first)]))
        places = np.concatenate(unsettled, axis=1)
        flat = np.ravel_multi_index(tuple(places + 1), values.shape)
        values.reshape(-1)[flat] = values_at(evaluate, lattice, places.T)
        known.reshape(-1)[flat] = True
    follow(evaluate, lattice, values, known)
    return LatticeValues(values, int(np.count_nonzero(known[INNER])))


METHODS: dict[str, Method] = {"sparse": sparse_values, "dense": dense_values}


def first_strides(lattice: Lattice, reach: float) -> Triple:
    """Cells along each axis between the points evaluated first: no value says more than `reach`, however far it is."""
    if prod(lattice.shape) <= AT_ONCE:
        return (1, 1, 1)
    strides = []
    for step, cells in zip(lattice.steps.tolist(), lattice.cells.tolist()):
        stride = 1
        while stride < cells and LIPSCHITZ * stride * 3**0.5 * step < reach:
            stride *= 2
        strides.append(stride)
    return tuple(strides)


def halvings(strides: Triple) -> Iterator[tuple[Triple, list[Triple]]]:
    """Strides and first points of sublattices that have each point once: all multiples, then those halfway between.

    The latter, halving by halving: of points halfway along one, two or three axes.
    """
    yield strides, [(0, 0, 0)]
    while max(strides) > 1:
        halfway = product(*((0, stride // 2) if stride > 1 else (0,) for stride in strides))
        yield strides, [first for first in halfway if any(first)]
        strides = tuple(max(1, stride // 2) for stride in strides)


def settled(
    bound: Float32[ndarray, "r s t"], strides: Triple, first: Triple, steps: Float[ndarray, " 3"]
) -> Float32[ndarray, "a b c"]:
    """Bounds of a sublattice from the points at `strides` around each of its points; 0 where nothing is settled.

    The bound of a point around it less what the distance to it may take, if that is not WEAK; on the last halving also
    the mean of all around it, less BEND times that distance. The farthest from 0 is kept. Beyond the lattice nothing is
    known.
    """
    halved = [axis for axis in range(3) if first[axis]]
    shape = [count + (axis in halved) for axis, count in enumerate(_every(bound, strides, first).shape)]
    total = np.zeros(shape, np.float32)  # contiguous: arithmetic on every second number takes several times as long
    coarse = _every(bound, strides, (0, 0, 0))[tuple(map(slice, shape))]
    total[tuple(map(slice, coarse.shape))] = coarse
    high = low = total
    for axis in halved:
        below, above = (slice(None),) * axis + (slice(None, -1),), (slice(None),) * axis + (slice(1, None),)
        total = total[below] + total[above]
        high, low = np.maximum(high[below], high[above]), np.minimum(low[below], low[above])
    distance = np.linalg.norm(first * steps)
    loss, bend = np.float32(LIPSCHITZ * distance), np.float32(BEND * distance)
    high, low = np.maximum(high - loss, 0), np.minimum(low + loss, 0)
    if max(strides) > 2:
        weak = WEAK * max(stride / 4 * step for stride, step in zip(strides, steps) if stride > 2)
        high, low = high * (high > weak), low * (low < -weak)
    else:
        mean = total * np.float32(0.5 ** len(halved))
        high, low = np.maximum(high, mean - bend), np.minimum(low, mean + bend)
    return np.where(high > -low, high, low)


def _every(array: Shaped[ndarray, "r s t"], strides: Triple, first: Triple) -> Shaped[ndarray, "a b c"]:
    """A view of the points at `strides` along each axis, from `first` on."""
    return array[tuple(map(slice, first, array.shape, strides))]


def follow(
    evaluate: Evaluate, lattice: Lattice, values: Float32[ndarray, "r s t"], known: Bool[ndarray, "r s t"]
) -> None:
    """Evaluate both ends of all edges with two signs, and go on from ends whose sign was concluded wrongly.

    The arrays have a layer of known points around the lattice, and are completed.
    """
    flat, evaluated, negative = values.reshape(-1), known.reshape(-1), values < 0
    pending = np.flatnonzero(ends(negative) & ~known)
    signs = negative.reshape(-1)
    _, s, t = values.shape
    around = np.array([s * t, -s * t, t, -t, 1, -1])
    while len(pending):
        places = np.array(np.unravel_index(pending, values.shape)).T - 1
        flat[pending] = values_at(evaluate, lattice, places)
        evaluated[pending] = True
        changed = pending[signs[pending] != (flat[pending] < 0)]
        signs[changed] ^= True
        beside = changed[:, None] + around
        pending = np.unique(beside[(signs[beside] != signs[changed][:, None]) & ~evaluated[beside]])


def ends(negative: Bool[ndarray, "r s t"]) -> Bool[ndarray, "r s t"]:
    """The points that have a neighbour of the other sign along an axis."""
    crossed = np.zeros(negative.shape, dtype=bool)
    for axis in range(3):
        low, high = (slice(None),) * axis + (slice(None, -1),), (slice(None),) * axis + (slice(1, None),)
        differ = negative[low] != negative[high]
        crossed[low] |= differ
        crossed[high] |= differ
    return crossed
