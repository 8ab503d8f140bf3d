"""From a field to closed solids and their union: where they are, what they keep, and what edits leave alone."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import InputError
from cagesdf.extraction import (
    CUBE,
    LOOSE,
    METHODS,
    SYMMETRIES,
    USUAL,
    CageField,
    Fineness,
    LiveSurface,
    Part,
    extract,
    extract_surface,
    field_of,
)
from cagesdf.extraction.lattice import Lattice
from cagesdf.extraction.marching import Marched, drawn, march
from cagesdf.extraction.merging import merged
from cagesdf.extraction.thinness import HELD, Thickness
from cagesdf.extraction.values import dense_values
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, face_areas, face_components, is_closed, signed_volume, topology
from cagesdf.geometry.solid import CUBE_FACES
from cagesdf.models.arms import DECODERS, make_decoder
from cagesdf.models.decoders import CageDecoder, Decoder, TrainsOn
from tests.support.analytic import sphere_sdf
from tests.support.spheres import SIZES

LATENT = torch.zeros(4)


class Analytic(Decoder):
    """A decoder that is a function of the point alone."""

    trains_on: ClassVar[TrainsOn] = "cage"

    def __init__(self, sdf: Callable[[np.ndarray], np.ndarray]) -> None:
        super().__init__()
        self.sdf = sdf

    def features(self, points: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return points

    def condition(self, code: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return cuboid

    def evaluate(self, features: torch.Tensor, condition: torch.Tensor, compute_dtype: torch.dtype) -> torch.Tensor:
        values = self.sdf(features.double().reshape(-1, 3).numpy())
        return torch.from_numpy(np.asarray(values, np.float32)).view(features.shape[:2])


class InCube(Analytic):
    """The same of one that knows no cuboids."""

    trains_on = "cube"


class Local(Analytic):
    """A decoder of parts: a function of the point in its cuboid's local frame, whose values end at its thickness."""

    trains_on = "part"
    trusted = 0.5

    def unit(self, cuboid: torch.Tensor) -> torch.Tensor:
        return cuboid[:, 12:].amin(dim=1)

    def features(self, points: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return (points - cuboid[:, None, :3]) @ cuboid[:, 3:12].view(-1, 3, 3).mT


class Filling(Local):
    """A decoder of boxes: each fills its cuboid."""

    def __init__(self) -> None:
        super().__init__(np.zeros_like)

    def evaluate(self, features: torch.Tensor, condition: torch.Tensor, compute_dtype: torch.dtype) -> torch.Tensor:
        beyond = features.abs() - condition[:, None, 12:] / 2
        return beyond.clamp(min=0).norm(dim=2) + beyond.amax(dim=2).clamp(max=0)


class PerCuboid(Local):
    """A ball in each cuboid, as large as its code says."""

    def __init__(self) -> None:
        super().__init__(np.zeros_like)

    def condition(self, code: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return code[:, :1]

    def evaluate(self, features: torch.Tensor, condition: torch.Tensor, compute_dtype: torch.dtype) -> torch.Tensor:
        return features.norm(dim=-1) - condition


class Linear(Decoder):
    """A decoder that needs code and cuboid."""

    trains_on: ClassVar[TrainsOn] = "cage"

    def features(self, points: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return points.sum(-1, keepdim=True)

    def condition(self, code: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return code[:, :1] + cuboid[:, 12:13]

    def evaluate(self, features: torch.Tensor, condition: torch.Tensor, compute_dtype: torch.dtype) -> torch.Tensor:
        return 0.01 * (features[..., 0] + condition)


def box(centre, size, axes=None) -> Cuboid:
    return Cuboid(np.array(centre, float), np.eye(3) if axes is None else axes, np.array(size, float))


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def touching() -> Cage:
    """A seat on a leg that shares a part of its lower face."""
    return Cage.of(
        {"seat": box([0.013, 0.31, 0], [1.21, 0.23, 0.83]), "leg": box([0.113, -0.305, 0.107], [0.3, 1, 0.2])}
    )


def noise(scale: float) -> Analytic:
    """A decoder without any continuity, with exact zeros among its values."""
    return Analytic(lambda points: scale * np.round(3 * np.sin(1e4 * points @ [1.0, 2.3, 3.1])) / 3)


def waves(seed: int, slope: float = 1.0) -> Analytic:
    """A smooth field without a meaning: a few plane waves, about as steep as `slope`."""
    rng = np.random.default_rng(seed)
    wave, phase = rng.normal(size=(4, 3)) * 6, rng.uniform(0, 6, 4)
    level = rng.uniform(-0.05, 0.05)
    size = slope / np.linalg.norm(wave, axis=1)
    return Analytic(lambda points: np.sin(points @ wave.T + phase) @ size + level)


def random_cage(seed: int, count: int) -> Cage:
    rng = np.random.default_rng(seed)
    return Cage.of(
        {str(i): box(rng.uniform(-0.5, 0.5, 3), rng.uniform(0.05, 1, 3), rotation(seed + i)) for i in range(count)}
    )


def network(seed: int = 1) -> Decoder:
    """The paper's, untrained, with surfaces in most cuboids."""
    torch.manual_seed(seed)
    decoder = CageDecoder(32, 4, 4, (16,), 2).eval()
    with torch.no_grad():
        decoder.backbone.out.weight.mul_(3)
    return decoder


def radii(mesh: Mesh) -> np.ndarray:
    return np.linalg.norm(mesh.vertices, axis=1)


def bytes_of(vertices: np.ndarray) -> set[bytes]:
    return {row.tobytes() for row in vertices + 0.0}


def assert_sound(mesh: Mesh) -> None:
    """Closed, manifold and outward, by other means than `check`'s."""
    edges = np.sort(np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=2).reshape(-1, 2))
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert is_closed(mesh)
    assert signed_volume(mesh) > 0


def assert_same(one: Mesh, other: Mesh) -> None:
    np.testing.assert_array_equal(one.vertices, other.vertices)
    np.testing.assert_array_equal(one.faces, other.faces)


@pytest.mark.parametrize("resolution", [24, 64])
def test_a_sphere_comes_out_with_its_radius_closed_and_outwards(resolution: int) -> None:
    def ball(points: np.ndarray) -> np.ndarray:
        return sphere_sdf(points, 0.61)

    cell = 2 * HALF_EXTENT / resolution
    for field in (
        field_of(InCube(ball), LATENT, touching()),
        field_of(Analytic(ball), LATENT, Cage.of({"all": box([0, 0, 0], [1.7, 1.6, 1.5], rotation(1))})),
    ):
        mesh = extract_surface(field, resolution)
        assert_sound(mesh)
        assert np.abs(radii(mesh) - 0.61).max() < 0.02 * cell
        assert signed_volume(mesh) == pytest.approx(4 / 3 * np.pi * 0.61**3, rel=0.02)


def test_vertices_lie_nearer_to_the_zero_set_than_between_lattice_points() -> None:
    ball, lattice = Analytic(lambda p: sphere_sdf(p, 0.31)), Lattice.of(box([0, 0, 0], [0.7] * 3), 0.1, 7)
    field = field_of(ball, LATENT, Cage.of({"all": lattice.cuboid}))

    marched = marched_of(field, lattice)
    before = np.abs(sphere_sdf(lattice.points(marched.places), 0.31))
    mesh, evaluations = drawn(marched, field_values(field), lattice)
    assert evaluations == len(mesh.vertices)
    assert np.abs(sphere_sdf(mesh.vertices, 0.31)).mean() < before.mean() / 5


@pytest.mark.parametrize("axes", [np.eye(3), rotation(4)])
@pytest.mark.parametrize("decoder", [Filling(), Local(lambda p: np.full(len(p), -1.0))])
def test_a_part_that_fills_its_cuboid_is_that_box_and_nothing_more(axes: np.ndarray, decoder: Decoder) -> None:
    """Eight corners, twelve faces: also where the network is 0 on the faces, but for rounding."""
    cage = Cage.of({"plate": box([0.1, 0.2, 0.3], [0.8, 0.013, 0.5], axes)})
    extraction = extract(field_of(decoder, LATENT, cage), 64)
    assert extraction.mesh.vertices.shape == (8, 3)
    assert extraction.mesh.faces.shape == (12, 3)
    corners = cage.corners()[0]
    gap = np.abs(extraction.mesh.vertices[:, None] - corners).max(axis=2)
    assert gap.min(axis=1).max() == pytest.approx(0, abs=0 if axes is np.eye(3) else 1e-15)
    assert extraction.clipped == (0 if isinstance(decoder, Filling) else 1)


def test_faces_of_marching_cubes_on_a_cuboid_lie_on_it_exactly_and_have_an_area() -> None:
    """Each before faces are made fewer: a bump that goes through a corner of its cuboid."""
    lattice = Lattice.of(box([0.5, 0.25, 0.125], [0.5, 0.5, 0.75]), 0.04, 12)
    bump = Analytic(lambda p: sphere_sdf(p - [0.75, 0.5, 0.5], 0.31))
    field = field_of(bump, LATENT, Cage.of({"all": lattice.cuboid}))
    mesh, _ = drawn(marched_of(field, lattice), field_values(field), lattice)
    assert_sound(mesh)
    assert face_areas(mesh).min() > 0
    on = [mesh.vertices[:, 0] == 0.75, mesh.vertices[:, 1] == 0.5, mesh.vertices[:, 2] == 0.5]
    assert np.logical_and.reduce(on).sum() == 1, "the corner"
    flat = [side[mesh.faces].all(axis=1) for side in on]
    for side, axis in zip(flat, range(3)):
        assert face_areas(Mesh(mesh.vertices, mesh.faces[side])).sum() == pytest.approx(
            np.pi * 0.31**2 / 4, rel=0.04
        ), axis


def marched_of(field: CageField, lattice: Lattice) -> Marched:
    return march(dense_values(field.on_lattice(lattice, 0), field.reach(0), lattice).values, lattice)


def field_values(field: CageField) -> Callable[[np.ndarray], np.ndarray]:
    return lambda points: field.values(points, 0)


def test_a_plate_thinner_than_a_cell_keeps_its_volume() -> None:
    cage = Cage.of({"plate": box([0, 0, 0], [0.9, 0.01, 0.7], rotation(2))})
    half = np.array([0.4, 0.003, 0.3])
    plate = Local(lambda p: (np.abs(p) - half).max(axis=1))
    mesh = extract_surface(field_of(plate, LATENT, cage), 64)
    assert signed_volume(mesh) == pytest.approx(8 * half.prod(), rel=0.05)


def test_a_network_that_says_outside_everywhere_gives_no_face() -> None:
    extraction = extract(field_of(Analytic(lambda p: np.ones(len(p))), LATENT, touching()), 32)
    assert extraction.mesh.vertices.shape == extraction.mesh.faces.shape == (0, 3)
    assert {part: len(mesh.faces) for part, mesh in extraction.parts.items()} == {"seat": 0, "leg": 0}
    assert extraction.clipped == extraction.components == 0


def test_a_cage_without_cuboids_gives_nothing() -> None:
    extraction = extract(CageField(Filling(), torch.zeros(0, 4), Cage.of({})), 32)
    assert (len(extraction.mesh.faces), len(extraction.parts), extraction.evaluations) == (0, 0, 0)


def test_a_diverged_network_is_refused() -> None:
    with pytest.raises(InputError, match="diverged"):
        extract(field_of(Analytic(lambda p: np.full(len(p), np.nan)), LATENT, touching()), 32)


def test_nothing_counts_as_clipped_where_the_network_keeps_within_or_ends_at_the_cage() -> None:
    ball = Analytic(lambda points: sphere_sdf(points, 0.5))
    assert extract(field_of(ball, LATENT, Cage.of({"all": box([0, 0, 0], [1.2] * 3)})), 48).clipped == 0
    assert extract(field_of(Filling(), LATENT, touching()), 64).clipped == 0


def test_half_of_a_sphere_that_sticks_out_of_its_cuboid_counts_as_clipped() -> None:
    ball = Analytic(lambda points: sphere_sdf(points, 0.5))
    cage = Cage.of({"half": box([0.25, 0, 0], [0.5, 1.2, 1.2])})
    extraction = extract(field_of(ball, LATENT, cage), 64)
    # A third of the area is flat; marching cubes has 1.5 times as many vertices on the round part as on a flat one.
    assert extraction.clipped == pytest.approx(1 / 4, rel=0.1)
    assert signed_volume(extraction.mesh) == pytest.approx(2 / 3 * np.pi * 0.5**3, rel=0.01)


def test_a_surface_that_leaves_the_cube_is_closed_there() -> None:
    mesh = extract_surface(field_of(InCube(lambda p: sphere_sdf(p, 1.4)), LATENT, touching()), 32)
    assert_sound(mesh)
    assert np.abs(mesh.vertices).max() == HALF_EXTENT


def test_the_union_of_overlapping_and_of_touching_boxes_has_their_volume() -> None:
    size = np.array([0.8, 0.5, 0.6])
    for shift, shared in (
        ([0.31, 0.11, -0.2], (size - [0.31, 0.11, 0.2]).prod()),
        ([0, 0.5, 0], 0.0),
        ([2, 0, 0], 0.0),
    ):
        cage = Cage.of({"a": box([0, 0, 0], size), "b": box(shift, size)})
        extraction = extract(field_of(Filling(), LATENT, cage), 40)
        assert_sound(extraction.mesh)
        assert signed_volume(extraction.mesh) == pytest.approx(2 * size.prod() - shared, rel=1e-9)
        assert extraction.components == (2 if shift[0] == 2 else 1)
        for part in ("a", "b"):
            assert signed_volume(extraction.parts[part]) == pytest.approx(size.prod(), rel=1e-12)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=10, deadline=None)
def test_a_part_moves_with_its_cuboid(seed: int) -> None:
    """Its surface in the lattice is the same to rounding, wherever the cuboid is and however it is turned."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.2, 0.6, 3)
    bumpy = Local(lambda p: sphere_sdf(p, 0.8 * size.min() / 2) + 0.02 * np.sin(25 * p[:, 0]) * np.cos(19 * p[:, 2]))
    surfaces = []
    for cuboid in (box([0, 0, 0], size), box(rng.normal(size=3), size, rotation(seed))):
        field = field_of(bumpy, LATENT, Cage.of({"all": cuboid}))
        lattice = Lattice.of(cuboid, 0.05, 12)
        surfaces.append(marched_of(field, lattice))
    np.testing.assert_array_equal(surfaces[0].faces, surfaces[1].faces)
    np.testing.assert_allclose(surfaces[0].places, surfaces[1].places, atol=1e-3)


@given(seed=st.integers(0, 10**6), scale=st.sampled_from([1e-9, 1e-3, 0.03, 10.0]), smooth=st.booleans())
@example(seed=75, scale=1e-9, smooth=False)  # a piece of two flat discs
@settings(max_examples=40, deadline=None)
def test_any_field_gives_closed_manifold_outward_surfaces_within_the_cuboids(
    seed: int, scale: float, smooth: bool
) -> None:
    """Of each part, before and after its faces are made fewer, and of all; `extract` checks only the last."""
    cage = random_cage(seed, 3)
    decoder = waves(seed, 100 * scale) if smooth else noise(scale)
    extraction = extract(field_of(decoder, LATENT, cage), 20, fineness=Fineness(6, 0.25, 0.028, 0.05))
    for part_id, mesh in extraction.parts.items():
        if len(mesh.faces):
            assert_sound(mesh)
            assert Cage.of({part_id: cage[part_id]}).signed_distance(mesh.vertices).max() < 1e-8
    if len(extraction.mesh.faces):
        assert_sound(extraction.mesh)
        assert cage.signed_distance(extraction.mesh.vertices).min(axis=1).max() < 1e-8
        if smooth:  # noise gives parts that run into themselves, whose unions may bridge a notch between cuboids
            middles = extraction.mesh.corners().mean(axis=1)
            assert cage.signed_distance(middles).min(axis=1).max() < 1e-8
    field, lattice = field_of(decoder, LATENT, cage), Lattice.of(cage["0"], 0.2, 6)
    marched = marched_of(field, lattice)
    if len(marched.faces):
        fewer = merged(marched, lattice, USUAL.sag)
        for surface in (marched, fewer):
            mesh, _ = drawn(surface, field_values(field), lattice)
            assert_sound(mesh)
            assert face_areas(mesh).min() > 0
        assert topology(mesh) == topology(Mesh(marched.places, marched.faces))


@given(seed=st.integers(0, 10**6))
@settings(max_examples=8, deadline=None)
def test_sparse_values_give_the_surface_of_dense_values(seed: int) -> None:
    """Also for fields much steeper than a distance: the surface is followed."""
    slope = [0.5, 1.0, 6.0][seed % 3]
    field = field_of(waves(seed, slope), LATENT, random_cage(seed, 2))
    sparse, dense = (extract(field, 40, METHODS[name]) for name in ("sparse", "dense"))
    assert_same(sparse.mesh, dense.mesh)
    assert sparse.evaluations <= dense.evaluations


@given(seed=st.integers(0, 10**6))
@settings(max_examples=8, deadline=None)
def test_the_value_of_a_point_does_not_depend_on_the_points_beside_it(seed: int) -> None:
    """Bit for bit, or an edit would not give what starting anew gives."""
    rng = np.random.default_rng(seed)
    field = field_of(network(), LATENT, touching())
    points = rng.uniform(-0.5, 0.5, (2500, 3))
    whole = field.values(points, 1)
    some = rng.permutation(2500)[: rng.integers(1, 2500)]
    np.testing.assert_array_equal(field.values(points[some], 1), whole[some])


@pytest.mark.parametrize("name", sorted(DECODERS))
def test_the_nodes_of_a_lattice_have_the_values_of_their_points(name: str) -> None:
    """For every decoder, in a cuboid of three lengths; and bit for bit whatever nodes are evaluated with them."""
    decoder = make_decoder(name, **SIZES, seed=0).requires_grad_(False)
    cuboid = box([0.1, -0.2, 0.05], [0.4, 0.9, 0.15], rotation(3))
    field = field_of(decoder, torch.linspace(-1, 1, SIZES["latent_dim"]), Cage.of({"a": cuboid}))
    field.reach = lambda cuboid: 100.0  # type: ignore[method-assign]
    lattice = Lattice.of(field.cage[field.cage.part_ids[0]], 0.05, 7)
    places = np.random.default_rng(0).permutation(np.argwhere(np.ones(lattice.shape)))
    values = field.values(lattice.points(places), 0)
    assert np.ptp(values) > 1e-3
    at_nodes = field.on_lattice(lattice, 0)
    whole = at_nodes(places)
    np.testing.assert_allclose(whole, values, atol=2e-5 * np.ptp(values))
    for count in (1, 50, 337):
        np.testing.assert_array_equal(at_nodes(places[:count]), whole[:count])


def test_each_point_is_asked_with_its_own_cuboid_and_code() -> None:
    """Against one call a point."""
    cage, codes = touching(), torch.tensor([[0.3, 0, 0, 0], [-0.1, 0, 0, 0]])
    field = CageField(Linear(), codes, cage)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (700, 3))
    vectors = torch.from_numpy(cage.vectors()).float()
    for i in range(2):
        slow = [
            float(Linear()(torch.from_numpy(point[None, None]).float(), codes[i : i + 1], vectors[i : i + 1]))
            for point in points
        ]
        np.testing.assert_allclose(field.values(points, i), slow, atol=1e-6)
        assert len(field.values(points[:0], i)) == 0


def test_values_end_at_the_decoders_reach() -> None:
    cage = Cage.of({"plate": box([0, 0, 0], [0.9, 0.01, 0.7])})
    far = np.array([[0.0, 0.0, 0.3]])
    assert field_of(Analytic(lambda p: np.full(len(p), 7.0)), LATENT, cage).values(far, 0) == np.float32(0.1)
    assert field_of(Local(lambda p: np.full(len(p), -7.0)), LATENT, cage).values(far, 0) == np.float32(-0.005)


def test_a_decoder_that_knows_no_cuboids_is_asked_in_the_cube() -> None:
    ball = InCube(lambda p: sphere_sdf(p, 0.4))
    assert field_of(ball, LATENT, Cage.of({})).cage is CUBE
    assert_same(
        extract_surface(field_of(ball, LATENT, Cage.of({})), 24),
        extract_surface(field_of(ball, LATENT, touching()), 24),
    )


def two_balls() -> CageField:
    """Two overlapping cuboids; the codes say a larger ball for the second."""
    cage = Cage.of({"a": box([-0.2, 0, 0], [0.8, 0.9, 0.9]), "b": box([0.2, 0.01, 0], [0.8, 0.9, 0.9])})
    return CageField(PerCuboid(), torch.tensor([[0.3], [0.38]]), cage)


def test_each_part_is_what_its_own_cuboid_holds_and_the_whole_is_their_union() -> None:
    field = two_balls()
    extraction = extract(field, 64)
    for part, radius in (("a", 0.3), ("b", 0.38)):
        mesh = extraction.parts[part]
        assert_sound(mesh)
        assert np.abs(np.linalg.norm(mesh.vertices - field.cage[part].centre, axis=1) - radius).max() < 1e-3
    truth = np.min(
        [
            sphere_sdf(extraction.mesh.vertices - c.centre, r)
            for c, r in zip(field.cage.cuboids().values(), (0.3, 0.38))
        ],
        axis=0,
    )
    assert np.abs(truth).max() < 0.1 * 2 * HALF_EXTENT / 64


@pytest.mark.parametrize("method", METHODS)
def test_an_edited_surface_is_that_of_starting_anew(method: str) -> None:
    """Vertex by vertex, over moves, a new code and an edit taken back; and fewer points are evaluated for it."""
    decoder, cage = network(), random_cage(5, 4)
    live = LiveSurface(40, METHODS[method])
    rng = np.random.default_rng(0)
    first = None
    for edit in range(6):
        latent = torch.full((4,), 0.1 * (edit == 3))
        moved = cage
        if edit not in (0, 5):
            centre = cage.centre.copy()
            centre[rng.integers(4)] += rng.normal(size=3) * 0.1
            moved = replace(cage, centre=centre)
        field = field_of(decoder, latent, moved)
        here, there = live.surface(field), extract(field, 40, METHODS[method])
        assert_same(here.mesh, there.mesh)
        assert (here.clipped, here.components) == (there.clipped, there.components)
        first = first or there.evaluations
        assert here.evaluations <= there.evaluations
        if edit in (1, 2):
            assert here.evaluations < 0.8 * first


def test_finer_cells_come_nearer_to_a_ball_though_they_have_fewer_faces_for_their_number() -> None:
    cage = Cage.of({"ball": Cuboid(np.zeros(3), np.eye(3), np.full(3, 0.8))})
    ball = Local(lambda p: np.linalg.norm(p, axis=1) - 0.37)
    surfaces = [extract(field_of(ball, LATENT, cage), cells).mesh for cells in (64, 128, 256)]
    away = [np.abs(sphere_sdf(surface.corners().mean(axis=1), 0.37)).mean() for surface in surfaces]
    assert away[0] > 1.2 * away[1] > 1.2 * 1.5 * away[2]
    assert len(surfaces[2].faces) < 3 * len(surfaces[1].faces)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=6, deadline=None)
def test_parts_that_are_moved_and_turned_ask_nothing_and_are_those_of_starting_anew(seed: int) -> None:
    """To the last bit, over edits of any cuboid, some of them resized, which asks one part."""
    rng = np.random.default_rng(seed)
    bumpy = Local(lambda p: np.linalg.norm(p, axis=1) - 0.2 + 0.03 * np.sin(25 * p[:, 0]) * np.cos(19 * p[:, 2]))
    cage = random_cage(seed, 4)
    cage = replace(cage, size=cage.size.clip(0.3))
    live = LiveSurface(24, fineness=Fineness(6, 0.25, 0.028, 0.05))
    live.surface(field_of(bumpy, LATENT, cage))
    for edit in range(6):
        centre, axes, size = cage.centre.copy(), cage.axes.copy(), cage.size.copy()
        k = rng.integers(4)
        centre[k] += rng.normal(size=3) * 0.1 * (edit % 3 != 1)
        axes[k] = axes[k] @ (rotation(seed + edit) if edit % 3 == 1 else np.eye(3))
        size[k] *= rng.uniform(0.8, 1.2, 3) if edit == 5 else 1
        cage = replace(cage, centre=centre, axes=axes, size=size)
        field = field_of(bumpy, LATENT, cage)
        once, anew = live.surface(field), extract(field, 24, fineness=Fineness(6, 0.25, 0.028, 0.05))
        assert_same(once.mesh, anew.mesh)
        for part in cage.part_ids:
            assert_same(once.parts[part], anew.parts[part])
        assert (once.evaluations > 0) == (edit == 5)
        assert once.evaluations < anew.evaluations


def test_a_part_of_a_decoder_that_knows_places_is_asked_again_where_it_was_moved() -> None:
    cage = touching()
    live = LiveSurface(32)
    live.surface(field_of(network(), LATENT, cage))
    moved = replace(cage, centre=cage.centre + np.array([[0.1, 0, 0], [0, 0, 0]]))
    assert live.surface(field_of(network(), LATENT, moved)).evaluations > 0


@pytest.mark.parametrize("name", sorted(name for name, kind in DECODERS.items() if kind.trains_on == "part"))
def test_values_of_decoders_of_parts_depend_on_the_place_in_the_cuboid_alone(name: str) -> None:
    """What `Decoder` says of them: a cuboid that is moved or turned has the values of the one at the origin."""
    decoder = make_decoder(name, **SIZES, seed=0).requires_grad_(False)
    rng = np.random.default_rng(2)
    cage = Cage.of({"a": box([0.1, -0.2, 0.05], [0.4, 0.9, 0.15], rotation(3))})
    field = CageField(decoder, torch.linspace(-1, 1, decoder.code_dim or SIZES["latent_dim"])[None], cage)
    unit = rng.uniform(-0.5, 0.5, (300, 3))
    values = field.values(cage.from_unit(unit, 0), 0)
    assert np.ptp(values) > 1e-3, f"{name}: untrained, it has one value everywhere in a cuboid"
    unplaced = field.unplaced()
    assert not unplaced.cage.centre.any()
    np.testing.assert_allclose(unplaced.values(unplaced.cage.from_unit(unit, 0), 0), values, atol=2e-5)


def test_an_edit_leaves_other_parts_as_they_are_and_asks_one_alone() -> None:
    """The very meshes: of a cuboid that was moved, and of one whose code is another."""
    field = two_balls()
    live = LiveSurface(48)
    start = live.surface(field)
    centre = field.cage.centre + np.array([[0.05, 0, 0], [0, 0, 0]])
    moved = live.surface(CageField(field.decoder, field.codes, replace(field.cage, centre=centre)))
    assert moved.parts["b"] is start.parts["b"]
    assert moved.parts["a"] is not start.parts["a"]
    other = live.surface(CageField(field.decoder, torch.tensor([[0.3], [0.33]]), field.cage))
    assert other.parts["a"] is start.parts["a"]
    assert signed_volume(other.parts["b"]) < signed_volume(start.parts["b"])
    assert 0 < other.evaluations < start.evaluations


@given(seed=st.integers(0, 10**6))
@settings(max_examples=5, deadline=None)
def test_unions_that_were_kept_change_nothing(seed: int) -> None:
    """Bit for bit, over edits of one of seven parts after another, some of them empty."""
    rng = np.random.default_rng(seed)
    decoder, cage = waves(seed, 1.0), random_cage(seed, 7)
    live = LiveSurface(20, fineness=Fineness(6, 0.25, 0.028, 0.05))
    for _ in range(4):
        field = field_of(decoder, LATENT, cage)
        assert_same(live.surface(field).mesh, extract(field, 20, fineness=Fineness(6, 0.25, 0.028, 0.05)).mesh)
        centre = cage.centre.copy()
        centre[rng.integers(7)] += rng.normal(size=3) * 0.2
        cage = replace(cage, centre=centre)


def test_an_edit_taken_back_asks_nothing() -> None:
    cage = touching()
    live = LiveSurface(32)
    resized = replace(cage, size=cage.size + np.array([[0.1, 0, 0], [0, 0, 0]]))
    start = live.surface(field_of(Filling(), LATENT, cage))
    assert live.surface(field_of(Filling(), LATENT, resized)).evaluations > 0
    back = live.surface(field_of(Filling(), LATENT, cage))
    assert back.evaluations == 0
    assert_same(back.mesh, start.mesh)


def test_equal_cuboids_with_equal_codes_are_asked_once() -> None:
    cage = Cage.of({name: box([0, 0, 0], [0.5] * 3) for name in "ab"})
    once = extract(CageField(PerCuboid(), torch.tensor([[0.2]]), Cage.of({"a": cage["a"]})), 32)
    twice = extract(CageField(PerCuboid(), torch.tensor([[0.2], [0.2]]), cage), 32)
    assert twice.evaluations == once.evaluations
    assert twice.parts["a"] is twice.parts["b"]


@pytest.mark.parametrize("decoder", [network(), Filling()])
def test_the_order_in_which_parts_are_made_does_not_matter(decoder: Decoder) -> None:
    """Not to the last bit: in threads, or backwards. Boxes have faces in one plane."""

    def backwards(make: Callable[[int], Part], cuboids: Iterable[int]) -> list[Part]:
        return [make(k) for k in reversed(list(cuboids))][::-1]

    field = field_of(decoder, LATENT, random_cage(5, 4) if isinstance(decoder, CageDecoder) else stacked())
    alone = extract(field, 40)
    with ThreadPoolExecutor(3) as pool:
        for each in (pool.map, backwards):
            other = extract(field, 40, each=each)
            assert_same(other.mesh, alone.mesh)
            assert other.evaluations == alone.evaluations


def stacked() -> Cage:
    """Boxes that share planes, edges and corners."""
    places = ([0, 0, 0], [0.4, 0, 0], [0.2, 0.2, 0], [-0.4, 0, 0], [0, 0.2, 0.1])
    return Cage.of({str(i): box(place, [0.4, 0.2, 0.3]) for i, place in enumerate(places)})


def mirrored_chair() -> Cage:
    """A seat across the mirror and two legs beside it, one named by other axes than the other."""
    left = box([-0.3, -0.4, 0.05], [0.1, 0.7, 0.13])
    right = Cuboid(np.array([0.3, -0.4, 0.05]), np.eye(3)[[1, 2, 0]], np.array([0.7, 0.13, 0.1]))
    return Cage.of({"seat": box([0, 0, 0], [0.9, 0.2, 0.7]), "left": left, "right": right})


def test_a_mirrored_cage_gives_exactly_mirrored_surfaces_whatever_the_network_says() -> None:
    """Of the whole, and of each part: its twin's."""
    cage = mirrored_chair()
    crooked = Analytic(lambda p: sphere_sdf(p - [0.07, 0, 0], 0.37) + 0.02 * np.sin(9 * p[:, 0]))
    field = field_of(crooked, LATENT, cage)
    as_it_is, extraction = extract(field, 48), extract(field, 48, symmetry=SYMMETRIES["x"])
    mirror = np.array([-1.0, 1, 1])
    assert bytes_of(extraction.mesh.vertices) == bytes_of(extraction.mesh.vertices * mirror)
    assert bytes_of(as_it_is.mesh.vertices) != bytes_of(as_it_is.mesh.vertices * mirror)
    single = extraction.mesh.vertices.astype(np.float32)
    assert bytes_of(single) == bytes_of(single * mirror.astype(np.float32)), "as it is written, too"
    right = as_it_is.mesh.vertices[as_it_is.mesh.vertices[:, 0] > 0.01]
    assert SurfaceDistance(extraction.mesh).unsigned(right).max() < 1e-9
    assert list(extraction.parts) == ["seat", "left", "right"]
    for part, twin in (("seat", "seat"), ("left", "right")):
        assert_sound(extraction.parts[part])
        assert bytes_of(extraction.parts[part].vertices) == bytes_of(extraction.parts[twin].vertices * mirror)
    kept = SurfaceDistance(as_it_is.parts["right"]).unsigned(extraction.parts["right"].vertices)
    assert kept.max() < 1e-9, "the right half says what both are"


def test_cuboids_that_cross_the_mirror_beside_their_images_are_mirrored_too() -> None:
    arms = {
        "one": box([0.1, 0, 0], [0.6, 0.1, 0.1], np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]])),
        "other": box([-0.1, 0, 0], [0.6, 0.1, 0.1], np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])),
    }
    extraction = extract(field_of(Filling(), LATENT, Cage.of(arms)), 32, symmetry=SYMMETRIES["x"])
    for part in arms:
        assert_sound(extraction.parts[part])
        assert signed_volume(extraction.parts[part]) == pytest.approx(0.006, rel=1e-6)
    assert bytes_of(extraction.parts["one"].vertices) == bytes_of(extraction.parts["other"].vertices * [-1.0, 1, 1])


def test_a_cage_that_is_not_mirrored_is_refused_and_the_cuboid_named() -> None:
    cage = mirrored_chair()
    moved = replace(cage, centre=cage.centre + np.array([[0, 0, 0], [0, 0, 0], [0, 0.02, 0]]))
    with pytest.raises(InputError, match="cuboid 'left' has no mirror image"):
        extract(field_of(Filling(), LATENT, moved), 24, symmetry=SYMMETRIES["x"])


def test_loose_pieces_are_counted_and_dropped_on_demand_with_what_is_as_large_kept() -> None:
    def balls(points: np.ndarray) -> np.ndarray:
        places = ([-0.3, 0, 0], [0.3, 0, 0], [0, 0.4, 0])
        return np.min([sphere_sdf(points - at, r) for at, r in zip(places, (0.2, 0.2, 0.1))], axis=0)

    field = field_of(Analytic(balls), LATENT, Cage.of({"all": box([0, 0, 0], [1.4] * 3)}))
    kept, dropped = extract(field, 48), extract(field, 48, loose=LOOSE["drop"], symmetry=SYMMETRIES["x"])
    assert (kept.components, kept.dropped) == (3, 0)
    assert (dropped.components, dropped.dropped) == (2, 1)
    assert bytes_of(dropped.mesh.vertices) == bytes_of(dropped.mesh.vertices * [-1.0, 1, 1])


@pytest.mark.parametrize(("radius", "left"), [(0.02, 1), (0.1, 2)])
def test_pieces_too_small_to_be_meant_are_swept_away_and_larger_ones_stay(radius: float, left: int) -> None:
    def balls(points: np.ndarray) -> np.ndarray:
        return np.minimum(sphere_sdf(points, 0.4), sphere_sdf(points - [0.0, 0.6, 0.0], radius))

    cage = Cage.of({"all": box([0, 0, 0], [1.5] * 3)})
    assert extract(field_of(Analytic(balls), LATENT, cage), 128).components == left
    hollow = Analytic(lambda p: np.maximum(sphere_sdf(p, 0.4), -sphere_sdf(p - [0.0, 0.2, 0.0], radius)))
    assert len(np.unique(face_components(extract(field_of(hollow, LATENT, cage), 128).mesh))) == left


def test_a_rod_as_thin_as_a_crumb_stays_and_so_does_a_part_of_crumbs_alone() -> None:
    def rod(points: np.ndarray) -> np.ndarray:
        apart = np.linalg.norm(points[:, :2] - [0.0, 0.6], axis=1) - 0.02
        return np.minimum(sphere_sdf(points, 0.4), np.maximum(apart, np.abs(points[:, 2]) - 0.3))

    cage = Cage.of({"all": box([0, 0, 0], [1.5] * 3)})
    assert extract(field_of(Analytic(rod), LATENT, cage), 128).components == 2
    ball = Analytic(lambda p: sphere_sdf(p, 0.02))
    assert extract(field_of(ball, LATENT, cage), 128).components == 1


@pytest.mark.parametrize("thick", [0.006, 0.012, 0.04])
def test_a_sheet_that_is_bent_through_a_deep_cuboid_is_whole_in_cells_that_its_thickness_skips(thick: float) -> None:
    """A quarter of a tube: torn where cells are 0.016 alone."""

    def sheet(points: np.ndarray) -> np.ndarray:
        shell = np.abs(np.hypot(points[:, 0] + 0.4, points[:, 1] + 0.4) - 0.7) - thick / 2
        return np.maximum(shell, np.abs(points[:, 2]) - 0.3)

    field = field_of(Analytic(sheet), LATENT, Cage.of({"all": box([0, 0, 0], [0.8, 0.8, 0.7])}))
    held, torn = (extract(field, 128, fineness=fineness) for fineness in (USUAL, replace(USUAL, finer=1.0)))
    assert topology(held.mesh) == (1, 0)
    assert (topology(torn.mesh) == (1, 0)) == (thick == 0.04)
    assert signed_volume(held.mesh) == pytest.approx(0.7 * np.pi / 2 * thick * 0.6, rel=0.1)
    assert (held.evaluations > torn.evaluations) == (thick < 0.04)


@pytest.mark.parametrize("size", [[0.9, 0.01, 0.7], [0.9, 0.01, 0.02]])
def test_a_plate_and_a_rod_along_their_cuboids_are_made_once(size: list[float]) -> None:
    half = 0.48 * np.array(size)
    field = field_of(Local(lambda p: (np.abs(p) - half).max(axis=1)), LATENT, Cage.of({"a": box([0, 0, 0], size)}))
    once = extract(field, 128, fineness=replace(USUAL, finer=1.0))
    assert extract(field, 128).evaluations == once.evaluations


@pytest.mark.parametrize("thick", [1e-4, 0.006, 0.02, 0.5])
def test_cells_that_hold_a_part_are_small_enough_but_no_smaller_than_allowed(thick: float) -> None:
    cuboid, cell = box([0.1, 0, 0], [0.8, 0.8, 0.7], rotation(3)), 2 * HALF_EXTENT / 128
    board = Cage.of({"a": Cuboid(cuboid.centre, rotation(8), np.array([0.4, thick, 0.4]))})
    thickness = Thickness(Mesh(board.corners()[0], CUBE_FACES), cuboid)
    usual, lattice = Lattice.of(cuboid, cell, USUAL.least), thickness.holding_lattice(cell, USUAL)
    assert (lattice.cells >= usual.cells).all()
    assert (lattice.cells - 1).prod() < 128**3
    assert lattice.steps.min() >= usual.steps.min() * USUAL.finer * 0.99
    if thick == 0.02:
        assert HELD <= thickness.cells(lattice) < 1.3 * HELD
    assert (lattice.cells == usual.cells).all() == (thick == 0.5)


def test_a_cavity_is_no_piece_and_stays() -> None:
    shell = Analytic(lambda p: np.abs(sphere_sdf(p, 0.4)) - 0.1)
    field = field_of(shell, LATENT, Cage.of({"all": box([0, 0, 0], [1.2] * 3)}))
    for loose in LOOSE.values():
        extraction = extract(field, 48, loose=loose)
        assert (extraction.components, extraction.dropped) == (1, 0)
        assert signed_volume(extraction.mesh) == pytest.approx(4 / 3 * np.pi * (0.5**3 - 0.3**3), rel=0.02)
