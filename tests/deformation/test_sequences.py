"""Cages in motion, and surfaces that follow them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.cage_fitting.cages import fit_cage
from cagesdf.cuboid import CORNER_ORDER, Cage, Sequence
from cagesdf.deformation.matching import Match, correspond
from cagesdf.deformation.sequences import (
    KeptDetails,
    ProgramPath,
    Trilinear,
    aligned_cage,
    cuboid_path,
    deform_shape,
    deform_vertices,
    detail_lengths,
    follow_own_cuboids,
    interpolated_cage,
    keep_details,
    make_sequence,
    scaled_cage,
    share_outside,
    solids_in_cuboids,
)
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import is_closed
from cagesdf.shape import Shape
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.parsing import parse
from tests.support import toy

SEEDS = st.integers(0, 2**32 - 1)


def random_cage(rng: np.random.Generator, parts: int = 3) -> Cage:
    return Cage(
        tuple(f"p{i}" for i in range(parts)),
        rng.uniform(-0.3, 0.3, (parts, 3)),
        Rotation.random(parts, rng=rng).as_matrix(),
        rng.uniform(0.2, 1, (parts, 3)),
    )


def slowly_deformed(vertices: np.ndarray, own: int, rest: Cage, moved: Cage) -> np.ndarray:
    """Vertex by vertex, corner by corner: the definition (§3.3)."""
    result = []
    for vertex in vertices:
        places = []
        for i in range(len(rest)):
            if i == own or rest.signed_distance(vertex[None])[0, i] <= 1e-6:
                unit = rest.to_unit(vertex[None], i)[0]
                weights = np.prod(0.5 + 2 * CORNER_ORDER * unit, axis=1)
                places.append(weights @ moved.corners()[i])
        result.append(np.mean(places, axis=0))
    return np.array(result)


@given(SEEDS)
def test_trilinear_interpolation_of_corners_is_what_moves_vertices(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest, moved = random_cage(rng), random_cage(rng)
    vertices = rng.uniform(-0.8, 0.8, (30, 3))
    np.testing.assert_allclose(
        deform_vertices(vertices, 1, rest, moved), slowly_deformed(vertices, 1, rest, moved), atol=1e-12
    )


@given(SEEDS)
def test_corners_of_a_lone_cuboid_go_to_its_corners(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest, moved = random_cage(rng, 1), random_cage(rng, 1)
    np.testing.assert_allclose(deform_vertices(rest.corners()[0], 0, rest, moved), moved.corners()[0], atol=1e-12)


@given(SEEDS)
def test_the_rest_cage_is_the_identity_and_the_way_back_undoes_the_way_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest = random_cage(rng)
    vertices = rng.uniform(-1, 1, (30, 3))
    np.testing.assert_allclose(deform_vertices(vertices, 0, rest, rest), vertices, atol=1e-12)
    lone, away = random_cage(rng, 1), random_cage(rng, 1)
    there = deform_vertices(vertices, 0, lone, away)
    np.testing.assert_allclose(deform_vertices(there, 0, away, lone), vertices, atol=1e-9)


@given(SEEDS)
def test_a_cage_moved_by_one_similarity_moves_every_vertex_by_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest = random_cage(rng, 4)
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    moved = Cage(rest.part_ids, 1.3 * rest.centre @ turn + shift, rest.axes @ turn, 1.3 * rest.size)
    vertices = rng.uniform(-1, 1, (30, 3))
    np.testing.assert_allclose(deform_vertices(vertices, 2, rest, moved), 1.3 * vertices @ turn + shift, atol=1e-12)


@given(SEEDS)
def test_an_axis_aligned_cage_that_is_scaled_scales_every_vertex(seed: int) -> None:
    rng = np.random.default_rng(seed)
    posed = random_cage(rng, 4)
    rest = Cage(posed.part_ids, posed.centre, np.tile(np.eye(3), (4, 1, 1)), posed.size)
    factors = rng.uniform(0.5, 2, 3)
    moved = scaled_cage(rest, factors)
    np.testing.assert_allclose(moved.corners(), rest.corners() * factors, atol=1e-12)
    vertices = rng.uniform(-1, 1, (30, 3))
    np.testing.assert_allclose(deform_vertices(vertices, 0, rest, moved), vertices * factors, atol=1e-12)


def test_a_shared_vertex_goes_to_the_mean_and_touching_within_a_millionth_counts() -> None:
    rest = Cage(("a", "b"), np.array([[0, 0, 0], [1, 0, 0.0]]), np.tile(np.eye(3), (2, 1, 1)), np.ones((2, 3)))
    moved = Cage(("a", "b"), rest.centre + np.array([[0, 0, 0], [0, 1, 0]]), rest.axes, rest.size)
    x = np.array([0.4, 0.5 - 2e-6, 0.5 - 5e-7, 0.5])
    vertices = np.stack([x, 0 * x, 0 * x], axis=1)
    moves = deform_vertices(vertices, 0, rest, moved) - vertices
    np.testing.assert_allclose(moves[:, 1], [0, 0, 0.5, 0.5], atol=1e-12)


@given(SEEDS)
def test_scaling_a_cage_gives_rotations_and_the_lengths_of_the_scaled_edges(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cage, factors = random_cage(rng), rng.uniform(0.5, 2, 3)
    moved = scaled_cage(cage, factors)
    np.testing.assert_allclose(np.linalg.det(moved.axes), 1)
    np.testing.assert_allclose(moved.axes @ moved.axes.swapaxes(1, 2), np.tile(np.eye(3), (3, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(moved.size, np.linalg.norm(cage.size[..., None] * cage.axes * factors, axis=2))
    np.testing.assert_allclose(scaled_cage(cage, np.full(3, 1.7)).corners(), 1.7 * cage.corners(), atol=1e-9)


def test_a_leaning_leg_follows_the_scaling_with_its_long_axis() -> None:
    lean = Rotation.from_euler("z", 0.3).as_matrix()
    cage = Cage(("leg",), np.zeros((1, 3)), lean[None], np.array([[0.02, 1.0, 0.02]]))
    factors = np.array([2.0, 1.0, 1.0])
    wanted = lean[1] * factors / np.linalg.norm(lean[1] * factors)
    assert scaled_cage(cage, factors).axes[0, 1] @ wanted > 0.999  # left as it was: 0.968


@given(SEEDS, st.floats(0, 1))
def test_interpolation_meets_its_ends_and_turns_evenly_the_short_way(seed: int, t: float) -> None:
    rng = np.random.default_rng(seed)
    source = random_cage(rng)
    target = aligned_cage(source, random_cage(rng), tuple((part, part) for part in source.part_ids))
    for at, end in ((0.0, source), (1.0, target)):
        np.testing.assert_allclose(interpolated_cage(source, target, at).vectors(), end.vectors(), atol=1e-9)
    middle = interpolated_cage(source, target, t)
    np.testing.assert_allclose(middle.size, (1 - t) * source.size + t * target.size)
    whole = Rotation.from_matrix(source.axes.swapaxes(1, 2) @ target.axes).magnitude()
    partly = Rotation.from_matrix(source.axes.swapaxes(1, 2) @ middle.axes).magnitude()
    np.testing.assert_allclose(partly, t * whole, atol=1e-6)
    assert (whole < np.radians(63)).all()


def test_partners_are_aligned_under_the_sources_names() -> None:
    rng = np.random.default_rng(0)
    source, target = random_cage(rng), random_cage(rng)
    aligned = aligned_cage(source, target, (("p0", "p2"), ("p1", "p0"), ("p2", "p1")))
    assert aligned.part_ids == source.part_ids
    np.testing.assert_array_equal(aligned.centre, target.centre[[2, 0, 1]])
    np.testing.assert_allclose(np.sort(aligned.size), np.sort(target.size[[2, 0, 1]]))


def stool_match() -> tuple[Match, dict[str, Cage]]:
    shapes = [toy.stool("a"), toy.stool("b", width=1.4, height=0.7, lean=0.3)]
    cages = {shape.shape_id: fit_cage(shape, 0.01, 1e-3, 1e-6, 10, np.random.default_rng(0)).cage for shape in shapes}
    pairs = tuple((part, part) for part in cages["a"].part_ids)
    return Match("a", "b", (1.0, 1.0, 1.0), pairs, 0.0, 1, ""), cages


def test_a_sequence_starts_at_rest_exactly_ends_at_the_target_and_holds_out_the_middle() -> None:
    match, cages = stool_match()
    sequence = make_sequence(match, cages, cuboid_path(match, cages), 6, (2, 3))
    np.testing.assert_array_equal(sequence.cages[0].vectors(), cages["a"].vectors())
    np.testing.assert_allclose(sequence.cages[5].centre, cages["b"].centre)
    np.testing.assert_allclose(sequence.t, [0, 0.2, 0.4, 0.6, 0.8, 1])
    assert sequence.held_out == (False, False, True, True, False, False)


def test_a_scaled_sequence_ends_at_the_scaled_cage() -> None:
    match, cages = stool_match()
    scaled = Match("a", None, (1.2, 0.8, 1.0), match.pairs, 0.0, 0, "")
    sequence = make_sequence(scaled, cages, cuboid_path(scaled, cages), 6, (2, 3))
    wanted = scaled_cage(cages["a"], np.array([1.2, 0.8, 1.0]))
    np.testing.assert_allclose(sequence.cages[5].vectors(), wanted.vectors(), atol=1e-9)


@pytest.mark.parametrize("held_out", [(0,), (6,), (2, 9)])
def test_the_rest_shape_and_steps_that_are_none_cannot_be_held_out(held_out: tuple[int, ...]) -> None:
    match, cages = stool_match()
    with pytest.raises(InputError, match="wanted steps among 1 to 5"):
        make_sequence(match, cages, cuboid_path(match, cages), 6, held_out)


def test_deformed_parts_stay_closed_and_only_shared_vertices_leave_their_cuboid() -> None:
    match, cages = stool_match()
    shape, sequence = toy.stool("a"), make_sequence(match, cages, cuboid_path(match, cages), 6, (2, 3))
    rest, moved = sequence.cages[0], sequence.cages[-1]
    meshes = deform_shape(shape, rest, moved)
    assert all(is_closed(mesh) for mesh in meshes)
    shares = share_outside(meshes, moved)
    for i, (part, mesh) in enumerate(zip(shape.parts, meshes)):
        out = moved.signed_distance(mesh.vertices)[:, i] > 1e-6
        shared = (rest.signed_distance(part.mesh.vertices) <= 1e-6).sum(axis=1) > 1
        assert not (out & ~shared).any()
        assert shares[i] == out.mean()
    assert shares.max() > 0
    np.testing.assert_array_equal(share_outside(deform_shape(shape, rest, rest), rest), 0)


def stool_transfers() -> tuple[Shape, Sequence, Trilinear, KeptDetails]:
    match, cages = stool_match()
    shape, sequence = toy.stool("a"), make_sequence(match, cages, cuboid_path(match, cages), 6, (2, 3))
    details = np.linspace(1, 1.2, 6)
    return shape, sequence, Trilinear.of(shape, sequence, details), KeptDetails.of(shape, sequence, details)


def test_trilinear_parts_follow_all_cuboids_or_their_own_and_are_the_same_in_their_unit_frames() -> None:
    shape, sequence, trilinear, _ = stool_transfers()
    rest, moved, solids = sequence.cages[0], sequence.cages[4], solids_in_cuboids(shape, sequence.cages[0])
    for ours, theirs in (
        (trilinear.parts(shape, sequence, 4), deform_shape(shape, rest, moved)),
        (trilinear.own_parts(shape, sequence, 4), follow_own_cuboids(shape, rest, moved)),
        (trilinear.in_cuboids(solids, 4), solids),
    ):
        assert [mesh.vertices.tobytes() for mesh in ours] == [mesh.vertices.tobytes() for mesh in theirs]


def test_kept_details_are_those_of_each_step_in_whichever_frame() -> None:
    shape, sequence, _, kept = stool_transfers()
    rest, moved = sequence.cages[0], sequence.cages[4]
    wanted = keep_details(shape, rest, moved, 1.16)
    solids = [part.mesh.with_vertices(rest.to_unit(part.mesh.vertices, i)) for i, part in enumerate(shape.parts)]
    in_cuboids = kept.in_cuboids(solids, 4)
    for i, mesh in enumerate(wanted):
        assert is_closed(mesh)
        np.testing.assert_allclose(kept.parts(shape, sequence, 4)[i].vertices, mesh.vertices, atol=1e-12)
        np.testing.assert_allclose(moved.from_unit(in_cuboids[i].vertices, i), mesh.vertices, atol=1e-12)
    np.testing.assert_array_equal(share_outside(wanted, moved), 0)


def test_a_box_among_kept_details_is_moved_as_by_its_cuboid_alone() -> None:
    shape, sequence, _, kept = stool_transfers()
    seat = sequence.cages[0].part_ids.index("seat")
    ours, theirs = kept.parts(shape, sequence, 5)[seat], Trilinear().own_parts(shape, sequence, 5)[seat]
    np.testing.assert_allclose(ours.vertices, theirs.vertices, atol=1e-9)


def test_a_detail_is_measured_in_the_unit_of_the_files() -> None:
    _, sequence, _, _ = stool_transfers()
    small, large = (Similarity(scale, np.eye(3), np.zeros(3)) for scale in (0.5, 2.0))
    np.testing.assert_allclose(detail_lengths(sequence, small, large), 1 + 3 * sequence.t)
    np.testing.assert_array_equal(detail_lengths(sequence, large, large), 1)


TABLE = """
Assembly Program_0 {
    bbox = Cuboid(1.0, 0.8, 0.6, True)
    cube0 = Cuboid(1.0, 0.1, 0.6, True)
    Program_1 = Cuboid(0.8, 0.7, 0.5, True)
    attach(cube0, bbox, 0.5, 1.0, 0.5, 0.5, 1.0, 0.5)
    squeeze(Program_1, cube0, bbox, top, 0.5, 0.5)
}
Assembly Program_1 {
    bbox = Cuboid(0.8, 0.7, 0.5, True)
    cube0 = Cuboid(0.1, 0.7, 0.1, True)
    cube1 = Cuboid(0.1, 0.7, 0.1, True)
    squeeze(cube0, bbox, bbox, top, 0.1, 0.1)
    squeeze(cube1, bbox, bbox, top, 0.1, 0.9)
    reflect(cube0, X)
    reflect(cube1, X)
}
"""
# The same structure: cuboids and statements in another order, other numbers.
OTHER_TABLE = """
Assembly Table {
    bbox = Cuboid(1.4, 0.6, 0.9, True)
    Legs = Cuboid(1.2, 0.5, 0.8, True)
    cube1 = Cuboid(1.4, 0.06, 0.9, True)
    attach(cube1, bbox, 0.5, 1.0, 0.5, 0.5, 1.0, 0.5)
    squeeze(Legs, cube1, bbox, top, 0.5, 0.5)
}
Assembly Legs {
    bbox = Cuboid(1.2, 0.5, 0.8, True)
    cube0 = Cuboid(0.2, 0.5, 0.2, True)
    cube1 = Cuboid(0.1, 0.5, 0.1, True)
    squeeze(cube1, bbox, bbox, top, 0.05, 0.05)
    squeeze(cube0, bbox, bbox, top, 0.2, 0.9)
    reflect(cube1, X)
    reflect(cube0, X)
}
"""


def assemblies() -> tuple[Assembly, Assembly, tuple[tuple[str, str], ...]]:
    """Two tables, and which parts correspond."""
    source = Assembly(parse(TABLE), Similarity(1.0, np.eye(3), np.zeros(3)))
    target = Assembly(parse(OTHER_TABLE), Similarity(0.8, np.eye(3), np.array([0.1, 0.0, -0.2])))
    return source, target, correspond(source, source.cage(), target, target.cage())


def test_a_path_of_programs_ends_at_the_targets_cuboids() -> None:
    source, target, pairs = assemblies()
    path = ProgramPath(source, target, pairs)
    np.testing.assert_allclose(path(0.0).vectors(), source.cage().vectors(), atol=1e-12)
    partners = dict(pairs)
    wanted = np.array([target.cage().vectors()[target.parts().index(partners[part])] for part in source.parts()])
    np.testing.assert_allclose(path(1.0).vectors(), wanted, atol=1e-12)
    assert partners["cube0"] == "cube1"
    assert partners["Program_1/cube0"] == "Legs/cube1"


def test_what_is_attached_stays_attached_on_a_path_of_programs() -> None:
    source, target, pairs = assemblies()
    path = ProgramPath(source, target, pairs)
    for t in (0.2, 0.5, 0.9):
        cage = path(t)
        top = cage["cube0"].centre[1] - cage["cube0"].size[1] / 2
        assert all(
            leg.centre[1] + leg.size[1] / 2 == pytest.approx(top, abs=0.05)
            for leg in map(cage.__getitem__, source.parts()[1:])
        )
        x = cage.centre[1:, 0]
        np.testing.assert_allclose(np.sort(x), np.sort(2 * cage["cube0"].centre[0] - x), atol=1e-12)


def test_a_program_that_executes_badly_on_the_way_rejects_its_source() -> None:
    source, target, pairs = assemblies()
    thin = target.program.with_parameters(
        np.where(target.program.parameters() == 0.06, 1e-4, target.program.parameters())
    )
    path = ProgramPath(source, target.with_program(thin), pairs)
    match = Match("a", "b", (1.0, 1.0, 1.0), pairs, 0.0, 1, "")
    with pytest.raises(ShapeRejected, match=r"towards b: .* cuboid cube0 is"):
        make_sequence(match, {"a": source.cage()}, path, 6, (2, 3))


def test_programs_that_say_different_things_have_no_common_parameters() -> None:
    source, target, pairs = assemblies()
    turned = target.with_program(parse(OTHER_TABLE.replace("reflect(cube1, X)", "reflect(cube1, Z)")))
    with pytest.raises(ValueError, match="says nothing like reflect"):
        source.parameters_of(turned, pairs)
