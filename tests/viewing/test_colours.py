"""Colours say which parts belong together."""

import numpy as np

from cagesdf.editing.links import mirrors, repeats
from cagesdf.editing.script import Build, Duplicate, Split
from cagesdf.editing.state import State
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.viewing.colours import SELECTED, part_colours
from tests.support.mirrored import chair, do, jug


def unlabelled(state: State) -> State:
    cuboids = dict(zip("abcdefghijklmnopqrstuvwxyz", state.cage.cuboids().values()))
    tree = PartHierarchy.flat(tuple(cuboids), ("",) * len(cuboids), "").with_cuboids(cuboids)
    return do(state, Build(structure=tree.to_json()))


def test_parts_that_mirror_or_repeat_each_other_share_a_colour_and_others_have_their_own() -> None:
    for state in (chair(), jug(), do(jug(), Duplicate(part="body", by=(0.0, 1.0, 0.0)))):
        colours = part_colours(state)
        assert tuple(sorted(colours)) == tuple(sorted(state.cage.part_ids))
        labels = state.structure.labels()
        for part, others in [*mirrors(state).items(), *repeats(state).items()]:
            assert all(colours[other] == colours[part] for other in others)
        assert all(
            colours[a] != colours[b]
            for a in labels
            for b in labels
            if labels[a] and labels[b] and labels[a] != labels[b]
        )
    many = unlabelled(do(chair(), Split(part="*", axis="y"), Split(part="seat", axis="x")))
    assert len(many.cage) > 14
    assert len(set(part_colours(many).values())) == len(many.cage)


def test_no_part_has_the_colour_of_outlines() -> None:
    colours = part_colours(unlabelled(do(chair(), Split(part="*", axis="y"))))
    assert min(np.abs(np.subtract(colour, SELECTED)).max() for colour in colours.values()) > 60
