"""STL: solids keep their names, and what is wrong is said with its line, or in bytes."""

from pathlib import Path

import numpy as np
import pytest

from cagesdf.errors import InputError
from cagesdf.formats.parts_folder import read_parts_file
from cagesdf.formats.stl import read_stl
from cagesdf.geometry.meshes import Mesh
from tests.support import mutants, toy

BOX = mutants.BOX
OTHER = toy.box([5, 0, 0], [1, 1, 1])


def read(path: Path, content: bytes | str) -> list[tuple[str, Mesh]]:
    (path / "a.stl").write_bytes(content.encode() if isinstance(content, str) else content)
    return read_stl(path / "a.stl")


def parts(path: Path, content: bytes | str) -> list[str]:
    read(path, content)
    return [part.part_id for part in read_parts_file(path / "a.stl", "a", "train").parts]


def text(*names: str) -> str:
    return "".join(mutants.stl_text(toy.box([5 * i, 0, 0], [1, 2, 3]), name) for i, name in enumerate(names))


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_solids_keep_their_names_and_corners(tmp_path: Path, end: str, encoding: str) -> None:
    solids = read(tmp_path, text("left leg", "Stühle", "1").replace("\n", end).encode(encoding))
    assert [name for name, _ in solids] == ["left leg", "Stühle", "1"]
    np.testing.assert_allclose(solids[0][1].corners(), toy.box([0, 0, 0], [1, 2, 3]).corners())


def test_solids_of_one_name_or_none_are_parts_of_their_own(tmp_path: Path) -> None:
    assert parts(tmp_path, text("part", "part", "", "part_2")) == ["part", "part_3", "part_4", "part_2"]
    assert parts(tmp_path, text("leg", "leg")) == ["leg", "leg_2"]
    assert parts(tmp_path, text("leg", "Leg")) == ["leg", "Leg"]


def test_names_in_no_utf8_stay_as_different_as_their_bytes(tmp_path: Path) -> None:
    content = text("A", "B").replace("solid A", "solid 桌腿").replace("solid B", "solid 桌面").encode("gbk")
    assert len(set(parts(tmp_path, content))) == 2


def test_words_may_be_written_in_capitals_and_spread_over_lines(tmp_path: Path) -> None:
    facets = text("a").partition("\n")[2].removesuffix("endsolid a\n")
    ((name, mesh),) = read(tmp_path, "SOLID a\n" + facets.upper().replace(" ", "\n\t") + "ENDSOLID")
    assert (name, len(mesh.faces)) == ("a", 12)


@pytest.mark.parametrize("header", [b"CAD", b"solid CAD", b"COLOR=\xff\0\0\xff", b"solid\n", b"\xff\xfe"])
def test_a_binary_file_is_known_by_its_length_whatever_it_begins_with(tmp_path: Path, header: bytes) -> None:
    ((name, mesh),) = read(tmp_path, mutants.stl_binary(BOX, header))
    assert name == ""
    np.testing.assert_array_equal(mesh.corners(), BOX.corners())


@pytest.mark.parametrize("header", [b"CAD", b"solid CAD"])
def test_a_binary_file_of_another_length_says_what_it_is(tmp_path: Path, header: bytes) -> None:
    content = mutants.stl_binary(BOX, header)
    for wrong, differs in ((content + b"\r\n", "686: 2 are too many"), (content[:-7], "677: 7 are missing")):
        with pytest.raises(InputError, match=rf"a\.stl: as a binary STL, .* 12 triangles, .* 684 bytes, .*{differs}"):
            read(tmp_path, wrong)
    with pytest.raises(InputError, match="has 7 bytes"):
        read(tmp_path, b"\1" * 7)
    with pytest.raises(InputError, match="has no faces"):
        read(tmp_path, content[:80] + bytes(4))


def test_a_text_file_cut_anywhere_is_rejected_with_a_line(tmp_path: Path) -> None:
    whole = text("seat", "leg").encode()
    for length in range(20, len(whole.rstrip()) - len("endsolid leg") + 5, 7):
        if whole[:length].rstrip().endswith(b"endsolid seat") or whole[:length].endswith(b"endsolid"):
            continue  # all that came before is whole
        with pytest.raises(InputError, match=r"a\.stl, line \d+: "):
            read(tmp_path, whole[:length])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("vertex 5.000000e-01 1", "vertex 0,5 1", r"line \d+: '0,5': wanted a decimal point, not a comma"),
        ("vertex 5.000000e-01 1", "vertex 1_0 1", r"line \d+: '1_0': wanted a number"),
        ("vertex 5.000000e-01 1", "vertex nan 1", r"facet \d+: corner \d of the face is at \(nan, "),
        ("    endloop", "      vertex 1 1 1\n    endloop", r"line 7: wanted endloop, got 'vertex 1 1 1'"),
        ("  endfacet\n", "", r"line 8: wanted endfacet, got 'facet normal 0 0 0'"),
        ("outer loop", "outer lop", "line 3: wanted outer loop, got 'outer lop'"),
        ("endsolid seat\n", "", r"line 86: wanted facet normal x y z, got 'solid leg'"),
        ("endsolid leg", "", r"line 171: ends within solid 'leg', which begins in line 87"),
        ("endsolid leg", "endsolid leg\nmore", "line 173: wanted solid NAME, got 'more'"),
        ("endsolid leg", "endsolid leg\nsolid back\nendsolid back", "line 173: solid 'back' has no faces"),
    ],
)
def test_a_line_that_is_wrong_is_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError, match=r"a\.stl, " + said):
        read(tmp_path, text("seat", "leg").replace(old, new, 1))
