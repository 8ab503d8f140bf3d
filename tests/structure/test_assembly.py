"""Programs as structures: parts, children and relations follow from what they execute to."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation as Turn

from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.structure.assembly import ROOT, Assembly
from cagesdf.structure.executor import execute, execute_nodes
from cagesdf.structure.parsing import parse
from cagesdf.structure.relations import Adjacency, Reflection, Translation
from cagesdf.structure.stored import read_structure
from tests.support import programs

HERE = Similarity(1.0, np.eye(3), np.zeros(3))


def similarity(seed: int) -> Similarity:
    rng = np.random.default_rng(seed)
    return Similarity(float(rng.uniform(0.3, 3)), Turn.random(random_state=seed).as_matrix(), rng.normal(size=3))


CHAIR = Assembly(programs.CHAIR, similarity(7))


def image(corners: np.ndarray, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Points mirrored in a plane."""
    return corners - 2 * ((corners - point) @ normal)[:, None] * normal


def same_points(a: np.ndarray, b: np.ndarray) -> bool:
    apart = np.linalg.norm(a[:, None] - b[None], axis=2)
    return bool(max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-9)


@settings(deadline=None)
@given(programs.program_texts())
def test_parts_are_the_leaves_in_the_order_of_execution(text: str) -> None:
    program = parse(text)
    structure = Assembly(program, HERE)
    assert structure.parts() == execute(program).part_ids == structure.cage().part_ids
    assert structure.signatures().keys() == {ROOT, *execute_nodes(program).part_ids}
    assert structure.signature() == structure.signatures()[structure.root()]


def test_children_lead_from_the_root_to_every_part() -> None:
    assert CHAIR.children(ROOT) == ("Base", "seat", "back", "arm", "cube4")
    assert CHAIR.children("Base") == ("Base/Side", "Base/cube1")
    assert CHAIR.children("Base/cube1")[0] == "Base/cube1/leg"
    found, waiting = set(), [ROOT]
    while waiting:
        node = waiting.pop()
        waiting += CHAIR.children(node)
        found |= set() if CHAIR.children(node) else {node}
    assert found == set(CHAIR.parts())


@settings(deadline=None, max_examples=30)
@given(programs.program_texts(), st.integers(0, 1000), st.integers(0, 1000))
def test_a_transformed_structure_has_the_transformed_cage(text: str, first: int, second: int) -> None:
    structure, moved = Assembly(parse(text), similarity(first)), similarity(second)
    wanted = structure.cage().transformed(moved)
    found = structure.transformed(moved).cage()
    np.testing.assert_allclose(found.vectors(), wanted.vectors(), atol=1e-9)
    np.testing.assert_allclose(wanted.corners(), [moved.to_canonical(c) for c in structure.cage().corners()], atol=1e-9)


def test_relations_are_transformed_with_the_structure() -> None:
    moved = similarity(3)
    for found, wanted in zip(CHAIR.transformed(moved).relations(), CHAIR.relations(), strict=True):
        assert type(found) is type(wanted)
        for key, value in vars(wanted.transformed(moved)).items():
            assert getattr(found, key) == (value if isinstance(value, str) else pytest.approx(value))


def test_symmetries_are_true_of_the_cuboids_in_mirrored_and_nested_blocks_too() -> None:
    nodes = execute_nodes(CHAIR.program).transformed(CHAIR.placement)
    corners = dict(zip(nodes.part_ids, nodes.corners()))
    symmetries = [relation for relation in CHAIR.relations() if not isinstance(relation, Adjacency)]
    pairs = {(relation.a, relation.b) for relation in symmetries}
    assert ("Base/Side", "Base/cube1") in pairs
    assert ("Base/cube1/leg", "Base/cube1/cube3") in pairs
    for relation in symmetries:
        a, b = corners[relation.a], corners[relation.b]
        match relation:
            case Reflection():
                assert np.linalg.norm(relation.normal) == pytest.approx(1)
                assert same_points(image(a, np.array(relation.point), np.array(relation.normal)), b), relation
            case Translation():
                # Of copies 1 to n of one cuboid, each is its number times the offset away.
                number = 1 + [r.b for r in symmetries if r.a == relation.a].index(relation.b)
                assert same_points(a + number * np.array(relation.offset), b), relation


def test_attachments_are_between_cuboids_that_are_there_and_never_the_bbox() -> None:
    attached = {(relation.a, relation.b) for relation in CHAIR.relations() if isinstance(relation, Adjacency)}
    assert attached == {
        *(("seat", "Base"), ("back", "seat"), ("arm", "back"), ("arm", "seat")),
        *((f"Base/{side}/bar", f"Base/{side}/leg") for side in ("Side", "cube1")),
    }


def test_a_structure_is_read_back_as_it_was_written() -> None:
    for read in (Assembly.from_json, read_structure):
        again = read(CHAIR.to_json())
        assert isinstance(again, Assembly)
        assert again.program == CHAIR.program
        assert again.to_json() == CHAIR.to_json()
        np.testing.assert_array_equal(again.cage().vectors(), CHAIR.cage().vectors())
    assert "\n" not in CHAIR.to_json()


def test_labels_stay_with_the_parts_whatever_becomes_of_the_program() -> None:
    labelled = CHAIR.labelled({"seat": "board", "back": ""})
    for structure in (
        labelled,
        labelled.transformed(similarity(1)),
        labelled.with_program(programs.scaled(CHAIR.program, 2.0)),
        read_structure(labelled.to_json()),
    ):
        assert structure.labels() == {part: "board" if part == "seat" else "" for part in CHAIR.parts()}
    assert "labels" not in CHAIR.to_json()


@pytest.mark.parametrize(
    "change",
    [
        {"labels": ["seat"]},
        {"program": "Assembly P {"},
        {"program": 5},
        {"placement": [1.0]},
        {"placement": [float("nan")] * 13},
        {"placement": None},
        {"placement": {}},
    ],
)
def test_what_is_no_program_and_placement_is_refused(change: dict) -> None:
    with pytest.raises(InputError):
        read_structure(json.dumps({**json.loads(CHAIR.to_json()), **change}))
    for text in ("", "[]", "{", "5", '{"placement": [1]}'):
        with pytest.raises(InputError):
            Assembly.from_json(text)
    with pytest.raises(InputError):
        read_structure("[1]")


def test_another_program_stays_in_place() -> None:
    grown = CHAIR.with_program(programs.scaled(CHAIR.program, 2.0))
    lower, upper = CHAIR.cage(), grown.cage()
    np.testing.assert_allclose(upper.size, 2 * lower.size, rtol=1e-6)
    fixed = CHAIR.placement.translation
    np.testing.assert_allclose(upper.centre - fixed, 2 * (lower.centre - fixed), atol=1e-6)
