"""The distance between cages: a distance, and the one between their surfaces."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cagesdf.cage_generation.cage_distance import cage_distances
from cagesdf.cuboid import Cage, Cuboid
from cagesdf.geometry.meshes import Mesh, join, sample_surface
from cagesdf.geometry.solid import CUBE_FACES
from cagesdf.structure.executor import execute
from tests.support import programs

CHAIR, GROWN = execute(programs.CHAIR), execute(programs.GROWN)


def cube(x: float = 0.0, side: float = 1.0) -> Cage:
    return Cage.of({"a": Cuboid(np.array([x, 0, 0]), np.eye(3), np.full(3, side))})


def test_equal_cages_are_nothing_apart_whatever_their_axes_are_called() -> None:
    other = Cage.of(
        {
            name: cuboid.permuted(np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]))
            for name, cuboid in CHAIR.cuboids().items()
        }
    )
    np.testing.assert_allclose(cage_distances([CHAIR, GROWN], [other, GROWN]).diagonal(), 0, atol=1e-12)


def test_the_distance_is_symmetric_and_grows_with_the_unit() -> None:
    apart = cage_distances([CHAIR, GROWN, cube()], [CHAIR, GROWN, cube()])
    np.testing.assert_allclose(apart, apart.T)
    assert (apart[~np.eye(3, dtype=bool)] > 0).all()
    twice = [Cage(cage.part_ids, 2 * cage.centre, cage.axes, 2 * cage.size) for cage in (CHAIR, GROWN)]
    assert cage_distances(twice[:1], twice[1:])[0, 0] == pytest.approx(2 * apart[0, 1])


def test_concentric_cubes_are_apart_what_they_differ_by() -> None:
    # Each face of the smaller is 0.25 from the larger, whose faces are as far from it, and their rims further.
    inner = 0.25
    found = cage_distances([cube()], [cube(side=0.5)])[0, 0]
    assert 2 * inner < found < 2.5 * inner


def test_it_is_near_the_chamfer_distance_of_many_random_points() -> None:
    rng = np.random.default_rng(0)
    clouds = [
        sample_surface(join([Mesh(corners, CUBE_FACES) for corners in cage.corners()]), 40_000, rng)[0]
        for cage in (CHAIR, GROWN)
    ]
    slow = sum(cKDTree(b).query(a)[0].mean() for a, b in (clouds, clouds[::-1]))
    assert cage_distances([CHAIR], [GROWN])[0, 0] == pytest.approx(slow, rel=0.1)
