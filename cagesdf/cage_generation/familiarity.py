"""Whether each part of a new cage is somewhat where a known shape has a part (ours; not in the paper)."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cagesdf.cuboid import Cage
from cagesdf.deformation.likeness import relative_boxes

USUAL = 0.9  # share of the known shapes that would be familiar, were they not known
LEAST = 0.1  # distance of `relative_boxes` at which parts are alike in any case


@dataclass(frozen=True, eq=False)
class Familiarity:
    """The boxes of known shapes' parts, relative to their shapes."""

    boxes: cKDTree  # of all parts, `relative_boxes`
    limit: float  # strangeness up to which a cage is familiar

    @staticmethod
    def of(cages: Collection[Cage]) -> "Familiarity":
        """From one known cage or more.

        The limit is the strangeness that USUAL of the known shapes don't exceed, each seen from the others: shapes that
        differ much among themselves let new ones differ as much. A shape without others sets none.
        """
        each = [relative_boxes(cage) for cage in cages]
        owner = np.repeat(np.arange(len(each)), [len(boxes) for boxes in each])
        tree = cKDTree(np.concatenate(each))
        if len(each) == 1:
            return Familiarity(tree, np.inf)
        strangeness = []
        for number, boxes in enumerate(each):
            # Of one more neighbour than the shape has parts, one at least is another shape's.
            distances, neighbours = tree.query(boxes, k=len(boxes) + 1)
            others = np.where(owner[neighbours] != number, distances, np.inf)
            strangeness.append(others.min(axis=1).max())
        return Familiarity(tree, max(LEAST, float(np.quantile(strangeness, USUAL))))

    def strangeness(self, cage: Cage) -> float:
        """The distance of the cage's strangest part from the known part that it is most like, by `relative_boxes`."""
        return float(self.boxes.query(relative_boxes(cage))[0].max())

    def familiar(self, cage: Cage) -> bool:
        """Whether no part is stranger than those of known shapes are to each other."""
        return self.strangeness(cage) <= self.limit
