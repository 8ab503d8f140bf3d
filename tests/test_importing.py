"""From raw shapes to canonical ones: frame, structure, repairs and reasons."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagesdf.cuboid import Cuboid
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.formats.listing import list_shapes, read_shape
from cagesdf.frames import UP_AXES
from cagesdf.geometry.meshes import Mesh, is_closed, signed_volume
from cagesdf.importing import import_shape, summary, verdict
from cagesdf.shape import RawPart, RawShape
from cagesdf.structure.hierarchy import Node, PartHierarchy
from cagesdf.structure.relations import Adjacency, Reflection, Rotation, Translation
from tests.support import toy

IKEA = Path(__file__).parent.parent.parent / "shared/data/ikea"
LIMITS: toy.Limits = {"weld": 1e-5, "max_faces": 10_000, "max_parts": 150, "min_thickness": 1e-4}


def raw_shape(meshes: dict[str, Mesh]) -> RawShape:
    parts = tuple(RawPart(name, name, mesh) for name, mesh in meshes.items())
    return RawShape("stool", "train", parts, PartHierarchy.flat(tuple(meshes), tuple(meshes), "stool"))


def stool() -> dict[str, Mesh]:
    return {"seat": toy.box([0, 1, 0], [1, 0.1, 1]), "leg": toy.rod([0.1, 0, 0], [0, 1, 0], 0.1)}


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("unit", [1e-3, 1.0, 25.4, 1e6])
def test_any_unit_and_either_up_axis_give_the_same_shape_and_the_way_back(up: str, unit: float) -> None:
    wanted = import_shape(raw_shape(stool()), "y", **LIMITS)
    placed = {
        name: mesh.with_vertices((unit * mesh.vertices + [3 * unit, -unit, 7 * unit]) @ UP_AXES[up])
        for name, mesh in stool().items()
    }
    shape = import_shape(raw_shape(placed), up, **LIMITS)
    for part, same in zip(shape.parts, wanted.parts):
        np.testing.assert_allclose(part.mesh.vertices, same.mesh.vertices, atol=1e-9)
        back = shape.similarity.to_raw(part.mesh.vertices)
        np.testing.assert_allclose(back, placed[part.part_id].vertices, rtol=1e-9, atol=1e-9 * unit)
    every = np.concatenate([part.mesh.vertices for part in shape.parts])
    assert np.linalg.norm(every, axis=1).max() == pytest.approx(1)
    np.testing.assert_allclose(every.max(0), -every.min(0), atol=1e-12)
    assert shape.status == "passed"


def test_each_part_is_closed_and_its_repair_is_told() -> None:
    meshes = stool()
    meshes["seat"] = Mesh(meshes["seat"].vertices, meshes["seat"].faces[1:])
    shape = import_shape(raw_shape(meshes), "y", **LIMITS)
    seat, leg = shape.parts
    assert shape.status == "repaired"
    assert (seat.repair.method, seat.repair.faces_before, seat.repair.faces_after) == ("capped", 11, 12)
    assert leg.repair.method == "none"
    assert all(is_closed(part.mesh) for part in shape.parts)
    assert seat.repair.volume == signed_volume(seat.mesh) == pytest.approx(0.1 * shape.similarity.scale**3)


def test_boxes_and_relations_move_with_the_meshes() -> None:
    """A relation that holds between raw points holds between their canonical images."""
    rng = np.random.default_rng(0)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    axes *= np.sign(np.linalg.det(axes))
    normal = axes[0]
    cuboid = Cuboid(rng.normal(size=3), axes, np.array([1.0, 2, 3]))
    relations = (
        Adjacency("a", "b", 0.5),
        Reflection("a", "b", (1.0, 2.0, 3.0), tuple(normal.tolist())),
        Translation("a", "b", (0.5, 0.0, 2.0)),
        Rotation("a", "b", (3.0, 2.0, 1.0), tuple(normal.tolist()), 0.7),
    )
    leaves = tuple(Node(name, name, (), (), cuboid) for name in "ab")
    tree = PartHierarchy(Node("root", "x", leaves, relations, None))
    similarity = import_shape(raw_shape(stool()), "z", **LIMITS).similarity
    moved = tree.transformed(similarity)

    points = rng.normal(size=(20, 3))
    box = moved.cuboids()["a"]
    local = (similarity.to_canonical(points) - box.centre) @ box.axes.T / box.size
    np.testing.assert_allclose(local, (points - cuboid.centre) @ axes.T / cuboid.size, atol=1e-12)

    adjacency, reflection, translation, rotation = moved.relations()
    assert isinstance(adjacency, Adjacency)
    assert isinstance(reflection, Reflection)
    assert isinstance(translation, Translation)
    assert isinstance(rotation, Rotation)
    assert adjacency.distance == pytest.approx(0.5 * similarity.scale)

    def mirrored(points, point, normal):
        return points - 2 * ((points - point) @ normal)[:, None] * normal

    def turned(points, pivot, axis, angle):
        a = np.asarray(axis)
        cross = np.cross(a, np.eye(3)) * -1
        matrix = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        return (points - pivot) @ matrix.T + pivot

    images = similarity.to_canonical(points)
    for raw, canonical in (
        (mirrored(points, (1, 2, 3), normal), mirrored(images, reflection.point, np.array(reflection.normal))),
        (points + np.array([0.5, 0, 2]), images + translation.offset),
        (turned(points, (3, 2, 1), normal, 0.7), turned(images, rotation.pivot, rotation.axis, rotation.angle)),
    ):
        np.testing.assert_allclose(similarity.to_canonical(raw), canonical, atol=1e-12)


def test_a_shape_of_one_part_passes() -> None:
    shape = import_shape(raw_shape({"seat": stool()["seat"]}), "y", **LIMITS)
    assert len(shape.parts) == 1
    assert shape.structure.parts() == ("seat",)


BOX = toy.box([0, 0, 0], [1, 1, 1])


@pytest.mark.parametrize(
    ("meshes", "reason"),
    [
        ({}, "has no parts"),
        ({"seat": BOX, "none": Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))}, "part none has no faces"),
        ({"seat": BOX, "nan": BOX.with_vertices(BOX.vertices * np.nan)}, "part nan has vertices that are NaN"),
        ({str(i): BOX for i in range(200)}, "200 parts, at most 150 wanted"),
        ({"fine": toy.ball([0, 0, 0], 1, 256)}, "faces, at most 10,000 wanted"),
        ({"seat": BOX.with_vertices(BOX.vertices * 0)}, "coincide"),
        ({"seat": BOX, "line": BOX.with_vertices(BOX.vertices * [1, 0, 0])}, "part line .*no area"),
    ],
    ids=["no part", "empty part", "NaN", "200 parts", "many faces", "a point", "a line"],
)
def test_a_shape_that_can_not_be_used_is_rejected_with_part_and_reason(meshes: dict[str, Mesh], reason: str) -> None:
    with pytest.raises(ShapeRejected, match=reason) as caught:
        import_shape(raw_shape(meshes), "y", **LIMITS)
    assert (caught.value.shape_id, caught.value.stage) == ("stool", "import_shapes")


def test_a_film_becomes_a_plate_or_is_rejected_where_plates_are_too_thin() -> None:
    raw = raw_shape({"seat": BOX, "film": BOX.with_vertices(BOX.vertices * [1, 1, 1e-5])})
    seat, film = import_shape(raw, "y", **LIMITS).parts
    assert (seat.repair.method, film.repair.method) == ("none", "wrapped")
    with pytest.raises(ShapeRejected, match=r"part film .*on average, wanted at least 0\.02"):
        import_shape(raw, "y", **(LIMITS | {"min_thickness": 0.02}))


def test_missing_system_libraries_are_never_a_rejection(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*arguments: object) -> None:
        raise InputError("apt-get install something")

    monkeypatch.setattr("cagesdf.geometry.solid.alpha_wrap", missing)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0.1], [0, 1, 0]])
    bent = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    with pytest.raises(InputError, match="apt-get"):
        import_shape(raw_shape({"seat": bent}), "y", **LIMITS)


@pytest.mark.parametrize(("lost", "told"), [(0.0, ""), (4e-5, ""), (8e-4, "; at most 0.08% of a part's surface lost")])
def test_the_verdict_tells_of_surface_that_is_lost_though_it_be_little(lost: float, told: str) -> None:
    shape = toy.stool("stool")
    part = replace(shape.parts[0], repair=replace(shape.parts[0].repair, lost=lost))
    assert verdict(replace(shape, parts=(part, *shape.parts[1:]))) == f"passed{told}"


def test_the_summary_counts_shapes_and_methods_and_gives_reasons() -> None:
    passed = import_shape(raw_shape(stool()), "y", **LIMITS)
    opened = raw_shape({"seat": Mesh(BOX.vertices, BOX.faces[1:])})
    text = summary(
        [passed, import_shape(replace(opened, shape_id="b"), "y", **LIMITS)],
        [ShapeRejected(f"bad{i}", "import_shapes", "has no parts") for i in range(25)],
    )
    assert "27 shapes: 1 passed, 1 repaired, 25 rejected" in text
    assert "2 none, 1 capped" in text
    assert "rejected bad0: has no parts" in text
    assert "and 5 more" in text


@pytest.mark.skipif(not IKEA.is_dir(), reason="needs the real furniture")
@pytest.mark.parametrize("shape_id", ["Chair_lisabo", "Table_lack"])
def test_real_furniture_becomes_closed_parts_in_its_own_place(shape_id: str) -> None:
    raw = read_shape(next(source for source in list_shapes(IKEA, shape_id)))
    shape = import_shape(raw, "y", **LIMITS)
    assert shape.status == "repaired"
    for part, before in zip(shape.parts, raw.parts):
        assert is_closed(part.mesh)
        assert part.repair.volume > 0
        found, wanted = shape.similarity.to_raw(part.mesh.vertices), before.mesh.vertices
        extent = np.ptp(wanted, axis=0).max()
        np.testing.assert_allclose(found.min(0), wanted.min(0), atol=0.01 * extent)
        np.testing.assert_allclose(found.max(0), wanted.max(0), atol=0.01 * extent)
