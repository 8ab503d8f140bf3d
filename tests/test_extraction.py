"""From field to surface: where it is, that it is closed, and how little of the grid is asked."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from analytic import sphere_sdf
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.distance import SurfaceDistance
from cagesdf.errors import InputError
from cagesdf.extraction import (
    NOBODY,
    OUTSIDES,
    CageField,
    Lattice,
    ask_sparsely,
    beside_surface,
    cube_field,
    domain_of,
    extract,
    extract_surface,
    outside_constant,
    outside_union,
)
from cagesdf.frames import HALF_EXTENT, OUTSIDE
from cagesdf.meshes import face_areas, is_closed, signed_volume
from cagesdf.solid import cage_surface

LATENT = torch.zeros(4)


class Analytic(torch.nn.Module):
    """A decoder that is a function of the point alone."""

    def __init__(self, sdf: Callable[[np.ndarray], np.ndarray]) -> None:
        super().__init__()
        self.sdf = sdf

    def forward(self, points: torch.Tensor, latent: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        values = self.sdf(points.double().reshape(-1, 3).numpy())
        return torch.from_numpy(np.asarray(values, np.float32)).view(points.shape[:2])


class Linear(torch.nn.Module):
    """A decoder that needs latent and cuboid."""

    def forward(self, points: torch.Tensor, latent: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return 0.01 * (points.sum(-1) + latent[:, :1] + cuboid[:, 12:13])


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


def test_the_surface_stays_within_the_cage_whatever_the_network_says() -> None:
    cage = touching()
    everywhere = extract(
        CageField(Analytic(lambda points: np.full(len(points), -1.0)), LATENT, cage, outside_union), 64
    )
    distance = SurfaceDistance(cage_surface(cage)).unsigned(everywhere.mesh.vertices)
    assert distance.max() < 0.6 * 2 * HALF_EXTENT / 64
    assert distance.mean() < 0.05 * 2 * HALF_EXTENT / 64
    assert everywhere.clipped == 1


def test_nothing_counts_as_clipped_where_the_network_keeps_within_or_ends_at_the_cage() -> None:
    ball = Analytic(lambda points: sphere_sdf(points, 0.5))
    assert extract(CageField(ball, LATENT, Cage.of({"all": box([0, 0, 0], [1.2] * 3)}), outside_union), 48).clipped == 0
    assert extract(CageField(perfect(touching()), LATENT, touching(), outside_union), 64).clipped == 0


def test_half_of_a_sphere_that_sticks_out_of_its_cuboid_counts_as_clipped() -> None:
    ball = Analytic(lambda points: sphere_sdf(points, 0.5))
    cage = Cage.of({"half": box([0.25, 0, 0], [0.5, 1.2, 1.2])})
    found = extract(CageField(ball, LATENT, cage, outside_union), 64)
    flat = np.abs(found.mesh.vertices[:, 0]) < 1e-3
    assert found.clipped == pytest.approx(flat.mean(), rel=0.25)  # the rim is within the tolerance


@given(seed=st.integers(0, 10**6), scale=st.sampled_from([1e-9, 1e-3, 0.03, 10.0]), whole=st.booleans())
@settings(max_examples=25, deadline=None)
def test_noise_gives_closed_surfaces_without_empty_faces(seed: int, scale: float, whole: bool) -> None:
    """Ambiguous cells, exact zeros, values at the clamp and next to 0: marching cubes closes them all."""
    rng = np.random.default_rng(seed)
    cage = Cage.of(
        {str(i): box(rng.uniform(-0.5, 0.5, 3), rng.uniform(0.05, 1, 3), rotation(seed + i)) for i in range(3)}
    )
    make = cube_field if whole else CageField
    for outside in OUTSIDES.values():
        mesh = extract_surface(make(noise(scale), LATENT, cage, outside), 20)
        assert len(mesh.faces) == 0 or is_closed(mesh)
        assert (face_areas(mesh.with_vertices(mesh.vertices.astype(np.float32).astype(float))) > 0).all()


@given(seed=st.integers(0, 10**6))
@settings(max_examples=15, deadline=None)
def test_lattice_points_belong_to_the_cuboid_that_most_contains_them(seed: int) -> None:
    """Against `Cage.assign` of every point; the distance outside is exact next to what is inside."""
    rng = np.random.default_rng(seed)
    cage = Cage.of(
        {str(i): box(rng.uniform(-0.4, 0.4, 3), rng.uniform(0.1, 0.9, 3), rotation(seed + i)) for i in range(4)}
    )
    corners = cage.corners().reshape(-1, 3)
    domain = domain_of(cage, Lattice.covering(corners.min(0), corners.max(0), 24))
    places = np.argwhere(np.ones(domain.lattice.shape))
    owner, depth = cage.assign(domain.lattice.points(places))
    found, found_depth = domain.owner.reshape(-1), domain.depth.reshape(-1)
    clear = np.abs(np.sort(cage.signed_distance(domain.lattice.points(places)), axis=1)[:, :2]).min(axis=1) > 1e-6
    inside = (depth <= 0) & clear
    assert (found[(depth > 0) & clear] == NOBODY).all()
    assert np.mean(found[inside] == owner[inside]) > 0.999  # float32 may tell two equal depths apart
    near = (found != NOBODY) | beside_surface(domain.owner != NOBODY).reshape(-1)
    np.testing.assert_allclose(found_depth[near], np.minimum(depth[near], OUTSIDE), atol=1e-6)


@pytest.mark.parametrize("slope", [0.7, 1.0, 6.0])
def test_asking_sparsely_equals_asking_everywhere(slope: float) -> None:
    """Also for a network much steeper than a distance: the surface is followed."""
    cage = Cage.of({"body": box([0, -0.1, 0], [1.2, 1.3, 1.1]), "neck": box([0, 0.6, 0], [0.5, 0.6, 0.5])})
    bumpy = Analytic(lambda points: slope * (sphere_sdf(points, 0.55) + 0.02 * np.sin(20 * points[:, 1])))
    for field in (CageField(bumpy, LATENT, cage, outside_union), cube_field(bumpy, LATENT, cage, outside_union)):
        domain = domain_of(field.cage, Lattice.covering(*field.bounds(), 96))
        answers = ask_sparsely(field.ask, domain)
        dense = np.full(domain.lattice.shape, OUTSIDE, np.float32)
        owned = np.argwhere(domain.owner != NOBODY)
        dense[tuple(owned.T)] = field.ask(domain.lattice.points(owned), domain.owner[tuple(owned.T)])
        np.testing.assert_array_equal(answers.values < 0, dense < 0)
        np.testing.assert_array_equal(answers.near, beside_surface(dense < 0))
        # The last bits of a value depend on which points are beside it in a batch.
        np.testing.assert_allclose(answers.values[answers.near], dense[answers.near], atol=1e-6)
        assert answers.asked < len(owned) / 2


def test_the_network_is_asked_at_a_small_part_of_the_grid_and_only_in_cuboids() -> None:
    cage = touching()
    field = CageField(perfect(cage), LATENT, cage, outside_union)
    seen = []

    def ask(points: np.ndarray, owner: np.ndarray) -> np.ndarray:
        seen.append(np.take_along_axis(cage.signed_distance(points), owner[:, None].astype(int), axis=1))
        return field.ask(points, owner)

    answers = ask_sparsely(ask, domain_of(cage, Lattice.covering(*field.bounds(), 128)))
    assert np.concatenate(seen).max() < 1e-6
    assert answers.asked == len(np.concatenate(seen)) < 0.02 * 129**3


def test_each_point_is_asked_with_its_own_cuboid_and_the_latent() -> None:
    """Against one call a point."""
    cage = touching()
    latent = torch.tensor([0.3, 0, 0, 0])
    field = CageField(Linear(), latent, cage, outside_union)
    rng = np.random.default_rng(0)
    points, owner = rng.uniform(-0.5, 0.5, (1500, 3)), rng.integers(0, 2, 1500)
    vectors = torch.from_numpy(cage.vectors()).float()
    slow = [
        float(Linear()(torch.from_numpy(point[None, None]).float(), latent[None], vectors[i][None]))
        for point, i in zip(points, owner)
    ]
    np.testing.assert_allclose(field.ask(points, owner), slow, atol=1e-6)
    assert len(field.ask(points[:0], owner[:0])) == 0


def test_the_grid_grows_with_an_edited_cage() -> None:
    """A cage moved by whole cells, far out of the unit sphere, gives the same mesh moved."""
    cage = touching()
    shift = np.array([40, 0, -7]) * 2 * HALF_EXTENT / 32
    moved = replace(cage, centre=cage.centre + shift)
    there = extract_surface(CageField(perfect(moved), LATENT, moved, outside_union), 32)
    here = extract_surface(CageField(perfect(cage), LATENT, cage, outside_union), 32)
    np.testing.assert_array_equal(there.faces, here.faces)
    np.testing.assert_allclose(there.vertices, here.vertices + shift, atol=1e-5)
    assert there.vertices.max() > HALF_EXTENT


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
