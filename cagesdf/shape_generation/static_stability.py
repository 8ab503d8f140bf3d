"""Whether a cage stands: rooted, and stable without a simulation (§4.4 of ShapeAssembly's paper has both words).

Cuboids that are at most NEAR apart are taken for joined, rigidly and for good; those whose lowest corner is
at most NEAR above the lowest of all stand on the ground. Lengths are shares of the cage's size, the
diagonal of the box around it. Only cuboids count, not the surfaces in them.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.sparse.csgraph import connected_components

from cagesdf.cuboid import Cage
from cagesdf.deformation.matching import gaps

NEAR = 0.02  # of the size
# The twelve edges of a cuboid: pairs of corners that differ in one coordinate.
EDGES = np.array([[a, a + bit] for bit in (4, 2, 1) for a in range(8) if not a & bit])
PARALLEL = 1e-12  # squared sine of the angle below which two edges have no single nearest points


def rooted(cage: Cage) -> bool:
    """Whether every cuboid is joined to one that is joined to … one that stands on the ground."""
    component, grounded = components(cage), _heights(cage).min(axis=1) <= _near(cage)
    return set(component) == set(component[grounded])


def stable(cage: Cage) -> bool:
    """Whether the cage is rooted and nothing of it falls over.

    A connected part has its centre of mass above the inside of the convex hull of the corners that it
    stands on. Cuboids are solid, all of one density; where two overlap, both have mass.
    """
    component, feet = components(cage), _heights(cage) <= _near(cage)
    volume, corners = cage.size.prod(axis=1), cage.corners()
    for label in set(component):
        members = component == label
        middle = np.average(cage.centre[members], axis=0, weights=volume[members])
        if not _surrounded((corners[members][feet[members]] - middle)[:, [0, 2]]):
            return False
    return True


def joined(cage: Cage) -> Bool[ndarray, "p p"]:
    """Whether each two cuboids are at most NEAR apart; each is joined to itself."""
    return distances(cage, _near(cage)) <= _near(cage)


def distances(cage: Cage, limit: float) -> Float[ndarray, "p p"]:
    """The distance between each two cuboids, 0 where they touch or overlap; exact up to `limit`, canonical units.

    Beyond `limit` it is a lower bound of their distance. Two convex polyhedra apart are nearest at a
    corner of one of them, or between two edges.
    """
    result = np.maximum(gaps(cage), 0)
    a, b = np.nonzero(np.triu((result > 0) & (result <= limit)))
    if len(a):
        corners = cage.corners()
        to_cuboids = cage.signed_distance(corners.reshape(-1, 3)).reshape(len(cage), 8, len(cage)).min(axis=1)
        at_corners = np.minimum(to_cuboids[a, b], to_cuboids[b, a])
        result[a, b] = result[b, a] = np.minimum(at_corners, _between_edges(corners[a], corners[b]))
    return result


def _between_edges(a: Float[ndarray, "m 8 3"], b: Float[ndarray, "m 8 3"]) -> Float[ndarray, " m"]:
    """The least distance between inner points of an edge of each; infinity where none are nearest to each other."""
    start_a, end_a = (a[:, EDGES[:, i], None] for i in (0, 1))
    start_b, end_b = (b[:, None, EDGES[:, i]] for i in (0, 1))
    along_a, along_b, apart = end_a - start_a, end_b - start_b, start_a - start_b
    aa, bb, ab = ((u * v).sum(axis=3) for u, v in ((along_a, along_a), (along_b, along_b), (along_a, along_b)))
    from_a, from_b = ((along * apart).sum(axis=3) for along in (along_a, along_b))
    across = aa * bb - ab * ab
    crossing = across > PARALLEL * aa * bb
    across = np.where(crossing, across, 1)
    s, t = (ab * from_b - bb * from_a) / across, (aa * from_b - ab * from_a) / across
    inner = crossing & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    length = np.linalg.norm(apart + s[..., None] * along_a - t[..., None] * along_b, axis=3)
    return np.where(inner, length, np.inf).min(axis=(1, 2))


def _near(cage: Cage) -> float:
    return NEAR * float(np.linalg.norm(np.ptp(cage.corners().reshape(-1, 3), axis=0)))


def _heights(cage: Cage) -> Float[ndarray, "p 8"]:
    """Height of each corner above the lowest one."""
    heights = cage.corners()[:, :, 1]
    return heights - heights.min()


def components(cage: Cage) -> Int[ndarray, " p"]:
    """The number of the connected part that each cuboid belongs to."""
    return connected_components(joined(cage), directed=False)[1]


def _surrounded(ways: Float[ndarray, "n 2"]) -> bool:
    """Whether the origin is inside the convex hull of points: no half-plane holds them all."""
    if len(ways) == 0:
        return False
    angles = np.sort(np.arctan2(ways[:, 1], ways[:, 0]))
    return bool(np.diff(angles, append=angles[0] + 2 * np.pi).max() < np.pi)
