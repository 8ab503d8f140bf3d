"""One field from the answers of all cuboids, exact where the surface is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int
from numpy import ndarray

from cagesdf.extraction.asking import Answers, Method
from cagesdf.extraction.field import CageField
from cagesdf.extraction.lattice import Lattice, Region

CHUNK = 1 << 16  # places that are looked at together: what is at work is their number times that of the cuboids


@dataclass(frozen=True, eq=False)
class Part:
    """What is known of one cuboid: its region, and the network's answers there.

    It depends on the network, the latent, the cuboid and the cell, not on the other cuboids.
    Further exact values are added to `answers` as neighbours make them necessary; signs stay.
    """

    region: Region
    answers: Answers


def part_of(field: CageField, cuboid: int, cell: float, method: Method) -> Part:
    """Ask a field's network for one of its cuboids."""
    region = Region.around(field.cage[field.cage.part_ids[cuboid]], cell)
    return Part(region, method(lambda points: field.ask(points, cuboid), region))


class Joined:
    """The field's signs on the lattice around a cage, and its values at both ends of all edges with two signs."""

    def __init__(self, field: CageField, parts: Sequence[Part], cell: float) -> None:
        """`parts` are the cuboids', in the cage's order, made with the same `cell`."""
        corners = field.cage.corners().reshape(-1, 3)
        lattice = Lattice.covering(corners.min(axis=0), corners.max(axis=0), cell)
        self.field = field
        self.parts = parts
        self.lattice = lattice
        self.asked = 0  # points given to the network here, beyond those that the parts have asked
        self.covered = np.zeros(lattice.shape, dtype=bool)  # in some cuboid
        self.values = np.full(lattice.shape, np.nan, np.float32)  # exact at the ends in cuboids, else NaN
        self.negative = np.zeros(lattice.shape, dtype=bool)
        contested = np.zeros(lattice.shape, dtype=bool)
        for part in parts:
            box, inside, negative = lattice.box_of(part.region.lattice), part.region.inside, part.answers.negative
            before = self.covered[box]
            contested[box] |= before & inside & (negative != self.negative[box])
            before |= inside
            self.negative[box] |= negative
        self._settle(np.flatnonzero(contested))
        del contested
        pending = np.flatnonzero(ends(self.negative))
        while len(changed := self._settle(pending)):
            pending = self._ends_beside(changed)

    def _settle(self, places: Int[ndarray, " n"]) -> Int[ndarray, " m"]:
        """Find the exact values at (flat) places that have none; return those whose sign was another."""
        values, negative = self.values.reshape(-1), self.negative.reshape(-1)
        places = places[self.covered.reshape(-1)[places] & np.isnan(values[places])]
        for chunk in np.split(places, range(CHUNK, len(places), CHUNK)):
            values[chunk] = self.field_at(chunk)
        changed = places[negative[places] != (values[places] < 0)]
        negative[changed] ^= True
        return changed

    def field_at(self, places: Int[ndarray, " n"]) -> Float32[ndarray, " n"]:
        """The field at places in cuboids, where all cuboids that contain one have been asked."""
        indices = np.stack(np.unravel_index(places, self.lattice.shape), axis=1)
        depth = np.full((len(places), len(self.parts)), np.inf, np.float32)
        values = np.zeros(depth.shape, np.float32)
        for k, part in enumerate(self.parts):
            rows, local, depths = part.region.among(indices, self.lattice)
            exact = part.answers.exact.reshape(-1)
            unknown = np.isnan(exact[local])
            if unknown.any():
                exact[local[unknown]] = self.field.ask(self.lattice.points(indices[rows[unknown]]), k)
                self.asked += int(unknown.sum())
            depth[rows, k], values[rows, k] = depths, exact[local]
        return self.field.overlap(depth, values)

    def _ends_beside(self, places: Int[ndarray, " n"]) -> Int[ndarray, " m"]:
        """Of the places and their six neighbours, those at edges from a place to a neighbour of the other sign."""
        _, s, t = self.lattice.shape
        around = places[:, None] + np.array([s * t, -s * t, t, -t, 1, -1])
        negative = self.negative.reshape(-1)
        differ = negative[around] != negative[places][:, None]
        return np.unique(np.concatenate([around[differ], places[differ.any(axis=1)]]))


def ends(negative: Bool[ndarray, "r s t"]) -> Bool[ndarray, "r s t"]:
    """The points that have a neighbour of the other sign along an axis."""
    found = np.zeros(negative.shape, dtype=bool)
    for axis in range(3):
        low, high = (slice(None),) * axis + (slice(None, -1),), (slice(None),) * axis + (slice(1, None),)
        differ = negative[low] != negative[high]
        found[low] |= differ
        found[high] |= differ
    return found
