"""Surfaces for other programs: what trimesh and our own readers get back."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import toy
import trimesh

from cagesdf.errors import InputError
from cagesdf.formats.obj import read_obj_groups
from cagesdf.io.exports import WRITERS, Model, as_stored, check_name, write_model
from cagesdf.io.meshes import read_ply
from cagesdf.meshes import is_closed, signed_volume

CENTRE = np.array([100.0, -2.0, 3.0])


def model() -> Model:
    """A ball far from the origin, cut at its middle; a third part has no face."""
    ball = as_stored(toy.ball(CENTRE, 1.0))
    owner = (ball.corners().mean(axis=1)[:, 0] > CENTRE[0]).astype(int)
    cuboids = {
        "leg 1": toy.box(CENTRE - [0.5, 0, 0], [1, 2, 2]),
        "back/rest": toy.box(CENTRE + np.array([0.5, 0, 0]), [1, 2, 2]),
        "none": toy.box(CENTRE + np.array([5, 0, 0]), [1, 1, 1]),
    }
    return Model(ball, owner, cuboids)


def scenes(path: Path) -> dict[str, list[str]]:
    """Names of the nodes of each scene of a .glb file, as glTF's text tells them."""
    content = path.read_bytes()
    magic, version, size, length = struct.unpack("<4sIII", content[:16])
    assert (magic, version, size) == (b"glTF", 2, len(content))
    tree = json.loads(content[20 : 20 + length])
    assert tree["scene"] == 0
    return {scene["name"]: [tree["nodes"][i]["name"] for i in scene["nodes"]] for scene in tree["scenes"]}


@pytest.mark.parametrize("ending", WRITERS)
def test_the_surface_is_the_same_in_every_format(ending: str, tmp_path: Path) -> None:
    write_model(tmp_path / f"a{ending}", model())
    scene = trimesh.load_scene(tmp_path / f"a{ending}", split_objects=True, group_material=False)
    shown = [mesh for name, mesh in scene.geometry.items() if not name.startswith("cuboids/")]
    solid = trimesh.util.concatenate(shown)
    solid.merge_vertices()
    assert solid.is_watertight
    assert len(solid.faces) == len(model().surface.faces)
    assert solid.volume == pytest.approx(signed_volume(model().surface), rel=1e-4)
    np.testing.assert_allclose(solid.bounds, [CENTRE - 1, CENTRE + 1], atol=1e-5)


def test_gltf_shows_the_surface_and_has_the_cuboids_in_a_second_scene_a_node_a_part(tmp_path: Path) -> None:
    write_model(tmp_path / "a.glb", model())
    assert scenes(tmp_path / "a.glb") == {
        "surface": ["leg 1", "back/rest"],
        "cuboids": ["leg 1", "back/rest", "none"],
    }
    scene = trimesh.load_scene(tmp_path / "a.glb")
    assert set(scene.graph.nodes_geometry) == {"leg 1", "back/rest"}
    low = scene.geometry["surface/leg 1"]
    assert low.triangles_center[:, 0].max() <= CENTRE[0]
    for name, cuboid in model().cuboids.items():
        box = scene.geometry[f"cuboids/{name}"]
        assert box.is_watertight
        np.testing.assert_allclose(box.bounds, [cuboid.vertices.min(0), cuboid.vertices.max(0)], atol=1e-5)


def test_objects_share_the_surfaces_vertices_and_keep_their_digits(tmp_path: Path) -> None:
    write_model(tmp_path / "a.obj", model())
    text = (tmp_path / "a.obj").read_text(encoding="utf-8")
    vertices = np.array([line.split()[1:] for line in text.splitlines() if line.startswith("v ")], np.float32)
    np.testing.assert_array_equal(vertices[: len(model().surface.vertices)], model().surface.vertices)
    groups = dict(read_obj_groups(tmp_path / "a.obj"))
    assert list(groups) == ["surface/leg 1", "surface/back/rest", *(f"cuboids/{name}" for name in model().cuboids)]
    assert all(is_closed(mesh) == name.startswith("cuboids/") for name, mesh in groups.items())


def test_the_ply_is_the_projects_own(tmp_path: Path) -> None:
    write_model(tmp_path / "a.ply", model())
    mesh = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.faces, model().surface.faces)


@pytest.mark.parametrize("ending", WRITERS)
def test_equal_models_give_equal_bytes(ending: str, tmp_path: Path) -> None:
    for name in "ab":
        write_model(tmp_path / f"{name}{ending.upper()}", model())
    assert (tmp_path / f"a{ending.upper()}").read_bytes() == (tmp_path / f"b{ending.upper()}").read_bytes()


def test_other_endings_are_refused() -> None:
    with pytest.raises(InputError, match=r"ends in \.ply, \.obj, \.stl, \.glb"):
        check_name(Path("a.step"))


def test_what_float32_makes_one_place_is_one_vertex_and_the_mesh_stays_closed() -> None:
    ball = toy.ball(CENTRE, 1.0)
    edge = ball.faces[0, :2]
    vertices = ball.vertices.copy()
    vertices[edge[1]] = vertices[edge[0]] + 1e-9
    stored = as_stored(ball.with_vertices(vertices))
    assert is_closed(stored)
    assert len(stored.vertices) == len(ball.vertices) - 1
    assert len(stored.faces) == len(ball.faces) - 2
    assert (stored.vertices == stored.vertices.astype(np.float32)).all()
