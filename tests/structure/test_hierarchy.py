"""Part hierarchies: StructureNet's JSON in and out, and what two of them share."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cagesdf.errors import InputError
from cagesdf.structure.hierarchy import MAX_DEPTH, PartHierarchy
from cagesdf.structure.relations import Adjacency, Reflection, Relation, Rotation, Translation


def leaf(number: int, label: str = "leg", x: float = 0.0) -> dict[str, Any]:
    return {"id": number, "label": label, "box": [x, 0, 0, 1, 2, 3, 1, 0, 0, 0, 1, 0]}


def chair(order: tuple[int, ...] = (2, 3, 4), **edge: Any) -> dict[str, Any]:
    legs = [leaf(2, x=-1.0), leaf(3, x=1.0), leaf(4, "seat")]
    children = [legs[i - 2] for i in order]
    base: dict[str, Any] = {"id": 1, "label": "chair", "children": children, "edges": []}
    if edge:
        ends = {"part_a": order.index(2), "part_b": order.index(3)}
        base["edges"] = [{**ends, **edge}]
    return {"id": 0, "label": "root", "children": [base]}


REFLECTION: dict[str, Any] = {"type": "REF_SYM", "params": [0, 0, 0, 1, 0, 0]}

trees = st.recursive(
    st.builds(lambda label, x: leaf(0, label, x), st.text(max_size=5), st.floats(-9, 9)),
    lambda below: st.builds(
        lambda label, children: {"id": 0, "label": label, "children": children},
        st.text(max_size=5),
        st.lists(below, min_size=1, max_size=4),
    ),
    max_leaves=12,
)


@given(trees)
def test_a_hierarchy_read_from_its_own_json_is_the_same(entry: dict) -> None:
    hierarchy = PartHierarchy.from_dict(entry)
    again = PartHierarchy.from_json(hierarchy.to_json())
    assert again.to_json() == hierarchy.to_json()
    assert again.parts() == hierarchy.parts()
    assert again.signature() == hierarchy.signature()


@given(trees)
def test_every_part_is_found_from_the_root_and_ids_are_unique(entry: dict) -> None:
    hierarchy = PartHierarchy.from_dict(entry)

    def below(node: str) -> list[str]:
        children = hierarchy.children(node)
        return [part for child in children for part in below(child)] if children else [node]

    assert tuple(below(hierarchy.root())) == hierarchy.parts()
    assert len(set(hierarchy.parts())) == len(hierarchy.parts())


def test_the_signature_ignores_order_boxes_and_adjacency() -> None:
    signature = PartHierarchy.from_dict(chair((2, 3, 4), **REFLECTION)).signature()
    assert PartHierarchy.from_dict(chair((4, 3, 2), **REFLECTION)).signature() == signature
    touching = chair((2, 3, 4), **REFLECTION)
    touching["children"][0]["edges"].append({"part_a": 0, "part_b": 2, "type": "ADJ", "dist": 0.1})
    assert PartHierarchy.from_dict(touching).signature() == signature


def test_the_signature_sees_labels_counts_nesting_and_symmetries() -> None:
    base = chair((2, 3, 4), **REFLECTION)
    relabelled, fewer = chair((2, 3, 4), **REFLECTION), chair((2, 3))
    relabelled["children"][0]["children"][2]["label"] = "top"
    nested = {"id": 9, "label": "root", "children": [chair((2, 3, 4), **REFLECTION)]}
    translated = chair((2, 3, 4), type="TRANS_SYM", params=[1, 0, 0])
    entries = [base, relabelled, fewer, nested, translated, chair()]
    assert len({PartHierarchy.from_dict(entry).signature() for entry in entries}) == len(entries)


def test_all_four_kinds_of_edge_are_read() -> None:
    kinds: dict[str, tuple[dict[str, Any], Relation]] = {
        "ADJ": ({"dist": 0.25}, Adjacency("2", "3", 0.25)),
        "REF_SYM": ({"params": [1, 2, 3, 0, 1, 0]}, Reflection("2", "3", (1.0, 2.0, 3.0), (0.0, 1.0, 0.0))),
        "TRANS_SYM": ({"params": [1, 2, 3]}, Translation("2", "3", (1.0, 2.0, 3.0))),
        "ROT_SYM": ({"params": [1, 2, 3, 0, 1, 0, 0.5]}, Rotation("2", "3", (1.0, 2.0, 3.0), (0.0, 1.0, 0.0), 0.5)),
    }
    for kind, (fields, relation) in kinds.items():
        assert PartHierarchy.from_dict(chair(type=kind, **fields)).relations() == (relation,)


def test_published_axes_that_are_rounded_become_a_rotation() -> None:
    entry = leaf(0)
    entry["box"][6:] = [0.71, 0.71, 0.0, -0.7, 0.71, 0.01]
    cuboid = PartHierarchy.from_dict(entry).cuboids()["0"]
    np.testing.assert_allclose(cuboid.axes @ cuboid.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(cuboid.axes) == pytest.approx(1)


def test_ids_that_occur_twice_are_told_apart() -> None:
    entry = {"id": 0, "label": "root", "children": [leaf(-1, "other"), leaf(-1, "other"), leaf(1)]}
    assert len(set(PartHierarchy.from_dict(entry).parts())) == 3


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ([], "wanted an object with an id"),
        ({"label": "x"}, "wanted an object with an id"),
        ({"id": 0, "box": [1, 2]}, "box needs 12 finite numbers"),
        ({"id": 0, "box": [float("nan")] * 12}, "box needs 12 finite numbers"),
        (chair(type="ADJACENT"), "'ADJACENT' is not one of"),
        (chair(type="REF_SYM", params=[0, 0]), "can't be read"),
        ({**chair(), "edges": [{"part_a": 0, "part_b": 7, "type": "ADJ"}]}, "can't be read"),
    ],
)
def test_what_is_no_hierarchy_is_refused_and_named(entry: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        PartHierarchy.from_dict(json.loads(json.dumps(entry)))


def test_a_tree_without_end_is_refused() -> None:
    entry = leaf(0)
    for i in range(MAX_DEPTH + 1):
        entry = {"id": i + 1, "label": "", "children": [entry]}
    with pytest.raises(InputError, match="levels"):
        PartHierarchy.from_dict(entry)


def test_other_cuboids_bring_their_own_mirrors_and_leave_the_tree_as_it_is() -> None:
    hierarchy = PartHierarchy.from_dict(chair(**REFLECTION))
    cuboids = {name: replace(cuboid, centre=cuboid.centre + 1) for name, cuboid in hierarchy.cuboids().items()}
    other = hierarchy.with_cuboids(cuboids)
    assert other.signature() == hierarchy.signature()
    assert other.parts() == hierarchy.parts()
    assert all(np.array_equal(other.cuboids()[name].centre, cuboid.centre) for name, cuboid in cuboids.items())
    (before,), (after,) = hierarchy.relations(), other.relations()
    assert isinstance(before, Reflection)
    assert isinstance(after, Reflection)
    assert np.allclose(np.abs(after.normal), np.abs(before.normal))
    assert np.isclose(after.point[0], before.point[0] + 1)


def test_an_id_that_is_made_unique_meets_no_other() -> None:
    """The second 7 would be called as the node before it already is."""
    entry = {"id": 0, "label": "x", "children": [leaf("7@2"), leaf(7), leaf(7)]}  # type: ignore[arg-type]
    parts = PartHierarchy.from_dict(entry).parts()
    assert parts == ("7@2", "7", "7@2@2")


@pytest.mark.parametrize("parts", [("root",), ("root", "root_"), ("", "root"), ("seat",)])
def test_a_flat_hierarchys_root_is_none_of_its_parts(parts: tuple[str, ...]) -> None:
    flat = PartHierarchy.flat(parts, ("",) * len(parts), "stool")
    again = PartHierarchy.from_json(flat.to_json())
    assert again.parts() == flat.parts() == flat.children(flat.root()) == parts
    assert again.root() not in parts
