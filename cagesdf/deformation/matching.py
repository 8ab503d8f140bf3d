"""Targets of deformation: structurally compatible shapes and their corresponding parts (§3.3).

Structures are compatible if their signatures are equal. Where parts have no labels, as in plain
folders of part meshes, a signature says little more than how many there are; then it must also be
equal which cuboids touch.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.optimize import linear_sum_assignment

from cagesdf.cuboid import Cage
from cagesdf.structure.base import Structure

CONTACT = 0.01  # canonical units: cuboids no further apart touch
OTHER_CONTACTS = 100.0  # added to the squared distance between parts that touch differently


@dataclass(frozen=True)
class Match:
    """The target of one shape's deformation: another shape's cage, or its own, scaled."""

    shape_id: str  # the source
    target_id: str | None  # structurally equal shape; None: the source's own cage, scaled
    scale: tuple[float, float, float]  # factors along the canonical axes; ones where there is a target
    pairs: tuple[tuple[str, str], ...]  # (source part, target part), in the source's order
    cost: float  # mean distance between partners' centres, canonical units
    candidates: int  # structurally equal shapes to choose from
    reason: str  # why this target, or why scaled


def group_by_structure(structures: Mapping[str, Structure], cages: Mapping[str, Cage]) -> dict[str, tuple[str, ...]]:
    """For each shape the other shapes whose structure is equal up to continuous parameters, sorted."""
    groups: dict[tuple[str, ...], list[str]] = {}
    keys = {shape_id: _key(structures[shape_id], cages[shape_id]) for shape_id in sorted(structures)}
    for shape_id, key in keys.items():
        groups.setdefault(key, []).append(shape_id)
    return {shape_id: tuple(other for other in groups[key] if other != shape_id) for shape_id, key in keys.items()}


def _key(structure: Structure, cage: Cage) -> tuple[str, ...]:
    return (structure.signature(), *sorted(_contact_classes(structure, cage).values()))


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
    Unlabelled parts go to parts that touch others alike, as far as there are any.

    Raises ValueError if the signatures differ.
    """
    if source.signature() != target.signature():
        raise ValueError(f"structures differ: {source.signature()!r} and {target.signature()!r}")
    signatures = source.signatures(), target.signatures()
    centres = _node_centres(source, source_cage), _node_centres(target, target_cage)
    classes = _contact_classes(source, source_cage), _contact_classes(target, target_cage)
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
            apart = np.array([[centres[0][i] - centres[1][j] for j in theirs] for i in ours])
            cost = (apart**2).sum(axis=2)
            cost += [[OTHER_CONTACTS * (classes[0].get(i) != classes[1].get(j)) for j in theirs] for i in ours]
            order = linear_sum_assignment(cost)[1]
            for child, k in zip(ours, order):
                walk(child, theirs[k])

    walk(source.root(), target.root())
    return tuple((part_id, partners[part_id]) for part_id in source.parts())


def relative_centres(cage: Cage) -> Float[ndarray, "p 3"]:
    """Centres of cuboids in the unit cube that the cage's bounding box is mapped to."""
    corners = cage.corners().reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    return (cage.centre - low) / (high - low)


def _node_centres(structure: Structure, cage: Cage) -> dict[str, Float[ndarray, " 3"]]:
    """Mean part centre below each node, relative to the cage's bounding box."""
    relative = relative_centres(cage)
    centres: dict[str, ndarray] = {}

    def walk(node: str) -> list[ndarray]:
        children = structure.children(node)
        below = [point for child in children for point in walk(child)]
        below = below if children else [relative[cage.part_ids.index(node)]]
        centres[node] = np.mean(below, axis=0)
        return below

    walk(structure.root())
    return centres


def _contact_classes(structure: Structure, cage: Cage) -> dict[str, str]:
    """A class for each part, shared by parts with equal contacts; empty if every part has a label.

    Each part is named by its signature and how many it touches, then twice more by its own name and those
    of the parts it touches (Weisfeiler and Lehman's colours).
    """
    signatures = structure.signatures()
    if all(signatures[part_id] for part_id in cage.part_ids):
        return {}
    contacts = touching(cage)
    names = [f"{signatures[part_id]}{contacts[i].sum()}" for i, part_id in enumerate(cage.part_ids)]
    for _ in range(2):
        around = [",".join(sorted(names[j] for j in np.flatnonzero(row))) for row in contacts]
        names = [f"{name}({others})" for name, others in zip(names, around)]
    return dict(zip(cage.part_ids, names))


def touching(cage: Cage) -> Bool[ndarray, "p p"]:
    """Whether each two cuboids are at most CONTACT apart along every separating axis; none touches itself."""
    return (gaps(cage) <= CONTACT) & ~np.eye(len(cage), dtype=bool)


def gaps(cage: Cage) -> Float[ndarray, "p p"]:
    """Gaps between each two cuboids along the axis that separates them most, canonical units.

    At most their distance; negative where they overlap, 0 for a cuboid and itself.
    """
    a, b = np.triu_indices(len(cage), 1)
    crosses = np.cross(cage.axes[a][:, :, None], cage.axes[b][:, None]).reshape(-1, 9, 3)
    axes = np.concatenate([cage.axes[a], cage.axes[b], crosses], axis=1)
    length = np.linalg.norm(axes, axis=2, keepdims=True)
    axes = np.where(length > 1e-6, axes / np.maximum(length, 1e-6), 0)  # of parallel edges: no axis
    gap = np.abs(np.einsum("mkx,mx->mk", axes, cage.centre[a] - cage.centre[b]))
    for i in (a, b):
        gap -= np.einsum("mka,ma->mk", np.abs(np.einsum("mkx,max->mka", axes, cage.axes[i])), cage.size[i] / 2)
    result = np.zeros((len(cage), len(cage)))
    result[a, b] = result[b, a] = gap.max(axis=1, initial=-np.inf)
    return result
