"""Parts that mirror each other, and what a change of one means for the other.

A change is a function from cuboid to cuboid, so its mirrored counterpart is: mirror, change, mirror back.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import linear_sum_assignment

from cagesdf.cuboid import PROPER_PERMUTATIONS, Cage, Cuboid
from cagesdf.editing.state import State
from cagesdf.structure.base import Structure
from cagesdf.structure.relations import Reflection

Change = Callable[[Cuboid], Cuboid]

# The improper signed permutations: they name a mirrored cuboid's axes so that these are right-handed again.
IMPROPER = -PROPER_PERMUTATIONS


@dataclass(frozen=True, eq=False)
class Mirror:
    """A plane."""

    point: Float[ndarray, " 3"]  # on it, canonical
    normal: Float[ndarray, " 3"]  # unit, canonical

    def __call__(self, point: Float[ndarray, " 3"]) -> Float[ndarray, " 3"]:
        """The mirror image of a point."""
        return point - 2 * ((point - self.point) @ self.normal) * self.normal

    def mirrored(self, change: Change, axes: Float[ndarray, "3 3"]) -> Change:
        """What a change of a cuboid that has these axes is for the cuboid on the other side."""
        flip = np.eye(3) - 2 * np.outer(self.normal, self.normal)

        def other(cuboid: Cuboid) -> Cuboid:
            flipped = cuboid.axes @ flip
            naming = IMPROPER[int(np.einsum("kij,jl,il->k", IMPROPER, flipped, axes).argmax())]
            image = Cuboid(self(cuboid.centre), naming @ flipped, np.abs(naming) @ cuboid.size)
            changed = change(image)
            return Cuboid(self(changed.centre), naming.T @ changed.axes @ flip, np.abs(naming.T) @ changed.size)

        return other


def mirrors(state: State) -> dict[str, dict[str, Mirror]]:
    """By part, the parts that mirror it according to the structure, and in which plane.

    A relation between nodes pairs the parts below them: each with the one that is nearest to its mirror image.
    """
    found: dict[str, dict[str, Mirror]] = {part: {} for part in state.cage.part_ids}
    for relation in state.structure.relations():
        if not isinstance(relation, Reflection):
            continue
        normal = np.array(relation.normal) / state.stretch
        mirror = Mirror(np.array(relation.point) * state.stretch, normal / np.linalg.norm(normal))
        ours, theirs = (_leaves(state.structure, node) for node in (relation.a, relation.b))
        for a, b in _nearest(state.cage, ours, theirs, mirror):
            found[a][b] = found[b][a] = mirror
    return found


def locked(state: State, changes: Mapping[str, Change]) -> dict[str, Change]:
    """The changes of some parts, and what they mean for those that mirror them, directly or through others."""
    every = dict(changes)
    planes = mirrors(state)
    waiting = deque(changes)
    while waiting:
        part = waiting.popleft()
        for other, mirror in planes[part].items():
            if other not in every:
                every[other] = mirror.mirrored(every[part], state.cage[part].axes)
                waiting.append(other)
    return every


def _leaves(structure: Structure, node: str) -> list[str]:
    children = structure.children(node)
    return [leaf for child in children for leaf in _leaves(structure, child)] if children else [node]


def _nearest(cage: Cage, ours: list[str], theirs: list[str], mirror: Mirror) -> list[tuple[str, str]]:
    """Pairs of parts on either side of a plane, so that the mirror images are near."""
    images = np.array([mirror(cage[part].centre) for part in ours])
    centres = np.array([cage[part].centre for part in theirs])
    rows, columns = linear_sum_assignment(np.linalg.norm(images[:, None] - centres, axis=2))
    return [(ours[i], theirs[j]) for i, j in zip(rows, columns)]
