"""OBJ files: what is written is read, and what is broken is named with its line."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
import toy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cagesdf.errors import InputError
from cagesdf.formats import obj
from cagesdf.formats.obj import read_obj, read_obj_groups

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


def test_a_polygon_becomes_a_fan(tmp_path: Path) -> None:
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
@given(content=st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.obj").write_bytes(b"v 0 0 0\n" + content)
    with contextlib.suppress(InputError):
        read_obj(tmp_path / "a.obj")


def test_a_missing_and_a_huge_file_are_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"none\.obj: can't be read"):
        read_obj(tmp_path / "none.obj")
    toy.write_obj(tmp_path / "a.obj", toy.box([0, 0, 0], [1, 1, 1]))
    monkeypatch.setattr(obj, "MAX_BYTES", 100)
    with pytest.raises(InputError, match="at most 100 are read"):
        read_obj(tmp_path / "a.obj")
