"""Changes of parts by hand: the shape stays, whatever is merged and split, and what can't be is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import is_closed, join, signed_volume
from cagesdf.parts.changing import changed
from cagesdf.parts.finding import FoundParts, as_written, find_parts, parts_as_written
from tests.support import toy

WELD, THIN = 1e-5, 1e-4
SAME = Similarity(1.0, np.eye(3), np.zeros(3))
MESH = join(
    [toy.box([0, 0, 0], [1, 0.1, 1]), *(toy.box([x, -0.5, 0], [0.1, 0.8, 0.1 + 0.01 * x]) for x in (-0.4, 0.4))]
)
FOUND = find_parts(MESH, WELD, THIN)


def volumes(found: FoundParts) -> dict[str, float]:
    return {part.name: signed_volume(part.mesh) for part in found.parts}


def test_merged_parts_are_one_with_the_first_one_s_name() -> None:
    before, after = volumes(FOUND), volumes(changed(FOUND, ["merge part_3 part_2"], SAME))
    assert after == pytest.approx({"part_1": before["part_1"], "part_3": before["part_2"] + before["part_3"]})


def test_a_split_leaves_the_name_to_the_lower_side_and_the_label_to_both() -> None:
    split = changed(FOUND, ["label part_1 seat", "split part_1 x 0.3"], SAME)
    assert volumes(split)["part_1"] == pytest.approx(0.8 * 0.1)
    assert volumes(split)["part_1_2"] == pytest.approx(0.2 * 0.1)
    assert [(part.name, part.label) for part in split.parts[:2]] == [("part_1", "seat"), ("part_1_2", "seat")]


def test_the_plane_is_in_the_file_s_frame_and_unit() -> None:
    placement = Similarity(0.01, Rotation.from_rotvec([0.3, 0.4, 0.5]).as_matrix(), np.array([0.1, 0.2, 0.3]))
    found = find_parts(MESH.with_vertices(placement.to_canonical(100 * MESH.vertices)), WELD, THIN)
    seat = max(found.parts, key=lambda part: signed_volume(part.mesh)).name
    sides = volumes(changed(found, [f"split {seat} x 30"], placement))
    whole = signed_volume(found.parts[0].mesh)
    assert sides[seat] == pytest.approx(0.8 * whole, rel=1e-6)


CHANGES = st.sampled_from(
    ["merge part_1 part_2", "merge part_2 part_3", "split part_1 x 0.1", "split part_2 y -0.6", "split part_3 y -0.3",
     "rename part_1 seat", "label part_2 leg"]
)  # fmt: skip


@settings(max_examples=25, deadline=None)
@given(st.lists(CHANGES, max_size=4))
def test_whatever_is_changed_the_parts_are_closed_and_add_up_and_come_back_from_the_file(changes: list[str]) -> None:
    found = FOUND
    for change in changes:
        try:
            found = changed(found, [change], SAME)
        except InputError:
            continue  # of a part that isn't there any more
    names = [part.name for part in found.parts]
    assert len(set(names)) == len(names)
    assert all(is_closed(part.mesh) for part in found.parts)
    assert sum(volumes(found).values()) == pytest.approx(sum(volumes(FOUND).values()), rel=1e-6)
    again = parts_as_written(MESH, as_written(found, SAME), SAME, WELD, THIN)
    assert volumes(again) == pytest.approx(volumes(found), rel=1e-6)


def test_names_with_spaces_are_quoted() -> None:
    renamed = changed(FOUND, ["rename part_1 'the seat'", "merge 'the seat' part_2"], SAME)
    assert [part.name for part in renamed.parts] == ["the seat", "part_3"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("merge part_1", "wanted one of: merge NAME NAME …; split"),
        ("merge part_1 part_1", "wanted two different parts"),
        ("weld part_1 part_2", "wanted one of"),
        ("", "wanted one of"),
        ("split part_1 x", "wanted one of"),
        ("split part_1 w 0", "wanted x, y or z as axis, got 'w'"),
        ("split part_1 x nan", "wanted a finite place, got 'nan'"),
        ("split part_1 x here", "'here'"),
        ("split part_1 x 0.6", "beside the part, which reaches from -0.5 to 0.5"),
        ("rename part_1 part_2", "there is a part 'part_2' already"),
        ("rename part_1 ' '", "wanted a name of printable letters"),
        ("label part_1 'a\tb'", "wanted a label of printable letters"),
        ("rename part_7 seat", "there is no part 'part_7'; the shape has part_1, part_2, part_3"),
        ("rename 'part_1 seat", "No closing quotation"),
    ],
)
def test_what_can_not_be_is_refused_with_the_change(change: str, message: str) -> None:
    with pytest.raises(InputError, match=r"change .*: ") as caught:
        changed(FOUND, [change], SAME)
    assert message in str(caught.value)


def test_a_change_leaves_what_was_given_as_it_was() -> None:
    changed(FOUND, ["rename part_1 seat", "merge part_2 part_3"], SAME)
    assert [part.name for part in FOUND.parts] == ["part_1", "part_2", "part_3"]
