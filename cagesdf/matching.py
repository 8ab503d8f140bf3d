"""Who is deformed towards whom: structurally compatible shapes and their corresponding parts (§3.3)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.optimize import linear_sum_assignment

from cagesdf.cuboid import Cage
from cagesdf.structure.base import Structure


@dataclass(frozen=True)
class Match:
    """What one shape is deformed towards: another shape's cage, or its own, scaled."""

    shape_id: str  # the source
    target_id: str | None  # structurally equal shape; None: the source's own cage, scaled
    scale: tuple[float, float, float]  # factors along the canonical axes; ones where there is a target
    pairs: tuple[tuple[str, str], ...]  # (source part, target part), in the source's order
    cost: float  # mean distance between partners' centres, canonical units
    candidates: int  # structurally equal shapes to choose from
    reason: str  # why this target, or why scaled


def group_by_structure(structures: Mapping[str, Structure]) -> dict[str, tuple[str, ...]]:
    """For each shape the other shapes whose structure is equal up to continuous parameters, sorted."""
    groups: dict[str, list[str]] = {}
    signatures = {shape_id: structures[shape_id].signature() for shape_id in sorted(structures)}
    for shape_id, signature in signatures.items():
        groups.setdefault(signature, []).append(shape_id)
    return {
        shape_id: tuple(other for other in groups[signature] if other != shape_id)
        for shape_id, signature in signatures.items()
    }


def match_to_one_of(
    shape_id: str,
    partners: tuple[str, ...],
    structures: Mapping[str, Structure],
    cages: Mapping[str, Cage],
    rng: np.random.Generator,
) -> Match:
    """Draw a target among `partners`, at least one, and find which part corresponds to which."""
    target_id = partners[int(rng.integers(len(partners)))]
    source, target = cages[shape_id], cages[target_id]
    pairs = correspond(structures[shape_id], source, structures[target_id], target)
    distances = [np.linalg.norm(source[a].centre - target[b].centre) for a, b in pairs]
    reason = f"drawn from {len(partners)} of equal structure"
    return Match(shape_id, target_id, (1.0, 1.0, 1.0), pairs, float(np.mean(distances)), len(partners), reason)


def match_to_scaled(shape_id: str, cage: Cage, factors: tuple[float, float], rng: np.random.Generator) -> Match:
    """Deform towards the shape's own cage, scaled along the canonical axes.

    The three factors are drawn from the range `factors`, uniform in their logarithm.
    """
    low, high = np.log(factors)
    scale = np.exp(rng.uniform(low, high, size=3))
    x, y, z = scale.tolist()
    cost = float(np.linalg.norm(cage.centre * (scale - 1), axis=1).mean())
    pairs = tuple((part_id, part_id) for part_id in cage.part_ids)
    return Match(shape_id, None, (x, y, z), pairs, cost, 0, "no shape of equal structure: scaled")


def correspond(
    source: Structure, source_cage: Cage, target: Structure, target_cage: Cage
) -> tuple[tuple[str, str], ...]:
    """Pairs of corresponding parts of two structures with the same signature, in the source's order.

    Both trees are walked together. Siblings whose subtrees have the same signature can stand for
    each other; of all such assignments the one with the smallest sum of squared distances
    between the subtrees' mean centres is taken, each cage's bounding box being mapped to a unit cube.

    Raises ValueError if the signatures differ.
    """
    if source.signature() != target.signature():
        raise ValueError(f"structures differ: {source.signature()!r} and {target.signature()!r}")
    signatures = source.signatures(), target.signatures()
    centres = _node_centres(source, source_cage), _node_centres(target, target_cage)
    partners: dict[str, str] = {}

    def walk(a: str, b: str) -> None:
        children = source.children(a), target.children(b)
        if not children[0]:
            partners[a] = b
        for signature in sorted({signatures[0][child] for child in children[0]}):
            ours, theirs = (
                [child for child in siblings if table[child] == signature]
                for siblings, table in zip(children, signatures)
            )
            order = _assign(np.array([centres[0][i] for i in ours]), np.array([centres[1][j] for j in theirs]))
            for child, k in zip(ours, order):
                walk(child, theirs[k])

    walk(source.root(), target.root())
    return tuple((part_id, partners[part_id]) for part_id in source.parts())


def _assign(ours: Float[ndarray, "n 3"], theirs: Float[ndarray, "n 3"]) -> Int[ndarray, " n"]:
    squared = ((ours[:, None] - theirs[None]) ** 2).sum(axis=2)
    return linear_sum_assignment(squared)[1]


def _node_centres(structure: Structure, cage: Cage) -> dict[str, Float[ndarray, " 3"]]:
    """Mean part centre below each node, relative to the cage's bounding box."""
    corners = cage.corners().reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    relative = (cage.centre - low) / (high - low)
    centres: dict[str, ndarray] = {}

    def walk(node: str) -> list[ndarray]:
        children = structure.children(node)
        below = [point for child in children for point in walk(child)]
        below = below if children else [relative[cage.part_ids.index(node)]]
        centres[node] = np.mean(below, axis=0)
        return below

    walk(structure.root())
    return centres
