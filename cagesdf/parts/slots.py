"""Labels of found parts that mean the same in all shapes of a collection, so that matching finds equal structures.

A slot is a place that a part can have in a shape: where it lies and how large it is, relative to the shape. Parts of
one shape that repeat or mirror each other have one slot together. Shapes are taken in turn; their parts are assigned to
the slots there are so that the differences are least in all (Kuhn and Munkres); parts unlike all of these open a slot.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import linear_sum_assignment

from cagesdf.shape import Part, Shape
from cagesdf.structure.hierarchy import PartHierarchy

ALIKE = 0.3  # of the logarithm of extents: parts of one shape that differ by less repeat each other
LEVEL = 0.05  # of the shape's height: they lie at one level
APART = 0.6  # difference from all slots that opens one
SIZES = 0.25  # weight of the logarithms of extents beside relative places
THIN = 0.01  # of the longest side: extents below count as this
LONG = 2.0  # times the other extents: a part is upright or a bar
BOARD = 0.4  # of the other extents: a part is a board


@dataclass(eq=False)
class _Slot:
    """A place: the mean place of the parts that were assigned to it."""

    label: str
    place: Float[ndarray, " 6"]
    count: int

    def take(self, place: Float[ndarray, " 6"]) -> None:
        """One more group of parts has this slot."""
        self.place = (self.count * self.place + place) / (self.count + 1)
        self.count += 1


def with_slots(shapes: list[Shape]) -> list[Shape]:
    """The shapes with a label for each part that has none and wasn't given by a file; others stay as they are."""
    slots: list[_Slot] = []
    return [shape if shape.origin.parts == "given" else _labelled(shape, slots) for shape in shapes]


def _labelled(shape: Shape, slots: list[_Slot]) -> Shape:
    unlabelled = [part for part in shape.parts if not part.label]
    if not unlabelled:
        return shape
    places = _places(shape, unlabelled)
    groups = _groups(places)
    means = np.array([places[group].mean(axis=0) for group in groups])
    labels: dict[str, str] = {}
    for group, slot in zip(groups, _assigned(means, slots)):
        labels |= {unlabelled[i].part_id: slot.label for i in group}
    parts = tuple(replace(part, label=labels.get(part.part_id, part.label)) for part in shape.parts)
    bare = PartHierarchy.flat(tuple(p.part_id for p in parts), tuple(p.label for p in parts), "")
    return replace(shape, parts=parts, structure=bare.with_relations(shape.structure.relations()))


def _places(shape: Shape, parts: list[Part]) -> Float[ndarray, "p 6"]:
    """Relative centres, the first one as the distance from the middle, and logarithms of relative extents."""
    every = np.concatenate([part.mesh.vertices for part in shape.parts])
    low, size = every.min(axis=0), np.maximum(np.ptp(every, axis=0), 1e-9)
    ends = np.array([[part.mesh.vertices.min(axis=0), part.mesh.vertices.max(axis=0)] for part in parts])
    centres = (ends.mean(axis=1) - low) / size
    centres[:, 0] = np.abs(centres[:, 0] - 0.5)
    extents = np.log(np.maximum((ends[:, 1] - ends[:, 0]) / size.max(), THIN))
    return np.concatenate([centres, extents], axis=1)


def _groups(places: Float[ndarray, "p 6"]) -> list[list[int]]:
    """Parts that repeat or mirror each other."""
    groups: list[list[int]] = []
    for i, place in enumerate(places):
        for group in groups:
            other = places[group[0]]
            if np.abs(place[3:] - other[3:]).max() < ALIKE and abs(place[1] - other[1]) < LEVEL:
                group.append(i)
                break
        else:
            groups.append([i])
    return groups


def _assigned(places: Float[ndarray, "g 6"], slots: list[_Slot]) -> list[_Slot]:
    """A slot for each place, all different; new ones are added to `slots`."""
    chosen: dict[int, _Slot] = {}
    if slots:
        apart = places[:, None] - np.array([slot.place for slot in slots])
        apart[..., 3:] *= SIZES
        cost = np.minimum(np.linalg.norm(apart, axis=2), APART)
        chosen = {int(i): slots[j] for i, j in zip(*linear_sum_assignment(cost)) if cost[i, j] < APART}
    for i, place in enumerate(places):
        if i in chosen:
            chosen[i].take(place)
        else:
            chosen[i] = _Slot(_label(place, {slot.label for slot in slots}), place, 1)
            slots.append(chosen[i])
    return [chosen[i] for i in range(len(places))]


def _label(place: Float[ndarray, " 6"], taken: set[str]) -> str:
    """A name of a place, with a number where it is taken."""
    level = ("low", "middle", "high")[min(int(3 * place[1]), 2)]
    extents = np.exp(place[3:])
    short, middle, long = np.sort(extents)
    if long > LONG * middle:
        kind = "upright" if extents[1] == long else "bar"
    else:
        kind = "board" if short < BOARD * middle else "block"
    name, number = f"{level} {kind}", 1
    while (label := name if number == 1 else f"{name} {number}") in taken:
        number += 1
    return label
