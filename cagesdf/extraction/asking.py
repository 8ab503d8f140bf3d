"""Which points of a cuboid the network is asked at."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray

from cagesdf.extraction.lattice import Region
from cagesdf.frames import OUTSIDE

# A value settles the sign of the points that are nearer than its size over this: 1 for a true
# distance, the rest for a network's slope.
LIPSCHITZ = 1.5
# Between two neighbours of one sign on the lattice's last halving, the value counts as at most this
# much nearer to 0 than their mean, in cells: as if the slope changed by no more than twice that. With half
# of it pieces were lost (docs/log.md).
BEND = 1.0

Ask = Callable[[Float[ndarray, "n 3"]], Float32[ndarray, " n"]]


@dataclass(frozen=True, eq=False)
class Answers:
    """What the network said on a region."""

    negative: Bool[ndarray, "r s t"]  # its sign, or what was concluded of it; false outside the cuboid
    exact: Float32[ndarray, "r s t"]  # its value; NaN where it was not asked
    asked: int  # points given to the network


Method = Callable[[Ask, Region], Answers]


def ask_densely(ask: Ask, region: Region) -> Answers:
    """Ask at every point in the cuboid."""
    values = np.full(region.lattice.shape, np.nan, np.float32)
    places = np.argwhere(region.inside)
    values[region.inside] = ask(region.lattice.points(places))
    return Answers(values < 0, values, len(places))


def ask_sparsely(ask: Ask, region: Region) -> Answers:
    """Ask at the points in the cuboid that may lie next to the network's surface, coarse to fine.

    The lattice is halved again and again. A point of it is asked unless an earlier one has settled
    it: a value v says that the surface is no nearer than |v| / LIPSCHITZ. The last halving, most of
    the points, also concludes from two sides. So for a field that is no steeper, only tips and
    sheets thinner than a cell are overlooked, which asking everywhere finds by chance. Wherever the
    surface is met, `joining` follows it to its end, however steep the network, and no value at the
    surface is ever a guess.
    """
    inside = region.inside
    bound = np.zeros(inside.shape, np.float32)  # at most the value's size, with its sign; 0: nothing is known
    exact = np.full(inside.shape, np.nan, np.float32)
    asked = 0
    for stride, first in sublattices(first_stride(region.lattice.cell)):
        spread(bound, stride, first, LIPSCHITZ * region.lattice.cell)
        if stride == 2:
            bridge(bound, first, BEND * region.lattice.cell)
        these = tuple(slice(start, None, stride) for start in first)
        places = np.argwhere(inside[these] & (bound[these] == 0)) * stride + np.array(first)
        where = tuple(places.T)
        exact[where] = bound[where] = ask(region.lattice.points(places))
        asked += len(places)
    return Answers((bound < 0) & inside, exact, asked)


METHODS: dict[str, Method] = {"sparse": ask_sparsely, "dense": ask_densely}


def first_stride(cell: float) -> int:
    """Cells between the points asked first: networks say no more than OUTSIDE, however far the surface."""
    stride = 1
    while LIPSCHITZ * stride * 3**0.5 * cell < OUTSIDE:
        stride *= 2
    return stride


def sublattices(stride: int) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Stride and first point of sublattices that have each point once: all multiples, then what is halfway between.

    Of the points halfway along one, two or three axes, the former come first: they settle some of the latter.
    """
    yield stride, (0, 0, 0)
    while stride > 1:
        for halfway in sorted(product((0, stride // 2), repeat=3), key=sum)[1:]:
            yield stride, halfway
        stride //= 2


def spread(bound: Float32[ndarray, "r s t"], stride: int, first: tuple[int, ...], slope: float) -> None:
    """Carry bounds to a sublattice from the points around, which lie on earlier ones; `slope` is a cell's loss."""
    half = stride // 2
    for steps in product(*((-1, 0, 1) if start else (0,) for start in first)):
        if not any(steps):
            continue
        beside = tuple(start + step * half for start, step in zip(first, steps))
        counts = [-(-(n - max(pair)) // stride) for n, *pair in zip(bound.shape, first, beside)]
        target, source = bound[_every(stride, first, counts)], bound[_every(stride, beside, counts)]
        left = np.abs(source) - np.float32(slope * half * np.linalg.norm(steps))
        better = left > np.abs(target)
        target[better] = np.copysign(left, source)[better]


def bridge(bound: Float32[ndarray, "r s t"], first: tuple[int, ...], loss: float) -> None:
    """Carry bounds to a sublattice of every second point from pairs of neighbours of one sign, less `loss`."""
    for axis in (k for k, start in enumerate(first) if start):
        low = tuple(start - (k == axis) for k, start in enumerate(first))
        high = tuple(start + (k == axis) for k, start in enumerate(first))
        counts = [-(-(n - start) // 2) for n, start in zip(bound.shape, high)]
        target, below, above = (bound[_every(2, start, counts)] for start in (first, low, high))
        left = np.abs(below + above) / 2 - np.float32(loss)
        better = (left > np.abs(target)) & (below * above > 0)
        target[better] = np.copysign(left, below)[better]


def _every(stride: int, first: tuple[int, ...], counts: list[int]) -> tuple[slice, ...]:
    return tuple(slice(start, start + stride * max(count, 0), stride) for start, count in zip(first, counts))
