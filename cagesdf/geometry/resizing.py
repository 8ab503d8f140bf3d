"""Resizing a part so that its details keep their size, axis by axis of its cuboid.

After Kraevoy et al. 2008, "Non-homogeneous resizing of complex models". An affine map stretches beads, blocks and
bevels with the cuboid. Here each axis is cut into even bins, and bins stretch in inverse proportion to what a stretch
would damage there: bin b by a factor s_b that minimises Σ w_b (s_b − 1)² for a given mean and a least factor.

The weight w (`vulnerability`) is an area, of two kinds. **Thickness**: the surface cuts rays along the axis into chords
of material and of gaps; the area around a ray is spread over each chord, so that short ones weigh more than long ones.
A block at a leg's end keeps its height, a shaft its diameter, a slot its width. **Slope**: a face is spread over its
extent with its area × n², n being the normal's component along the axis; that is how far a stretch moves the face off
itself. Beads, bends and bevels keep their profile. Walls (n = 0) slide along themselves, and caps (n = 1) have no
extent that could stretch.

Bins beyond a part's ends weigh what the outermost one within them does: otherwise the little room that a surface may
leave at its cuboid's faces would take all the stretch. Networks round edges off, so of their surfaces the outermost
cells of the lattice lie beyond the ends, too.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from cagesdf.geometry.meshes import Mesh, face_normals

BINS = 64  # along each axis
RAYS = 16, 12  # across the other two axes
CAP = 0.02  # 1 − n² from which on a face counts as sloping in full (8 degrees from a cap)
LEAST = 0.1  # factor of a bin, unless the whole axis shrinks more
SOFTEST = 0.03  # added to all weights, whose mean is 1: a bin without any weight doesn't take everything
NARROW = 1e-4  # of the axis: shorter stretches are spread over this length

EXACT = np.zeros(3)


@dataclass(frozen=True, eq=False)
class AxisWarp:
    """A map of a cuboid's unit frame onto itself: along each axis monotone, and linear within bins."""

    knots: Float[ndarray, "3 k"]  # unit: where the borders of even bins of [−½, ½] go; rise from −½ to ½

    def __call__(self, points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Unit points, moved. Outside the cuboid they are moved like the nearest point of it."""
        even = np.linspace(-0.5, 0.5, self.knots.shape[1])
        clipped = points.clip(-0.5, 0.5)
        moved = [np.interp(column, even, knots) for column, knots in zip(clipped.T, self.knots)]
        return np.stack(moved, axis=1) + (points - clipped)


def keeping_warp(
    weights: Float[ndarray, "3 b"], size: Float[ndarray, " 3"], moved: Float[ndarray, " 3"], detail: float = 1.0
) -> AxisWarp:
    """The warp that a part needs in its unit frame so that details keep their size in a resized cuboid.

    `weights` are the part's `vulnerability` in a cuboid with lengths `size`; the cuboid's new lengths are `moved`. A
    detail that keeps its size has `detail` times its length, which differs from 1 where the two cuboids are not
    measured in the same unit.
    """
    totals = moved / (size * detail)
    return AxisWarp(np.array([_knots(stretches(w, float(total))) for w, total in zip(weights, totals)]))


def _knots(factors: Float[ndarray, " b"]) -> Float[ndarray, " k"]:
    borders = np.concatenate([[0.0], np.cumsum(factors)])
    return borders / borders[-1] - 0.5


def stretches(weights: Float[ndarray, " b"], total: float) -> Float[ndarray, " b"]:
    """The factors s that minimise Σ weights·(s − 1)², their mean being `total` > 0 and none below `LEAST` or `total`.

    Closed form: s = 1 + λ/weights, except for the softest bins, which are at the least factor once it binds. Weights
    are relative to their mean, and SOFTEST is added to them.
    """
    count, least = len(weights), min(LEAST, total)
    stiffness = weights / (weights.mean() or 1.0) + SOFTEST
    order = np.argsort(stiffness, kind="stable")
    compliance = 1 / stiffness[order]
    # With the k softest bins at the least factor, the others share what is then left of the change.
    shared = (count * (total - 1) + np.arange(count) * (1 - least)) / np.cumsum(compliance[::-1])[::-1]
    allowed = 1 + shared * compliance >= least
    allowed[-1] = True  # all but the stiffest
    bound = int(np.argmax(allowed)) if total < 1 else 0
    factors = np.empty(count)
    factors[order] = 1 + shared[bound] * compliance
    return np.maximum(factors, least)


def vulnerability(
    solid: Mesh, size: Float[ndarray, " 3"], rounded: Float[ndarray, " 3"] = EXACT
) -> Float[ndarray, "3 b"]:
    """For each axis and bin, how much a stretch there would damage a closed part; areas, in squared units of `size`.

    `solid` is in the unit frame of a cuboid with lengths `size`. Of a network's surface, `rounded` is the share of each
    length within which its ends aren't to be trusted.
    """
    normals = face_normals(solid.with_vertices(solid.vertices * size))
    twice = np.sqrt(np.square(normals).sum(axis=1))
    along = np.square(normals / np.maximum(twice, 1e-300)[:, None])
    slopes = twice[:, None] / 2 * along * np.minimum(1, (1 - along) / CAP)
    corners = solid.corners()
    weights = []
    for axis in range(3):
        first, second = (k for k in range(3) if k != axis)
        cell = size[first] * size[second] / (RAYS[0] * RAYS[1])
        start, end = chords(solid, axis)
        thickness = _spread(start, end, np.full(len(start), cell))
        slope = _spread(corners[:, :, axis].min(axis=1), corners[:, :, axis].max(axis=1), slopes[:, axis])
        ends = float(corners[:, :, axis].min() + rounded[axis]), float(corners[:, :, axis].max() - rounded[axis])
        weights.append(_between(thickness + slope, *ends))
    return np.array(weights)


def _between(weights: Float[ndarray, " b"], low: float, high: float) -> Float[ndarray, " b"]:
    """The weights; a bin that isn't wholly between two unit coordinates has that of the nearest bin that is."""
    borders = np.linspace(-0.5, 0.5, BINS + 1)
    inside = np.flatnonzero((borders[:-1] >= low - NARROW) & (borders[1:] <= high + NARROW))
    return weights[np.arange(BINS).clip(inside[0], inside[-1])] if len(inside) else weights


def chords(solid: Mesh, axis: int) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"]]:
    """Starts and ends of the chords into which a closed mesh in a unit frame cuts rays along an axis.

    Chords are of material or of gaps, and lie between a ray's first and last crossing. RAYS rays stand evenly over the
    cuboid's face. One that meets an edge exactly counts as beside it.
    """
    corners = solid.corners()
    flat = corners[:, :, [k for k in range(3) if k != axis]]
    face, number, ray = _candidates(flat)
    a, b, c = (flat[face, k] - ray for k in range(3))
    sides = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    twice = sides.sum(axis=1)
    turn = np.sign(twice)[:, None]
    # An edge belongs to one of the two triangles that join there: to both or none if only one of them is entered.
    edges = np.stack([c - b, a - c, b - a], axis=1) * turn[:, :, None]
    beside = (edges[:, :, 1] > 0) | ((edges[:, :, 1] == 0) & (edges[:, :, 0] < 0))
    met = ((sides * turn > 0) | ((sides == 0) & beside)).all(axis=1) & (twice != 0)
    face, number, sides, twice = face[met], number[met], sides[met], twice[met]
    depth = (sides * corners[face, :, axis]).sum(axis=1) / twice
    order = np.lexsort((depth, number))
    number, depth, clockwise = number[order], depth[order], (twice < 0)[order]
    # Seen along the axis, faces that are entered turn one way, those that are left the other.
    chord = (number[1:] == number[:-1]) & (clockwise[1:] != clockwise[:-1])
    return depth[:-1][chord], depth[1:][chord]


def _candidates(
    triangles: Float[ndarray, "f 3 2"],
) -> tuple[Int[ndarray, " n"], Int[ndarray, " n"], Float[ndarray, "n 2"]]:
    """Each triangle with each ray in its bounding rectangle: number of the triangle, of the ray, place of the ray."""
    lattice = [(np.arange(count) + 0.5) / count - 0.5 for count in RAYS]
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    first = np.stack([np.searchsorted(places, low[:, k]) for k, places in enumerate(lattice)], axis=1)
    last = np.stack([np.searchsorted(places, high[:, k], "right") for k, places in enumerate(lattice)], axis=1)
    spans = last - first
    counts = spans.prod(axis=1)
    face = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    i = first[face, 0] + within // spans[face, 1]
    j = first[face, 1] + within % spans[face, 1]
    return face, i * RAYS[1] + j, np.stack([lattice[0][i], lattice[1][j]], axis=1)


def _cross(a: Float[ndarray, "n 2"], b: Float[ndarray, "n 2"]) -> Float[ndarray, " n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _spread(
    start: Float[ndarray, " n"], end: Float[ndarray, " n"], weight: Float[ndarray, " n"]
) -> Float[ndarray, " b"]:
    """Each weight spread evenly over its interval of [−½, ½], summed by bin."""
    half = np.maximum(end - start, NARROW) / 2
    middle = ((start + end) / 2).clip(half - 0.5, 0.5 - half)
    density = weight / (2 * half)
    # ∫ of a density that begins at x is density · max(0, border − x), up to each border.
    summed = _ramps(middle - half, density) - _ramps(middle + half, density)
    return np.maximum(np.diff(summed), 0)


def _ramps(places: Float[ndarray, " n"], slopes: Float[ndarray, " n"]) -> Float[ndarray, " k"]:
    """Σ slopes · max(0, border − place) for each border of the bins."""
    borders = np.linspace(-0.5, 0.5, BINS + 1)
    order = np.argsort(places, kind="stable")
    places, slopes = places[order], slopes[order]
    rise, offset = (np.concatenate([[0.0], np.cumsum(values)]) for values in (slopes, slopes * places))
    passed = np.searchsorted(places, borders)
    return borders * rise[passed] - offset[passed]
