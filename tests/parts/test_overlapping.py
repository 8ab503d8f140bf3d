"""Found parts reach into each other where they end in one plane, and are the same solid together."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cagesdf.geometry.meshes import Mesh, is_closed, signed_volume
from cagesdf.geometry.solid import as_manifold, from_manifold, union
from cagesdf.importing import import_shape
from cagesdf.parts import overlapping as parts_overlapping
from cagesdf.parts.cutting import cut
from cagesdf.parts.overlapping import REACH, overlapping
from cagesdf.shape import RawPart, RawShape
from cagesdf.structure.hierarchy import PartHierarchy
from tests.support import toy

WELD = 1e-5
SEAT, LEG = toy.box([0, 0.05, 0], [1, 0.1, 1]), toy.box([0.3, -0.3, 0.3], [0.1, 0.6, 0.1])


def shrunk(meshes: list[Mesh], length: float) -> list[Mesh]:
    """Boxes that end `length` too early on all sides, as learnt surfaces may."""
    result = []
    for mesh in meshes:
        middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        factors = 1 - 2 * length / np.ptp(mesh.vertices, axis=0)
        result.append(mesh.with_vertices(middle + factors * (mesh.vertices - middle)))
    return result


def solids_of(meshes: list[Mesh]) -> int:
    return len(as_manifold(union(meshes)).decompose())


def test_a_leg_goes_on_into_the_seat_and_the_seat_stays() -> None:
    seat, leg = overlapping([SEAT, LEG], WELD)
    assert seat is SEAT
    assert signed_volume(leg) == pytest.approx(signed_volume(LEG) + 0.01 * REACH, rel=1e-9)
    assert np.ptp(leg.vertices, axis=0) == pytest.approx([0.1, 0.6 + REACH, 0.1])
    assert signed_volume(union([seat, leg])) == pytest.approx(signed_volume(union([SEAT, LEG])), rel=1e-9)


def test_surfaces_that_end_too_early_still_hang_together() -> None:
    whole = as_manifold(union([SEAT, LEG, toy.box([0, 0.3, -0.45], [1, 0.5, 0.1])]))
    pieces = [from_manifold(piece) for piece, _ in cut(whole, (0.0, 1.0, 0.0, 0.1002))]
    pieces = [from_manifold(p) for piece in pieces for p, _ in cut(as_manifold(piece), (0.0, 1.0, 0.0, -0.0002))]
    assert len(pieces) == 3
    assert solids_of(shrunk(pieces, 0.2 * REACH)) == 3
    reaching = overlapping(pieces, WELD)
    assert all(is_closed(mesh) for mesh in reaching)
    assert solids_of(shrunk(reaching, 0.2 * REACH)) == 1
    assert signed_volume(union(reaching)) == pytest.approx(whole.volume(), rel=1e-6)


def test_a_part_ends_within_a_thin_neighbour() -> None:
    board = toy.box([0, 0.004, 0], [1, 0.008, 1])
    _, leg = overlapping([board, LEG], WELD)
    assert 0.001 < leg.vertices[:, 1].max() <= 0.004


@pytest.mark.parametrize("axis", range(3))
def test_a_board_that_comes_twice_is_not_continued_by_its_copy(axis: int) -> None:
    """Moved along itself a board meets nearly all of a copy, which it holds already."""
    board = toy.box([0, 0, 0], [1, 0.05, 0.7])
    copy = board.with_vertices(Rotation.from_rotvec([1e-4, 2e-4, 1e-4]).apply(board.vertices))
    one, other = map(parts_overlapping._Body.of, (board, copy))
    assert parts_overlapping._piece(one, other, np.eye(3)[axis]).is_empty()


def test_surfaces_that_cross_each_other_everywhere_are_not_united(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts_overlapping, "CROWDED", 1e-3)
    assert all(mesh is before for mesh, before in zip(overlapping([SEAT, LEG], WELD), [SEAT, LEG], strict=True))


def test_parts_that_reach_into_each_other_or_lie_apart_stay_as_they_are() -> None:
    deep, far = toy.box([0.3, -0.28, 0.3], [0.1, 0.6, 0.1]), toy.box([0, 2, 0], [1, 1, 1])
    meshes = [SEAT, deep, far]
    assert all(after is before for after, before in zip(overlapping(meshes, WELD), meshes, strict=True))


def test_a_turned_shape_has_the_same_overlaps() -> None:
    turn = Rotation.from_rotvec([0.4, -0.7, 0.2]).as_matrix()
    turned = [mesh.with_vertices(mesh.vertices @ turn.T) for mesh in (SEAT, LEG)]
    volumes = [signed_volume(mesh) for mesh in overlapping([SEAT, LEG], WELD)]
    assert [signed_volume(mesh) for mesh in overlapping(turned, WELD)] == pytest.approx(volumes, rel=1e-6)


def test_no_crumb_is_left_where_faces_coincide() -> None:
    """Real faults: `chair_C` of KayKit had a crumb without a volume, and became a shell as it was repaired."""
    rounded = from_manifold(
        as_manifold(toy.ball([0, 0, 0], 0.5, 24)) + as_manifold(toy.ball([0.7, 0.2, 0.1], 0.45, 20))
    )
    for angle in np.linspace(0.1, 1.4, 6):
        normal = np.array([np.cos(angle), np.sin(angle), 0.3])
        x, y, z = (normal / np.linalg.norm(normal)).tolist()
        pieces = [from_manifold(piece) for piece, _ in cut(as_manifold(rounded), (x, y, z, 0.3))]
        for mesh in overlapping(pieces, WELD):
            assert all(piece.volume() > 1e-4 for piece in as_manifold(mesh).decompose())


def test_found_parts_of_an_imported_shape_overlap_where_they_were_cut() -> None:
    whole = union([SEAT, LEG, toy.box([0, 0.3, -0.45], [1, 0.5, 0.1])])
    parts = (RawPart("all", "", whole),)
    raw = RawShape("chair", "train", parts, PartHierarchy.flat(("all",), ("",), ""), whole=True)
    shape = import_shape(raw, "y", weld=WELD, max_faces=10**6, max_parts=150, min_thickness=1e-4, parts="found")
    meshes = [part.mesh for part in shape.parts]
    together = signed_volume(union(meshes))
    assert len(meshes) == 3
    assert together == pytest.approx(signed_volume(whole) * shape.similarity.scale**3, rel=1e-4)
    assert sum(map(signed_volume, meshes)) > together + 0.5 * REACH * 0.1 * shape.similarity.scale**2
