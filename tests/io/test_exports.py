"""Surfaces for other programs: what trimesh and our own readers get back."""

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.errors import InputError
from cagesdf.exported import FAR, ExportedShape, Place
from cagesdf.formats.gltf import read_gltf
from cagesdf.formats.obj import read_obj, read_obj_groups
from cagesdf.geometry.meshes import Mesh, is_closed, join, signed_volume
from cagesdf.geometry.solid import union
from cagesdf.io.exports import WRITERS, check_name, write_boxes, write_export
from cagesdf.io.meshes import read_ply
from tests.support import toy

CENTRE = np.array([100.0, -2.0, 3.0])
UTM = np.array([500000.25, 5300000.86, 412.0])  # a table's place in metres: float32 has steps of half a metre there
PRECISE = [ending for ending in WRITERS if ending != ".stl"]  # formats that hold any place


def model(centre: np.ndarray = CENTRE) -> ExportedShape:
    """Two balls away from the origin that run into each other; a third part has no face."""
    cuboids = {
        "leg 1": toy.box(centre - [0.5, 0, 0], [1, 2, 2]),
        "back/rest": toy.box(centre + np.array([0.5, 0, 0]), [1, 2, 2]),
        "none": toy.box(centre + np.array([5, 0, 0]), [1, 1, 1]),
    }
    parts = {
        "leg 1": toy.ball(centre - [0.3, 0, 0], 1.0),
        "back/rest": toy.ball(centre + np.array([0.3, 0, 0]), 1.0),
        "none": Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)),
    }
    return ExportedShape.of(union([parts["leg 1"], parts["back/rest"]]), parts, cuboids)


def whole(mesh: Mesh) -> ExportedShape:
    """One part without a cuboid to speak of."""
    return ExportedShape.of(mesh, {"all": mesh}, {"all": toy.box([0, 0, 0], [1, 1, 1])})


def joined(path: Path) -> trimesh.Trimesh:
    """All geometry that a file holds as one mesh, as readers have it that ask for no names; GLB: its first scene."""
    scene = trimesh.load_scene(path, split_objects=True, group_material=False)
    solid = scene.to_mesh()
    solid.merge_vertices()
    return solid


def tree_of(path: Path) -> dict:
    """The JSON of a .glb file."""
    content = path.read_bytes()
    magic, version, size, length = struct.unpack("<4sIII", content[:16])
    assert (magic, version, size) == (b"glTF", 2, len(content))
    return json.loads(content[20 : 20 + length])


def scenes(path: Path) -> dict[str, list[str]]:
    """Names of the nodes of each scene of a .glb file, as glTF's text tells them."""
    tree = tree_of(path)
    assert tree["scene"] == 0
    return {scene["name"]: [tree["nodes"][i]["name"] for i in scene["nodes"]] for scene in tree["scenes"]}


def distinct_names(path: Path) -> list[str]:
    return [line[2:] for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("o ")]


@pytest.mark.parametrize("ending", [".ply", ".stl"])
def test_a_file_of_one_mesh_holds_the_surface_and_nothing_else(ending: str, tmp_path: Path) -> None:
    write_export(tmp_path / f"a{ending}", model())
    solid = joined(tmp_path / f"a{ending}")
    assert solid.is_watertight
    assert len(solid.faces) == len(model().surface.faces)
    assert solid.volume == pytest.approx(signed_volume(model().surface), rel=1e-6)
    np.testing.assert_allclose(solid.bounds, CENTRE + np.array([[-1.3, -1, -1], [1.3, 1, 1]]), atol=1e-5)


@pytest.mark.parametrize("ending", [".obj", ".glb"])
def test_a_file_of_parts_holds_each_as_a_closed_mesh_of_its_own(ending: str, tmp_path: Path) -> None:
    write_export(tmp_path / f"a{ending}", model())
    reader = read_obj_groups if ending == ".obj" else read_gltf
    groups = dict(reader(tmp_path / f"a{ending}"))
    assert [name.replace("_", " ") for name in groups] == ["leg 1", "back/rest"]
    for mesh, shift in zip(groups.values(), (-0.3, 0.3)):
        assert is_closed(mesh)
        np.testing.assert_allclose(
            (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2, CENTRE + np.array([shift, 0, 0]), atol=1e-5
        )
        assert signed_volume(mesh) == pytest.approx(signed_volume(toy.ball([0, 0, 0], 1.0)), rel=1e-5)


def test_gltf_shows_the_parts_and_has_the_surface_and_the_cuboids_in_further_scenes(tmp_path: Path) -> None:
    write_export(tmp_path / "a.glb", model())
    assert scenes(tmp_path / "a.glb") == {
        "parts": ["leg 1", "back/rest"],
        "surface": ["surface"],
        "cuboids": ["leg 1", "back/rest", "none"],
    }
    scene = trimesh.load_scene(tmp_path / "a.glb")
    assert set(scene.graph.nodes_geometry) == {"leg 1", "back/rest"}
    whole = scene.geometry["surface/surface"]
    assert whole.is_watertight
    assert len(whole.faces) == len(model().surface.faces)
    for name, cuboid in model().cuboids.items():
        box = scene.geometry[f"cuboids/{name}"]
        assert box.is_watertight
        np.testing.assert_allclose(box.bounds, [cuboid.vertices.min(0), cuboid.vertices.max(0)], atol=1e-5)


def test_objects_keep_their_digits(tmp_path: Path) -> None:
    write_export(tmp_path / "a.obj", model())
    text = (tmp_path / "a.obj").read_text(encoding="utf-8")
    vertices = np.array([line.split()[1:] for line in text.splitlines() if line.startswith("v ")], np.float32)
    np.testing.assert_array_equal(vertices, np.concatenate([part.vertices for part in model().parts.values()]))


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize("centre", [CENTRE, UTM])
def test_cuboids_have_a_file_of_their_own(ending: str, centre: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    if ending == ".stl" and centre is UTM:
        pytest.skip("refused")
    write_boxes(path, model(centre))
    solid = joined(path)
    assert solid.volume == pytest.approx(4 + 4 + 1, rel=1e-6)
    np.testing.assert_allclose(solid.bounds, [centre - [1, 1, 1], centre + np.array([5.5, 1, 1])], atol=1e-5)
    if ending == ".obj":
        assert distinct_names(path) == ["leg_1", "back/rest", "none"]
    if ending == ".glb":
        assert scenes(path) == {"cuboids": ["leg 1", "back/rest", "none"]}


@pytest.mark.parametrize("centre", [CENTRE, UTM])
def test_the_ply_is_the_projects_own(centre: np.ndarray, tmp_path: Path) -> None:
    write_export(tmp_path / "a.ply", model(centre))
    mesh = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.faces, model(centre).surface.faces)
    np.testing.assert_array_equal(mesh.vertices, model(centre).surface.vertices + model(centre).origin)


@pytest.mark.parametrize("ending", WRITERS)
def test_equal_models_give_equal_bytes(ending: str, tmp_path: Path) -> None:
    for name in "ab":
        write_export(tmp_path / f"{name}{ending.upper()}", model())
    assert (tmp_path / f"a{ending.upper()}").read_bytes() == (tmp_path / f"b{ending.upper()}").read_bytes()


def test_other_endings_are_refused() -> None:
    with pytest.raises(InputError, match=r"ends in \.ply, \.obj, \.stl, \.glb"):
        check_name(Path("a.step"))


# Far from the origin

SHAPE = join([toy.ball([0.1, 0.2, 0.3], 0.5, 16), toy.rod([0, -0.7, 0], [0, 0.2, 0.1], 0.02, segments=8)])
READERS: list[tuple[str, Callable[[Path], Mesh]]] = [
    (".ply", read_ply),
    (".obj", read_obj),
    *((ending, lambda path: Mesh(np.asarray(joined(path).vertices), joined(path).faces)) for ending in PRECISE),
]
turns = st.tuples(*[st.floats(-180, 180)] * 3)
places = st.tuples(*[st.floats(-1e7, 1e7)] * 3)


@given(st.floats(-3, 4), turns, places)
@example(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
@example(0.0, (0.0, 0.0, 0.0), (500000.25, 5300000.86, 412.0))
@example(-3.0, (10.0, 20.0, 30.0), (1e7, -1e7, 1e7))
@settings(max_examples=15, deadline=None)
def test_a_surface_is_read_back_as_it_was_wherever_and_however_large_it_is(
    tmp_path_factory: pytest.TempPathFactory,
    power: float,
    turn: tuple[float, float, float],
    place: tuple[float, float, float],
) -> None:
    """Closed, within 1e-5 of its size near the origin, 1e-6 far from it where float64 has that, and of its volume."""
    rotation = Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
    size = 10.0**power
    mesh = SHAPE.with_vertices(size * SHAPE.vertices @ rotation.T + place)
    reach = np.abs(mesh.vertices).max()
    exact = 1e-6 if reach > FAR * np.ptp(mesh.vertices, axis=0).max() else 1e-5
    tolerance = exact * size + 4 * np.spacing(reach)
    folder = tmp_path_factory.mktemp("far")
    for ending, read in READERS:
        write_export(folder / f"a{ending}", whole(mesh))
        back = read(folder / f"a{ending}")
        assert is_closed(back)
        local = (back.vertices - place) @ rotation / size
        assert signed_volume(Mesh(local, back.faces)) == pytest.approx(signed_volume(SHAPE), rel=20 * tolerance / size)
        nearest = np.linalg.norm(local[:, None] - SHAPE.vertices, axis=2).min(axis=1)
        assert nearest.max() <= 2 * tolerance / size


@pytest.mark.parametrize("ratio", [1, FAR - 1, FAR + 1, 1000, 1e5, 1e8, 5e10])
def test_formats_hold_the_very_same_places(ratio: float, tmp_path: Path) -> None:
    mesh = SHAPE.with_vertices(SHAPE.vertices + ratio * np.array([1.3, -1.0, 0.1]))
    write_export(tmp_path / "a.ply", whole(mesh))
    write_export(tmp_path / "a.glb", whole(mesh))
    [node] = [node for node in tree_of(tmp_path / "a.glb")["nodes"] if node["name"] == "all"][:1]
    scene = trimesh.load_scene(tmp_path / "a.glb", process=False)
    local = np.asarray(scene.geometry["parts/all"].vertices)
    glb = local + np.array(node.get("translation", [0.0, 0.0, 0.0]))
    np.testing.assert_array_equal(glb, read_ply(tmp_path / "a.ply").vertices)
    if "translation" in node:
        write_export(tmp_path / "a.obj", whole(mesh))
        np.testing.assert_array_equal(read_obj(tmp_path / "a.obj").vertices, read_ply(tmp_path / "a.ply").vertices)


def test_stl_is_refused_exactly_where_the_others_need_more_than_float32(tmp_path: Path) -> None:
    side = np.ptp(SHAPE.vertices, axis=0).max()
    near, far = (SHAPE.with_vertices(SHAPE.vertices + np.array([ratio * side, 0, 0])) for ratio in (FAR - 1, FAR + 1))
    write_export(tmp_path / "near.stl", whole(near))
    assert joined(tmp_path / "near.stl").volume == pytest.approx(signed_volume(SHAPE), rel=1e-4)
    with pytest.raises(InputError, match=r"from the origin, where STL's float32.*write \.obj, \.ply or \.glb"):
        write_export(tmp_path / "far.stl", whole(far))
    assert [path.name for path in tmp_path.iterdir()] == ["near.stl"]


@pytest.mark.parametrize(("size", "place"), [(1.0, 1e12), (1e-31, 0.0), (1e31, 0.0), (np.nan, 0.0), (1e-3, 1e15)])
def test_what_no_format_holds_is_refused(size: float, place: float) -> None:
    with pytest.raises(InputError, match="files hold lengths"):
        Place.of(SHAPE.with_vertices(size * SHAPE.vertices + place))


def test_a_mesh_without_faces_is_stored_as_it_is() -> None:
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    assert Place.of(empty).stored(empty) is empty


@pytest.mark.parametrize("centre", [CENTRE, UTM])
def test_what_rounding_makes_one_place_is_one_vertex_and_the_mesh_stays_closed(centre: np.ndarray) -> None:
    ball = toy.ball(centre, 1.0)
    edge = ball.faces[0, :2]
    vertices = ball.vertices.copy()
    vertices[edge[1]] = vertices[edge[0]] + 1e-9
    far = ball.with_vertices(vertices)
    origin, stored = Place.of(far).origin, Place.of(far).stored(far)
    assert is_closed(stored)
    assert len(stored.vertices) == len(ball.vertices) - 1
    assert len(stored.faces) == len(ball.faces) - 2
    assert (stored.vertices == stored.vertices.astype(np.float32)).all()
    assert origin.any() == (centre is UTM)
