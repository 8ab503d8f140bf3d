"""Rays meet the cuboids that a walk along them meets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage
from cagesdf.viewing.picking import along, entries

FAR, STEPS = 4.0, 4001


def a_cage(rng: np.random.Generator, parts: int) -> Cage:
    return Cage(
        tuple(f"part_{i}" for i in range(parts)),
        rng.uniform(-0.5, 0.5, (parts, 3)),
        Rotation.random(parts, rng=rng).as_matrix(),
        rng.uniform(0.05, 0.8, (parts, 3)),
    )


@given(st.integers(0, 2**32 - 1))
def test_a_ray_enters_where_a_walk_along_it_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cage, origin, direction = a_cage(rng, 5), rng.normal(size=3), rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    walk = np.linspace(0, FAR, STEPS)
    inside = cage.signed_distance(origin + walk[:, None] * direction) <= 0
    found = entries(cage, origin, direction)
    step = FAR / (STEPS - 1)
    for cuboid in range(5):
        if inside[:, cuboid].any():
            first = walk[inside[:, cuboid].argmax()]
            assert first - step - 1e-9 <= found[cuboid] <= first + 1e-9
        elif np.isfinite(found[cuboid]):  # a corner between two steps, or beyond the walk
            there = cage.signed_distance(origin + (found[cuboid]) * direction[None])[0, cuboid]
            assert abs(there) < 1e-9


@pytest.mark.parametrize("axis", range(3))
def test_rays_along_an_axis_meet_what_they_are_in_front_of(axis: int) -> None:
    cage = Cage(("a",), np.zeros((1, 3)), np.eye(3)[None], np.array([[1.0, 2.0, 3.0]]))
    ahead, beside = -5 * np.eye(3)[axis], -5 * np.eye(3)[axis] + 5 * np.eye(3)[axis - 1]
    assert entries(cage, ahead, np.eye(3)[axis]).tolist() == [5 - (axis + 1) / 2]
    assert entries(cage, beside, np.eye(3)[axis]).tolist() == [np.inf]
    assert entries(cage, ahead, -np.eye(3)[axis]).tolist() == [np.inf]
    assert entries(cage, np.zeros(3), np.eye(3)[axis]).tolist() == [0.0]


def test_the_nearest_comes_first_whatever_the_order_of_parts() -> None:
    rng = np.random.default_rng(0)
    cage = a_cage(rng, 12)
    for _ in range(100):
        origin, direction = rng.normal(size=3), rng.normal(size=3)
        found, order = along(cage, origin, direction), rng.permutation(12)
        again = Cage.of({cage.part_ids[i]: cage[cage.part_ids[i]] for i in order})
        assert found == along(again, origin, direction)
        ways = dict(zip(cage.part_ids, entries(cage, origin, direction)))
        assert [ways[part] for part in found] == sorted(way for way in ways.values() if np.isfinite(way))
