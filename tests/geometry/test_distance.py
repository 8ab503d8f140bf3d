"""Signed distance to closed surfaces: value, sign, and both again on unions."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cagesdf.geometry.distance import SurfaceDistance, morton_order
from cagesdf.geometry.meshes import Mesh, join, weld
from cagesdf.geometry.solid import union
from tests.support import toy
from tests.support.analytic import box_sdf, sphere_sdf

SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS)
def test_distance_to_a_box_is_the_closed_form_sign_included(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.01, 1, 3)
    points = np.concatenate([rng.uniform(-1, 1, (50, 3)), rng.choice([-0.6, -0.5, 0.4], (20, 3)) * size])
    surface = SurfaceDistance(toy.box([0, 0, 0], size))
    np.testing.assert_allclose(surface.signed(points), box_sdf(points, size), atol=1e-12)


def test_distance_to_a_fine_ball_is_nearly_that_to_the_sphere() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (2000, 3))
    surface = SurfaceDistance(toy.ball([0, 0, 0], 0.7, 128))
    assert (
        np.abs(surface.signed(points) - sphere_sdf(points, 0.7)).max() < 7e-4
    )  # the mesh lies inside the sphere by up to 1e-3 of its radius


def test_the_side_told_by_normals_is_the_one_told_by_winding_numbers() -> None:
    """On a union, whose surface has concave edges and slivers; the points lie near edges and vertices too."""
    shape = toy.stool("a")
    solid = union([part.mesh for part in shape.parts])
    rng = np.random.default_rng(0)
    corners = solid.vertices[rng.integers(len(solid.vertices), size=4000)]
    points = np.concatenate([corners + rng.normal(size=(4000, 3)) * 0.003, rng.uniform(-1, 1, (4000, 3))])
    surface = SurfaceDistance(solid)
    signed = surface.signed(points)
    np.testing.assert_array_equal(signed < 0, surface.inside(points))
    np.testing.assert_array_equal(np.abs(signed), surface.unsigned(points))


@given(SEEDS)
def test_the_side_of_a_knife_edge_is_that_of_its_planes(seed: int) -> None:
    """Random tetrahedra, flat ones too: one face's normal misleads at edges sharper than a right angle."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.5, 0.5, (4, 3)) * [1, 1, rng.choice([1, 0.1, 0.01])]
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    if np.linalg.det(corners[1:] - corners[0]) < 0:
        faces = faces[:, ::-1].copy()
    a, b, c = corners[faces].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    points = np.concatenate([corners.repeat(50, 0) + rng.normal(size=(200, 3)) * 0.02, rng.uniform(-1, 1, (50, 3))])
    inside = ((points[:, None] - a) * normals).sum(axis=2).max(axis=1) < 0
    np.testing.assert_array_equal(SurfaceDistance(Mesh(corners, faces)).signed(points) < 0, inside)


def test_where_two_solids_touch_in_an_edge_the_side_is_right() -> None:
    """Four faces meet there, so that no sum of normals tells it."""
    pair = join([toy.box([-0.25, -0.25, 0], [0.5, 0.5, 1]), toy.box([0.25, 0.25, 0], [0.5, 0.5, 1])])
    surface = SurfaceDistance(weld(pair, 1e-9))
    points = np.random.default_rng(0).normal(size=(2000, 3)) * [0.1, 0.1, 0.7]
    inside = (points[:, 0] * points[:, 1] > 0) & (np.abs(points) < 0.5).all(axis=1)
    np.testing.assert_array_equal(surface.signed(points) < 0, inside)


def test_a_face_without_area_does_not_decide_a_side() -> None:
    box = toy.box([0, 0, 0], [1, 1, 1])
    a, b = box.faces[0][:2]
    middle = (box.vertices[a] + box.vertices[b]) / 2
    split = np.concatenate([box.faces, [[a, len(box.vertices), b]]]).astype(np.int32)
    surface = SurfaceDistance(Mesh(np.concatenate([box.vertices, middle[None]]), split))
    points = middle + np.random.default_rng(0).normal(size=(200, 3)) * 0.01
    np.testing.assert_allclose(surface.signed(points), box_sdf(points, [1, 1, 1]), atol=1e-12)


def test_distances_inside_overlaps_are_to_the_outer_surface() -> None:
    pair = union([toy.box([-0.2, 0, 0], [0.6, 1, 1]), toy.box([0.2, 0, 0], [0.6, 1, 1])])
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (500, 3))
    np.testing.assert_allclose(SurfaceDistance(pair).signed(points), box_sdf(points, [1, 1, 1]), atol=1e-9)


def test_signed_distance_has_a_gradient_of_length_one() -> None:
    surface = SurfaceDistance(union([part.mesh for part in toy.stool("a").parts]))
    points = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    step = 1e-6 * np.eye(3)
    gradient = np.stack([surface.signed(points + h) - surface.signed(points - h) for h in step], axis=1) / 2e-6
    length = np.linalg.norm(gradient, axis=1)
    # Not where the nearest point jumps.
    assert (np.abs(length - 1) < 1e-4).mean() > 0.99
    assert length.max() < 1 + 1e-6


@given(SEEDS, st.integers(0, 50))
def test_morton_order_is_a_permutation_and_its_steps_are_short(seed: int, count: int) -> None:
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    assert sorted(morton_order(points)) == list(range(count))


def test_morton_order_visits_octants_one_after_the_other() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (1000, 3))
    octant = (points > 0) @ [4, 2, 1]
    assert (np.diff(octant[morton_order(np.concatenate([points, [[-1, -1, -1], [1, 1, 1]]]))[1:-1]]) >= 0).mean() > 0.98
