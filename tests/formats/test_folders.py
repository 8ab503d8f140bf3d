"""Part folders, and files with several parts."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from cagesdf.errors import ShapeRejected
from cagesdf.formats.listing import list_shapes, read_shape
from cagesdf.formats.polygons import Polygons, triangulated
from cagesdf.geometry.meshes import face_areas, is_closed, signed_volume
from cagesdf.importing import import_shape
from tests.support import toy
from tests.support.gltf_files import Gltf

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


def test_a_folder_with_a_single_file_is_a_whole_shape_with_the_parts_that_the_file_has(tmp_path: Path) -> None:
    toy.write_obj(tmp_path / "one" / "model.obj", SEAT)
    scene = trimesh.Scene()
    for name, mesh in (("seat", SEAT), ("leg", LEG)):
        scene.add_geometry(as_trimesh(mesh), node_name=name, geom_name=name)
    (tmp_path / "two").mkdir()
    scene.export(tmp_path / "two" / "scene.glb")
    for name in ("seat", "leg"):
        toy.write_obj(tmp_path / "parts" / f"{name}.obj", LEG)
    read_parts = {name: read(tmp_path, name) for name in ("one", "two", "parts")}
    names = {name: sorted(part.part_id for part in raw.parts) for name, raw in read_parts.items()}
    assert names == {"one": ["model"], "two": ["leg", "seat"], "parts": ["leg", "seat"]}
    assert {name: raw.whole for name, raw in read_parts.items()} == {"one": True, "two": True, "parts": False}


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


# A comb with concave lids and, at one edge of a lid, a flat flap of the same outline: faces of any number of corners.
COMB = np.array([[0, 0], [3, 0], [3, 2], [2, 2], [2, 1], [1, 1], [1, 3], [0, 3.0]])
TURN = Rotation.from_rotvec([0.3, 0.7, -0.4]).as_matrix()
COMB_AREA, COMB_ROUND, COMB_DEPTH = 6.0, 14.0, 0.5


def comb_faces() -> tuple[np.ndarray, list[list[int]]]:
    """Vertices and faces; the last face is the flap."""
    count = len(COMB)
    layers = [np.column_stack([outline, np.full(count, z)]) for outline, z in ((COMB, 0), (COMB, 0.5), (-COMB, 0))]
    lids = [[*range(count)][::-1], [*range(count, 2 * count)]]
    sides = [[i, (i + 1) % count, count + (i + 1) % count, count + i] for i in range(count)]
    return np.concatenate(layers) @ TURN.T, [*lids, *sides, [*range(2 * count, 3 * count)]]


def as_obj(vertices: np.ndarray, faces: list[list[int]]) -> bytes:
    """UTF-16 with CRLF; corners are counted from the end, over two lines."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    for face in faces:
        first, *others = (f"{i - len(vertices)}//1" for i in face)
        lines.append(f"f {first} \\\r\n{' '.join(others)}")
    return "\r\n".join(["o Kamm für 椅子", *lines]).encode("utf-16")


def as_ply(vertices: np.ndarray, faces: list[list[int]]) -> bytes:
    """Binary, big endian, numbers of corners in two bytes."""
    header = (
        f"ply\nformat binary_big_endian 1.0\nelement face {len(faces)}\nproperty list ushort int vertex_index\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\nend_header\n"
    )
    rows = b"".join(np.array(len(f), ">u2").tobytes() + np.array(f, ">i4").tobytes() for f in faces)
    return header.encode() + rows + vertices.astype(">f8").tobytes()


def as_glb(vertices: np.ndarray, faces: list[list[int]]) -> bytes:
    """A sparse accessor over halves, with a normalised scale that the node undoes."""
    size = float(np.abs(vertices).max())
    numbers = np.round(vertices / size * 32767).astype(np.int16)
    gltf = Gltf()
    positions = gltf.sparse(numbers, numbers * (np.arange(len(numbers)) % 2)[:, None], "i2", places="u1")
    gltf.tree["accessors"][positions]["normalized"] = True
    triangles = triangulated(vertices, Polygons(np.concatenate(faces), np.array([*map(len, faces)])), str).faces
    mesh = gltf.add("meshes", primitives=[gltf.primitive(positions, gltf.accessor(triangles.ravel(), "u1"))])
    gltf.add("scenes", nodes=[gltf.add("nodes", mesh=mesh, name="root", scale=[size, -size, size])])
    gltf.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    return gltf.glb()


def as_stl(vertices: np.ndarray, faces: list[list[int]]) -> bytes:
    mesh = triangulated(vertices, Polygons(np.concatenate(faces), np.array([*map(len, faces)])), str)
    corners = mesh.corners()
    rows = np.zeros(len(corners), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]))
    rows["corners"] = corners
    return b"solid that is binary".ljust(80) + np.array(len(rows), "<u4").tobytes() + rows.tobytes()


@pytest.mark.parametrize(("suffix", "written"), [("obj", as_obj), ("ply", as_ply), ("glb", as_glb), ("stl", as_stl)])
def test_a_comb_with_a_flap_has_all_of_its_surface_in_every_format(tmp_path: Path, suffix: str, written) -> None:
    (tmp_path / f"comb.{suffix}").write_bytes(written(*comb_faces()))
    raw = read(tmp_path, "comb")
    area = 3 * COMB_AREA + COMB_ROUND * COMB_DEPTH
    assert face_areas(raw.parts[0].mesh).sum() == pytest.approx(area, rel=1e-3 if suffix == "glb" else 1e-6)
    shape = import_shape(raw, up="y", weld=1e-5, max_faces=1000, max_parts=1, min_thickness=1e-4)
    repair = shape.parts[0].repair
    assert repair.plates == 1
    assert repair.lost <= 1e-3
    scale = shape.similarity.scale
    plate = repair.volume / scale**3 - COMB_AREA * COMB_DEPTH
    assert 0 < plate < COMB_AREA * 2e-3 / scale, "the flap is thinner than what all of a sheet lies within"
