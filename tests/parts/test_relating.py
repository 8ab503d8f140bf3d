"""Relations between parts of which files tell none: which there are, and what they follow."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation as Turn

from cagesdf.cage_fitting.boxes import fit_cuboid
from cagesdf.cuboid import Cage
from cagesdf.editing.links import mirrors, repeats
from cagesdf.editing.state import State
from cagesdf.frames import Similarity
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.geometry.solid import union
from cagesdf.importing import import_shape
from cagesdf.io.shapes import read_shapes, write_shapes
from cagesdf.parts.relating import relations
from cagesdf.parts.slots import with_slots
from cagesdf.shape import RawPart, RawShape, Shape
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.structure.relations import Adjacency, Reflection, Relation, Rotation, Translation
from tests.support import toy

WHERE = [(-0.4, -0.3), (0.4, -0.3), (-0.4, 0.3), (0.4, 0.3)]


def chair() -> dict[str, Mesh]:
    """A seat, four legs and five slats that touch it."""
    legs = {f"leg_{i}": toy.box([x, -0.4, z], [0.1, 0.7, 0.1]) for i, (x, z) in enumerate(WHERE)}
    slats = {f"slat_{i}": toy.box([-0.4 + 0.2 * i, 0.4, -0.45], [0.08, 0.7, 0.04]) for i in range(5)}
    return {"seat": toy.box([0, 0, 0], [1, 0.1, 1]), **legs, **slats}


def hook() -> Mesh:
    """A solid that is no mirror image of itself."""
    boxes = [([0, 0, 0], [0.3, 0.02, 0.02]), ([0.14, 0.05, 0], [0.02, 0.1, 0.02]), ([-0.14, 0, 0.1], [0.02, 0.02, 0.2])]
    return union([toy.box(centre, size) for centre, size in boxes])


def fan(blades: int) -> dict[str, Mesh]:
    """Hooks around an axis."""
    blade = hook()
    around = [Turn.from_rotvec([0, 2 * np.pi / blades * i, 0]).as_matrix() for i in range(blades)]
    return {
        f"blade_{i}": blade.with_vertices((blade.vertices + np.array([0.5, 0.1, 0])) @ turn.T)
        for i, turn in enumerate(around)
    }


def mirrored(mesh: Mesh) -> Mesh:
    """The image in the plane x = 0."""
    return Mesh(mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1].copy())


def image(relation: Relation, points: np.ndarray) -> np.ndarray:
    """Where a relation takes points of its part a."""
    match relation:
        case Reflection(point=point, normal=normal):
            return points - 2 * ((points - np.array(point)) @ normal)[:, None] * np.array(normal)
        case Translation(offset=offset):
            return points + np.array(offset)
        case Rotation(pivot=pivot, axis=axis, angle=angle):
            return (points - pivot) @ Turn.from_rotvec(angle * np.array(axis)).as_matrix().T + pivot
    raise AssertionError(relation)


def kinds(found: tuple[Relation, ...]) -> list[tuple[str, str, str]]:
    return [(type(relation).__name__, relation.a, relation.b) for relation in found]


def repeated(found: tuple[Relation, ...]) -> list[Relation]:
    return [relation for relation in found if not isinstance(relation, Adjacency)]


def test_legs_are_mirrored_slats_in_a_row_moved_and_what_touches_is_attached() -> None:
    found = relations(chair())
    touching = [("Adjacency", "seat", part) for part in chair() if part != "seat"]
    near = [(0, 1), (0, 2), (1, 3), (2, 3)]
    legs = [("Reflection", f"leg_{i}", f"leg_{j}") for i, j in near]
    slats = [("Translation", f"slat_{i}", f"slat_{i + 1}") for i in range(4)]
    # The diagonals say no more than the sides, nor the longer side than the shorter.
    assert kinds(found) == [*touching, *legs, *slats]


def test_parts_on_a_circle_are_turned_where_no_mirror_leads_from_one_to_the_next() -> None:
    found = repeated(relations(fan(5)))
    turns = [relation for relation in found if isinstance(relation, Rotation)]
    assert len(turns) == len(found) == 5
    assert [relation.angle for relation in turns] == pytest.approx([2 * np.pi / 5] * 5)
    assert all(np.abs(relation.axis) == pytest.approx([0, 1, 0], abs=1e-9) for relation in turns)


def test_hands_are_told_apart() -> None:
    right = hook()
    left = mirrored(right)
    moved = right.with_vertices(right.vertices + np.array([0, 0, 1]))
    beside = left.with_vertices(left.vertices + np.array([1.0, 0, 0]))
    assert kinds(relations({"a": right, "b": moved})) == [("Translation", "a", "b")]
    assert kinds(relations({"a": right, "b": beside})) == [("Reflection", "a", "b")]
    turned = right.with_vertices(right.vertices @ Turn.from_rotvec([0.3, 1.0, 0.2]).as_matrix().T + [0, 0, 1.0])
    assert kinds(relations({"a": right, "b": turned})) == []


def test_parts_of_other_lengths_or_in_one_place_are_not_related() -> None:
    short, long = toy.box([0, 0, 0], [0.1, 0.7, 0.1]), toy.box([1, 0, 0], [0.1, 0.8, 0.1])
    assert relations({"a": short, "b": long}) == ()
    assert repeated(relations({"a": short, "b": short})) == []
    assert relations({"a": short}) == ()


@pytest.mark.parametrize("parts", [chair(), fan(3)], ids=["chair", "fan"])
def test_each_part_lies_on_the_image_of_the_one_it_is_related_to(parts: dict[str, Mesh]) -> None:
    found = repeated(relations(parts))
    assert found
    for relation in found:
        there = image(relation, parts[relation.a].vertices)
        assert SurfaceDistance(parts[relation.b]).unsigned(there).max() < 1e-9


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([chair(), fan(3)]))
def test_a_shape_that_is_turned_moved_and_scaled_has_the_relations_that_go_along(seed, parts) -> None:
    rng = np.random.default_rng(seed)
    motion = Similarity(rng.uniform(0.7, 1.4), Turn.random(random_state=rng).as_matrix(), rng.uniform(-5, 5, 3))
    moved = {part: mesh.with_vertices(motion.to_canonical(mesh.vertices)) for part, mesh in parts.items()}
    before, after = relations(parts), relations(moved)
    assert kinds(before) == kinds(after)
    for relation, own in zip(repeated(before), repeated(after)):
        points = parts[relation.a].vertices
        there = image(relation.transformed(motion), motion.to_canonical(points))
        np.testing.assert_allclose(image(own, motion.to_canonical(points)), there, atol=1e-6)


@pytest.mark.parametrize("parts", [chair(), fan(3)], ids=["chair", "fan"])
def test_a_mirrored_shape_has_mirrored_relations(parts: dict[str, Mesh]) -> None:
    before, after = relations(parts), relations({part: mirrored(mesh) for part, mesh in parts.items()})
    assert kinds(before) == kinds(after)
    for relation, own in zip(repeated(before), repeated(after)):
        points = parts[relation.a].vertices
        np.testing.assert_allclose(image(own, points * [-1, 1, 1]), image(relation, points) * [-1, 1, 1], atol=1e-9)


@settings(max_examples=5, deadline=None)
@given(st.permutations(list(chair())))
def test_the_order_of_the_parts_changes_nothing(order: list[str]) -> None:
    def pairs(parts: dict[str, Mesh]) -> set[tuple[str, frozenset[str]]]:
        return {(kind, frozenset((a, b))) for kind, a, b in kinds(relations(parts))}

    assert pairs({part: chair()[part] for part in order}) == pairs(chair())


def imported(parts: dict[str, Mesh], choice: str) -> Shape:
    meshes = parts if choice == "given" else {"all": join([*parts.values()])}
    raw = tuple(RawPart(name, "", mesh) for name, mesh in meshes.items())
    structure = PartHierarchy.flat(tuple(meshes), ("",) * len(meshes), "")
    return import_shape(RawShape("a", "train", raw, structure, whole=True), "y", 1e-5, 10**6, 150, 1e-4, choice)


@pytest.mark.parametrize("choice", ["given", "found"])
def test_shapes_without_relations_get_some_which_are_stored_and_which_edits_follow(choice: str, tmp_path: Path) -> None:
    [shape] = with_slots([imported(chair(), choice)])
    write_shapes(tmp_path, [shape])
    [stored] = read_shapes(tmp_path)
    assert stored.structure.relations() == shape.structure.relations()
    cage = Cage.of({part.part_id: fit_cuboid(part.mesh.vertices, 0.01, 1e-3) for part in shape.parts})
    state = State.opened(cage, stored.structure, np.zeros(4, np.float32), shape.similarity)
    assert sorted(len(others) for others in mirrors(state).values()) == [0] * 6 + [2] * 4
    assert sorted(len(others) for others in repeats(state).values()) == [0] * 5 + [1] * 2 + [2] * 3


def test_found_relations_say_nothing_of_the_structure_and_stay_apart_from_those_that_files_tell() -> None:
    bare = PartHierarchy.flat(("a", "b"), ("leg", "leg"), "")
    relation = Translation("a", "b", (1.0, 0.0, 0.0))
    found = bare.with_relations((relation,))
    told = PartHierarchy(replace(bare.tree, relations=(relation,)))
    assert found.signature() == bare.signature() != told.signature()
    cuboid = fit_cuboid(toy.box([0, 0, 0], [1, 1, 1]).vertices, 0.0, 1e-3)
    moved = Similarity(2.0, np.eye(3), np.zeros(3))
    for structure in (found.transformed(moved), found.with_cuboids({"a": cuboid, "b": cuboid})):
        again = PartHierarchy.from_json(structure.to_json())
        assert again.relations() == structure.relations() != ()
        assert again.signature() == bare.signature()
    assert PartHierarchy.from_json(told.to_json()).signature() == told.signature()


def test_relations_that_files_tell_are_kept_as_they_are() -> None:
    meshes = chair()
    bare = PartHierarchy.flat(tuple(meshes), tuple(meshes), "")
    told = PartHierarchy(replace(bare.tree, relations=(Translation("leg_0", "leg_3", (0.8, 0.0, 0.6)),)))
    raw = RawShape("a", "train", tuple(RawPart(name, name, mesh) for name, mesh in meshes.items()), told)
    shape = import_shape(raw, "y", 1e-5, 10**6, 150, 1e-4)
    assert kinds(shape.structure.relations()) == [("Translation", "leg_0", "leg_3")]
    with pytest.raises(ValueError, match="itself"):
        told.with_relations(())
