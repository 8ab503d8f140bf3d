"""Targets: who is compatible, which part is which, and what is drawn."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cagesdf.cage_fitting.cages import fit_cage
from cagesdf.cuboid import Cage
from cagesdf.deformation.matching import (
    CONTACT,
    correspond,
    group_by_structure,
    match_to_one_of,
    match_to_scaled,
    touching,
)
from cagesdf.shape import Shape
from cagesdf.structure.hierarchy import Node, PartHierarchy
from tests.support import toy


def cage_of(shape: Shape) -> Cage:
    return fit_cage(shape, 0.01, 1e-3, 1e-6, 10, np.random.default_rng(0)).cage


def points_cage(centres: dict[str, list[float]]) -> Cage:
    """Small cubes at the given centres."""
    count = len(centres)
    return Cage(
        tuple(centres),
        np.array(list(centres.values()), float),
        np.tile(np.eye(3), (count, 1, 1)),
        np.full((count, 3), 0.1),
    )


def leaf(name: str, label: str) -> Node:
    return Node(name, label, (), (), None)


@pytest.fixture(scope="module")
def stools() -> dict[str, Shape]:
    return {
        shape.shape_id: shape
        for shape in (
            toy.stool("a"),
            toy.stool("b", width=1.3, height=0.6),
            toy.stool("c", legs=3),
            toy.stool("d", lean=0.3),
        )
    }


def test_stools_of_equally_many_legs_are_compatible_and_nobody_with_itself(stools: dict[str, Shape]) -> None:
    structures = {shape_id: shape.structure for shape_id, shape in stools.items()}
    groups = group_by_structure(structures, {shape_id: cage_of(shape) for shape_id, shape in stools.items()})
    assert groups == {"a": ("b", "d"), "b": ("a", "d"), "c": (), "d": ("a", "b")}


def test_legs_correspond_by_place_whatever_their_names_and_order(stools: dict[str, Shape]) -> None:
    source, target = stools["a"], stools["b"]
    names = {"leg0": "w", "leg1": "x", "leg2": "y", "leg3": "z", "seat": "s"}
    cage = cage_of(target)
    order = [4, 2, 0, 3, 1]
    shuffled = Cage(
        tuple(names[cage.part_ids[i]] for i in order), cage.centre[order], cage.axes[order], cage.size[order]
    )
    legs = tuple(leaf(name, "leg") for name in "yxwz")
    tree = Node("root", "stool", (Node("base", "base", legs, (), None), leaf("s", "seat")), (), None)
    pairs = correspond(source.structure, cage_of(source), PartHierarchy(tree), shuffled)
    assert pairs == tuple((part_id, names[part_id]) for part_id in source.structure.parts())


def test_correspondence_is_symmetric_and_the_identity_on_itself(stools: dict[str, Shape]) -> None:
    a, b = stools["a"], stools["d"]
    forth = correspond(a.structure, cage_of(a), b.structure, cage_of(b))
    back = correspond(b.structure, cage_of(b), a.structure, cage_of(a))
    assert sorted(forth) == sorted((x, y) for y, x in back)
    assert all(x == y for x, y in correspond(a.structure, cage_of(a), a.structure, cage_of(a)))


def test_subtrees_go_together_even_where_single_parts_lie_nearer_elsewhere() -> None:
    """Golden: two arms of two unlabelled parts each; arm by arm, then part by part."""

    def tree(arms: list[list[str]]) -> PartHierarchy:
        nodes = tuple(
            Node(f"arm{i}", "arm", tuple(leaf(name, "bar") for name in names), (), None) for i, names in enumerate(arms)
        )
        return PartHierarchy(Node("root", "thing", nodes, (), None))

    source = points_cage({"a": [0, 0, 0], "b": [1, 0, 0], "c": [4, 1, 0], "d": [5, 0, 0]})
    target = points_cage({"p": [5, 0, 0], "q": [3.9, 1, 0], "r": [2.2, 0, 0], "s": [0, 0, 0]})
    pairs = correspond(tree([["a", "b"], ["c", "d"]]), source, tree([["p", "q"], ["r", "s"]]), target)
    assert pairs == (("a", "s"), ("b", "r"), ("c", "q"), ("d", "p"))


def test_assignment_equals_the_best_of_all_permutations() -> None:
    from itertools import permutations

    rng = np.random.default_rng(0)
    names = tuple("abcde")
    structure = PartHierarchy.flat(names, ("",) * 5, "heap")
    for _ in range(20):
        cages = [points_cage(dict(zip(names, rng.uniform(-1, 1, (5, 3)).tolist()))) for _ in range(2)]
        relative = []
        for cage in cages:
            corners = cage.corners().reshape(-1, 3)
            relative.append((cage.centre - corners.min(axis=0)) / np.ptp(corners, axis=0))
        cost = {order: ((relative[0] - relative[1][list(order)]) ** 2).sum() for order in permutations(range(5))}
        best = min(cost, key=lambda order: cost[order])
        pairs = correspond(structure, cages[0], structure, cages[1])
        assert pairs == tuple((names[i], names[j]) for i, j in enumerate(best))


def test_scaling_and_moving_a_whole_cage_changes_no_correspondence(stools: dict[str, Shape]) -> None:
    shape, cage = stools["a"], cage_of(stools["a"])
    turned = Cage(cage.part_ids, cage.centre * 3 + 7, cage.axes, cage.size * 3)
    pairs = correspond(shape.structure, cage, shape.structure, turned)
    assert all(x == y for x, y in pairs)
    small = cage.axes @ Rotation.from_euler("y", 0.1).as_matrix()
    pairs = correspond(shape.structure, cage, shape.structure, Cage(cage.part_ids, cage.centre, small, cage.size))
    assert all(x == y for x, y in pairs)


def test_different_structures_do_not_correspond(stools: dict[str, Shape]) -> None:
    a, c = stools["a"], stools["c"]
    with pytest.raises(ValueError, match="structures differ"):
        correspond(a.structure, cage_of(a), c.structure, cage_of(c))


def test_a_target_is_one_of_the_partners_the_same_for_the_same_seed(stools: dict[str, Shape]) -> None:
    structures = {shape_id: shape.structure for shape_id, shape in stools.items()}
    cages = {shape_id: cage_of(shape) for shape_id, shape in stools.items()}
    matches = [match_to_one_of("a", ("b", "d"), structures, cages, np.random.default_rng(seed)) for seed in range(8)]
    assert {match.target_id for match in matches} == {"b", "d"}
    again = match_to_one_of("a", ("b", "d"), structures, cages, np.random.default_rng(3))
    assert again == matches[3]
    b = next(match for match in matches if match.target_id == "b")
    distances = [np.linalg.norm(cages["a"][x].centre - cages["b"][y].centre) for x, y in b.pairs]
    assert b.cost == pytest.approx(np.mean(distances))
    assert b.candidates == 2


def unlabelled(shape: Shape) -> PartHierarchy:
    parts = shape.structure.parts()
    return PartHierarchy.flat(parts, ("",) * len(parts), "stool")


def test_parts_without_labels_are_told_apart_by_what_they_touch(stools: dict[str, Shape]) -> None:
    """A seat that four legs touch is no leg, however low it lies in the other shape."""
    a, cage = unlabelled(stools["a"]), cage_of(stools["a"])
    assert touching(cage).sum(axis=1).tolist() == [4, 1, 1, 1, 1]
    low = Cage(cage.part_ids, cage.centre * [1, -1, 1], cage.axes, cage.size)
    assert ("seat", "seat") in correspond(a, cage, a, low)
    apart = Cage(cage.part_ids, cage.centre * 3, cage.axes, cage.size)
    groups = group_by_structure(dict.fromkeys("xyz", a), {"x": cage, "y": low, "z": apart})
    assert groups == {"x": ("y",), "y": ("x",), "z": ()}


def test_cuboids_touch_if_and_only_if_points_of_both_are_near() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        cage = Cage(
            ("a", "b"), rng.uniform(-1, 1, (2, 3)), Rotation.random(2, rng=rng).as_matrix(), rng.uniform(0.2, 1, (2, 3))
        )
        inside = cage.from_unit(rng.uniform(-0.5, 0.5, (20000, 3)), 0)
        gap = cage.signed_distance(inside)[:, 1].min()
        if gap < CONTACT:
            assert touching(cage)[0, 1]
        if gap > 0.15:  # the points leave gaps, and boxes corner to corner pass for a little nearer than they are
            assert not touching(cage)[0, 1]
    assert not touching(cage).diagonal().any()


def test_scaling_factors_stay_in_range_and_their_logarithms_fill_it() -> None:
    cage = points_cage({"a": [1, 0, 0], "b": [0, 1, 0]})
    scales = np.array([match_to_scaled("a", cage, (0.5, 2.0), np.random.default_rng(k)).scale for k in range(500)])
    assert scales.min() >= 0.5
    assert scales.max() <= 2.0
    assert abs(np.median(scales) - 1) < 0.06
    match = match_to_scaled("a", cage, (0.5, 2.0), np.random.default_rng(0))
    assert (match.target_id, match.pairs) == (None, (("a", "a"), ("b", "b")))
