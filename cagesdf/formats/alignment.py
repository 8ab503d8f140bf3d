"""Alignment of a program: the meshes of a shape that each leaf stands for.

Published programs name no part [Jones et al. 2020]. They were made from the part trees of the same
shapes, in whose unit they are, moved to the centre of the bounding box. A leaf stands for one node of
the tree, whatever is below it, or for the meshes that a node has and none of its children. Leaves are
matched to such candidates by how much their boxes overlap; no mesh is given twice.
"""

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.optimize import linear_sum_assignment

from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh, face_areas
from cagesdf.shape import AlignedPart
from cagesdf.structure.executor import execute
from cagesdf.structure.program import AssemblyProgram

PADDING = 0.005  # raw units, on all sides of both boxes, so that thin panels overlap that aren't quite in place
WIDE = 0.025  # the same, for what is thinner than it is out of place
LEAST = 0.1  # a smaller overlap, averaged over both paddings, is no match
DRIFT = 0.05  # raw units along each axis: the centres of program and meshes may be so far apart
ROUNDS = 8  # of moving the program and matching again
TRIED = 512  # assignments tried, after which the better branch is followed at each conflict
DIVISIONS = 3  # of a face's edges: one sample in each of its small triangles
APART = -1.0  # overlap of pairs that are ruled out: worse than none


@dataclass(frozen=True)
class Candidate:
    """Meshes that one leaf may stand for."""

    node_id: str  # unique
    label: str  # semantic name, "" if there is none
    objs: tuple[str, ...]  # names of meshes, at least one


@dataclass(frozen=True, eq=False)
class Alignment:
    """A program, its leaves matched to meshes."""

    parts: tuple[AlignedPart, ...]  # in the order of execution
    placement: Similarity  # program → raw: a translation


def align(program: AssemblyProgram, candidates: Sequence[Candidate], meshes: Mapping[str, Mesh]) -> Alignment:
    """Match the leaves of a program to candidates, then give each mesh that is left to a leaf.

    `meshes` are raw, by name; y is up in them. The sum of `Boxes.overlap` is as large as it can be
    with no mesh matched twice, so never a node together with one above it. The program's centre is
    the meshes' box centre, moved by the median offset of candidates from matched leaves as long as
    that raises the sum. What is left goes to the cuboid that holds most of its surface, or is nearest.

    Raises InputError if a mesh isn't finite, or a leaf gets none; ProgramError if the program
    doesn't execute.
    """
    names = [name for name, mesh in meshes.items() if len(mesh.faces)]
    for name in names:
        if not np.isfinite(meshes[name].vertices).all():
            raise InputError(f"mesh {name} has vertices that are NaN or infinite; export it again")
    if not names:
        raise InputError("its meshes have no faces; export it again")
    candidates = _distinct(candidates, names)
    vertices = np.concatenate([meshes[name].vertices for name in names])
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    owned = np.array([[name in candidate.objs for name in names] for candidate in candidates])
    cage = execute(program)

    cage, placement, chosen = _settled(cage, centre, [meshes[name] for name in names], owned)
    iou = Boxes.of(cage, [meshes[name] for name in names], owned).iou(PADDING)
    objs = [[names[j] for j in np.flatnonzero(owned[c])] if c >= 0 else [] for c in chosen]
    taken = {name for item in objs for name in item}
    leftovers: list[list[str]] = [[] for _ in chosen]
    for name in names:
        if name not in taken:
            leftovers[_holder(cage, meshes[name])].append(name)
    for part_id, matched, more in zip(cage.part_ids, objs, leftovers):
        if not matched and not more:
            raise InputError(
                f"leaf {part_id} of its program has no mesh: no part that is free lies where its cuboid does, "
                "and none of the meshes left over is nearest to it; is it another shape's program?"
            )
    parts = tuple(
        AlignedPart(
            part_id,
            candidates[c].node_id if c >= 0 else "",
            candidates[c].label if c >= 0 else "",
            tuple(matched),
            tuple(more),
            float(iou[i, c]) if c >= 0 else 0.0,
        )
        for i, (part_id, c, matched, more) in enumerate(zip(cage.part_ids, chosen, objs, leftovers))
    )
    return Alignment(parts, placement)


@dataclass(frozen=True, eq=False)
class Boxes:
    """Each candidate's box along the axes of each cuboid.

    With the same axes their overlap is exact. Of the part that a cuboid was fitted to, the box is as
    tight as the smallest; of others it may be larger.
    """

    half: Float[ndarray, "p 3"]  # of the cuboids' lengths
    low: Float[ndarray, "p c 3"]  # local frame of the cuboid
    high: Float[ndarray, "p c 3"]

    @staticmethod
    def of(cage: Cage, meshes: Sequence[Mesh], owned: Bool[ndarray, "c m"]) -> "Boxes":
        """Boxes of the candidates that own these meshes; cage and meshes in one frame."""
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])[:-1]
        vertices = np.concatenate([mesh.vertices for mesh in meshes])
        low, high = np.zeros((2, len(cage), len(owned), 3))
        for i in range(len(cage)):
            local = cage.to_local(vertices, i)
            low[i] = np.where(owned[..., None], np.minimum.reduceat(local, starts), np.inf).min(axis=1)
            high[i] = np.where(owned[..., None], np.maximum.reduceat(local, starts), -np.inf).max(axis=1)
        return Boxes(cage.size / 2, low, high)

    def iou(self, padding: float) -> Float[ndarray, "p c"]:
        """Intersection over union of cuboid and box, both padded on all sides."""
        half, low, high = self.half[:, None] + padding, self.low - padding, self.high + padding
        shared = np.prod(np.maximum(np.minimum(high, half) - np.maximum(low, -half), 0), axis=-1)
        return shared / (np.prod(2 * half, axis=-1) + np.prod(high - low, axis=-1) - shared)

    def overlap(self) -> Float[ndarray, "p c"]:
        """The measure of a match: mean IoU over both paddings; 0 where it is less than LEAST."""
        mean = (self.iou(PADDING) + self.iou(WIDE)) / 2
        return np.where(mean >= LEAST, mean, 0.0)


def choose(overlap: Float[ndarray, "p c"], owned: Bool[ndarray, "c m"]) -> list[int]:
    """The candidate of each leaf, or −1: no mesh is taken twice, and the overlaps' sum is largest.

    Candidates of a tree share meshes only if one is above the other. The best assignment that
    ignores this is tried first; where it takes two such candidates, either the upper one is ruled
    out or all that share meshes with it, and of these ways the most promising is followed.
    """
    conflict = (owned.astype(int) @ owned.T.astype(int)) > 0
    np.fill_diagonal(conflict, False)
    order = count()
    waiting = [(0.0, next(order), np.ones(len(owned), bool))]
    while True:
        _, tried, allowed = heapq.heappop(waiting)
        chosen = _assigned(overlap, allowed)
        taken = [c for c in chosen if c >= 0]
        clashes = [c for c in taken if conflict[c, taken].any()]
        if not clashes:
            return chosen
        upper = max(clashes, key=lambda c: int(owned[c].sum()))
        branches = (allowed & (np.arange(len(owned)) != upper), allowed & ~conflict[upper])
        if tried >= TRIED:
            waiting = []
        for branch in branches:
            # No assignment under it can be better: those that respect more conflicts come later.
            bound = sum(overlap[i, c] for i, c in enumerate(_assigned(overlap, branch)) if c >= 0)
            heapq.heappush(waiting, (-bound, next(order), branch))


def _assigned(overlap: Float[ndarray, "p c"], allowed: Bool[ndarray, " c"]) -> list[int]:
    rows, columns = linear_sum_assignment(np.where(allowed, overlap, APART), maximize=True)
    chosen = [-1] * len(overlap)
    for row, column in zip(rows.tolist(), columns.tolist()):
        if allowed[column] and overlap[row, column] > 0:
            chosen[row] = column
    return chosen


def _settled(
    cage: Cage, centre: Float[ndarray, " 3"], meshes: Sequence[Mesh], owned: Bool[ndarray, "c m"]
) -> tuple[Cage, Similarity, list[int]]:
    """The cage in the raw frame, its similarity to there, and the candidate of each cuboid."""
    low = np.stack([mesh.vertices.min(axis=0) for mesh in meshes])
    high = np.stack([mesh.vertices.max(axis=0) for mesh in meshes])
    middle = (
        np.where(owned[..., None], low, np.inf).min(axis=1) + np.where(owned[..., None], high, -np.inf).max(axis=1)
    ) / 2
    best, best_sum, drift = (cage, Similarity(1.0, np.eye(3), centre), [-1] * len(cage)), -1.0, np.zeros(3)
    for _ in range(ROUNDS):
        placement = Similarity(1.0, np.eye(3), centre + drift)
        placed = cage.transformed(placement)
        overlap = Boxes.of(placed, meshes, owned).overlap()
        chosen = choose(overlap, owned)
        matched = [(i, c) for i, c in enumerate(chosen) if c >= 0]
        total = float(sum(overlap[i, c] for i, c in matched))
        if total <= best_sum:
            break
        best, best_sum = (placed, placement, chosen), total
        if matched:
            ways = np.array([middle[c] - placed.centre[i] for i, c in matched])
            drift = np.clip(drift + np.median(ways, axis=0), -DRIFT, DRIFT)
    return best


def _distinct(candidates: Sequence[Candidate], names: Sequence[str]) -> list[Candidate]:
    """Candidates with meshes among `names`; of those with the same, the last: in a tree's preorder the deepest."""
    by_meshes = {frozenset(candidate.objs) & frozenset(names): candidate for candidate in candidates}
    return [candidate for objs, candidate in by_meshes.items() if objs]


def _holder(cage: Cage, mesh: Mesh) -> int:
    """The cuboid that holds most of a mesh's surface; of those that hold none the one nearest on average."""
    # Centres of the small triangles, in barycentric coordinates: those like the face, and those upside down.
    alike = [(i + 1 / 3, j + 1 / 3) for i in range(DIVISIONS) for j in range(DIVISIONS - i)]
    turned = [(i + 2 / 3, j + 2 / 3) for i in range(DIVISIONS - 1) for j in range(DIVISIONS - 1 - i)]
    u, v = np.array(alike + turned).T / DIVISIONS
    weights = np.stack([u, v, 1 - u - v], axis=1)
    samples = np.einsum("sk,fkd->fsd", weights, mesh.corners()).reshape(-1, 3)
    areas = np.repeat(face_areas(mesh), len(weights)) + np.finfo(float).tiny
    distance = cage.signed_distance(samples)
    inside = (areas[:, None] * (distance <= PADDING)).sum(axis=0) / areas.sum()
    away = (areas[:, None] * distance).sum(axis=0) / areas.sum()
    return int(np.lexsort([away, -inside])[0])
