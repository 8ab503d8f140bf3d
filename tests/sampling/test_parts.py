"""Points of parts: exact distances to the part's own surface, as many as it asks for, around its own cuboid."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage
from cagesdf.deformation.sequences import solids_in_cuboids
from cagesdf.frames import BEYOND
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, face_areas, is_closed
from cagesdf.geometry.solid import as_manifold, from_manifold, make_solid, union
from cagesdf.sampling import parts as part_sampling
from cagesdf.sampling.parts import (
    FEWEST,
    LARGEST,
    LEAST_CHUNKS,
    MOST,
    SMALLEST,
    THINNEST,
    PartSamples,
    sample_part,
    shares,
    thinness,
)
from cagesdf.structure.hierarchy import Node
from tests.support import toy

CHUNK = 16
COUNTS = (40.0, 12.0)  # around the surface, and uniform
BOX = toy.box((0, 0, 0), (1, 1, 1))


def cage(size: tuple[float, float, float] = (0.6, 0.3, 0.1), seed: int = 0) -> Cage:
    """One cuboid, anywhere."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(1, 3, 3)))[0]
    axes[:, 0] *= np.linalg.det(axes)[:, None]
    return Cage(("p",), rng.uniform(-0.3, 0.3, (1, 3)), axes, np.array([size]))


def sampled(
    unit: Mesh, where: Cage, counts: tuple[float, float] = COUNTS, cuboid: int = 0, seed: int = 0, share: float = 1.0
) -> PartSamples:
    return sample_part(unit, where, cuboid, *counts, share, CHUNK, np.random.default_rng(seed))


def flat(samples: PartSamples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return samples.points.reshape(-1, 3).astype(np.float64), samples.sdf.ravel(), samples.near.ravel()


@given(size=st.tuples(*[st.floats(0.005, 1.0)] * 3), seed=st.integers(0, 50))
@settings(max_examples=20, deadline=None)
def test_distances_to_a_box_are_those_to_its_cuboid_and_points_lie_in_and_a_little_around_it(
    size: tuple[float, float, float], seed: int
) -> None:
    where = cage(size, seed)
    points, sdf, _ = flat(sampled(BOX, where, seed=seed))
    np.testing.assert_allclose(sdf, where.signed_distance(points)[:, 0], atol=1e-6)
    rounding = 1e-6 / min(size)  # of a float32, in lengths
    assert np.abs(where.to_unit(points, 0)).max() <= 0.5 + BEYOND + rounding


def test_distances_to_a_ball_are_the_balls_where_the_cuboid_is_a_cube_of_another_size() -> None:
    where = cage((0.4, 0.4, 0.4))
    points, sdf, near = flat(sampled(toy.ball((0, 0, 0), 0.5, 128), where))
    exact = np.linalg.norm(points - where.centre[0], axis=1) - 0.2
    np.testing.assert_allclose(sdf, exact, atol=0.2e-3)  # the mesh lies within a thousandth of the radius
    assert np.abs(sdf[near]).mean() < np.abs(sdf[~near]).mean() / 2


def test_there_are_as_many_points_as_the_surface_has_area_in_the_unit_frame_in_whole_chunks() -> None:
    for unit, least in ((BOX, 6), (toy.box((0, 0, 0), (1, 1, 0.02)), 2), (toy.ball((0, 0, 0), 0.5), 3)):
        area = max(face_areas(unit).sum(), SMALLEST)
        assert area > least - 1e-9
        for size in ((0.6, 0.3, 0.1), (0.1, 0.1, 0.1)):
            samples = sampled(unit, cage(size))
            assert samples.sdf.shape[1] == CHUNK
            assert 0 <= samples.sdf.size - int(52 * area) < CHUNK
            # Those that fell too far out are drawn uniformly.
            assert int(40 * area) / 3 < samples.near.sum() <= int(40 * area)


def test_a_part_has_its_least_chunks_and_a_rough_one_no_more_than_the_largest() -> None:
    assert len(sampled(BOX, cage(), (0.1, 0.1)).sdf) == LEAST_CHUNKS
    slats = union([toy.box((0, 0, z), (1, 1, 0.004)) for z in np.linspace(-0.49, 0.49, 120)])
    wire = BOX.with_vertices(BOX.vertices * [1, 0.01, 0.01])
    assert face_areas(wire).sum() < SMALLEST
    for share in (FEWEST, 1.0, MOST):
        expected = -(-int(150 * max(SMALLEST, share * face_areas(wire).sum())) // CHUNK)
        assert len(sampled(wire, cage(), (100.0, 50.0), share=share).sdf) == expected
    assert face_areas(slats).sum() > LARGEST
    assert len(sampled(slats, cage(), (1.0, 0.5)).sdf) == -(-int(1.5 * LARGEST) // CHUNK)


def test_points_are_multiplied_by_the_parts_share() -> None:
    for share in (0.75, 1.0, 3.0):
        assert 0 <= sampled(BOX, cage(), share=share).sdf.size - int(52 * 6 * share) < CHUNK


def test_shares_are_roots_of_areas_over_their_mean_bounded_the_same_at_any_scale_and_place() -> None:
    sizes = np.array([(0.4, 0.4, 0.4), (0.4, 0.4, 0.4), (0.2, 0.2, 0.2), (0.01, 0.01, 0.01), (2.0, 2.0, 2.0)])
    rng = np.random.default_rng(0)
    where = Cage(tuple("abcde"), rng.uniform(-1, 1, (5, 3)), np.tile(np.eye(3), (5, 1, 1)), sizes)
    areas = 6 * sizes[:, 0] ** 2
    for count in (1, 4, 5):
        few = Cage(where.part_ids[:count], where.centre[:count], where.axes[:count], where.size[:count])
        expected = np.sqrt(areas[:count] / areas[:count].mean()).clip(FEWEST, MOST)
        np.testing.assert_allclose(shares([BOX] * count, few), expected)
        larger = Cage(few.part_ids, 3 * few.centre + 1, few.axes, 3 * few.size)
        np.testing.assert_allclose(shares([BOX] * count, larger), expected)
    assert shares([BOX], cage()) == [1.0]


@given(lengths=st.tuples(*[st.floats(0.03, 1.5)] * 3))
def test_a_part_that_fills_its_cuboid_isn_t_thin(lengths: tuple[float, float, float]) -> None:
    box = toy.box((0, 0, 0), lengths)
    assert thinness(box, np.array(lengths)) == pytest.approx(1.0)


@given(wall=st.floats(0.002, 0.05), width=st.floats(0.3, 1.2))
def test_the_thinner_a_wall_the_more_points_whatever_the_width_of_what_it_encloses(wall: float, width: float) -> None:
    size = np.full(3, width)
    outside, inside = toy.box((0, 0, 0), size), toy.box((0, wall, 0), size - 2 * wall * np.array([1, 0, 1]))
    hollow = from_manifold(as_manifold(outside) - as_manifold(inside))
    expected = min(max(2 / wall / 60, 1.0), THINNEST)  # both sides of it by what a cube of 0.1 has
    assert thinness(hollow, size) == pytest.approx(expected, rel=0.25)


def test_near_points_are_spread_evenly_over_the_surface_in_the_unit_frame() -> None:
    """However flat the cuboid: of a box's points, each face has a sixth."""
    where = cage((0.8, 0.8, 0.05))
    points, _, near = flat(sampled(BOX, where, (500.0, 1.0)))
    unit = where.to_unit(points[near], 0)
    along, count = np.abs(unit).argmax(axis=1), near.sum()
    # Narrow offsets only: in a flat cuboid wide ones leave its faces.
    close = np.abs(np.abs(unit).max(axis=1) - 0.5) < 0.01
    shares = np.bincount(along[close], minlength=3) / close.sum()
    assert close.sum() > count / 3
    assert shares[:2] == pytest.approx([shares[0], shares[0]], abs=0.03)
    assert shares.min() > 0.15


def test_uniform_points_fill_the_enlarged_cuboid_evenly() -> None:
    where = cage()
    points, _, near = flat(sampled(BOX, where, (0.2, 600.0)))
    unit = where.to_unit(points[~near], 0) / (0.5 + BEYOND)
    assert len(unit) > 3000
    np.testing.assert_allclose(unit.mean(axis=0), 0, atol=0.05)
    np.testing.assert_allclose((unit**2).mean(axis=0), 1 / 3, atol=0.02)


def test_the_same_seed_gives_the_same_bytes_and_another_one_others() -> None:
    one, same, other = (sampled(BOX, cage(), seed=seed) for seed in (3, 3, 4))
    for name in ("points", "sdf", "near"):
        assert getattr(one, name).tobytes() == getattr(same, name).tobytes()
    assert one.points.tobytes() != other.points.tobytes()


def test_chunks_are_mixed() -> None:
    """None has near points or uniform ones alone."""
    shares = sampled(BOX, cage(), (100.0, 100.0)).near.mean(axis=1)
    assert 0 < shares.min() < shares.max() < 1


def test_a_surface_stays_the_same_in_the_unit_frame_however_the_cuboid_moves() -> None:
    """A ball stretched with its cuboid: a point is inside of it as it was inside of the ball."""
    ball = toy.ball((0, 0, 0), 0.5, 64)
    for seed in range(3):
        where = cage((0.9, 0.2, 0.4), seed)
        points, sdf, _ = flat(sampled(ball, where, seed=seed))
        radius = np.linalg.norm(where.to_unit(points, 0), axis=1)
        clear = np.abs(radius - 0.5) > 0.005
        np.testing.assert_array_equal(sdf[clear] < 0, radius[clear] < 0.5)


def pieced() -> tuple[toy.Shape, Cage]:
    """A part that was drawn as two pieces that overlap, imported, and a part that reaches into it; their cage."""
    cross = [toy.box((0, 0, 0), (1.0, 0.5, 0.5)), toy.box((0, 0, 0), (0.5, 1.0, 0.9))]
    faces = np.concatenate([cross[0].faces, cross[1].faces + len(cross[0].vertices)])
    meshes = {
        "cross": make_solid(Mesh(np.concatenate([mesh.vertices for mesh in cross]), faces), 1e-5, 1e-4).mesh,
        "peg": toy.box((0.3, 0, 0.3), (0.3, 0.3, 0.7)),
    }
    leaves = tuple(Node(name, name, (), (), None) for name in meshes)
    shape = toy.shape_of("s", meshes, Node("root", "thing", leaves, (), None))
    corners = [(part.mesh.vertices.min(axis=0), part.mesh.vertices.max(axis=0)) for part in shape.parts]
    low, high = (np.array(ends) for ends in zip(*corners))
    names = tuple(part.part_id for part in shape.parts)
    return shape, Cage(names, (low + high) / 2, np.array([np.eye(3)] * 2), high - low)


def test_a_part_of_overlapping_pieces_has_the_distance_of_their_union() -> None:
    shape, rest = pieced()
    solids = solids_in_cuboids(shape, rest)
    assert all(is_closed(solid) for solid in solids)
    np.testing.assert_allclose([np.abs(solid.vertices).max(axis=0) for solid in solids], 0.5, atol=1e-9)
    points, sdf, _ = flat(sampled(solids[0], rest, (40.0, 800.0)))
    scale = shape.similarity.scale
    cross = [toy.box((0, 0, 0), (1.0, 0.5, 0.5)), toy.box((0, 0, 0), (0.5, 1.0, 0.9))]
    whole = union([mesh.with_vertices(shape.similarity.to_canonical(mesh.vertices)) for mesh in cross])
    np.testing.assert_allclose(sdf, SurfaceDistance(whole).signed(points), atol=1e-6)
    # Where pieces overlap the union's surface is farther away than that of either.
    assert sdf.min() < -0.26 * scale


def test_where_cuboids_overlap_both_have_points_with_their_own_distances() -> None:
    shape, rest = pieced()
    solids = solids_in_cuboids(shape, rest)
    distances = []
    for i, solid in enumerate(solids):
        points, sdf, _ = flat(sampled(solid, rest, (2000.0, 600.0), cuboid=i))
        common = (rest.signed_distance(points) < 0).all(axis=1)
        assert common.sum() > 50
        surface = SurfaceDistance(union([shape.parts[i].mesh]))
        np.testing.assert_allclose(sdf[common], surface.signed(points[common]), atol=1e-6)
        distances.append(sdf[common])
    assert all((sdf < 0).any() for sdf in distances)


def test_a_part_that_is_not_closed_is_refused() -> None:
    shape, rest = pieced()
    first = shape.parts[0]
    opened = replace(first, mesh=Mesh(first.mesh.vertices, first.mesh.faces[1:]))
    with pytest.raises(ValueError, match="no closed solid"):
        solids_in_cuboids(replace(shape, parts=(opened, shape.parts[1])), rest)


def test_the_last_digit_of_exponentials_decides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """It differs between processors; bytes must not."""
    first = sampled(BOX, cage())
    exponential = np.exp
    monkeypatch.setattr(part_sampling.np, "exp", lambda x: np.nextafter(exponential(x), np.inf))
    np.testing.assert_array_equal(sampled(BOX, cage()).points, first.points)
