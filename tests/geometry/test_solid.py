"""The repair chain gives back volume, sign and place of solids that were broken on purpose."""

import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.errors import NotSolidError
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, is_closed, join, sample_surface, signed_volume, weld
from cagesdf.geometry.solid import (
    METHODS,
    SHEET,
    TIGHT,
    as_manifold,
    cap,
    make_solid,
    outer_surface,
    pieces,
    thickness,
    union,
)
from tests.support import broken, toy

BOX = toy.box([0.1, 0, 0], [1, 0.5, 0.25])
BALL = toy.ball([0, 0, 0], 0.5)
TUBE = toy.from_manifold(
    manifold3d.Manifold.cylinder(1.0, 0.5, 0.5, 32)
    - manifold3d.Manifold.cylinder(3.0, 0.4, 0.4, 32).translate([0, 0, -1])
)


def solid(mesh: Mesh) -> tuple[Mesh, str]:
    found = make_solid(mesh, 1e-5, 1e-4)
    return found.mesh, found.method


def flipped(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces[:, ::-1]))


def soup(mesh: Mesh) -> Mesh:
    return Mesh(mesh.corners().reshape(-1, 3), np.arange(3 * len(mesh.faces), dtype=np.int32).reshape(-1, 3))


def opened(mesh: Mesh, side: int, sign: int) -> Mesh:
    """Without the faces that lie in one extreme plane."""
    value = (mesh.vertices[:, side] * sign).max() * sign
    lies = (np.abs(mesh.corners()[:, :, side] - value) < 1e-9).all(1)
    assert lies.any()
    return Mesh(mesh.vertices, mesh.faces[~lies])


def some_flipped(mesh: Mesh) -> Mesh:
    faces = mesh.faces.copy()
    faces[::3] = faces[::3, ::-1]
    return Mesh(mesh.vertices, faces)


def doubled(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[:, ::-1]]))


def assert_same_solid(result: Mesh, wanted: Mesh, tolerance: float = 1e-9) -> None:
    """Closed for manifold3d, as large, in the same place, and inside where the wanted one is."""
    assert as_manifold(result).status() == manifold3d.Error.NoError
    assert signed_volume(result) == pytest.approx(signed_volume(wanted), rel=1e-6, abs=tolerance)
    np.testing.assert_allclose(result.vertices.min(0), wanted.vertices.min(0), atol=tolerance)
    np.testing.assert_allclose(result.vertices.max(0), wanted.vertices.max(0), atol=tolerance)
    points = np.random.default_rng(0).uniform(-1, 1, (2000, 3))
    np.testing.assert_array_equal(SurfaceDistance(result).inside(points), SurfaceDistance(wanted).inside(points))


@pytest.mark.parametrize("mesh", [BOX, BALL, TUBE], ids=["box", "ball", "tube"])
@pytest.mark.parametrize(
    ("damage", "method"),
    [
        (lambda mesh: mesh, "none"),
        (flipped, "flipped"),
        (soup, "merged"),
        (lambda mesh: soup(flipped(mesh)), "merged"),
        (doubled, "merged"),
        (lambda mesh: doubled(soup(mesh)), "merged"),
        (some_flipped, "oriented"),
        (lambda mesh: doubled(some_flipped(mesh)), "oriented"),
        (lambda mesh: Mesh(mesh.vertices, mesh.faces[1:]), "capped"),
        (lambda mesh: soup(some_flipped(Mesh(mesh.vertices, mesh.faces[1:]))), "capped"),
    ],
    ids=["clean", "flipped", "soup", "flipped soup", "both-sided", "both-sided soup", "some flipped",
         "both-sided, some flipped", "opened", "opened soup, some flipped"],
)  # fmt: skip
def test_damage_that_keeps_the_shape_is_undone(mesh: Mesh, damage, method: str) -> None:
    result, found = solid(damage(mesh))
    assert found == method
    assert_same_solid(result, mesh)


def test_a_closed_outward_mesh_comes_back_as_it_is() -> None:
    result, method = solid(BALL)
    assert method == "none"
    np.testing.assert_array_equal(result.vertices, BALL.vertices)
    np.testing.assert_array_equal(result.faces, BALL.faces)


@pytest.mark.parametrize("side", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_box_without_one_side_is_closed_there(side: int, sign: int) -> None:
    result, method = solid(opened(BOX, side, sign))
    assert method == "capped"
    assert_same_solid(result, BOX)


def test_a_tube_without_one_end_gets_a_ring_and_no_lid() -> None:
    result, method = solid(opened(TUBE, 2, 1))
    assert method == "capped"
    assert_same_solid(result, TUBE)


def test_a_box_that_lacks_two_sides_that_meet_is_the_box() -> None:
    result, _ = solid(opened(opened(BOX, 0, 1), 2, 1))
    assert_same_solid(result, BOX)


def test_faces_that_meet_at_t_junctions_are_closed_without_a_gap() -> None:
    fine = toy.from_manifold(as_manifold(BOX).refine(2))
    left = Mesh(fine.vertices, fine.faces[fine.corners()[:, :, 1].max(1) < 0.25 - 1e-9])
    coarse = Mesh(BOX.vertices, BOX.faces[(BOX.corners()[:, :, 1] > 0.25 - 1e-9).all(1)])
    rest = Mesh(fine.vertices, fine.faces[fine.corners()[:, :, 1].max(1) >= 0.25 - 1e-9])
    rest = Mesh(rest.vertices, rest.faces[~(rest.corners()[:, :, 1] > 0.25 - 1e-9).all(1)])
    result, method = solid(join([left, rest, coarse]))
    assert method == "capped"
    assert_same_solid(result, BOX)


def test_two_boxes_glued_at_a_face_that_only_one_of_them_has_are_one_solid() -> None:
    halves = [toy.box([-0.25, 0, 0], [0.5, 1, 1]), toy.box([0.25, 0, 0], [0.5, 1, 1])]
    result, method = solid(join([halves[0], opened(halves[1], 0, -1)]))
    assert method == "capped"
    assert_same_solid(result, toy.box([0, 0, 0], [1, 1, 1]))


def test_a_sheet_inside_a_solid_is_dropped() -> None:
    sheet = opened(opened(toy.box([0.1, 0, 0], [0.8, 0.3, 0.1]), 2, 1), 1, 1)
    flat = Mesh(sheet.vertices, sheet.faces[:1])
    result, method = solid(join([BOX, flat]))
    assert method == "capped"
    assert_same_solid(result, BOX)


@pytest.mark.parametrize("turned", [False, True])
def test_overlapping_pieces_are_one_solid_even_if_one_is_inside_out(turned: bool) -> None:
    other = toy.box([0.4, 0.1, 0], [1, 0.5, 0.1])
    result, method = solid(join([BOX, flipped(other) if turned else other]))
    assert method == "united"
    assert_same_solid(result, union([BOX, other]))


def test_pieces_apart_stay_as_they_are_and_a_cavity_stays_one() -> None:
    apart = join([BOX, toy.ball([0, 0.7, 0], 0.2)])
    assert solid(apart)[1] == "none"
    hollow = join([BALL, flipped(toy.ball([0, 0, 0], 0.3))])
    for mesh in (hollow, flipped(hollow)):
        result, _ = solid(mesh)
        assert signed_volume(result) == pytest.approx(signed_volume(hollow))


def test_a_solid_around_another_swallows_it() -> None:
    result, method = solid(join([BALL, toy.ball([0, 0, 0], 0.3)]))
    assert method == "united"
    assert_same_solid(result, BALL)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_whatever_faces_are_lost_or_turned_the_result_is_closed_outward_and_within_the_hull(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = [BOX, BALL, TUBE][int(rng.integers(3))]
    faces = mesh.faces[rng.random(len(mesh.faces)) > rng.uniform(0, 0.1)]
    turn = rng.random(len(faces)) < rng.uniform(0, 0.3)
    faces = np.where(turn[:, None], faces[:, ::-1], faces).astype(np.int32)
    result, method = solid(Mesh(mesh.vertices, faces))
    assert method in METHODS
    assert is_closed(result)
    assert 0 < signed_volume(result) <= as_manifold(mesh).hull().volume() * (1 + 1e-6) + 4 * TIGHT
    points = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    truth = SurfaceDistance(mesh)
    agree = SurfaceDistance(result).inside(points) == truth.inside(points)
    assert (agree | (truth.unsigned(points) < 0.12)).mean() > 0.95


@pytest.mark.parametrize(
    "sheet",
    [
        Mesh(np.array([[-0.5, 0, -0.5], [0.5, 0, -0.5], [0.5, 0, 0.5], [-0.5, 0, 0.5]]),
             np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)),
        Mesh(BALL.vertices, BALL.faces[(BALL.corners()[:, :, 1] + 0.2 * BALL.corners()[:, :, 0] ** 2 < -0.15).all(1)]),
    ],
    ids=["flat", "bowl"],
)  # fmt: skip
def test_a_sheet_becomes_a_plate_around_it(sheet: Mesh) -> None:
    result, method = solid(sheet)
    assert method == "wrapped"
    assert as_manifold(result).status() == manifold3d.Error.NoError
    assert thickness(result) == pytest.approx(SHEET, rel=0.2)
    assert SurfaceDistance(sheet).unsigned(result.vertices).max() <= SHEET / 2 * 1.001
    middle = sheet.corners().mean(1)
    assert SurfaceDistance(result).inside(middle).all()
    again, _ = solid(sheet)
    assert np.array_equal(again.vertices, result.vertices)
    assert np.array_equal(again.faces, result.faces)


def test_a_bowl_is_not_filled() -> None:
    bowl = Mesh(
        BALL.vertices, BALL.faces[(BALL.corners()[:, :, 1] + 0.2 * BALL.corners()[:, :, 0] ** 2 < -0.15).all(1)]
    )
    assert not SurfaceDistance(solid(bowl)[0]).inside(np.array([[0.0, -0.25, 0.0]]))[0]


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        (Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), "no faces"),
        (BOX.with_vertices(np.where(BOX.vertices > 0.2, np.nan, BOX.vertices)), "NaN"),
        (BOX.with_vertices(BOX.vertices * 0), "no area"),
        (BOX.with_vertices(BOX.vertices * [1, 1, 1e-5]), "thick on average"),
    ],
)
def test_what_can_not_be_solid_is_refused_with_the_reason(mesh: Mesh, reason: str) -> None:
    with pytest.raises(NotSolidError, match=reason):
        make_solid(mesh, 1e-9, 2 * SHEET)


def test_pieces_fall_apart_where_more_than_two_faces_meet() -> None:
    touching = join([toy.box([-0.5, -0.5, 0], [1, 1, 1]), toy.box([0.5, 0.5, 0], [1, 1, 1])])
    parts = pieces(weld(touching, 1e-6))
    assert [len(part.faces) for part in parts] == [12, 12]
    assert all(is_closed(cap(part)) for part in parts)


def test_the_union_refuses_an_open_mesh_by_its_place() -> None:
    with pytest.raises(ValueError, match="mesh 1 of 2"):
        union([BOX, Mesh(BOX.vertices, BOX.faces[1:])])


@pytest.mark.parametrize("limit", ["MAX_PIECES", "MAX_OPEN_EDGES"])
def test_what_is_too_much_to_close_piece_by_piece_is_wrapped(limit: str, monkeypatch: pytest.MonkeyPatch) -> None:
    tube = opened(TUBE, 2, 1)
    assert solid(tube)[1] == "capped"
    monkeypatch.setattr(f"cagesdf.geometry.solid.{limit}", 0)
    assert solid(tube)[1] == "wrapped"


def test_more_sheets_than_can_be_wrapped_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cagesdf.geometry.solid.MAX_FACES", 1)
    corners = np.array([[0.0, 0, 0], [0.3, 0, 0], [0.3, 0.3, 0.04], [0, 0.3, 0]])
    bent = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    with pytest.raises(NotSolidError, match="2 of its faces have no thickness, at most 1"):
        solid(bent)


def boards(seed: int) -> Mesh:
    """Two flat sheets of different triangulations that cross, or of which one ends on the other, in any pose."""
    rng = np.random.default_rng(seed)
    floor = grid_sheet(*rng.integers(1, 6, 2))
    angle = rng.uniform(0.6, np.pi - 0.6)
    turned = np.array([[np.cos(angle), np.sin(angle), 0], [0, 0, 1], [np.sin(angle), -np.cos(angle), 0]])
    low = rng.choice([0.0, -0.3])
    wall = grid_sheet(*rng.integers(1, 6, 2))
    wall = wall.with_vertices(
        (wall.vertices * [0.6, 0.9, 1] + [0.3 + low, 0, 0]) @ turned + [rng.uniform(-0.2, 0.2), 0, 0]
    )
    pose = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    both = join([floor, wall])
    return both.with_vertices(both.vertices @ pose)


def grid_sheet(across: int, along: int) -> Mesh:
    """A rectangle in xy about the origin, 1 by 1, of 2 × across × along triangles."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, across + 1), np.linspace(-0.5, 0.5, along + 1), indexing="ij")
    ids = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    return Mesh(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), faces)


def test_slivers_beside_a_flat_sheet_are_part_of_it() -> None:
    corners = np.array([[-0.5, 0, -0.5], [0.5, 0, -0.5], [0.5, 0, 0.5], [-0.5, 0, 0.5], [0.5, 0, 0], [0.5, 0, 0.25]])
    sheet = Mesh(corners, np.array([[0, 2, 1], [0, 3, 2], [1, 4, 2], [4, 5, 2]], dtype=np.int32))
    result, method = solid(sheet)
    assert method == "wrapped"
    assert signed_volume(result) == pytest.approx(SHEET, rel=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_flat_sheets_that_meet_keep_their_corners(seed: int) -> None:
    mesh = boards(seed)
    result = make_solid(mesh, 1e-5, 1e-4)
    assert (result.method, result.lost) == ("wrapped", 0)
    points, _ = sample_surface(mesh, 2000, np.random.default_rng(0))
    beside = SurfaceDistance(result.mesh).unsigned(points) > SHEET
    assert beside.mean() < 0.036, "only the line in which they cross lies deeper"
    assert SurfaceDistance(mesh).unsigned(result.mesh.vertices).max() < 2 * SHEET


def test_thousands_of_solids_in_one_part_stay_as_they_are() -> None:
    """In a time that grows with their number, not its square."""
    grid = np.stack(np.meshgrid(*[np.linspace(-0.9, 0.9, 12)] * 3), axis=-1).reshape(-1, 3)
    beads = join([toy.box(place, [0.05, 0.05, 0.05]) for place in grid])
    result, method = solid(beads)
    assert method == "none"
    assert result is beads


def test_pieces_and_sheets_that_are_left_out_or_thickened_are_counted() -> None:
    sheet = Mesh(np.array([[0.0, 0, 0], [0.3, 0, 0], [0, 0.2, 0]]), np.array([[0, 1, 2]], dtype=np.int32))
    buried = make_solid(join([BOX, sheet]), 1e-5, 1e-4)
    assert (buried.method, buried.dropped, buried.plates) == ("capped", 1, 0)
    outside = make_solid(join([BOX, sheet, sheet.with_vertices(sheet.vertices + np.array([0, 0, 0.5]))]), 1e-5, 1e-4)
    assert (outside.method, outside.dropped, outside.plates) == ("wrapped", 1, 1)


def test_a_surface_that_runs_into_itself_becomes_its_outside() -> None:
    coil = make_solid(broken.loop(0, 7), 1e-5, 1e-4)
    assert coil.method == "untangled"
    assert_same_solid(coil.mesh, union([broken.loop(0, 4), broken.loop(3.5, 7)]), 1e-6)
    assert make_solid(broken.loop(0, 5), 1e-5, 1e-4).method == "none"


def test_the_outer_surface_has_no_face_inside_where_components_overlap_touch_or_hold_each_other() -> None:
    other = toy.box([0.4, 0.1, 0], [1, 0.5, 0.1])
    touching = toy.box([0, 0, 0], [1, 0.5, 0.25]), toy.box([1, 0, 0], [1, 0.5, 0.25])
    for components in ([BOX, other], touching, [BALL, toy.ball([0, 0, 0], 0.3)]):
        mesh = join([*components])
        assert_same_solid(outer_surface(mesh), union([*components]))
        assert_same_solid(union([mesh]), union([*components]))
    assert len(outer_surface(join([*touching])).faces) < 24


def test_the_outer_surface_of_one_component_or_of_some_apart_is_the_mesh_itself() -> None:
    for mesh in (BOX, TUBE, join([BOX, toy.ball([0, 0.7, 0], 0.2)])):
        assert outer_surface(mesh) is mesh


def test_a_cavity_stays_one_when_its_solid_overlaps_another_and_what_is_in_it_stays() -> None:
    hollow = join([BALL, flipped(toy.ball([0, 0, 0], 0.3))])
    inside, through = toy.ball([0, 0, 0], 0.1), toy.box([0, 0, 0], [2, 0.05, 0.05])
    assert outer_surface(hollow) is hollow
    for other in (inside, through):
        wanted = as_manifold(hollow) + as_manifold(other)
        assert signed_volume(outer_surface(join([hollow, other]))) == pytest.approx(wanted.volume())


@given(st.integers(0, 2**32 - 1))
def test_uniting_components_commutes_with_affine_maps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = join([toy.box(rng.uniform(-0.4, 0.4, 3), rng.uniform(0.1, 0.8, 3)) for _ in range(3)])
    matrix = rng.normal(size=(3, 3))
    matrix *= np.sign(np.linalg.det(matrix))
    before = outer_surface(mesh)
    assert_same_solid(
        outer_surface(mesh.with_vertices(mesh.vertices @ matrix)), before.with_vertices(before.vertices @ matrix)
    )


def test_a_mesh_that_is_no_solid_has_no_outer_surface() -> None:
    with pytest.raises(ValueError, match="mesh 0 of 1 is no closed solid"):
        outer_surface(Mesh(BOX.vertices, BOX.faces[1:]))
