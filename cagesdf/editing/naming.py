"""Plain names for the parts of new programs, whose cuboids have numbers alone.

A part is called as the training part that it is most like in place and size, relative to the whole, in the few shapes
that are most like all of it; where the training parts have no labels, by its group and its place in it. Parts that
mirror or repeat each other share a label, so that `part_names` numbers them.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.deformation.likeness import relative_boxes
from cagesdf.editing.links import linked, mirrors, repeats
from cagesdf.editing.state import State
from cagesdf.frames import Similarity
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.base import Structure

FEW = 5  # shapes whose labels a new one gets
WITHIN = " / "  # between a group and a part of it


@dataclass(frozen=True, eq=False)
class KnownParts:
    """The training parts that have labels."""

    boxes: Float[ndarray, "n 6"]  # see `relative_boxes`
    labels: tuple[str, ...]
    owners: Int[ndarray, " n"]  # number of the shape that each is of, from 0 on

    @staticmethod
    def of(states: Iterable[State]) -> "KnownParts":
        """The labelled parts of some shapes."""
        boxes: list[ndarray] = []
        words: list[str] = []
        owners: list[int] = []
        for number, state in enumerate(states):
            labels = state.structure.labels()
            named = [bool(labels[part]) for part in state.cage.part_ids]
            boxes.append(relative_boxes(state.cage)[named])
            words += [labels[part] for part in state.cage.part_ids if labels[part]]
            owners += [number] * sum(named)
        return KnownParts(np.concatenate([np.zeros((0, 6)), *boxes]), tuple(words), np.array(owners, int))

    def labelled(self, structure: Structure, cage: Cage) -> Structure:
        """A structure around a cage, canonical, with a label for each part; one that has any, or no program, stays."""
        if not isinstance(structure, Assembly) or structure.names:
            return structure
        words = self._nearest(cage) if self.labels else _by_group(cage.part_ids)
        state = State.opened(cage, structure, np.zeros(0, np.float32), Similarity(1.0, np.eye(3), np.zeros(3)))
        links = [mirrors(state), repeats(state)]
        names: dict[str, str] = {}
        for part in cage.part_ids:
            alike = linked([part], links)
            _, word = min(words[other] for other in alike)
            names.setdefault(part, word)
        return structure.labelled(names)

    def document(self, structure: Structure, cage: Cage) -> str:
        """A new structure as an operation takes it, labelled; a program that doesn't say where it stands as cuboids."""
        labelled = self.labelled(structure, cage)
        placed = labelled if labelled.placed_program() is not None else labelled.with_cuboids(cage.cuboids())
        return placed.to_json()

    def _nearest(self, cage: Cage) -> dict[str, tuple[float, str]]:
        """By part, the distance of the nearest training part, and its label."""
        apart = np.linalg.norm(relative_boxes(cage)[:, None] - self.boxes, axis=2)
        shapes = np.unique(self.owners)
        misfits = np.array([apart[:, self.owners == shape].min(axis=1).mean() for shape in shapes])
        apart[:, ~np.isin(self.owners, shapes[np.argsort(misfits, kind="stable")[:FEW]])] = np.inf
        nearest = apart.argmin(axis=1)
        distances = apart.min(axis=1).tolist()
        return {part: (distances[i], self.labels[nearest[i]]) for i, part in enumerate(cage.part_ids)}


def group_names(structure: Structure) -> dict[str, str]:
    """A name for each node between the root and the parts, by id: labels of what is in it, numbered where shared.

    A node whose parts have no labels keeps its id.
    """
    labels = structure.labels()

    def words(node: str) -> list[str]:
        children = structure.children(node)
        inside = [word for child in children for word in words(child)]
        return inside if children else [labels[node].partition(WITHIN)[0]]

    def groups(node: str) -> list[str]:
        inner = [child for child in structure.children(node) if structure.children(child)]
        return [group for child in inner for group in (child, *groups(child))]

    texts = {
        node: ", ".join(dict.fromkeys(word for word in words(node) if word)) or node
        for node in groups(structure.root())
    }
    shared, seen = Counter(texts.values()), Counter[str]()
    names = {}
    for node, text in texts.items():
        seen[text] += 1
        names[node] = f"{text} ({seen[text]})" if shared[text] > 1 else text
    return names


def _by_group(parts: tuple[str, ...]) -> dict[str, tuple[float, str]]:
    """By part, its place in the order of parts, and a label: group 1 / part 2, or part 2 outside of groups."""
    groups: dict[str, list[str]] = {}
    for part in parts:
        groups.setdefault(part.rpartition("/")[0], []).append(part)
    numbers = {group: number for number, group in enumerate((group for group in groups if group), 1)}
    return {
        part: (
            float(place),
            (f"group {numbers[group]}{WITHIN}" if group else "") + f"part {groups[group].index(part) + 1}",
        )
        for place, part in enumerate(parts)
        for group in [part.rpartition("/")[0]]
    }
