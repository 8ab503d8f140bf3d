"""From field to surface: where it is, that it is closed, and how little of the grid is asked."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import torch
import toy
from analytic import sphere_sdf
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.distance import SurfaceDistance
from cagesdf.errors import InputError
from cagesdf.extraction import (
    LOOSE,
    METHODS,
    OUTSIDES,
    OVERLAPS,
    SYMMETRIES,
    CageField,
    LiveSurface,
    cube_field,
    extract,
    extract_surface,
)
from cagesdf.extraction.bounding import bounded, fans_over, same_faces, spared_faces
from cagesdf.extraction.field import outside_constant, outside_union
from cagesdf.extraction.joining import part_of
from cagesdf.extraction.surface import march
from cagesdf.frames import HALF_EXTENT
from cagesdf.meshes import Mesh, is_closed, signed_volume
from cagesdf.models.decoders import CageDecoder, Decoder, LocalCageDecoder
from cagesdf.solid import as_manifold, cage_surface, from_manifold

LATENT = torch.zeros(4)


class Analytic(Decoder):
    """A decoder that is a function of the point alone."""

    def __init__(self, sdf: Callable[[np.ndarray], np.ndarray]) -> None:
        super().__init__()
        self.sdf = sdf

    def features(self, points: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return points

    def condition(self, latent: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return cuboid

    def at(self, features: torch.Tensor, condition: torch.Tensor, products: torch.dtype) -> torch.Tensor:
        values = self.sdf(features.double().reshape(-1, 3).numpy())
        return torch.from_numpy(np.asarray(values, np.float32)).view(features.shape[:2])


class PerCuboid(Decoder):
    """A decoder that knows its cuboid by the first coordinate of its centre: another ball in each."""

    def __init__(self, radius: dict[float, float]) -> None:
        super().__init__()
        self.radius = {round(x, 4): radius for x, radius in radius.items()}

    def features(self, points: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return points - cuboid[:, None, :3]

    def condition(self, latent: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return torch.tensor([[self.radius[round(float(x), 4)]] for x in cuboid[:, 0]])

    def at(self, features: torch.Tensor, condition: torch.Tensor, products: torch.dtype) -> torch.Tensor:
        return features.norm(dim=-1) - condition


class Linear(Decoder):
    """A decoder that needs latent and cuboid."""

    def features(self, points: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return points.sum(-1, keepdim=True)

    def condition(self, latent: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return latent[:, :1] + cuboid[:, 12:13]

    def at(self, features: torch.Tensor, condition: torch.Tensor, products: torch.dtype) -> torch.Tensor:
        return 0.01 * (features[..., 0] + condition)


def box(centre, size, axes=None) -> Cuboid:
    return Cuboid(np.array(centre, float), np.eye(3) if axes is None else axes, np.array(size, float))


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def touching() -> Cage:
    """A seat on a leg that shares a part of its lower face; no face lies on the lattice."""
    return Cage.of(
        {"seat": box([0.013, 0.31, 0], [1.21, 0.23, 0.83]), "leg": box([0.113, -0.305, 0.107], [0.3, 1, 0.2])}
    )


def perfect(cage: Cage) -> Analytic:
    """The network that has learnt a shape of boxes that fill their cuboids."""
    return Analytic(SurfaceDistance(cage_surface(cage)).signed)


def noise(scale: float) -> Analytic:
    """A decoder without any continuity, with exact zeros among its values."""
    return Analytic(lambda points: scale * np.round(3 * np.sin(1e4 * points @ [1.0, 2.3, 3.1])) / 3)


def radii(mesh) -> np.ndarray:
    return np.linalg.norm(mesh.vertices, axis=1)


@pytest.mark.parametrize("resolution", [24, 64])
def test_a_sphere_comes_out_with_its_radius_closed_and_outwards(resolution: int) -> None:
    ball = Analytic(lambda points: sphere_sdf(points, 0.61))
    cell = 2 * HALF_EXTENT / resolution
    for field in (
        cube_field(ball, LATENT, touching(), outside_union),
        CageField(ball, LATENT, Cage.of({"all": box([0, 0, 0], [1.7, 1.6, 1.5], rotation(1))}), outside_union),
    ):
        mesh = extract_surface(field, resolution)
        assert is_closed(mesh)
        assert np.abs(radii(mesh) - 0.61).max() < 0.1 * cell
        assert signed_volume(mesh) == pytest.approx(4 / 3 * np.pi * 0.61**3, rel=0.02)


def test_touching_cuboids_leave_no_groove_and_the_constant_is_worse_than_the_union() -> None:
    """In % of the longest side: 0.009 here (0.3 at worst, at concave edges) against 0.5."""
    cage = touching()
    truth = SurfaceDistance(cage_surface(cage))
    error = {}
    for name, outside in OUTSIDES.items():
        mesh = extract_surface(CageField(perfect(cage), LATENT, cage, outside), 128)
        error[name] = 100 / 1.21 * truth.unsigned(mesh.vertices)
        assert is_closed(mesh)
    assert error["union"].mean() < 0.05
    assert error["union"].max() < 0.4
    assert error["union"].mean() < error["constant"].mean() / 3


def test_nothing_counts_as_clipped_where_the_network_keeps_within_or_ends_at_the_cage() -> None:
    ball = Analytic(lambda points: sphere_sdf(points, 0.5))
    assert extract(CageField(ball, LATENT, Cage.of({"all": box([0, 0, 0], [1.2] * 3)}), outside_union), 48).clipped == 0
    assert extract(CageField(perfect(touching()), LATENT, touching(), outside_union), 64).clipped == 0


def test_half_of_a_sphere_that_sticks_out_of_its_cuboid_counts_as_clipped() -> None:
    ball = Analytic(lambda points: sphere_sdf(points, 0.5))
    cage = Cage.of({"half": box([0.25, 0, 0], [0.5, 1.2, 1.2])})
    found = extract(CageField(ball, LATENT, cage, outside_union), 64)
    # A third of the area is flat; marching cubes has 1.5 times as many vertices on the round part as on a flat one.
    assert found.clipped == pytest.approx(1 / 4, rel=0.1)


def test_a_surface_that_leaves_the_cube_is_closed_there() -> None:
    mesh = extract_surface(cube_field(Analytic(lambda p: sphere_sdf(p, 1.4)), LATENT, touching(), outside_union), 32)
    assert is_closed(mesh)
    assert np.abs(mesh.vertices).max() < HALF_EXTENT + 2 * HALF_EXTENT / 32


def test_a_network_that_says_outside_everywhere_gives_no_face() -> None:
    found = extract(CageField(Analytic(lambda p: np.ones(len(p))), LATENT, touching(), outside_union), 32)
    assert found.mesh.vertices.shape == found.mesh.faces.shape == (0, 3)
    assert found.clipped == 0


def test_a_diverged_network_is_refused() -> None:
    with pytest.raises(InputError, match="diverged"):
        extract(CageField(Analytic(lambda p: np.full(len(p), np.nan)), LATENT, touching(), outside_constant), 32)


def random_cage(seed: int, count: int) -> Cage:
    rng = np.random.default_rng(seed)
    return Cage.of(
        {str(i): box(rng.uniform(-0.5, 0.5, 3), rng.uniform(0.05, 1, 3), rotation(seed + i)) for i in range(count)}
    )


@given(
    seed=st.integers(0, 10**6),
    scale=st.sampled_from([1e-9, 1e-3, 0.03, 10.0]),
    outside=st.sampled_from(list(OUTSIDES.values())),
    overlap=st.sampled_from(list(OVERLAPS.values())),
)
@settings(max_examples=25, deadline=None)
def test_noise_gives_closed_manifold_surfaces_within_the_cuboids(seed: int, scale: float, outside, overlap) -> None:
    """`extract` checks them itself; here they are checked by other means."""
    cage = random_cage(seed, 3)
    found = extract(CageField(noise(scale), LATENT, cage, outside, overlap), 20)
    if len(found.mesh.faces):
        edges = np.sort(np.stack([found.mesh.faces, np.roll(found.mesh.faces, -1, axis=1)], axis=2).reshape(-1, 2))
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
        assert is_closed(found.mesh)
        assert cage.signed_distance(found.mesh.vertices).min(axis=1).max() < 1e-6
        middles = found.mesh.corners().mean(axis=1)
        assert cage.signed_distance(middles).min(axis=1).max() < 1e-6


def test_what_the_network_would_fill_is_the_cage_itself() -> None:
    """Its edges and corners too, which marching cubes alone would round off."""
    cage = touching()
    found = extract(CageField(Analytic(lambda p: np.full(len(p), -1.0)), LATENT, cage, outside_union), 64)
    assert found.clipped == 1
    assert found.overshoot < 1e-9
    distance = SurfaceDistance(cage_surface(cage)).unsigned(found.mesh.vertices)
    assert distance.mean() < 0.02 * 2 * HALF_EXTENT / 64


@given(seed=st.integers(0, 10**6))
@settings(max_examples=8, deadline=None)
def test_the_value_of_a_point_does_not_depend_on_the_points_beside_it(seed: int) -> None:
    """Bit for bit, or an edit would not give what starting anew gives; for both of our networks."""
    rng = np.random.default_rng(seed)
    for kind in (LocalCageDecoder, CageDecoder):
        decoder = kind(32, 4, 4, (16,), 2).eval()
        field = CageField(decoder, LATENT, touching(), outside_union)
        points = rng.uniform(-0.5, 0.5, (1500, 3))
        whole = field.ask(points, 1)
        some = rng.permutation(1500)[: rng.integers(1, 1500)]
        np.testing.assert_array_equal(field.ask(points[some], 1), whole[some])


def test_each_point_is_asked_with_its_own_cuboid_and_the_latent() -> None:
    """Against one call a point."""
    cage, latent = touching(), torch.tensor([0.3, 0, 0, 0])
    field = CageField(Linear(), latent, cage, outside_union)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (700, 3))
    vectors = torch.from_numpy(cage.vectors()).float()
    for i in range(2):
        slow = [
            float(Linear()(torch.from_numpy(point[None, None]).float(), latent[None], vectors[i][None]))
            for point in points
        ]
        np.testing.assert_allclose(field.ask(points, i), slow, atol=1e-6)
        assert len(field.ask(points[:0], i)) == 0


def test_the_grid_grows_with_an_edited_cage() -> None:
    """A cage moved by whole cells, far out of the unit sphere, gives the same surface moved."""
    cage = touching()
    shift = np.array([40, 0, -7]) * 2 * HALF_EXTENT / 32
    moved = replace(cage, centre=cage.centre + shift)
    there = extract_surface(CageField(perfect(moved), LATENT, moved, outside_union), 32)
    here = extract_surface(CageField(perfect(cage), LATENT, cage, outside_union), 32)
    assert signed_volume(there) == pytest.approx(signed_volume(here), rel=1e-5)
    assert SurfaceDistance(here).unsigned(there.vertices - shift).max() < 1e-4
    assert there.vertices.max() > HALF_EXTENT


def two_balls() -> tuple[PerCuboid, Cage]:
    """Two overlapping cuboids; the network has a larger ball for the second."""
    cage = Cage.of({"a": box([-0.2, 0, 0], [0.8, 0.9, 0.9]), "b": box([0.2, 0.01, 0], [0.8, 0.9, 0.9])})
    return PerCuboid({-0.2: 0.3, 0.2: 0.38}), cage


def test_overlaps_take_the_deepest_the_least_or_a_mean_of_all() -> None:
    depth = np.array([[-0.1, -0.3], [-0.3, -0.1], [np.inf, -0.2], [0.0, np.inf]], np.float32)
    values = np.array([[1, 5], [1, 5], [9, 5], [1, 9]], np.float32)
    np.testing.assert_allclose(OVERLAPS["deepest"](depth, values), [5, 1, 5, 1])
    np.testing.assert_allclose(OVERLAPS["union"](depth, values), [1, 1, 5, 1])
    np.testing.assert_allclose(OVERLAPS["blend"](depth, values), [4, 2, 5, 1], rtol=1e-6)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_the_blend_has_no_jump_where_a_cuboid_ends(seed: int) -> None:
    """As one weight goes to 0, the field goes to that of the others; the paper's choice jumps somewhere."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(1, 3)).astype(np.float32)
    depth = -rng.uniform(0.1, 0.5, (1, 3)).astype(np.float32)
    depth[0, 2] = -1e-7
    without = depth.copy()
    without[0, 2] = np.inf
    np.testing.assert_allclose(OVERLAPS["blend"](depth, values), OVERLAPS["blend"](without, values), atol=1e-4)


def test_the_union_of_two_parts_has_both_and_the_deepest_alone_has_a_step() -> None:
    decoder, cage = two_balls()
    volume = {
        name: signed_volume(extract_surface(CageField(decoder, LATENT, cage, outside_union, overlap), 64))
        for name, overlap in OVERLAPS.items()
    }
    assert volume["union"] > volume["blend"] > 0
    assert volume["union"] > volume["deepest"]


@pytest.mark.parametrize("overlap", OVERLAPS)
@pytest.mark.parametrize("method", METHODS)
def test_an_edited_surface_is_that_of_starting_anew(overlap: str, method: str) -> None:
    """Vertex by vertex, over moves, a new latent and an edit taken back; and less is asked for it."""
    torch.manual_seed(1)
    decoder = LocalCageDecoder(32, 4, 4, (16,), 2).eval()
    with torch.no_grad():
        decoder.backbone.out.weight.mul_(3)
    cage = random_cage(5, 4)
    live = LiveSurface(decoder, 40, CageField, outside_union, OVERLAPS[overlap], METHODS[method])
    rng = np.random.default_rng(0)
    first = None
    for edit in range(6):
        latent = torch.full((4,), 0.1 * (edit == 3))
        moved = cage
        if edit not in (0, 5):
            centre = cage.centre.copy()
            centre[rng.integers(4)] += rng.normal(size=3) * 0.1
            moved = replace(cage, centre=centre)
        here = live.surface(latent, moved)
        field = CageField(decoder, latent, moved, outside_union, OVERLAPS[overlap])
        there = extract(field, 40, METHODS[method])
        np.testing.assert_array_equal(here.mesh.vertices, there.mesh.vertices)
        np.testing.assert_array_equal(here.mesh.faces, there.mesh.faces)
        assert (here.clipped, here.components) == (there.clipped, there.components)
        first = first or there.asked
        assert here.asked <= there.asked
        if edit in (1, 2):
            assert here.asked < 0.8 * first


def test_an_edit_taken_back_asks_nothing() -> None:
    cage = touching()
    live = LiveSurface(perfect(cage), 32)
    moved = replace(cage, centre=cage.centre + np.array([[0.1, 0, 0], [0, 0, 0]]))
    start = live.surface(LATENT, cage)
    assert live.surface(LATENT, moved).asked > 0
    back = live.surface(LATENT, cage)
    assert back.asked == 0
    np.testing.assert_array_equal(back.mesh.vertices, start.mesh.vertices)


def marched(cage: Cage, phase: float) -> Mesh:
    """A bumpy ball before it is cut: it leaves its cuboids here and there."""
    waves = Analytic(lambda p: sphere_sdf(p, 0.5) + 0.05 * np.sin(17 * p[:, 0]) * np.sin(13 * p[:, 1] + phase))
    cell = 2 * HALF_EXTENT / 40
    field = CageField(waves, LATENT, cage, outside_union)
    return march(field, [part_of(field, k, cell, METHODS["dense"]) for k in range(len(cage))], cell).mesh


def intersection(mesh: Mesh, cage: Cage) -> Mesh:
    return from_manifold(as_manifold(mesh) ^ as_manifold(cage_surface(cage)))


def triangles(mesh: Mesh) -> set[frozenset[bytes]]:
    return {frozenset(corner.tobytes() for corner in triangle) for triangle in mesh.corners()}


@given(seed=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_cutting_only_what_lies_in_no_cuboid_gives_the_intersection_of_the_whole(seed: int) -> None:
    cage = random_cage(seed, 4)
    mesh = marched(cage, seed)
    if len(mesh.faces):
        found, whole = bounded(mesh, cage), intersection(mesh, cage)
        assert is_closed(found)
        assert bytes_of(found.vertices) == bytes_of(whole.vertices)
        assert signed_volume(found) == pytest.approx(signed_volume(whole), rel=1e-12)
        # Each is one of the ways to triangulate the same polygons, which differ at the cut alone.
        spared, _ = spared_faces(mesh, cage)
        assert triangles(Mesh(mesh.vertices, mesh.faces[spared])) <= triangles(found) & triangles(whole)


def test_most_of_a_surface_is_not_cut() -> None:
    cage = Cage.of({"all": box([0, 0, 0], [1.05] * 3)})
    mesh = marched(cage, 0.0)
    spared, rim = spared_faces(mesh, cage)
    assert 0.7 < spared.mean() < 1
    tails, heads = rim.T
    assert sorted(tails) == sorted(heads) == sorted(set(tails)), "simple loops"
    assert is_closed(Mesh(mesh.vertices, mesh.faces))
    _, centres, fans = fans_over(mesh, rim)
    vertices = np.concatenate([mesh.vertices, centres])
    assert is_closed(Mesh(vertices, np.concatenate([mesh.faces[~spared], fans]).astype(np.int32)))
    assert (cage.signed_distance(centres).min(axis=1) < 0).all()


def test_faces_are_the_same_in_any_order_from_any_vertex_on_but_not_turned_over_or_with_an_edge_swapped() -> None:
    rng = np.random.default_rng(0)
    faces = toy.ball([0, 0, 0], 1).faces
    turned = np.take_along_axis(faces, (rng.integers(3, size=(len(faces), 1)) + np.arange(3)) % 3, axis=1)
    assert same_faces(faces, rng.permutation(turned))
    assert not same_faces(faces, faces[1:])
    over = faces.copy()
    over[7] = over[7, ::-1]
    assert not same_faces(faces, over)
    assert not same_faces(np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 1, 3], [1, 2, 3]]))


def test_where_a_fan_does_not_come_back_the_whole_mesh_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    def flat(mesh: Mesh, rim: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        ends, centres, fans = fans_over(mesh, rim)
        return ends, np.tile(mesh.vertices[ends[:1]], (len(centres), 1)), fans

    cage = Cage.of({"all": box([0, 0, 0], [1.05] * 3)})
    mesh = marched(cage, 0.0)
    monkeypatch.setattr("cagesdf.extraction.bounding.fans_over", flat)
    found, whole = bounded(mesh, cage), intersection(mesh, cage)
    assert is_closed(found)
    assert triangles(found) == triangles(whole)


def test_threads_give_the_same_surface() -> None:
    torch.manual_seed(1)
    decoder, cage = LocalCageDecoder(32, 4, 4, (16,), 2).eval(), random_cage(5, 4)
    with ThreadPoolExecutor(3) as pool:
        live = LiveSurface(decoder, 40, each=pool.map)
        field = CageField(decoder, LATENT, cage, outside_union)
        alone, *others = extract(field, 40), extract(field, 40, each=pool.map), live.surface(LATENT, cage)
    for other in others:
        np.testing.assert_array_equal(other.mesh.vertices, alone.mesh.vertices)
        np.testing.assert_array_equal(other.mesh.faces, alone.mesh.faces)
        assert other.asked == alone.asked


def bytes_of(vertices: np.ndarray) -> set[bytes]:
    return {row.tobytes() for row in vertices + 0.0}


def mirrored_chair() -> Cage:
    """A seat across the mirror and two legs beside it, one named by other axes than the other."""
    left = box([-0.3, -0.4, 0.05], [0.1, 0.7, 0.13])
    right = Cuboid(np.array([0.3, -0.4, 0.05]), np.eye(3)[[1, 2, 0]], np.array([0.7, 0.13, 0.1]))
    return Cage.of({"seat": box([0, 0, 0], [0.9, 0.2, 0.7]), "left": left, "right": right})


def test_a_mirrored_cage_gives_an_exactly_mirrored_surface_whatever_the_network_says() -> None:
    cage = mirrored_chair()
    crooked = Analytic(lambda p: sphere_sdf(p - [0.07, 0, 0], 0.37) + 0.02 * np.sin(9 * p[:, 0]))
    field = CageField(crooked, LATENT, cage, outside_union)
    as_it_is, found = extract(field, 48), extract(field, 48, symmetry=SYMMETRIES["x"])
    mirror = np.array([-1.0, 1, 1])
    assert bytes_of(found.mesh.vertices) == bytes_of(found.mesh.vertices * mirror)
    assert bytes_of(as_it_is.mesh.vertices) != bytes_of(as_it_is.mesh.vertices * mirror)
    single = found.mesh.vertices.astype(np.float32)
    assert bytes_of(single) == bytes_of(single * mirror.astype(np.float32)), "as it is written, too"
    right = as_it_is.mesh.vertices[as_it_is.mesh.vertices[:, 0] > 0.01]
    assert SurfaceDistance(found.mesh).unsigned(right).max() < 1e-9


def test_a_cage_that_is_not_mirrored_is_refused_and_the_cuboid_named() -> None:
    cage = mirrored_chair()
    moved = replace(cage, centre=cage.centre + np.array([[0, 0, 0], [0, 0, 0], [0, 0.02, 0]]))
    with pytest.raises(InputError, match="cuboid 'left' has no mirror image"):
        extract(CageField(perfect(cage), LATENT, moved, outside_union), 24, symmetry=SYMMETRIES["x"])


def test_loose_pieces_are_counted_and_dropped_on_demand_with_what_is_as_large_kept() -> None:
    def balls(points: np.ndarray) -> np.ndarray:
        places = ([-0.3, 0, 0], [0.3, 0, 0], [0, 0.4, 0])
        return np.min([sphere_sdf(points - at, r) for at, r in zip(places, (0.2, 0.2, 0.1))], axis=0)

    field = CageField(Analytic(balls), LATENT, Cage.of({"all": box([0, 0, 0], [1.4] * 3)}), outside_union)
    kept, dropped = extract(field, 48), extract(field, 48, loose=LOOSE["drop"], symmetry=SYMMETRIES["x"])
    assert (kept.components, kept.dropped) == (3, 0)
    assert (dropped.components, dropped.dropped) == (2, 1)
    assert bytes_of(dropped.mesh.vertices) == bytes_of(dropped.mesh.vertices * [-1.0, 1, 1])


def test_a_cavity_is_no_piece_and_stays() -> None:
    shell = Analytic(lambda p: np.abs(sphere_sdf(p, 0.4)) - 0.1)
    field = CageField(shell, LATENT, Cage.of({"all": box([0, 0, 0], [1.2] * 3)}), outside_union)
    for loose in LOOSE.values():
        found = extract(field, 48, loose=loose)
        assert (found.components, found.dropped) == (1, 0)
        assert signed_volume(found.mesh) == pytest.approx(4 / 3 * np.pi * (0.5**3 - 0.3**3), rel=0.02)
