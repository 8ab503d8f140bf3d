"""Marching cubes beside scikit-image's, and the laws of its table."""

from collections import Counter
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.measure import marching_cubes

from cagesdf.cuboid import Cuboid
from cagesdf.extraction import table
from cagesdf.extraction.lattice import Lattice, strides_of
from cagesdf.extraction.marching import crossed_cells, march, triangles
from cagesdf.geometry.meshes import Mesh, edge_keys, signed_volume, topology
from tests.support.analytic import box_sdf, sphere_sdf


def padded(values: np.ndarray) -> np.ndarray:
    return np.pad(values.astype(np.float32), 1, constant_values=1)


def halfway(values: np.ndarray) -> Mesh:
    """Marching cubes of signs alone: each vertex halfway along its edge."""
    (low, axes), corners = triangles(*crossed_cells(values), values.shape)
    places = np.stack(np.unravel_index(low, values.shape), axis=1) + 0.5 * np.eye(3)[axes]
    return Mesh(places, corners.T)


def slowly(values: np.ndarray) -> Mesh:
    signs = np.where(values < 0, np.float32(-1), np.float32(1))
    vertices, faces, _, _ = marching_cubes(signs, level=0.0, gradient_direction="descent", method="lorensen")
    return Mesh(vertices.astype(np.float64), faces)


def sorted_rows(rows: np.ndarray) -> np.ndarray:
    return rows[np.lexsort(rows.T)]


def assert_closed_and_manifold(mesh: Mesh) -> None:
    forth, back = edge_keys(mesh)
    np.testing.assert_array_equal(forth, back)
    assert (forth[1:] != forth[:-1]).all()
    a, b, c = mesh.faces.T
    assert ((a != b) & (b != c) & (c != a)).all()


def assert_like_the_slow_one(values: np.ndarray) -> None:
    fast, slow = halfway(values), slowly(values)
    np.testing.assert_array_equal(sorted_rows(fast.vertices), sorted_rows(slow.vertices))
    assert len(fast.faces) == len(slow.faces)
    assert topology(fast) == topology(slow)
    assert_closed_and_manifold(fast)


@given(seed=st.integers(0, 10**6), size=st.tuples(*[st.integers(1, 7)] * 3), share=st.floats(0.05, 1))
@settings(max_examples=60, deadline=None)
def test_any_signs_give_the_vertices_and_topology_of_scikit_image(
    seed: int, size: tuple[int, int, int], share: float
) -> None:
    """Noise has all ambiguous faces, and cells of each of the 256 codes."""
    values = np.random.default_rng(seed).random(size) - share
    values.flat[0] = -1
    assert_like_the_slow_one(padded(values))


@pytest.mark.parametrize("sdf", [lambda p: sphere_sdf(p, 0.31), lambda p: box_sdf(p, [0.5, 0.3, 0.55])])
def test_solids_have_the_volume_that_scikit_image_gives(sdf) -> None:
    lattice = Lattice.of(Cuboid(np.zeros(3), np.eye(3), np.full(3, 0.7)), 0.02, 1)
    values = padded(sdf(lattice.points(np.argwhere(np.ones(lattice.shape)))).reshape(lattice.shape))
    assert_like_the_slow_one(values)
    assert signed_volume(halfway(values)) == pytest.approx(signed_volume(slowly(values)), rel=1e-3)
    marched = march(values, lattice)
    true = 4 / 3 * np.pi * 0.31**3 if sdf(np.zeros((1, 3)))[0] == -0.31 else 0.5 * 0.3 * 0.55
    assert signed_volume(Mesh(lattice.points(marched.places), marched.faces)) == pytest.approx(true, rel=0.01)


@given(seed=st.integers(0, 10**6), size=st.tuples(*[st.integers(2, 6)] * 3), share=st.floats(0.1, 0.9))
@settings(max_examples=60, deadline=None)
def test_vertices_beyond_the_cuboid_meet_at_points_of_the_lattice(
    seed: int, size: tuple[int, int, int], share: float
) -> None:
    """Against doing it vertex by vertex: the same places and faces, as sets."""
    rng = np.random.default_rng(seed)
    values = padded(rng.random(size) - share)
    values[2, 2, 2] = -0.5
    cells = np.array(size) - 1
    lattice = Lattice(Cuboid(np.zeros(3), np.eye(3), cells.astype(float)), cells)
    marched, signs = march(values, lattice), halfway(values)

    def place(vertex: np.ndarray) -> tuple[float, ...]:
        low, high = np.floor(vertex).astype(int), np.ceil(vertex).astype(int)
        below, above = (float(values[tuple(end)]) for end in (low, high))
        share = min(max(below / (below - above), 1e-3), 1 - 1e-3)
        return tuple((low - 1 + share * (high - low)).clip(0, cells).tolist())

    places = [place(vertex) for vertex in signs.vertices]
    faces = Counter(frozenset(places[k] for k in face) for face in signs.faces.tolist())
    result = [tuple(row) for row in marched.places.tolist()]
    assert len(set(result)) == len(result)
    assert Counter(frozenset(result[k] for k in face) for face in marched.faces.tolist()) == Counter(
        {face: count for face, count in faces.items() if len(face) == 3}
    )
    on_points = {tuple(row) for row in result if all(x in (0, n) or x % 1 == 0 for x, n in zip(row, cells))}
    assert len(marched.clipped) >= len(on_points)
    forth, back = edge_keys(Mesh(marched.places, marched.faces))
    np.testing.assert_array_equal(forth, back)


def test_cells_in_which_all_corners_agree_are_not_looked_at() -> None:
    values = np.full((5, 6, 7), np.float32(1))
    assert len(crossed_cells(values)[0]) == 0
    values[2, 3, 3] = -1
    cells, codes = crossed_cells(values)
    first = np.ravel_multi_index((2, 3, 3), values.shape)
    expected = sorted(first - np.array(table.CORNERS) @ strides_of(values.shape))
    assert cells.tolist() == expected
    assert sorted(codes.tolist()) == [1 << k for k in range(8)]


@pytest.mark.parametrize("code", range(256))
def test_each_loop_of_a_cell_is_a_disc_with_no_diagonal_on_a_face_of_the_cell(code: int) -> None:
    """Its border is the lines on the cell's faces, so that the next cell has them the other way round."""
    loops = table.loops(code)
    crossed = [e for e, (axis, low) in enumerate(table.EDGES) if (code >> low ^ code >> low + (4, 2, 1)[axis]) & 1]
    assert sorted(edge for loop in loops for edge in loop) == crossed
    faces = table.TRIANGLES[code]
    assert len(faces) == sum(len(loop) - 2 for loop in loops)
    sides = Counter(side for a, b, c in faces for side in ((a, b), (b, c), (c, a)))
    border = {side for loop in loops for side in zip(loop, [*loop[1:], loop[0]])}
    assert {side for side in sides if side[::-1] not in sides} == border
    assert max(sides.values(), default=1) == 1
    for a, b in {pair for triangle in faces for pair in combinations(triangle, 2)}:
        assert (a, b) in border or (b, a) in border or not table.share_a_face(a, b)


@pytest.mark.parametrize("corner", range(8))
def test_one_inside_corner_is_cut_off_with_the_triangle_facing_away_from_it(corner: int) -> None:
    [triangle] = table.TRIANGLES[1 << corner]
    ends = np.array([np.array(table.CORNERS[low]) + 0.5 * np.eye(3)[axis] for axis, low in table.EDGES])
    a, b, c = ends[list(triangle)]
    assert np.cross(b - a, c - a) @ (a - table.CORNERS[corner]) > 0
