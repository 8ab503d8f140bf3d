"""Part folders, and files with several parts."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import toy
import trimesh

from cagesdf.errors import ShapeRejected
from cagesdf.formats.listing import list_shapes, read_shape
from cagesdf.meshes import is_closed, signed_volume

SEAT = toy.box([0, 1, 0], [1, 0.1, 1])
LEG = toy.box([0, 0.5, 0], [0.1, 1, 0.1])


def as_trimesh(mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def read(folder: Path, shape_id: str):
    return read_shape(next(source for source in list_shapes(folder, "*") if source.shape_id == shape_id))


def test_each_file_of_a_folder_is_a_part_with_the_letters_of_its_name_as_label(tmp_path: Path) -> None:
    for name in ("seat", "left_leg_2", "left_leg_10", "03"):
        toy.write_obj(tmp_path / "stool" / f"{name}.obj", LEG)
    shape = read(tmp_path, "stool")
    assert [(part.part_id, part.label) for part in shape.parts] == [
        ("03", "part"), ("left_leg_2", "left leg"), ("left_leg_10", "left leg"), ("seat", "seat"),
    ]  # fmt: skip
    assert shape.structure.parts() == tuple(part.part_id for part in shape.parts)
    assert shape.structure.children(shape.structure.root()) == shape.structure.parts()


@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "glb"])
def test_every_kind_of_file_gives_the_same_part(tmp_path: Path, kind: str) -> None:
    (tmp_path / "stool").mkdir()
    as_trimesh(SEAT).export(tmp_path / "stool" / f"seat.{kind}")
    (part,) = read(tmp_path, "stool").parts
    assert len(part.mesh.faces) == 12
    assert signed_volume(part.mesh) == pytest.approx(0.1, rel=1e-6)
    np.testing.assert_allclose(part.mesh.vertices.min(0), SEAT.vertices.min(0), atol=1e-7)


def test_the_nodes_of_a_scene_are_parts_where_the_scene_places_them(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    mirror = np.diag([-1.0, 1, 1, 1])
    mirror[0, 3] = 0.4
    scene.add_geometry(as_trimesh(SEAT), node_name="seat", geom_name="seat")
    scene.add_geometry(as_trimesh(LEG), node_name="leg.1", geom_name="leg", transform=mirror)
    scene.export(tmp_path / "stool.glb")
    parts = {part.part_id: part for part in read(tmp_path, "stool").parts}
    assert {name: part.label for name, part in parts.items()} == {"seat": "seat", "leg.1": "leg"}
    leg = parts["leg.1"].mesh
    np.testing.assert_allclose(leg.vertices.mean(0), [0.4, 0.5, 0], atol=1e-6)
    assert is_closed(leg)
    assert signed_volume(leg) > 0


def test_the_groups_of_an_obj_file_are_parts(tmp_path: Path) -> None:
    toy.write_obj(tmp_path / "stool.obj", SEAT)
    text = (tmp_path / "stool.obj").read_text()
    (tmp_path / "stool.obj").write_text(text.replace("\nf ", "\no seat\nf ", 1) + "o leg\nf 1 2 3\n")
    assert [part.part_id for part in read(tmp_path, "stool").parts] == ["seat", "leg"]


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.obj", b"v 0 0\n", "line 1"),
        ("a.glb", b"glTF junk", "can't be read as GLB"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 99\n", "can't be read as PLY"),
        ("a.stl", b"\0" * 80 + b"\x09\0\0\0" + b"\0" * 60, "9 triangles, .* 390 are missing"),
    ],
    ids=["obj", "glb", "ply", "stl"],
)
def test_a_file_that_can_not_be_read_rejects_its_shape_with_the_reason(
    tmp_path: Path, name: str, content: bytes, reason: str
) -> None:
    (tmp_path / "stool").mkdir()
    (tmp_path / "stool" / name).write_bytes(content)
    with pytest.raises(ShapeRejected, match=reason) as caught:
        read(tmp_path, "stool")
    assert caught.value.shape_id == "stool"


def test_a_scene_can_not_make_us_open_other_files(tmp_path: Path) -> None:
    """A GLB whose buffer is a path is refused, though the file that it names is there."""
    secret = as_trimesh(SEAT).vertices.astype("<f4").tobytes()
    (tmp_path / "secret.bin").write_bytes(secret)
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "../secret.bin", "byteLength": len(secret)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(secret)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0,
    }  # fmt: skip
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    header = b"glTF" + np.array([2, 20 + len(text), len(text)], "<u4").tobytes() + b"JSON"
    (tmp_path / "stools" / "stool").mkdir(parents=True)
    (tmp_path / "stools" / "stool" / "a.glb").write_bytes(header + text)
    with pytest.raises(ShapeRejected):
        read(tmp_path / "stools", "stool")


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    toy.write_obj(tmp_path / "stool" / "seat.obj", SEAT)
    as_trimesh(SEAT).export(tmp_path / "stool" / "seat.stl")
    with pytest.raises(ShapeRejected, match=r"stool: seat\.obj and seat\.stl would have one name, 'seat'; keep"):
        read(tmp_path, "stool")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_files_with_names_in_no_utf8_are_parts_of_their_own_and_their_faults_can_be_written(tmp_path: Path) -> None:
    toy.write_obj(tmp_path / "stool" / "leg.obj", LEG)
    content = (tmp_path / "stool" / "leg.obj").read_bytes()
    for name in (b"F\xfc\xdfe.obj", b"F\xe4\xdfe.obj"):
        Path(os.fsdecode(os.fsencode(tmp_path / "stool") + b"/" + name)).write_bytes(content)
    assert [part.part_id for part in read(tmp_path, "stool").parts] == ["Fäße", "Füße", "leg"]
    Path(os.fsdecode(os.fsencode(tmp_path / "stool") + b"/\xff.ply")).write_bytes(b"")
    with pytest.raises(ShapeRejected, match=r"\\udcff\.ply: can't be read as PLY") as caught:
        read(tmp_path, "stool")
    assert caught.value.reason.encode("utf-8")
