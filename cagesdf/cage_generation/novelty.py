"""Novelty of structures and cages: whether the training shapes have them.

Cages are compared centred and scaled to the unit sphere, their parts paired as §3.3 pairs them; names
and the order of statements don't matter.
"""

from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.deformation.matching import correspond
from cagesdf.frames import Similarity
from cagesdf.structure.base import Structure

TOLERANCE = 0.01  # a cage that differs by less from one of equal structure is a copy of it


def standing(cage: Cage, reach: float) -> Similarity:
    """The similarity that centres a cage's bounding box and puts its farthest corner at the distance `reach`."""
    corners = cage.corners().reshape(-1, 3)
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    scale = reach / float(np.linalg.norm(corners - centre, axis=1).max())
    return Similarity(scale, np.eye(3), -scale * centre)


def reach_of(cages: Iterable[Cage]) -> float:
    """Distance of the farthest corner from the middle of the bounding box: median over cages, at least one."""
    return float(np.median([1 / standing(cage, 1.0).scale for cage in cages]))


class Known:
    """The structures that a generator was trained on, with their cages."""

    def __init__(self, structures: Mapping[str, Structure], cages: Mapping[str, Cage]) -> None:
        """Structures and canonical cages are by shape id."""
        self._by_signature: dict[str, list[str]] = {}
        for shape_id in sorted(structures):
            self._by_signature.setdefault(structures[shape_id].signature(), []).append(shape_id)
        self._structures = structures
        self._cages = {shape_id: cage.transformed(standing(cage, 1.0)) for shape_id, cage in cages.items()}

    def nearest(self, structure: Structure, cage: Cage, without: str = "") -> tuple[str, float]:
        """The most similar known shape of equal structure, `without` apart, and its `difference`.

        "" and infinity if no other has that structure.
        """
        others = [name for name in self._by_signature.get(structure.signature(), []) if name != without]
        difference, name = min(
            [(self.difference(structure, cage, name), name) for name in others], default=(np.inf, "")
        )
        return name, difference

    def difference(self, structure: Structure, cage: Cage, name: str) -> float:
        """Difference between a cage and that of a known shape; infinity if their structures differ.

        Mean distance of the cuboids' corners to the nearest corner of their partners, both ways, in radii
        of the cages.
        """
        if structure.signature() != self._structures[name].signature():
            return np.inf
        cage, other = cage.transformed(standing(cage, 1.0)), self._cages[name]
        pairs = correspond(structure, cage, self._structures[name], other)
        ours, theirs = np.array([[cage.part_ids.index(a), other.part_ids.index(b)] for a, b in pairs]).T
        return _apart(cage.corners()[ours], other.corners()[theirs])


def _apart(a: Float[ndarray, "p 8 3"], b: Float[ndarray, "p 8 3"]) -> float:
    """Mean distance of each cuboid's corners to the nearest of its partner's, whatever the names of the axes."""
    distances = np.linalg.norm(a[:, :, None] - b[:, None], axis=3)
    return float((distances.min(axis=1).mean() + distances.min(axis=2).mean()) / 2)
