"""Relations between the parts of a shape whose files have none: attached, mirrored, moved, turned.

Two parts repeat each other if one lies on the other after a motion, up to a share of its size. There may be several
such motions: four straight legs are both mirrored and moved. Three or more in a row at equal steps are moved; otherwise
a mirror comes before a translation, this before a rotation about the centre of the circle on which they lie. Among
equal parts the nearest are related, until all hang together; equal distances count alike, so that a mirrored shape has
mirrored relations.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import manifold3d
import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation as Turn

from cagesdf.deformation.matching import CONTACT
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import as_manifold
from cagesdf.structure.relations import Adjacency, Reflection, Relation, Rotation, Translation, Vector

NEAR = 0.02  # of a part's extent: how far from its image the other may be
ALIKE = 0.04  # relative difference of the volumes and of the principal lengths of parts that repeat each other
LEVEL = 0.02  # relative difference of distances that count alike
POINTS = 400  # of a surface that are compared


@dataclass(frozen=True, eq=False)
class _Body:
    """A part, and what parts that repeat it have in common."""

    part_id: str
    mesh: Mesh  # canonical, closed
    volume: float
    centre: Float[ndarray, " 3"]  # of mass
    lengths: Float[ndarray, " 3"]  # standard deviations of its mass along its principal axes, ascending

    @staticmethod
    def of(part_id: str, mesh: Mesh) -> "_Body":
        corners = mesh.corners()
        origin = mesh.vertices.mean(axis=0)
        a, b, c = np.moveaxis(corners - origin, 1, 0)
        volumes = np.einsum("fx,fx->f", a, np.cross(b, c)) / 6  # of the tetrahedra over the faces, signed
        volume = float(volumes.sum())
        total = a + b + c
        first = volumes @ total / (4 * volume)
        products = sum(np.einsum("f,fx,fy->xy", volumes, side, side) for side in (a, b, c, total))
        spread = products / (20 * volume) - np.outer(first, first)
        return _Body(part_id, mesh, volume, origin + first, np.sqrt(np.maximum(np.linalg.eigvalsh(spread), 0)))

    @cached_property
    def points(self) -> Float[ndarray, "n 3"]:
        """At most about POINTS of its vertices and face centres."""
        every = np.concatenate([self.mesh.vertices, self.mesh.corners().mean(axis=1)])
        return every[:: max(1, len(every) // POINTS)]

    @cached_property
    def surface(self) -> SurfaceDistance:
        return SurfaceDistance(self.mesh)

    @cached_property
    def reach(self) -> float:
        return NEAR * float(np.linalg.norm(np.ptp(self.mesh.vertices, axis=0)))

    def is_like(self, other: "_Body") -> bool:
        """Whether a motion may lead from one to the other."""
        pairs = ((self.volume, other.volume), *zip(self.lengths, other.lengths))
        return all(abs(a - b) <= ALIKE * max(a, b) for a, b in pairs)


@dataclass(frozen=True, eq=False)
class _Motion:
    """A motion of space, x → matrix·x + offset."""

    matrix: Float[ndarray, "3 3"]  # orthogonal
    offset: Float[ndarray, " 3"]  # canonical units

    @staticmethod
    def about(point: Float[ndarray, " 3"], matrix: Float[ndarray, "3 3"]) -> "_Motion":
        return _Motion(matrix, point - matrix @ point)

    def leads(self, a: _Body, b: _Body) -> bool:
        """Whether it takes one body to the other."""
        moved = a.points @ self.matrix.T + self.offset
        back = (b.points - self.offset) @ self.matrix
        return bool(b.surface.unsigned(moved).max() <= b.reach and a.surface.unsigned(back).max() <= a.reach)


def relations(parts: dict[str, Mesh]) -> tuple[Relation, ...]:
    """Relations between parts, closed and canonical, by id: those of parts that touch, then those of equal parts."""
    bodies = [_Body.of(part_id, mesh) for part_id, mesh in parts.items()]
    return (*_attached(parts), *_repeated(bodies))


def _attached(parts: dict[str, Mesh]) -> Iterator[Adjacency]:
    """Parts that are less than CONTACT apart."""
    solids = {part_id: as_manifold(mesh) for part_id, mesh in parts.items()}
    boxes = {part_id: np.array(solid.bounding_box()).reshape(2, 3) for part_id, solid in solids.items()}
    for a, b in combinations(parts, 2):
        if np.maximum(boxes[a][0] - boxes[b][1], boxes[b][0] - boxes[a][1]).max() < CONTACT:
            gap = _gap(solids[a], solids[b])
            if gap < CONTACT:
                yield Adjacency(a, b, gap)


def _gap(a: manifold3d.Manifold, b: manifold3d.Manifold) -> float:
    return float(a.min_gap(b, CONTACT))


def _repeated(bodies: list[_Body]) -> list[Relation]:
    """Relations of equal parts, the nearest ones, so that all that repeat each other hang together."""
    waiting = sorted(
        (float(np.linalg.norm(bodies[j].centre - bodies[i].centre)), i, j)
        for i, j in combinations(range(len(bodies)), 2)
        if bodies[i].is_like(bodies[j])
    )
    found: dict[tuple[int, int], Relation] = {}
    trees = np.arange(len(bodies))
    while waiting:
        farthest = waiting[0][0] * (1 + LEVEL)
        level = [(i, j) for distance, i, j in waiting if distance <= farthest and trees[i] != trees[j]]
        waiting = [pair for pair in waiting if pair[0] > farthest]
        for i, j in level:
            alike = [body for body in bodies if body.is_like(bodies[i])]
            relation = _relation(bodies[i], bodies[j], alike)
            if relation is not None:
                found[i, j] = relation
        ends = np.array([*found], dtype=np.int64).reshape(-1, 2).T
        links = coo_array((np.ones(ends.shape[1], bool), tuple(ends)), (len(bodies),) * 2)
        trees = connected_components(links, directed=False)[1]
    return [found[pair] for pair in sorted(found)]


def _relation(a: _Body, b: _Body, alike: list[_Body]) -> Relation | None:
    """The relation that makes b from a, or None; also None in one place. `alike` are all parts of their kind."""
    offset = b.centre - a.centre
    if np.linalg.norm(offset) <= min(a.reach, b.reach):
        return None
    moved = _Motion(np.eye(3), offset).leads(a, b)
    if moved and any(
        np.linalg.norm(c.centre - end) <= a.reach for c in alike for end in (b.centre + offset, a.centre - offset)
    ):
        return Translation(a.part_id, b.part_id, _vector(offset))
    normal = offset / np.linalg.norm(offset)
    middle = (a.centre + b.centre) / 2
    if _Motion.about(middle, np.eye(3) - 2 * np.outer(normal, normal)).leads(a, b):
        return Reflection(a.part_id, b.part_id, _vector(middle), _vector(normal))
    if moved:
        return Translation(a.part_id, b.part_id, _vector(offset))
    return _rotation(a, b, alike)


def _rotation(a: _Body, b: _Body, alike: list[_Body]) -> Rotation | None:
    """The turn of one part to another about the centre of the circle that three or more lie on."""
    if len(alike) < 3:
        return None
    centres = np.array([body.centre for body in alike])
    mean = centres.mean(axis=0)
    _, extents, directions = np.linalg.svd(centres - mean)
    if extents[1] <= a.reach or (len(extents) > 2 and extents[2] > a.reach):
        return None  # in a line, or in no plane
    axis = directions[2]
    flat = (centres - mean) @ directions[:2].T
    solution = np.linalg.lstsq(np.column_stack([2 * flat, np.ones(len(flat))]), (flat**2).sum(axis=1), rcond=None)[0]
    pivot = mean + solution[:2] @ directions[:2]
    if np.ptp(np.linalg.norm(centres - pivot, axis=1)) > a.reach:
        return None
    start, end = a.centre - pivot, b.centre - pivot
    across = np.cross(start, end)
    axis = axis if axis @ across >= 0 else -axis
    angle = float(np.arctan2(axis @ across, start @ end))
    if not _Motion.about(pivot, Turn.from_rotvec(angle * axis).as_matrix()).leads(a, b):
        return None
    return Rotation(a.part_id, b.part_id, _vector(pivot), _vector(axis), angle)


def _vector(values: Float[ndarray, " 3"]) -> Vector:
    x, y, z = values.tolist()
    return x, y, z
