"""Colours of parts: those that belong together share one, others don't, and none is the selection's."""

import colorsys
import re

from cagesdf.editing.links import alike, linked, mirrors, repeats
from cagesdf.editing.parts import part_names
from cagesdf.editing.state import State
from cagesdf.rendering import PART_COLOURS, rgb

Colour = tuple[int, int, int]

SELECTED: Colour = (255, 0, 128)  # outlines of what is selected
AXES: tuple[Colour, Colour, Colour] = ((255, 32, 96), (32, 223, 128), (32, 128, 255))  # x, y, z, as the gizmo has them
GOLDEN = 0.618  # share of the colour circle between consecutive further hues
NUMBER = re.compile(r"[ _\-.]*\d+$")


def groups(state: State) -> dict[str, int]:
    """By part, a number that parts share which have a label in common, mirror or repeat each other, or differ in name
    by a number alone."""
    names, labels = part_names(state.structure), state.structure.labels()
    links = [mirrors(state), repeats(state), alike(state)]
    words: dict[str, str] = {}
    for part, name in names.items():
        word = labels[part] or NUMBER.sub("", name) or name
        # An unlabelled program calls its cuboids cube1, cube2, in blocks of it Block/cube1: these are no kinds.
        kind = bool(labels[part]) or word.rpartition("/")[2] not in ("cube", "part")
        words[part] = word if kind else f"{part}\n"
    number: dict[str, int] = {}
    for part in names:
        if part not in number:
            same = {words[other] for other in linked([part], links)}
            new = max(number.values(), default=-1) + 1
            number |= {other: new for other in names if words[other] in same and other not in number}
    return number


def part_colours(state: State) -> dict[str, Colour]:
    """By part, the colour of its group: the pictures' colours first, then hues between them."""
    return {part: palette(number) for part, number in groups(state).items()}


def palette(number: int) -> Colour:
    """Colour number 0, 1, ...; all differ from each other and from SELECTED."""
    if number < len(PART_COLOURS):
        return rgb(PART_COLOURS[number])
    # Hues from 0 to 0.85: pinks are the selection's.
    hue, shade = 0.85 * ((number * GOLDEN) % 1), (0.45, 0.62, 0.35)[number % 3]
    red, green, blue = colorsys.hls_to_rgb(hue, shade, 0.45)
    return round(255 * red), round(255 * green), round(255 * blue)
