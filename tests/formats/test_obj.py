"""OBJ files: what is written is read, and what is broken is named with its line."""

import contextlib
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cagesdf.errors import InputError
from cagesdf.formats import content, obj
from cagesdf.formats.obj import read_obj, read_obj_groups
from cagesdf.geometry.meshes import face_normals
from tests.support import toy

NUMBERS = st.floats(-1e6, 1e6)
POINTS = st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), min_size=3, max_size=12)
SAME_FOLDER = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


@SAME_FOLDER
@given(points=POINTS, data=st.data())
def test_faces_written_in_any_form_are_read_back(tmp_path: Path, points, data) -> None:
    """Plain, with texture and normal indices, counted from the end, and broken over lines."""
    count = len(points)
    corner = st.integers(0, count - 1)
    faces = data.draw(st.lists(st.tuples(corner, corner, corner), min_size=1, max_size=8))
    lines = ["# made up", "mtllib none.mtl", *(f"v {x!r} {y!r} {z!r}" for x, y, z in points), "vn 0 0 1", "s off"]
    for face in faces:
        form = data.draw(st.sampled_from(["{0}", "{0}/7", "{0}//8", "{0}/7/8", "{1}", "{1}//2"]))
        gap = data.draw(st.sampled_from([" ", "  ", "\t", " \\\n "]))
        lines.append("f " + gap.join(form.format(i + 1, i - count) for i in face))
    end = data.draw(st.sampled_from(["\n", "\r\n"]))
    (tmp_path / "a.obj").write_bytes(end.join(lines).replace(" \\\n", " \\" + end).encode())
    np.testing.assert_array_equal(read_obj(tmp_path / "a.obj").corners(), np.array(points, float)[np.array(faces)])


def test_a_convex_polygon_becomes_a_fan(tmp_path: Path) -> None:
    square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 9\nf 1 2 3 4\n"
    (tmp_path / "a.obj").write_text(square)
    mesh = read_obj(tmp_path / "a.obj")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert len(mesh.vertices) == 4, "vertices that no face uses are left out"


def write_named(path: Path, first: str, second: str) -> None:
    box = toy.box([0, 0, 0], [1, 1, 1])
    lines = [f"v {x} {y} {z}" for x, y, z in box.vertices]
    faces = [f"f {a} {b} {c}" for a, b, c in box.faces + 1]
    path.write_text("\n".join([*lines, first, *faces[:5], second, *faces[5:]]))


@pytest.mark.parametrize(("first", "second"), [("o seat\ng x", "o left leg\ng x"), ("o all\ng seat", "g left leg")])
def test_objects_are_the_parts_or_groups_where_there_is_one_object(tmp_path: Path, first: str, second: str) -> None:
    write_named(tmp_path / "a.obj", first, second)
    parts = read_obj_groups(tmp_path / "a.obj")
    assert [(name, len(mesh.faces)) for name, mesh in parts] == [("seat", 5), ("left leg", 7)]
    assert len(read_obj(tmp_path / "a.obj").faces) == 12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 0\nv 1 0\n", "line 2: can't read 'v 1 0'"),
        ("v 0 0 zero\n", "line 1: .*zero"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "line 4: .*needs three vertices.*cut short"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 3\nv 0 1 0\n", "line 3: .*there are 2 vertices"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", "line 4: "),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n", "line 4: "),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n", "line 4: "),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3.0\n", "line 4: .*'3.0': wanted a whole number"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0_3\n", "line 4: "),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999999\n", "line 4: "),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9223372036854775809\n", "line 4: "),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 \\\n2 \\\n4\n", "line 4: "),
        ("v 0 0 0\nv 1 0 0\nv 0 1 nan\nf 1 2 3\n", "line 4: corner 3 of the face is at .0, 1, nan."),
        ("v 0 0 0\nv 1 0 0\nv 0 1 1e999\nf 1 2 3\n", "line 4: corner 3 of the face is at .0, 1, inf."),
        ("v 0,5 0 0\n", "line 1: .*decimal point, not a comma"),
        ("v 1_0 0 0\n", "line 1: "),
        ("v 0 0 0 red\n", "line 1: .*'red'"),
        ("v 0 0 0\n\0\0", "line 2: holds a byte of 0"),
        ("surf 0 1 0 1 1 2 3 4\n", "line 1: .*free-form surfaces aren't read"),
        ("call other.obj\n", "line 1: .*other files aren't read"),
        ("v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 4\n", "line 5: the outline of the face crosses itself"),
    ],
)
def test_a_broken_line_is_named_with_its_text(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(InputError, match=r"a\.obj, " + message):
        read_obj(tmp_path / "a.obj")


@SAME_FOLDER
@given(share=st.floats(0, 1))
def test_a_file_cut_anywhere_is_read_as_far_as_it_goes_or_refused(tmp_path: Path, share: float) -> None:
    toy.write_obj(tmp_path / "a.obj", toy.ball([0, 0, 0], 1, 8))
    whole = (tmp_path / "a.obj").read_bytes()
    (tmp_path / "a.obj").write_bytes(whole[: int(share * len(whole))])
    try:
        count = len(read_obj(tmp_path / "a.obj").faces)
    except InputError:
        return
    assert count <= len(toy.ball([0, 0, 0], 1, 8).faces)


@SAME_FOLDER
@given(rest=st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(tmp_path: Path, rest: bytes) -> None:
    (tmp_path / "a.obj").write_bytes(b"v 0 0 0\n" + rest)
    with contextlib.suppress(InputError):
        read_obj(tmp_path / "a.obj")


def test_a_missing_and_a_huge_file_are_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"none\.obj: can't be read"):
        read_obj(tmp_path / "none.obj")
    toy.write_obj(tmp_path / "a.obj", toy.box([0, 0, 0], [1, 1, 1]))
    monkeypatch.setattr(content, "MAX_BYTES", 100)
    with pytest.raises(InputError, match="at most 100 are read"):
        read_obj(tmp_path / "a.obj")


def both(first: str, second: str) -> str:
    """Two triangles under two statements each, every one with vertices of its own."""
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    return f"{corners}{first}\nf 1 2 3\n{corners}{second}\nf 4 5 6\n"


def names(path: Path, content: bytes) -> list[str]:
    (path / "a.obj").write_bytes(content)
    return [name for name, _ in read_obj_groups(path / "a.obj")]


@pytest.mark.parametrize("key", ["o", "g"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "latin-1"])
def test_any_encoding_and_line_end_is_read(tmp_path: Path, key: str, end: str, encoding: str) -> None:
    text = f"{key} Füße\n" + both(f"{key} Füße", f"{key} Stühle # blue")
    assert names(tmp_path, text.replace("\n", end).encode(encoding)) == ["Füße", "Stühle"]


@pytest.mark.parametrize("encoding", ["gbk", "shift-jis", "big5", "cp1251", "latin-1", "utf-8"])
@pytest.mark.parametrize("pair", [("桌腿", "桌面"), ("表", "能"), ("ножка", "сидка"), ("Füße", "Fäße")])
def test_names_stay_different_in_any_encoding(tmp_path: Path, encoding: str, pair: tuple[str, str]) -> None:
    """In Shift JIS, 表 ends in the byte of a backslash."""
    first, second = (name.encode(encoding, errors="ignore") for name in pair)
    if first == second:
        first = first + b"\\"
    text = both("o A", "o B").encode().replace(b"o A", b"o " + first).replace(b"o B", b"o " + second)
    assert len(set(names(tmp_path, text))) == 2


def test_a_comment_may_follow_anything_and_a_name_may_hold_a_number_sign(tmp_path: Path) -> None:
    text = both("o leg#1 # left", "o leg#2\t# right").replace("0\n", "0 # corner\n").replace("3\n", "3 # face\n", 1)
    assert names(tmp_path, text.encode()) == ["leg#1", "leg#2"]
    assert names(tmp_path, both("o #1", "o #2").encode()) == ["#1", "#2"]
    assert names(tmp_path, both("o seat # 1", "o seat # 2").encode()) == ["seat", "seat"]


def test_a_comment_or_a_name_that_ends_in_a_backslash_continues_nothing(tmp_path: Path) -> None:
    text = "# C:\\models\\\nmtllib C:\\\n" + both("o a\\", "o b\\")
    assert names(tmp_path, text.encode()) == ["a\\", "b\\"]


def test_objects_of_one_name_are_parts_unless_they_share_vertices(tmp_path: Path) -> None:
    assert names(tmp_path, both("o leg", "o leg").encode()) == ["leg", "leg"]
    assert names(tmp_path, both("o leg", "o leg").replace("f 4 5 6", "f 4 5 1").encode()) == ["leg"]
    assert names(tmp_path, both("o all\ng a", "o all\ng b").encode()) == ["a", "b"]
    assert names(tmp_path, both("g a", "g a").encode()) == ["a"], "by the format, a group is all that has its name"
    assert names(tmp_path, both("", "o seat").encode()) == ["", "seat"]
    assert names(tmp_path, both("o seat", "").encode()) == ["seat"]


def test_materials_are_no_parts_and_their_library_need_not_exist(tmp_path: Path) -> None:
    whole = both("usemtl wood", "usemtl cloth")
    assert names(tmp_path, b"mtllib none.mtl\n" + whole.encode()) == [""]
    assert names(tmp_path, both("o seat\nusemtl wood", "usemtl cloth").encode()) == ["seat"]


def test_a_group_that_goes_on_later_is_one_part_and_may_be_called_after_a_material(tmp_path: Path) -> None:
    text = both("g wood\nusemtl wood", "g cloth\nusemtl cloth") + "v 0 0 1\nv 1 0 1\nv 0 1 1\ng wood\nf 7 8 9\n"
    (tmp_path / "a.obj").write_text(text)
    parts = read_obj_groups(tmp_path / "a.obj")
    assert [(name, len(mesh.faces)) for name, mesh in parts] == [("wood", 2), ("cloth", 1)]


def test_weights_colours_and_old_faces_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0 1\nv 1 0 0 0.5 0.5 0.5\nv 0 1 0 1 0 0 1\nfo 1 2 3\n")
    assert read_obj(tmp_path / "a.obj").vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def test_a_concave_face_is_no_fan(tmp_path: Path) -> None:
    """Point 1 doesn't see point 4."""
    text = "v 3 0 0\nv 3 3 0\nv 2 1 0\nv 1 3 0\nv 1 -1 0\nf 1 2 3 4 5\n"
    (tmp_path / "a.obj").write_text(text)
    mesh = read_obj(tmp_path / "a.obj")
    normals = face_normals(mesh)
    assert normals[:, 2].min() > 0
    assert normals[:, 2].sum() == pytest.approx(2 * 5)


def test_more_parts_than_anyone_can_use_are_refused(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\n" + "".join(f"g {i}\nf 1 2 3\n" for i in range(10_001))
    with pytest.raises(InputError, match="has 10,001 named parts"):
        names(tmp_path, text.encode())


STATEMENTS = st.sampled_from(
    [
        "v 0 0 1", "v 1 0 0", "v 0 1 -0.5e-3", "v 1 2", "v 1 2 3 4", "v\t1.5  2 +3 ", "v 1,5 2 3", "v 1_0 2 3",
        "v 1.2.3 0 0", "v 1e400 0 0", "v --1 0 0", "f 1 2 3", "f -1 -2 -3", "f 1/1/1 2/7/ 3//3", "f 1 2 3 1",
        "f 1 2", "f 0 1 2", "f 9 1 2", "f -9 1 2", "f 1/ 2/ 3/", "f 1//a 2 3", "f 99999999999999999999 1 2",
        "f 1_0 2 3", "f 1 2 3 \\", "v 1 \\", "2 3", "g leg", "o seat", "# v 1 2 3", "", "usemtl wood",
        " f 1 2 3", "vn 0 0 1", "f 1 2 -", "f 1-2 2 3",
    ]
)  # fmt: skip


@settings(SAME_FOLDER, max_examples=400)
@given(lines=st.lists(STATEMENTS, max_size=14), end=st.sampled_from(["\n", "\r\n"]), last=st.booleans())
def test_runs_of_lines_are_read_as_one_line_at_a_time(tmp_path: Path, lines: list[str], end: str, last: bool) -> None:
    """Contents, order and messages are those of the slow version."""
    whole = ["v 0 0 0", "v 1 0 0", "v 0 1 0", *lines]
    path = tmp_path / "a.obj"
    path.write_bytes((end.join(whole) + end * last).encode())

    def outcome(runs: re.Pattern[bytes]) -> object:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(obj, "RUN", runs)
            try:
                return obj._read(path, path.read_bytes())
            except InputError as error:
                return str(error)

    assert outcome(obj.RUN) == outcome(re.compile(rb"(?!)"))
