"""Polygons become triangles that cover them once, in any pose and size; what can't is refused by its place."""

from collections import Counter
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.errors import InputError
from cagesdf.formats.polygons import MAX_CORNERS, Polygons, triangulated
from cagesdf.geometry.meshes import Mesh, face_normals

SEEDS = st.integers(0, 2**32 - 1)


def mesh_of(points, *loops) -> Mesh:
    corners = np.concatenate([np.asarray(loop, np.int64) for loop in loops])
    return triangulated(
        np.asarray(points, float), Polygons(corners, np.array([len(loop) for loop in loops])), lambda i: f"a, face {i}"
    )


def one(points) -> Mesh:
    """The triangles of a single polygon; corners that coincide stay several vertices."""
    return mesh_of(points, range(len(points)))


def cells(rng: np.random.Generator) -> np.ndarray:
    """The outline of random unit squares side by side: concave, with many corners in line; integers."""
    while True:
        squares = {(0, 0)}
        while len(squares) < 12:
            x, y = sorted(squares)[rng.integers(len(squares))]
            squares.add([(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)][rng.integers(4)])
        after: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for x, y in squares:
            corners = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)]
            for i, (dx, dy) in enumerate([(0, -1), (1, 0), (0, 1), (-1, 0)]):
                if (x + dx, y + dy) not in squares:
                    after.setdefault(corners[i], []).append(corners[(i + 1) % 4])
        # Squares that touch at a corner only, or enclose a hole, have other outlines than one loop.
        if any(len(corners) > 1 for corners in after.values()):
            continue
        outline = [min(after)]
        while (following := after[outline[-1]][0]) != outline[0]:
            outline.append(following)
        if len(outline) == len(after):
            return np.array(outline, float)


def star(rng: np.random.Generator) -> np.ndarray:
    """A polygon around the origin with long and short spikes."""
    count = int(rng.integers(5, 40))
    angles = (np.arange(count) + rng.uniform(0.1, 0.9, count)) / count * 2 * np.pi
    radii = 10.0 ** rng.uniform(-3, 0, count)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)


def posed(outline: np.ndarray, rng: np.random.Generator, size: float = 1.0, offset: float = 0.0) -> np.ndarray:
    flat = np.column_stack([outline, np.zeros(len(outline))])
    return size * (flat @ Rotation.random(random_state=rng).as_matrix().T + offset * rng.normal(size=3))


def doubled_areas(outline: np.ndarray, faces: np.ndarray) -> list[Fraction]:
    """Exact."""
    exact = [[Fraction(x) for x in point] for point in outline.tolist()]
    return [
        (exact[b][0] - exact[a][0]) * (exact[c][1] - exact[a][1])
        - (exact[b][1] - exact[a][1]) * (exact[c][0] - exact[a][0])
        for a, b, c in faces.tolist()
    ]


def rim(faces: np.ndarray) -> Counter[tuple[int, int]]:
    """Directed edges that have no opposite."""
    edges = Counter((a, b) for face in faces.tolist() for a, b in zip(face, face[1:] + face[:1]))
    return edges - Counter({(b, a): count for (a, b), count in edges.items()})


def assert_covers(outline: np.ndarray, faces: np.ndarray) -> None:
    """Triangles of an outline cover it once: as many as there must be, none negative, within the outline's edges."""
    count = len(outline)
    assert len(faces) == count - 2
    assert rim(faces) == Counter((i, (i + 1) % count) for i in range(count))
    areas = doubled_areas(outline, faces)
    assert min(areas) >= 0
    assert sum(areas) == sum(doubled_areas(outline, np.array([[0, i, i + 1] for i in range(1, count - 1)])))


@given(seed=SEEDS)
def test_an_outline_with_corners_in_line_is_covered_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    outline = cells(rng)
    assert_covers(outline, one(np.column_stack([outline, np.zeros(len(outline))])).faces)


@given(seed=SEEDS)
def test_a_spiky_outline_is_covered_exactly_and_turned_over_the_other_way_round(seed: int) -> None:
    outline = star(np.random.default_rng(seed))
    assert_covers(outline, one(np.column_stack([outline, np.zeros(len(outline))])).faces)
    backwards = one(np.column_stack([outline[::-1], np.zeros(len(outline))])).faces
    assert_covers(outline, (len(outline) - 1 - backwards)[:, ::-1])


@given(seed=SEEDS, kind=st.sampled_from([cells, star]), size=st.sampled_from([1e-90, 1e-9, 1.0, 1e9, 1e90]))
def test_pose_and_size_change_nothing(seed: int, kind, size: float) -> None:
    rng = np.random.default_rng(seed)
    outline = kind(rng)
    points = posed(outline, rng, size, offset=10.0)
    faces = one(points).faces
    assert len(faces) == len(outline) - 2
    assert rim(faces) == Counter((i, (i + 1) % len(outline)) for i in range(len(outline)))
    assert min(doubled_areas(outline, faces)) >= -1e-12, "but for what turning rounded"
    whole = face_normals(Mesh(points / size, faces)).sum(0)
    fan = np.cross(points[1:-1] / size - points[0] / size, points[2:] / size - points[0] / size).sum(0)
    np.testing.assert_allclose(whole, fan, atol=1e-9)


@given(seed=SEEDS, kind=st.sampled_from([cells, star]))
def test_no_point_is_covered_twice_or_left_out(seed: int, kind) -> None:
    """A slow, obvious version: even-odd against the triangles that a point lies in."""
    rng = np.random.default_rng(seed)
    outline = kind(rng)
    faces = one(posed(outline, rng)).faces
    points = rng.uniform(outline.min(0), outline.max(0), (200, 2))
    x, y = points.T[:, :, None]
    (x0, y0), (x1, y1) = outline.T, np.roll(outline, -1, axis=0).T
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
    inside = crossings.sum(1) % 2
    a, b, c = outline[faces].transpose(1, 0, 2)

    def left(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return (q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0]) > 0

    np.testing.assert_array_equal((left(a, b) & left(b, c) & left(c, a)).sum(1), inside)


@given(seed=SEEDS, noise=st.sampled_from([1e-16, 1e-12, 1e-8]))
def test_an_outline_that_lies_in_no_plane_exactly_keeps_its_area(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    outline = cells(rng)
    points = posed(outline, rng)
    points += noise * rng.normal(size=points.shape)
    faces = one(points).faces
    area = np.linalg.norm(face_normals(Mesh(points, faces)), axis=1).sum()
    assert area == pytest.approx(24, abs=1e3 * noise), "twelve unit squares, twice"


@pytest.mark.parametrize("thin", [1e-6, 1e-12, 1e-15])
def test_a_thin_outline_is_covered_exactly(thin: float) -> None:
    outline = np.array([[0, 0], [4, 0], [4, 2], [3, 2], [3, 1], [1, 1], [1, 2], [0, 2]], float) * [1, thin]
    assert_covers(outline, one(np.column_stack([outline, np.zeros(8)])).faces)


@given(seed=SEEDS, count=st.integers(3, 12))
def test_a_convex_polygon_is_the_fan_of_its_first_corner(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    angles = (np.arange(count) + rng.uniform(0, 0.5, count)) / count * 2 * np.pi
    faces = one(posed(np.stack([np.cos(angles), 0.5 * np.sin(angles)], axis=1), rng)).faces
    assert faces.tolist() == [[0, i, i + 1] for i in range(1, count - 1)]


@given(seed=SEEDS)
def test_a_face_with_a_slit_to_its_hole_is_covered_once(seed: int) -> None:
    """Its outline runs along the slit twice: as Blender and CAD programs write holes."""
    rng = np.random.default_rng(seed)
    ring = [[0, 0], [3, 0], [3, 3], [0, 3], [0, 0], [1, 1], [1, 2], [2, 2], [2, 1], [1, 1]]
    points = posed(np.array(ring, float), rng)
    areas = np.linalg.norm(face_normals(Mesh(points, one(points).faces)), axis=1) / 2
    assert len(areas) == 8
    assert areas.sum() == pytest.approx(8)


@given(seed=SEEDS, where=st.integers(0, 5))
def test_corners_that_are_there_twice_keep_the_area_and_the_edges(seed: int, where: int) -> None:
    rng = np.random.default_rng(seed)
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float)
    points = posed(np.insert(outline, where, outline[where], axis=0), rng)
    faces = one(points).faces
    assert rim(faces) == Counter((i, (i + 1) % 7) for i in range(7))
    assert np.linalg.norm(face_normals(Mesh(points, faces)), axis=1).sum() == pytest.approx(6)


@pytest.mark.parametrize(
    "points",
    [[[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], [[1, 1, 1]] * 5, [[0, 0, 0], [1, 2, 3], [0, 0, 0], [3, 2, 1]]],
    ids=["in line", "in one place", "there and back"],
)
def test_a_polygon_without_area_becomes_triangles_without_area(points) -> None:
    mesh = one(points)
    assert len(mesh.faces) == len(points) - 2
    np.testing.assert_allclose(face_normals(mesh), 0, atol=1e-15)


def turns(count: int, step: int) -> np.ndarray:
    angles = np.arange(count) * step / count * 2 * np.pi
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def spiral(rounds: float) -> np.ndarray:
    """A band that lies on itself where it is longer than a round; none of its triangles would be negative."""
    angles = np.linspace(0, 2 * np.pi * rounds, 40)
    outer = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([outer, 0.7 * outer[::-1]])


@given(seed=SEEDS)
@pytest.mark.parametrize(
    "outline",
    [
        np.array([[0, 0], [1, 1], [1, 0], [0, 1]]),
        np.array([[0, 0], [1, 1], [1, 0], [0, 2]]),
        turns(5, 2),
        turns(7, 3),
        spiral(1.5),
        np.array([[0, 0], [4, 0], [4, 2], [3, 2], [3, -1], [2, -1], [2, 2], [0, 2]]),
    ],
    ids=["even bow tie", "bow tie", "pentagram", "heptagram", "band", "through its edge"],
)
def test_an_outline_that_crosses_itself_is_refused_by_its_place(outline: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.concatenate([posed(outline.astype(float), rng), rng.normal(size=(3, 3))])
    count = len(outline)
    with pytest.raises(InputError, match="a, face 1: the outline of the face crosses itself"):
        mesh_of(points, [count, count + 1, count + 2], range(count))


@given(seed=SEEDS)
def test_a_small_outline_that_crosses_itself_is_read_with_its_edges(seed: int) -> None:
    """Files of a public collection have some: a hundredth of the mesh at most is wrong then, and nothing is open."""
    rng = np.random.default_rng(seed)
    small = posed(0.02 * turns(5, 2), rng)
    points = np.concatenate([small, np.array([[0, 0, 0], [3, 0, 0], [0, 3, 0]])])
    mesh = mesh_of(points, range(5), [5, 6, 7])
    assert rim(mesh.faces[:3]) == Counter((i, (i + 1) % 5) for i in range(5))


def test_a_band_that_ends_before_it_meets_itself_is_covered() -> None:
    assert_covers(spiral(0.9), one(np.column_stack([spiral(0.9), np.zeros(80)])).faces)


def test_a_quad_that_folds_over_is_split_at_its_shorter_diagonal() -> None:
    points = np.array([[0, 0, 0], [1, 0, 1], [1, 0.1, 0], [0, 0.1, 1.0]])
    assert one(points).faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_faces_keep_their_order_and_their_vertices() -> None:
    rng = np.random.default_rng(0)
    points = np.concatenate(
        [[[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0]], rng.normal(size=(5, 3))]
    )
    mesh = mesh_of(points, [6, 7, 8], [0, 1, 2, 3, 4, 5], [9, 7, 6], [0, 1, 2, 3])
    assert len(mesh.vertices) == 10, "the last vertex is used by no face"
    assert mesh.faces[[0, 5]].tolist() == [[6, 7, 8], [9, 7, 6]]
    assert set(mesh.faces[1:5].ravel()) == set(range(6))
    assert mesh.faces[6:].tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("loop", "said"),
    [
        ([0, 1, 4], "a, face 1: corner 3 of the face is vertex 4 counted from 0, but there are 4"),
        ([0, -1, 1], "a, face 1: corner 2 of the face is vertex -1"),
        ([2**40, 0, 1], "a, face 1: corner 1 .* 1,099,511,627,776"),
        ([0, 1], "a, face 1: the face has 2 corners; wanted at least three"),
        ([], "a, face 1: the face has 0 corners"),
        ([0, 1, 3], r"a, face 1: corner 3 of the face is at \(0, nan, 1\); wanted finite"),
    ],
)
def test_a_wrong_face_is_named(loop: list[int], said: str) -> None:
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, np.nan, 1]]
    with pytest.raises(InputError, match=said):
        mesh_of(points, [0, 1, 2], loop)


@pytest.mark.parametrize("bad", [np.inf, -np.inf, 1e101])
def test_numbers_that_are_no_places_are_refused_where_a_face_uses_them(bad: float) -> None:
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [bad, 0, 0]]
    assert len(mesh_of(points, [0, 1, 2]).vertices) == 3
    with pytest.raises(InputError, match="a, face 0: corner 1"):
        mesh_of(points, [3, 0, 1])


def test_a_huge_face_is_read_if_it_is_convex_and_refused_otherwise() -> None:
    count = MAX_CORNERS + 2
    outline = np.column_stack([turns(count, 1), np.zeros(count)])
    assert len(one(outline).faces) == count - 2
    outline[::2] *= 0.5
    with pytest.raises(InputError, match="a, face 0: the face has 10,002 corners and isn't convex"):
        one(outline)
