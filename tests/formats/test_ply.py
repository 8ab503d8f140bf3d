"""PLY: any order, type and layout gives the same faces; what a header says falsely is refused."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from cagesdf.errors import InputError
from cagesdf.formats.ply import read_ply
from cagesdf.geometry.meshes import Mesh, is_closed, signed_volume
from tests.support import mutants

HEADER = (
    "ply\nformat {order} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {count}\nproperty list uchar int vertex_indices\nend_header\n"
)
POINTS = "0 0 0\n1 0 0\n0 1 0\n"


def read(path: Path, content: bytes | str) -> Mesh:
    (path / "a.ply").write_bytes(content.encode() if isinstance(content, str) else content)
    return read_ply(path / "a.ply")


@pytest.mark.parametrize("order", ["ascii", "<", ">"])
def test_mixed_polygons_are_read_among_other_elements_and_properties(tmp_path: Path, order: str) -> None:
    mesh = read(tmp_path, mutants.ply_file(order, *mutants.quads()))
    assert len(mesh.faces) == 20
    assert is_closed(mesh)
    assert signed_volume(mesh) == pytest.approx(0.6)


@pytest.mark.parametrize(("order", "length"), [*product("<>", ["char", "uchar", "short", "ushort", "int", "uint"])])
def test_lengths_and_indices_may_be_of_any_whole_type(tmp_path: Path, order: str, length: str) -> None:
    points, faces = mutants.quads()
    wanted = read(tmp_path, mutants.ply_file("ascii", points, faces)).faces
    for index in ("char", "uchar", "short", "ushort", "int", "uint"):
        mesh = read(tmp_path, mutants.ply_file(order, points, faces, length, index))
        np.testing.assert_array_equal(mesh.faces, wanted)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kept", [slice(2, None), slice(0, 2), slice(0, 1)], ids=["quads", "hexagons", "one"])
def test_rows_of_one_size_are_read_as_those_of_several(tmp_path: Path, order: str, kept: slice) -> None:
    points, faces = mutants.quads()
    mesh = read(tmp_path, mutants.ply_file(order, points, faces[kept]))
    other = read(tmp_path, mutants.ply_file("ascii", points, faces[kept]))
    np.testing.assert_array_equal(mesh.faces, other.faces)
    np.testing.assert_allclose(mesh.vertices, other.vertices, atol=1e-7)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_may_end_in_any_way(tmp_path: Path, end: str) -> None:
    text = mutants.ply_file("ascii", *mutants.quads()).decode()
    assert len(read(tmp_path, text.replace("\n", end)).faces) == 20
    assert len(read(tmp_path, text.replace("\n", end).encode("utf-16")).faces) == 20
    head, body = mutants.ply_file("<", *mutants.quads()).split(b"end_header\n")
    assert len(read(tmp_path, head.replace(b"\n", end.encode()) + b"end_header" + end.encode() + body).faces) == 20


def test_positions_in_double_keep_all_their_digits(tmp_path: Path) -> None:
    content = HEADER.replace("float", "double").format(order="binary_big_endian", count=1).encode()
    points = np.array([[500_000.1, 0, 0], [1, 2 / 3, 0], [0, 0, 1e-20]])
    content += points.astype(">f8").tobytes() + b"\3" + np.arange(3, dtype=">i4").tobytes()
    np.testing.assert_array_equal(read(tmp_path, content).vertices, points)


def test_coordinates_may_stand_in_any_order_among_others(tmp_path: Path) -> None:
    text = HEADER.format(order="ascii", count=1).replace("float x\nproperty float y\nproperty float z", "int z\n"
        "property list uchar float weights\nproperty short x\nproperty uchar red\nproperty float y")  # fmt: skip
    mesh = read(tmp_path, f"{text}3 1 0.5 1 255 2\n6 0 4 255 5\n9 2 7 7 7 255 8\n3 0 1 2\n")
    assert mesh.vertices.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]


def test_strips_are_triangles_of_one_side_and_end_at_minus_one(tmp_path: Path) -> None:
    text = HEADER.replace("vertex 3", "vertex 4").replace("face", "tristrips").format(order="ascii", count=2)
    mesh = read(tmp_path, text + POINTS + "0 0 1\n8 0 1 2 3 -1 3 1 0\n5 0 1 1 2 3\n")
    assert mesh.faces.tolist() == [[0, 1, 2], [2, 1, 3], [3, 1, 0], [1, 2, 3]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("obj\n", "can't be read as PLY: wanted a first line ply"),
        ("ply\nformat ascii 1.0\nelement vertex 99\n", "can't be read as PLY: no line end_header"),
        (HEADER.format(order="ascii", count=1) + POINTS + "3 0 1 3\n", "face 0, counted from 0: corner 3 .* vertex 3"),
        (HEADER.format(order="ascii", count=2) + POINTS + "3 0 1 2\n3 0 -1 2\n", "face 1, .* corner 2 .* vertex -1"),
        (HEADER.format(order="ascii", count=2) + POINTS + "3 0 1 2\n", "ends after line 13, before row 1 of the 2 of"),
        (HEADER.format(order="ascii", count=1) + POINTS + "3 0 1\n", "line 13: .*3 values wanted, 2 there"),
        (HEADER.format(order="ascii", count=1) + POINTS + "3 0 1 2 0\n", "line 13: .*4 values wanted, 5 there"),
        (HEADER.format(order="ascii", count=1) + POINTS + "-3 0 1 2\n", "line 13"),
        (HEADER.format(order="ascii", count=1) + POINTS + "3 0 1 2.5\n", "line 13: .*'2.5': wanted a whole number"),
        (HEADER.format(order="ascii", count=1) + "0 0 0\n1,5 0 0\n", "line 11: .*decimal point, not a comma"),
        (HEADER.format(order="ascii", count=1) + "0 0 0\n1 0\n0 1 0\n", "line 11: "),
        (HEADER.format(order="ascii", count=1) + "nan 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "face 0, .* at .nan, 0, 0."),
        (HEADER.format(order="ascii", count=1) + POINTS + "2 0 1\n", "face 0, .*2 corners"),
        (HEADER.format(order="ascii", count=1) + POINTS + "3 0 1 2\n3 0 1 2\n", "line 14: .*nothing more"),
        (HEADER.format(order="ascii", count=0) + POINTS, "has no faces"),
        (HEADER.format(order="ascii", count=1).replace("vertex_indices", "others") + POINTS + "3 0 1 2\n", "no faces"),
        (HEADER.format(order="ascii", count=1).replace("float z", "float w"), "has no property z"),
        (HEADER.format(order="ascii", count=1).replace("list uchar", "list float"), "line 8: "),
        (HEADER.format(order="ascii", count=1).replace("uchar int", "uchar float"), "line 8: .*whole numbers"),
        (HEADER.format(order="ascii", count=1).replace("float z", "float y"), "line 6: .*second property"),
        (HEADER.format(order="middle_endian", count=1), "line 2: .*binary_little_endian"),
        (HEADER.format(order="ascii", count=-1), "line 7: "),
        (HEADER.format(order="ascii", count=10**9), "at most 5,000,000"),
    ],
)
def test_what_is_wrong_is_said_with_its_line_or_face(tmp_path: Path, text: str, said: str) -> None:
    if "at most" in said:
        text += POINTS
    with pytest.raises(InputError, match=r"a\.ply.*" + said):
        read(tmp_path, text)


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_counts_that_lie_are_refused_before_anything_is_made(tmp_path: Path, order: str) -> None:
    content = mutants.ply_file(order, *mutants.quads())
    with pytest.raises(InputError, match=r"takes 51,999,999,948 bytes"):
        read(tmp_path, content.replace(b"vertex 12", b"vertex 3999999996"))
    with pytest.raises(InputError, match=r"row \d+ of the 4,000 of element face"):
        read(tmp_path, content.replace(b"face 8", b"face 4000"))
    with pytest.raises(InputError, match="2 bytes more than its header says"):
        read(tmp_path, content + b"\0\0")
    with pytest.raises(InputError, match="cut short"):
        read(tmp_path, content[:-1])
    with pytest.raises(InputError, match="row 0 of the 8 of element face has a list of -6 values"):
        read(tmp_path, content.replace(b"list uchar int", b"list char int").replace(b"\3\6", b"\3\xfa"))
