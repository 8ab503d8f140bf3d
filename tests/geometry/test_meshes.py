"""Meshes: welding, closedness, volume and sampling, against slow obvious versions."""

from collections import Counter

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from cagesdf.geometry.meshes import Mesh, face_areas, is_closed, join, sample_surface, signed_volume, topology, weld
from tests.support import toy

SEEDS = st.integers(0, 2**32 - 1)


def soup(mesh: Mesh) -> Mesh:
    """The same faces, no vertex shared."""
    return Mesh(mesh.corners().reshape(-1, 3), np.arange(3 * len(mesh.faces), dtype=np.int32).reshape(-1, 3))


def slow_is_closed(mesh: Mesh) -> bool:
    edges = Counter((int(a), int(b)) for face in mesh.faces for a, b in zip(face, np.roll(face, -1)))
    return bool(edges) and all(edges[a, b] == edges[b, a] for a, b in edges)


@given(SEEDS, st.integers(0, 12))
def test_closedness_is_that_of_counting_edges_one_by_one(seed: int, dropped: int) -> None:
    rng = np.random.default_rng(seed)
    box = toy.box([0, 0, 0], [1, 2, 3])
    faces = box.faces[rng.permutation(12)[dropped // 4 :]]
    flip = rng.random(len(faces)) < (0.5 if dropped % 4 == 3 else 0)
    faces = np.where(flip[:, None], faces[:, ::-1], faces).astype(np.int32)
    mesh = Mesh(box.vertices, faces)
    assert is_closed(mesh) == slow_is_closed(mesh)


def test_a_closed_mesh_is_told_from_an_opened_a_flipped_and_an_empty_one() -> None:
    ball = toy.ball([0, 0, 0], 1)
    flipped_face = ball.faces.copy()
    flipped_face[0] = flipped_face[0][::-1]
    assert is_closed(ball)
    assert not is_closed(Mesh(ball.vertices, ball.faces[1:]))
    assert not is_closed(Mesh(ball.vertices, flipped_face))
    assert not is_closed(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)))


@given(SEEDS)
def test_welding_a_soup_restores_the_closed_mesh(seed: int) -> None:
    noise = np.random.default_rng(seed).uniform(-1e-7, 1e-7, (36, 3))
    box = soup(toy.box([0.00005, 0.00005, 0.00005], [1, 2, 3]))
    welded = weld(box.with_vertices(box.vertices + noise), 1e-4)
    assert is_closed(welded)
    assert len(welded.vertices) == 8
    assert signed_volume(welded) == pytest.approx(6, abs=1e-5)


def test_welding_keeps_a_face_that_comes_in_both_windings_once() -> None:
    box = toy.box([0, 0, 0], [1, 1, 1])
    doubled = Mesh(box.vertices, np.concatenate([box.faces, box.faces[:, ::-1]]))
    assert len(weld(doubled, 1e-6).faces) == 12
    assert is_closed(weld(doubled, 1e-6))


def test_welding_drops_faces_that_collapse_and_vertices_that_nothing_uses() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 1e-9], [5, 5, 5]])
    welded = weld(Mesh(vertices, np.array([[0, 1, 2], [1, 3, 0]], dtype=np.int32)), 1e-6)
    assert len(welded.faces) == 1
    assert len(welded.vertices) == 3


@given(SEEDS)
def test_volume_does_not_depend_on_the_place_and_changes_sign_with_the_winding(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.1, 2, 3)
    mesh = toy.box(rng.uniform(-100, 100, 3), size)
    assert signed_volume(mesh) == pytest.approx(size.prod(), rel=1e-6)
    assert signed_volume(Mesh(mesh.vertices, mesh.faces[:, ::-1])) == pytest.approx(-size.prod(), rel=1e-6)


def test_joining_keeps_all_faces_and_joins_none() -> None:
    pair = join([toy.box([0, 0, 0], [1, 1, 1]), toy.ball([3, 0, 0], 1)])
    assert signed_volume(pair) == pytest.approx(1 + signed_volume(toy.ball([3, 0, 0], 1)))
    assert len(join([]).faces) == 0


def test_samples_lie_on_their_faces_and_fall_by_area() -> None:
    mesh = toy.box([0, 0, 0], [1, 2, 4])
    points, faces = sample_surface(mesh, 20000, np.random.default_rng(0))
    a, b, c = mesh.corners()[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    assert np.abs(np.einsum("nd,nd->n", points - a, normals)).max() < 1e-12
    share = np.bincount(faces, minlength=12) / 20000
    np.testing.assert_allclose(share, face_areas(mesh) / face_areas(mesh).sum(), atol=0.01)


def test_a_surface_without_area_can_not_be_sampled() -> None:
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], dtype=np.int32))
    with pytest.raises(ValueError, match="no area"):
        sample_surface(flat, 5, np.random.default_rng(0))


def test_any_number_of_vertices_in_one_place_are_one_and_too_many_near_ones_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A fan as loose triangles: pairs of its centre's copies would fill the memory."""
    around = np.linspace(0, 2 * np.pi, 20_001)
    rim = np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    corners = np.stack([np.zeros_like(rim[1:]), rim[:-1], rim[1:]], axis=1)
    fan = Mesh(corners.reshape(-1, 3), np.arange(60_000, dtype=np.int32).reshape(-1, 3))
    assert len(weld(fan, 1e-7).vertices) == 20_001 + 1 - 1
    monkeypatch.setattr("cagesdf.geometry.meshes.MAX_PAIRS", 1000)
    with pytest.raises(ValueError, match=r"nearer than 0\.01"):
        weld(fan, 0.01)


def test_topology_counts_closed_surfaces_and_their_handles() -> None:
    sphere, ring = trimesh.creation.icosphere(1), trimesh.creation.torus(1.0, 0.3)
    one, two = (Mesh(np.array(solid.vertices), np.array(solid.faces, np.int32)) for solid in (sphere, ring))
    away = two.with_vertices(two.vertices + np.array([4.0, 0, 0]))
    assert topology(one) == (1, 0)
    assert topology(two) == (1, 1)
    assert topology(join([one, two, away])) == (3, 2)
