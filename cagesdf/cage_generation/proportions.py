"""New proportions for known structures: a Gaussian for each, over the cages of the shapes that have it.

For categories whose cuboids are free of each other, such as vases. A draw is an affine combination of all
the cages of one structure, so whatever linear relation holds in all of them, such as symmetry, a common
axis or equal widths, holds in it too. It never makes a structure that training has not shown.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation as Turn

from cagesdf.cage_generation.generator import Generated, Generator, Samples, samples_of
from cagesdf.cage_generation.novelty import standing
from cagesdf.cuboid import Cage
from cagesdf.deformation.matching import correspond, touching
from cagesdf.structure.base import Structure

THINNEST = 1e-3  # lengths of a cuboid, canonical units


@dataclass(frozen=True, eq=False)
class Family:
    """The cages of the shapes that share a structure."""

    structure: Structure  # of one of them
    part_ids: tuple[str, ...]  # of that structure
    cuboids: Float[ndarray, "n p 15"]  # as `Cage.vectors`, parts in that order; n ≥ 1

    def combined(self, weights: Float[ndarray, " n"]) -> Cage:
        """Σ wᵢ · cage i; the weights' sum is 1. Axes are combined as rotations from their mean."""
        blend = np.tensordot(weights, self.cuboids, axes=1)
        axes = self.cuboids[:, :, 3:12].reshape(*self.cuboids.shape[:2], 3, 3)
        for part in range(len(self.part_ids)):
            turns = Turn.from_matrix(axes[:, part])
            mean = turns.mean()
            away = weights @ (turns * mean.inv()).as_rotvec()
            blend[part, 3:12] = (Turn.from_rotvec(away) * mean).as_matrix().ravel()
        return Cage.from_vectors(self.part_ids, blend)

    def contacts(self) -> ndarray:
        """Whether each two parts touch in all of the cages."""
        return np.all([touching(Cage.from_vectors(self.part_ids, cage)) for cage in self.cuboids], axis=0)


def families(structures: Mapping[str, Structure], cages: Mapping[str, Cage]) -> tuple[Family, ...]:
    """Shapes grouped by structure, their parts paired as §3.3 pairs them; the largest family first."""
    groups: dict[str, list[str]] = {}
    for shape_id in sorted(structures):
        groups.setdefault(structures[shape_id].signature(), []).append(shape_id)
    result: list[Family] = []
    for ids in sorted(groups.values(), key=lambda ids: (-len(ids), ids)):
        first, cage = structures[ids[0]], cages[ids[0]]
        vectors = []
        for shape_id in ids:
            partners = dict(correspond(first, cage, structures[shape_id], cages[shape_id]))
            order = [cages[shape_id].part_ids.index(partners[part]) for part in cage.part_ids]
            vectors.append(cages[shape_id].vectors()[order])
        result.append(Family(first, cage.part_ids, np.array(vectors)))
    return tuple(result)


@dataclass(frozen=True, eq=False)
class ProportionGenerator(Generator):
    """Structures as often as training has them, each with proportions of its own."""

    families: tuple[Family, ...]
    reach: float  # distance of the farthest corner of a cage, canonical units: the training cages' median

    def sample(self, rng: np.random.Generator, count: int, temperature: float) -> Samples:
        """See `Generator.sample`; a temperature of 1 has the covariance of the training cages."""
        sizes = np.array([len(family.cuboids) for family in self.families])
        drawn: list[Generated | str] = []
        contacts = [family.contacts() for family in self.families]
        for choice in rng.choice(len(sizes), count, p=sizes / sizes.sum()):
            family, n = self.families[choice], sizes[choice]
            normal = rng.standard_normal(n)
            spread = temperature / np.sqrt(max(n - 1, 1)) * (normal - normal.mean())
            drawn.append(self._checked(family, family.combined(1 / n + spread), contacts[choice]))
        return samples_of(drawn)

    def _checked(self, family: Family, cage: Cage, contacts: ndarray) -> Generated | str:
        if cage.size.min() < THINNEST:
            return "cuboid shrunk to nothing"
        if (contacts & ~touching(cage)).any():
            return "parts came apart"
        similarity = standing(cage, self.reach)
        placed = cage.transformed(similarity)
        return Generated(family.structure.with_cuboids(placed.cuboids()), placed)
