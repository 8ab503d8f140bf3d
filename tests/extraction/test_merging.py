"""Fewer vertices where a surface is nearly flat: what stays where it is, and what becomes one."""

from collections.abc import Callable

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cuboid
from cagesdf.extraction.lattice import Lattice
from cagesdf.extraction.marching import Marched, march
from cagesdf.extraction.merging import merged
from cagesdf.extraction.thinness import USUAL
from cagesdf.extraction.values import dense_values
from cagesdf.geometry.meshes import Mesh, is_closed, signed_volume, topology
from tests.support.analytic import sphere_sdf

SIZE = np.array([0.5, 0.8, 0.65])
SAG = USUAL.sag
LATTICE = Lattice.of(Cuboid(np.zeros(3), np.eye(3), SIZE), 0.03, 8)


def marched(sdf: Callable[[np.ndarray], np.ndarray]) -> Marched:
    return march(
        dense_values(lambda places: sdf(LATTICE.points(places)).astype(np.float32), 1.0, LATTICE).values, LATTICE
    )


def mesh_of(surface: Marched) -> Mesh:
    return Mesh(LATTICE.points(surface.places), surface.faces)


def on_faces(surface: Marched) -> np.ndarray:
    return ((surface.places == 0) | (surface.places == LATTICE.cells)).any(axis=1)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=10, deadline=None)
def test_a_plane_keeps_less_than_half_of_its_vertices_and_stays_that_plane(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    before = marched(lambda points: points @ normal - rng.uniform(-0.02, 0.02))
    after = merged(before, LATTICE, SAG)
    heights = [mesh_of(surface).vertices[~on_faces(surface)] @ normal for surface in (before, after)]
    assert len(heights[1]) < 0.5 * len(heights[0])
    assert np.ptp(heights[1]) <= np.ptp(heights[0]) + 1e-12
    assert signed_volume(mesh_of(after)) > 0.999 * signed_volume(mesh_of(before))


@given(seed=st.integers(0, 10**6), radius=st.floats(0.05, 0.4), sag=st.floats(0, 0.12))
@settings(max_examples=20, deadline=None)
def test_a_ball_stays_a_ball_and_its_vertices_on_faces_where_they_are(seed: int, radius: float, sag: float) -> None:
    """Closed, of the same topology; means of vertices lie below its surface by a fraction of a step."""
    centre = np.random.default_rng(seed).uniform(-0.2, 0.2, 3)
    before = marched(lambda points: sphere_sdf(points - centre, radius))
    after = merged(before, LATTICE, sag)
    assert is_closed(mesh_of(after))
    assert topology(mesh_of(after)) == topology(mesh_of(before))
    rim, kept = (np.unique(surface.places[on_faces(surface)], axis=0) for surface in (before, after))
    np.testing.assert_array_equal(kept, rim)
    away = sphere_sdf(mesh_of(after).vertices[~on_faces(after)] - centre, radius)
    assert np.abs(away).max() < (0.1 + 0.8 * sag) * LATTICE.steps.max()


def test_the_larger_the_sag_the_fewer_vertices_and_without_it_hardly_any_go() -> None:
    before = marched(lambda points: sphere_sdf(points, 0.35))
    counts = [len(merged(before, LATTICE, sag).places) for sag in (0.0, 0.01, 0.03, 0.1)]
    assert counts[0] > 0.99 * len(before.places)
    assert counts == sorted(set(counts), reverse=True)


def test_nothing_is_merged_across_a_sheet_thinner_than_a_step() -> None:
    """Two walls whose vertices lie around the same points of the lattice."""
    tilted = np.array([0.6, 0.8, 0])
    before = marched(lambda points: np.abs(points @ tilted - 0.003) - 0.4 * LATTICE.steps.min())
    after = merged(before, LATTICE, SAG)
    assert topology(mesh_of(after)) == topology(mesh_of(before))
    assert len(after.places) < len(before.places)
    assert signed_volume(mesh_of(after)) > 0.9 * signed_volume(mesh_of(before))


def test_an_edge_keeps_its_vertices() -> None:
    """A wedge whose faces meet at a right angle inside the cuboid: no point of its ridge moves by half a step."""
    wedge = np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0]])
    before = marched(lambda points: (points @ wedge.T).max(axis=1) - 0.05)
    after = merged(before, LATTICE, SAG)
    assert len(after.places) < 0.8 * len(before.places)
    outside = (mesh_of(after).vertices @ wedge.T).max(axis=1)
    inner = ~on_faces(after)
    assert np.abs(outside[inner] - 0.05).max() < 0.5 * LATTICE.steps.max()
    assert abs(signed_volume(mesh_of(after)) / signed_volume(mesh_of(before)) - 1) < 0.002
