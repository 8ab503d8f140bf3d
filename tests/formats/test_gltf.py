"""glTF: however a file stores its triangles, they are the same; what isn't read is refused by its name."""

import base64
import json
import math
import tracemalloc
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.errors import InputError
from cagesdf.exported import ExportedShape
from cagesdf.formats import gltf
from cagesdf.formats.gltf import SUFFIXES, read_gltf
from cagesdf.formats.gltf_json import MAX_ENTRIES
from cagesdf.formats.listing import find_shape, read_shape
from cagesdf.geometry.meshes import Mesh, face_areas, is_closed, signed_volume, weld
from cagesdf.io.exports import write_export
from tests.support import toy
from tests.support.gltf_files import TYPES, Gltf, packed

RNG = np.random.default_rng
BOX = toy.box([0.5, 1, 0], [1, 2, 4])
LAST = {"i1": 127, "u1": 255, "i2": 32767, "u2": 65535}  # the numbers that stand for 1


def as_file(content: bytes | Gltf, tmp_path: Path, name: str = "a.glb") -> Path:
    path = tmp_path / name
    path.write_bytes(content.glb() if isinstance(content, Gltf) else content)
    return path


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("gltf")


def read(file: Gltf, tmp_path: Path) -> dict[str, Mesh]:
    parts = read_gltf(as_file(file, tmp_path))
    assert len(dict(parts)) == len(parts)
    return dict(parts)


def one(primitive: dict[str, Any], file: Gltf, tmp_path: Path) -> Mesh:
    """The mesh of a file with one primitive."""
    (mesh,) = read(file.show(file.add("nodes", mesh=file.add("meshes", primitives=[primitive]))), tmp_path).values()
    return mesh


def soup(seed: int) -> Mesh:
    """Vertices in float32, some of them zero, and triangles between them."""
    rng = RNG(seed)
    vertices = rng.normal(size=(rng.integers(3, 40), 3)).astype(np.float32)
    vertices[rng.random(len(vertices)) < 0.3] = 0
    faces = rng.integers(len(vertices), size=(rng.integers(1, 40), 3))
    return Mesh(vertices.astype(np.float64), faces.astype(np.int32))


def unread(file: Gltf, tmp_path: Path, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        read_gltf(as_file(file, tmp_path))


# However they are stored


STORED: dict[str, Callable[[Gltf, np.ndarray], int]] = {
    "plain": lambda file, rows: file.accessor(rows),
    "interleaved": lambda file, rows: file.accessor(rows, offset=8, stride=32),
    "unaligned": lambda file, rows: file.accessor(rows, offset=3, stride=17),
    "sparse over rows": lambda file, rows: file.sparse(rows, RNG(0).normal(size=rows.shape).astype(np.float32)),
    "sparse over strided rows": lambda file, rows: file.sparse(rows, rows[::-1], places="u4", stride=20),
    "sparse over nothing": lambda file, rows: file.sparse(rows, None, places="u1"),
}


@given(seed=st.integers(0, 10**6), stored=st.sampled_from(sorted(STORED)), index=st.sampled_from(["u1", "u2", "u4"]))
def test_positions_and_indices_are_the_same_however_they_are_stored(
    place: Path, seed: int, stored: str, index: str
) -> None:
    wanted, file = soup(seed), Gltf()
    file.view(b"before")
    primitive = file.primitive(STORED[stored](file, wanted.vertices), file.accessor(wanted.faces.ravel(), index))
    np.testing.assert_array_equal(one(primitive, file, place).corners(), wanted.corners())


@given(seed=st.integers(0, 10**6), base=st.booleans())
def test_sparse_indices_name_the_vertices_that_plain_ones_name(place: Path, seed: int, base: bool) -> None:
    wanted, file = soup(seed), Gltf()
    corners = wanted.faces.ravel()
    indices = file.sparse(corners, corners[::-1] if base else None, "u2")
    mesh = one(file.primitive(file.accessor(wanted.vertices), indices), file, place)
    np.testing.assert_array_equal(mesh.corners(), wanted.corners())


def test_without_indices_three_vertices_each_are_a_triangle(tmp_path: Path) -> None:
    file, wanted = Gltf(), BOX.corners()
    np.testing.assert_array_equal(
        one(file.primitive(file.accessor(wanted.reshape(-1, 3))), file, tmp_path).corners(), wanted
    )


def test_an_accessor_without_a_view_holds_zeros(tmp_path: Path) -> None:
    file = Gltf()
    zeros = file.add("accessors", componentType=5126, count=3, type="VEC3")
    np.testing.assert_array_equal(one(file.primitive(zeros), file, tmp_path).corners(), np.zeros((1, 3, 3)))


@given(
    kind=st.sampled_from(sorted(LAST)), normalized=st.booleans(), seed=st.integers(0, 10**6), sparse=st.booleans(),
    required=st.booleans(),
)  # fmt: skip
def test_integers_are_the_floats_that_the_specification_gives(
    place: Path, kind: str, normalized: bool, seed: int, sparse: bool, required: bool
) -> None:
    limits = np.iinfo(kind)
    stored = RNG(seed).integers(limits.min, limits.max, size=(9, 3), endpoint=True).astype(kind)
    stored[0] = [limits.min, limits.max, 0]
    wanted = [[max(int(c) / LAST[kind], -1.0) if normalized else float(c) for c in row] for row in stored]
    file = Gltf()
    if required:
        file.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    rows = file.sparse(stored, stored[::-1], kind) if sparse else file.accessor(stored, kind, stride=8)
    file.tree["accessors"][rows]["normalized"] = normalized
    np.testing.assert_array_equal(one(file.primitive(rows), file, place).corners().reshape(-1, 3), wanted)


def as_listed(mode: int, corners: list[int]) -> list[tuple[int, int, int]]:
    """The triangles of a strip (5) or fan (6), one by one, as the specification lists them."""
    triangles = []
    for i in range(len(corners) - 2):
        if mode == 6:
            triangles.append((corners[i + 1], corners[i + 2], corners[0]))
        elif i % 2 == 0:
            triangles.append((corners[i], corners[i + 1], corners[i + 2]))
        else:
            triangles.append((corners[i], corners[i + 2], corners[i + 1]))
    return [triangle for triangle in triangles if len({*triangle}) == 3]


@given(mode=st.sampled_from([5, 6]), seed=st.integers(0, 10**6), indexed=st.booleans())
def test_strips_and_fans_are_the_triangles_that_they_stand_for(
    place: Path, mode: int, seed: int, indexed: bool
) -> None:
    rng, file = RNG(seed), Gltf()
    vertices = rng.normal(size=(8, 3)).astype(np.float32)
    corners = [0, 1, 2, *rng.integers(8, size=9).tolist()] if indexed else list(range(8))
    indices = file.accessor(corners, "u1") if indexed else None
    mesh = one(file.primitive(file.accessor(vertices), indices, mode=mode), file, place)
    np.testing.assert_array_equal(mesh.corners(), vertices[as_listed(mode, corners)])


def test_a_strip_and_two_fans_that_make_a_box_are_closed_and_outward(tmp_path: Path) -> None:
    x, _, z = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]] * 2).T
    file, vertices = Gltf(), np.stack([x, [0] * 4 + [2] * 4, z], axis=1)
    positions = file.accessor(vertices)
    kinds = ((5, [0, 4, 1, 5, 2, 6, 3, 7, 0, 4]), (6, [0, 1, 2, 3]), (6, [7, 6, 5, 4]))
    primitives = [file.primitive(positions, file.accessor(corners, "u2"), mode=mode) for mode, corners in kinds]
    file.show(file.add("nodes", mesh=file.add("meshes", primitives=primitives)))
    ((name, mesh),) = read(file, tmp_path).items()
    assert name == "part"
    assert is_closed(mesh), "primitives that share their positions share vertices"
    assert signed_volume(mesh) == pytest.approx(2.0)


def test_morph_targets_are_added_with_the_weights_of_rest(tmp_path: Path) -> None:
    """The node's weights stand before the mesh's; without either nothing moves."""
    wanted, shift = BOX.corners(), RNG(0).normal(size=BOX.vertices.shape).astype(np.float32)
    for node, mesh, factor in (
        ({}, {}, 0),
        ({}, {"weights": [0, 0.5]}, 0.5),
        ({"weights": [0, 2]}, {"weights": [1, 1]}, 2),
    ):
        file = Gltf()
        targets = [{"NORMAL": 0}, {"POSITION": file.sparse(shift, None)}]
        primitive = file.primitive(file.accessor(BOX.vertices), file.accessor(BOX.faces.ravel(), "u2"), targets=targets)
        file.show(file.add("nodes", mesh=file.add("meshes", primitives=[primitive], **mesh), **node))
        (moved,) = read(file, tmp_path).values()
        np.testing.assert_allclose(moved.corners(), wanted + factor * shift[BOX.faces], atol=1e-12)


# Where the buffer lies


def test_a_buffer_is_the_same_beside_the_file_in_a_folder_or_in_the_text(tmp_path: Path) -> None:
    file = Gltf()
    file.show(file.part(BOX, "sitz fläche"))
    (tmp_path / "ein ordner").mkdir()
    (tmp_path / "ein ordner" / "zahlen.bin").write_bytes(file.data)
    (tmp_path / "zahlen ü.bin").write_bytes(bytes(file.data) + b"more")
    encoded = base64.b64encode(file.data).decode()
    for uri in ("zahlen ü.bin", "zahlen%20%C3%BC.bin", "./ein%20ordner/zahlen.bin", "ein ordner\\zahlen.bin",
                f"data:application/octet-stream;base64,{encoded}", f"DATA:;BASE64,{encoded}",
                "data:," + "".join(f"%{byte:02x}" for byte in file.data)):  # fmt: skip
        for text in (
            file.text(uri).encode(),
            b"\xef\xbb\xbf" + file.text(uri).encode(),
            file.text(uri).encode("utf-16"),
        ):
            ((name, mesh),) = read_gltf(as_file(text, tmp_path, "a.gltf"))
            assert name == "sitz fläche"
            np.testing.assert_array_equal(mesh.corners(), BOX.corners())


def test_a_buffer_is_read_from_nowhere_but_the_files_folder(tmp_path: Path) -> None:
    file, folder = Gltf(), tmp_path / "shapes"
    file.show(file.part(BOX))
    (folder / "below").mkdir(parents=True)
    (tmp_path / "secret.bin").write_bytes(file.data)
    (tmp_path / "shapes.bin").write_bytes(file.data)
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    (folder / "up").symlink_to(tmp_path)
    (folder / "circle").symlink_to(folder / "circle")
    outside = "not in the file's folder"
    reasons = {
        "../secret.bin": outside, "%2e%2e/secret.bin": outside, "below/../../secret.bin": outside,
        "..\\secret.bin": outside, str(tmp_path / "secret.bin"): outside, "//host/secret.bin": outside,
        "file:///etc/passwd": outside, (tmp_path / "secret.bin").as_uri(): outside, "http://127.0.0.1/a.bin": outside,
        "C:\\secret.bin": outside, "link.bin": outside, "up/secret.bin": outside, "../shapes.bin": outside,
        "none.bin": "'none.bin' is missing", "below": "'below' is missing", "": "'' is missing",
        "circle": "'circle' is", "a" * 5000: "is no file's name", "a%00.bin": "is no file's name",
        "data:text/plain;base64,@@@": "data: URI can't be read", "data:": "it has no comma",
    }  # fmt: skip
    for uri, reason in reasons.items():
        (folder / "a.gltf").write_text(file.text(uri), encoding="utf-8")
        with pytest.raises(InputError, match=reason):
            read_gltf(folder / "a.gltf")


# Nodes are parts


def test_a_node_is_a_part_whatever_the_materials_and_meshes(tmp_path: Path) -> None:
    """Two materials, one mesh in two nodes, a node with mesh and children, nodes without a mesh."""
    file = Gltf()
    halves = [Mesh(BOX.vertices, BOX.faces[:5]), Mesh(BOX.vertices, BOX.faces[5:])]
    box = file.mesh(*halves, name="Cube")
    feet = [file.add("nodes", mesh=box, translation=[x, 0, 0]) for x in (3, 6)]
    top = file.add("nodes", mesh=box, name="Top", children=feet)
    file.show(file.add("nodes", name="Empty", children=[top]))
    parts = read(file, tmp_path)
    assert list(parts) == ["Top", "Cube", "Cube_2"]
    for mesh, x in zip(parts.values(), (0, 3, 6), strict=True):
        assert len(mesh.faces) == 12
        assert is_closed(weld(mesh, 1e-9))
        np.testing.assert_allclose(mesh.vertices.min(0), [x, 0, -2], atol=1e-6)


def test_names_are_kept_and_no_two_parts_have_one(tmp_path: Path) -> None:
    given_names = [
        "leg",
        "leg",
        "leg_2",
        "",
        "root",
        "a/b",
        "  ",
        "two\nlines\t\0",
        "e\u0301",
        "\u00e9",
        "part",
        "leg",
        "x" * 999,
    ]
    file = Gltf()
    file.show(*(file.part(BOX, name) for name in given_names))
    assert list(read(file, tmp_path)) == [
        "leg", "leg_3", "leg_2", "part", "root", "a/b", "part_2", "two lines", "é", "é_2", "part_3", "leg_4", "x" * 120,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("scenes", "shown", "wanted"),
    [
        ([[0, 1], [2]], 0, ["0", "1", "below"]),
        ([[0, 1], [2]], 1, ["2"]),
        ([[2], [0, 1]], None, ["2"]),
        ([], None, ["0", "1", "below", "2"]),
    ],
    ids=["scene 0", "scene 1", "no default", "no scenes"],
)
def test_the_default_scene_is_read_else_the_first_else_all_nodes(
    tmp_path: Path, scenes: list[list[int]], shown: int | None, wanted: list[str]
) -> None:
    file = Gltf()
    for name in "012":
        file.part(BOX, name)
    file.tree["nodes"][1]["children"] = [file.part(BOX, "below")]
    file.tree |= {"scenes": [{"nodes": nodes} for nodes in scenes]} if scenes else {}
    file.tree |= {} if shown is None else {"scene": shown}
    assert list(read(file, tmp_path)) == wanted


def test_points_and_lines_are_left_out_and_the_surfaces_beside_them_are_read(tmp_path: Path) -> None:
    file = Gltf()
    positions, corners = file.accessor(BOX.vertices), file.accessor(BOX.faces.ravel(), "u2")
    lines = [file.primitive(positions, mode=mode) for mode in range(4)]
    mixed = file.add("meshes", primitives=[*lines, file.primitive(positions, corners)])
    axis = file.add("nodes", name="axis", mesh=file.add("meshes", primitives=lines))
    parts = read(file.show(axis, file.add("nodes", name="seat", mesh=mixed)), tmp_path)
    assert list(parts) == ["seat"]
    assert is_closed(parts["seat"])
    file.tree["scenes"][0]["nodes"] = [axis]
    unread(file, tmp_path, "its scene has no faces .*not only points or lines")


def rotation(x: float, y: float, z: float, w: float) -> list[list[float]]:
    """The matrix of a unit quaternion, term by term."""
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]


def product(a: list[list[float]], b: list[list[float]]) -> list[list[float]]:
    return [[math.fsum(a[i][k] * b[k][j] for k in range(4)) for j in range(4)] for i in range(4)]


def a_place(rng: np.random.Generator) -> tuple[dict[str, Any], list[list[float]]]:
    """A node's place as a matrix or as translation, rotation and scale, and its 4 × 4 matrix the slow way."""
    t, q = rng.normal(size=3).tolist(), rng.normal(size=4)
    q = (q / np.linalg.norm(q)).tolist()
    s = (rng.uniform(0.3, 2, size=3) * rng.choice([-1, 1], size=3)).tolist()
    moved = [[float(i == j) if i == 3 or j < 3 else t[i] for j in range(4)] for i in range(4)]
    turned = [[*row, 0.0] for row in rotation(*q)] + [[0.0, 0.0, 0.0, 1.0]]
    scaled = [[[*s, 1.0][i] if i == j else 0.0 for j in range(4)] for i in range(4)]
    matrix = product(product(moved, turned), scaled)
    if rng.random() < 0.5:
        return {"translation": t, "rotation": q, "scale": s}, matrix
    return {"matrix": [matrix[i][j] for j in range(4) for i in range(4)]}, matrix


@settings(max_examples=50)
@given(seed=st.integers(0, 10**6))
def test_parts_lie_where_a_slow_chain_of_matrices_places_them_and_face_outward(place: Path, seed: int) -> None:
    rng, file = RNG(seed), Gltf()
    box, count = file.mesh(BOX), 6
    matrices: list[list[list[float]]] = []
    parents = [-1, *(int(rng.integers(i)) for i in range(1, count))]
    for i in range(count):
        told, matrix = a_place(rng)
        matrices.append(matrix if i == 0 else product(matrices[parents[i]], matrix))
        file.add("nodes", name=str(i), mesh=box, children=[j for j in range(count) if parents[j] == i], **told)
    for name, mesh in read(file.show(0), place).items():
        matrix = matrices[int(name)]
        corners = [[*corner, 1.0] for corner in BOX.vertices.tolist()]
        wanted = [[math.fsum(a * b for a, b in zip(row, corner)) for row in matrix[:3]] for corner in corners]
        np.testing.assert_allclose(np.array(wanted), mesh.vertices, atol=1e-6)
        assert is_closed(mesh)
        assert signed_volume(mesh) > 0


def chair() -> Gltf:
    """Nodes at two depths, two of one name, meshes with two primitives; accessors of several kinds."""
    file = Gltf()
    leg = file.mesh(toy.box([0, 0, 0], [0.1, 1, 0.1]), toy.ball([0, -0.5, 0], 0.1, 8), name="Leg")
    legs = [
        file.add("nodes", mesh=leg, translation=[x, 0, 0], **name)
        for x, name in ((0, {}), (1, {}), (2, {"name": "hind"}))
    ]
    seat = file.part(toy.box([1, 1, 0], [3, 0.2, 1]), "seat", children=legs[:2])
    back = toy.box([1, 2, 0], [3, 2, 0.1])
    primitive = file.primitive(file.sparse(back.vertices, None), file.accessor(back.faces.ravel(), "u1"))
    file.add("scenes", nodes=[])
    return file.show(legs[2], file.add("nodes", name="seat", mesh=file.add("meshes", primitives=[primitive])), seat)


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_the_order_of_the_jsons_lists_changes_nothing(place: Path, seed: int) -> None:
    wanted, shuffled = read(chair(), place), read(chair().shuffled(RNG(seed)), place)
    assert list(wanted) == list(shuffled) == ["hind", "seat", "seat_2", "Leg", "Leg_2"]
    for name, mesh in wanted.items():
        np.testing.assert_array_equal(mesh.corners(), shuffled[name].corners())


def test_our_own_exports_give_their_parts_back(tmp_path: Path) -> None:
    balls = {"leg 1": toy.ball([3, -2, 1], 1.0), "back/rest": toy.ball([3, -1, 1], 0.7)}
    model = ExportedShape.of(balls["leg 1"], balls, {"leg 1": BOX, "back/rest": BOX})
    write_export(tmp_path / "a.glb", model)
    parts = dict(read_gltf(tmp_path / "a.glb"))
    assert list(parts) == list(balls)
    for name, mesh in parts.items():
        np.testing.assert_array_equal(mesh.corners(), model.parts[name].corners())


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_is_a_shape_and_a_file_in_a_folder_is_a_part(tmp_path: Path, suffix: str) -> None:
    file = chair()
    encoded = base64.b64encode(file.data).decode()
    content = file.glb() if suffix == ".glb" else file.text(f"data:;base64,{encoded}").encode()
    (tmp_path / "chair").mkdir()
    as_file(content, tmp_path, f"desk{suffix}")
    for name in ("seat", "stand"):
        as_file(content, tmp_path / "chair", f"{name}{suffix}")
    whole = find_shape(tmp_path / f"desk{suffix}")
    assert [part.part_id for part in read_shape(whole).parts] == ["hind", "seat", "seat_2", "Leg", "Leg_2"]
    assert [part.label for part in read_shape(whole).parts] == ["hind", "seat", "seat", "leg", "leg"]
    folder = find_shape(tmp_path / "chair")
    part, other = read_shape(folder).parts
    assert (part.part_id, other.part_id) == ("seat", "stand")
    assert face_areas(part.mesh).sum() == pytest.approx(sum(face_areas(p.mesh).sum() for p in read_shape(whole).parts))


# Refused


def used(extension: str, kind: str, **entry: Any) -> Callable[[Gltf], object]:
    """An extension of the first entry of a kind."""
    return lambda file: file.tree[kind][0].update(extensions={extension: entry})


def compressed(file: Gltf) -> None:
    """Draco in one of two primitives, and not required."""
    placeholder = file.add("accessors", componentType=5126, count=8, type="VEC3")
    extension = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    primitives = file.tree["meshes"][0]["primitives"]
    primitives.append({**primitives[0], "attributes": {"POSITION": placeholder}, "extensions": extension})


def change(kind: str, **entry: Any) -> Callable[[Gltf], object]:
    """Other values in the first entry of a list."""
    return lambda file: file.tree[kind][0].update(entry)


def change_primitive(**entry: Any) -> Callable[[Gltf], object]:
    return lambda file: file.tree["meshes"][0]["primitives"][0].update(entry)


def change_sparse(**entry: Any) -> Callable[[Gltf], object]:
    """The positions' replaced rows told otherwise."""
    parts = {"indices": {"bufferView": 1, "componentType": 5121}, "values": {"bufferView": 0}}
    return lambda file: file.tree["accessors"][0].update(sparse={"count": 1, **parts, **entry})


def require(extension: str) -> Callable[[Gltf], object]:
    return lambda file: file.tree.update(extensionsUsed=[extension], extensionsRequired=[extension])


def change_position(value: float) -> Callable[[Gltf], object]:
    def apply(file: Gltf) -> None:
        file.data[12:16] = np.float32(value).tobytes()

    return apply


def elsewhere(file: Gltf) -> None:
    """Positions in a second buffer, which is nowhere."""
    file.add("buffers", byteLength=len(file.data))
    file.add("buffers", byteLength=999)
    file.tree["bufferViews"][0].update(buffer=1)


def meshopt(file: Gltf) -> None:
    """Positions in meshopt's fallback buffer, which has no bytes; not required."""
    elsewhere(file)
    used("EXT_meshopt_compression", "bufferViews")(file)


def squeezed(file: Gltf) -> None:
    """Positions that an extension nobody knows tells."""
    file.tree["accessors"][0].pop("bufferView")
    change_primitive(extensions={"ACME_squeeze": {}})(file)


def morphed(file: Gltf) -> None:
    """A morph target of other vertices."""
    change_primitive(targets=[{"POSITION": 1}])(file)
    file.tree["meshes"][0].update(weights=[1])


WHERE = r"node 0 \('seat'\), mesh 0, primitive 0"
REFUSED: dict[str, tuple[Callable[[Gltf], object], str]] = {
    "Draco required": (require("KHR_draco_mesh_compression"),
                       r"with Draco \(KHR_draco_mesh_compression in extensionsRequired\); export without compression"),
    "Draco used": (compressed, r"primitive 1: compressed with Draco \(KHR_draco_mesh_compression\)"),
    "meshopt required": (require("EXT_meshopt_compression"), "meshopt .*in extensionsRequired.*without compression"),
    "meshopt used": (meshopt, r"compressed with meshopt \(EXT_meshopt_compression\)"),
    "GPU instances": (used("EXT_mesh_gpu_instancing", "nodes"), r"node 0 \('seat'\): .*EXT_mesh_gpu_instancing"),
    "unknown extension": (require("ACME_meshes"), r"ACME_meshes \(extensionsRequired\)"),
    "unknown compression": (squeezed, f"{WHERE}: only ACME_squeeze tells its numbers"),
    "skin": (change("nodes", skin=0), "is skinned"),
    "glTF 1": (lambda file: file.tree.update(asset={"version": "1.0"}), "is glTF 1.0; wanted glTF 2.0"),
    "glTF 3": (lambda file: file.tree.update(asset={"version": "2.0", "minVersion": "3.0"}), "is glTF 3.0"),
    "no version": (lambda file: file.tree.pop("asset"), "asset: Field required"),
    "a cycle": (lambda file: file.tree["nodes"][0].update(children=[0]), "wanted one place in a tree"),
    "a cycle apart": (lambda file: (file.add("nodes", children=[2]), file.add("nodes", children=[1])), "in a cycle"),
    "two parents": (lambda file: [file.tree["scenes"][0]["nodes"].append(file.add("nodes", children=[n]))
                                  for n in [file.add("nodes")] * 2], "is 2 times a child"),
    "a root twice": (lambda file: file.tree["scenes"][0]["nodes"].append(0), "2 times a root"),
    "no such scene": (lambda file: file.tree.update(scene=7), "shows scene 7; it has 1"),
    "no such node": (change("scenes", nodes=[4]), "names node 4; it has 1"),
    "no such child": (change("nodes", children=[4]), "names node 4; it has 1"),
    "no such mesh": (change("nodes", mesh=9), r"node 0 \('seat'\): names mesh 9; the file has 1"),
    "no such accessor": (change_primitive(indices=9), f"{WHERE}: accessor 9 is named; the file has 2"),
    "no such view": (change("accessors", bufferView=9), "bufferView 9 is named; the file has 2"),
    "no such buffer": (change("bufferViews", buffer=9), "buffer 9 is named; the file has 1"),
    "no positions": (change_primitive(attributes={}), f"{WHERE}: its vertices have no POSITION"),
    "mode 7": (change_primitive(mode=7), f"{WHERE}: mode 7"),
    "component type": (change("accessors", componentType=5130), f"{WHERE}, accessor 0: component type 5130"),
    "floats as indices": (lambda file: file.tree["accessors"][1].update(componentType=5126),
                          f"{WHERE}: its indices are of component type 5126"),
    "positions of 2": (change("accessors", type="VEC2"), "accessor 0: is VEC2"),
    "positions of 1": (change("accessors", type="SCALAR"), "accessor 0: is SCALAR; wanted VEC3"),
    "7 corners": (lambda file: file.tree["accessors"][1].update(count=7), f"{WHERE}: has 7 corners; wanted a multiple"),
    "fan of 2": (lambda file: (file.tree["accessors"][1].update(count=2), change_primitive(mode=6)(file)), "3 or more"),
    "vertex beyond": (change("accessors", count=4), f"{WHERE}: a face names vertex 7; there are 4"),
    "row beyond": (change_sparse(count=8, indices={"bufferView": 0, "componentType": 5125}), "replaces element"),
    "sparse by floats": (change_sparse(indices={"bufferView": 1, "componentType": 5126}), "sparse: .* type 5126"),
    "sparse of too much": (change_sparse(count=10**15), "sparse: 1,000,000,000,000,000 places"),
    "a cut view": (change("bufferViews", byteLength=95), f"{WHERE}, accessor 0, bufferView 0: .*end at byte 96; .* 95"),
    "overlapping rows": (change("bufferViews", byteStride=4), "8 elements of 12 bytes, 4 apart"),
    "a view outside": (change("bufferViews", byteOffset=10**6), "ends at byte 1,000,096 of buffer 0"),
    "a short buffer": (lambda file: file.add("buffers", byteLength=10**6), "has 240 bytes, wanted 1,000,000"),
    "no buffer": (elsewhere, "buffer 1 names no file"),
    "a count below 0": (change("accessors", count=-1), "accessors 0 count: .*greater than or equal to 0"),
    "a count of words": (change("accessors", count="many"), "accessors 0 count"),
    "a huge number": (change("nodes", scale=[1e308, 1e308, 1e999]), "nodes 0 scale 2: .*finite"),
    "too far": (change("nodes", scale=[1e308] * 3, translation=[1e308] * 3), "coordinates too large"),
    "no rotation": (change("nodes", rotation=[0, 0, 0, 0]), r"node 0 \('seat'\): its rotation is no unit quaternion"),
    "perspective": (change("nodes", matrix=[1, 0, 0, 1, *[0, 1, 0, 0], *[0, 0, 1, 0], *[0, 0, 0, 1]]), "last row"),
    "15 numbers": (change("nodes", matrix=[1.0] * 15), "nodes 0 matrix: "),
    "not a number": (change_position(math.nan), f"{WHERE}: vertex 1 is not finite"),
    "infinite": (change_position(math.inf), f"{WHERE}: vertex 1 is not finite"),
    "another target": (morphed, "a morph target has 36 vertices; wanted 8"),
    "too many roots": (change("scenes", nodes=[0] * (MAX_ENTRIES + 1)), "scenes 0 nodes: .*at most 100000"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_can_not_be_read_is_refused_by_its_name_and_place(tmp_path: Path, name: str) -> None:
    apply, reason = REFUSED[name]
    file = Gltf()
    node = file.add("nodes", name="seat", mesh=0)
    file.add("meshes", primitives=[file.primitive(file.accessor(BOX.vertices), file.accessor(BOX.faces.ravel(), "u4"))])
    read(file.show(node), tmp_path)
    apply(file)
    unread(file, tmp_path, reason)


@pytest.mark.parametrize(("limit", "most"), [("MAX_ENTRIES", 10), ("MAX_CORNERS", 400)])
def test_a_scene_that_places_too_much_is_refused(
    tmp_path: Path, limit: str, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A box has 36 corners; meshes count as often as they are placed."""
    monkeypatch.setattr(gltf, limit, most)
    file = Gltf()
    box = file.mesh(BOX)
    file.show(*(file.add("nodes", mesh=box) for _ in range(10)))
    assert len(read(file, tmp_path)) == 10
    file.tree["scenes"][0]["nodes"] += [file.add("nodes", mesh=box) for _ in range(2)]
    unread(file, tmp_path, f"and more, at most {most} are read")


@pytest.mark.parametrize(
    "extension", ["KHR_materials_unlit", "KHR_texture_transform", "EXT_texture_webp", "KHR_lights_punctual"]
)
def test_extensions_that_leave_shapes_alone_may_be_required(tmp_path: Path, extension: str) -> None:
    file = Gltf()
    require(extension)(file)
    assert list(read(file.show(file.part(BOX, "seat")), tmp_path)) == ["seat"]


def test_what_is_compressed_and_plain_as_well_is_read_plainly(tmp_path: Path) -> None:
    file = Gltf()
    file.show(file.part(BOX, "seat"))
    change_primitive(extensions={"KHR_draco_mesh_compression": {"bufferView": 0}})(file)
    used("EXT_meshopt_compression", "bufferViews")(file)
    np.testing.assert_array_equal(read(file, tmp_path)["seat"].corners(), BOX.corners())


@pytest.mark.parametrize("told", ["no view", "no view, indices", "a view", "sparse", "instances", "buffers"])
def test_no_number_of_the_file_makes_us_take_memory(tmp_path: Path, told: str) -> None:
    """Counts of gigabytes in a file of a kilobyte are refused before anything of their size is there."""
    file, many = Gltf(), 3 * 10**9
    node = file.part(BOX)
    positions, indices = file.tree["accessors"]
    if told == "instances":
        indices.update(count=3 * 10**5)
        indices.pop("bufferView")
        file.show(node, *(file.add("nodes", mesh=0) for _ in range(99)))
    else:
        file.show(node)
    if told == "buffers":
        file.add("buffers", byteLength=many, uri="a.bin")
    if told == "a view":
        positions.update(count=many)
    if told == "sparse":
        positions.pop("bufferView")
        places, values = {"bufferView": 1, "componentType": 5125}, {"bufferView": 0}
        positions.update(count=many, sparse={"count": 1, "indices": places, "values": values})
    if told.startswith("no view"):
        entry = indices if told.endswith("indices") else positions
        entry.pop("bufferView")
        entry.update(count=many)
    path = as_file(file, tmp_path)
    tracemalloc.start()
    with pytest.raises(InputError, match=r"at most|is missing"):
        read_gltf(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 * 2**20


def test_a_container_that_is_damaged_is_refused(tmp_path: Path) -> None:
    whole = chair().glb()
    length = int.from_bytes(whole[12:16], "little")
    damaged = {
        whole[:15]: "15 bytes are too few",
        whole[:-1]: "cut short",
        whole[:4] + b"\1" + whole[5:]: "is glTF 1; wanted glTF 2.0",
        whole[:12] + b"\xff\xff\xff\x7f" + whole[16:]: "chunk 0 says it has",
        whole[: 20 + length] + b"\xff\xff\xff\x7f" + whole[24 + length :]: "chunk 1 says it has",
        whole[:16] + b"BIN\0" + whole[20:]: "first chunk isn't JSON",
        b"glTF junk": "can't be read as GLB",
        b"": "can't be read as GLB",
        b"[" * 10**5: "can't be read as GLB",
        packed([], b""): "can't be read as GLB",
        b"{}" + b" ," * 5_000_001: "5,000,002 values",
    }
    for content, reason in damaged.items():
        with pytest.raises(InputError, match=reason):
            read_gltf(as_file(content, tmp_path))
    with pytest.raises(InputError, match="No such file"):
        read_gltf(tmp_path / "none.glb")
    assert len(read_gltf(as_file(whole + b"more", tmp_path))) == 5, "what follows the file is no part of it"


def test_names_in_latin_1_and_zeros_behind_the_json_are_read(tmp_path: Path) -> None:
    """Neither is as the specification wants it; programs write both."""
    file = Gltf()
    whole = file.show(file.part(BOX, "St?hle"), file.part(BOX, "T?r")).glb()
    length = int.from_bytes(whole[12:16], "little")
    text = (
        whole[20 : 20 + length]
        .replace(b"St?hle", b"St\xfchle")
        .replace(b"T?r", b"T\xfcr")
        .rstrip()
        .ljust(length, b"\0")
    )
    parts = dict(read_gltf(as_file(whole[:20] + text + whole[20 + length :], tmp_path)))
    assert list(parts) == ["Stühle", "Tür"]
    np.testing.assert_array_equal(parts["Tür"].corners(), BOX.corners())


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """A file with some bytes, numbers or stretches of it changed; lengths in the container are right, mostly."""
    length = int.from_bytes(content[12:16], "little")
    text, data = bytearray(content[20 : 20 + length]), bytearray(content[28 + length :])
    for _ in range(rng.integers(1, 3)):
        kind, place = rng.choice([0, 1, 1, 2, 3, 3, 3, 4]), int(rng.integers(len(text)))
        digits = [i for i, byte in enumerate(text) if 48 <= byte <= 57]
        if kind == 0:
            text[place] = rng.integers(256)
        elif kind == 1 and digits:
            start = digits[rng.integers(len(digits))]
            text[start : start + 1] = str(rng.choice([0, 1, 2, 3, 7, 99, 5121, 5126, 2**31, 2**63, -1, 1e300])).encode()
        elif kind == 2:
            del text[place : place + rng.integers(1, 40)]
        elif kind == 3 and len(data):
            data[rng.integers(len(data))] = rng.integers(256)
        elif kind == 4:
            del data[rng.integers(len(data) + 1) :]
    if rng.random() < 0.1:
        return content[: 20 + len(text)] + bytes(data)
    chunks = len(text).to_bytes(4, "little") + b"JSON" + text + len(data).to_bytes(4, "little") + b"BIN\0" + data
    return content[:8] + (12 + len(chunks)).to_bytes(4, "little") + chunks


def test_mutated_files_are_read_or_refused_and_nothing_else(tmp_path: Path) -> None:
    rng, seen, whole = RNG(0), Counter[str](), chair().glb()
    for _ in range(400):
        try:
            parts = read_gltf(as_file(mutated(whole, rng), tmp_path))
        except InputError as error:
            seen["refused" if str(tmp_path) in str(error) else "without a path"] += 1
            continue
        seen["read"] += 1
        for _, mesh in parts:
            assert np.isfinite(mesh.vertices).all()
            assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
    assert set(seen) == {"read", "refused"}
    assert min(seen.values()) > 40


def test_types_of_the_specification_are_all_there() -> None:
    assert set(TYPES.values()) == {5120, 5121, 5122, 5123, 5125, 5126}


def test_equal_files_give_equal_structures(tmp_path: Path) -> None:
    """Ids depend on nothing but the file: two copies are one structure."""
    first, second = (as_file(chair(), tmp_path, f"{name}.glb") for name in "ab")
    shapes = [read_shape(find_shape(path)) for path in (first, second)]
    assert shapes[0].structure.to_json() == shapes[1].structure.to_json()
    assert json.loads(shapes[0].structure.to_json())["id"] == "root"
