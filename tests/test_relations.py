"""Relations follow parts to other places."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation as Turn

from cagesdf.structure.relations import Adjacency, Reflection, Rotation, Translation

A, B = np.array([0.3, 0.2, -0.1]), np.array([-0.4, 0.5, 0.7])


def test_the_mirror_between_two_centres_takes_one_to_the_other() -> None:
    mirror = Reflection("a", "b", (9.0, 9.0, 9.0), (1.0, 0.0, 0.0)).between(A, B)
    normal, point = np.array(mirror.normal), np.array(mirror.point)
    assert np.allclose(A - 2 * ((A - point) @ normal) * normal, B)


def test_the_mirror_of_a_part_that_is_its_own_image_keeps_its_direction() -> None:
    mirror = Reflection("a", "a", (9.0, 9.0, 9.0), (0.0, 0.0, 1.0)).between(A, A)
    assert mirror.normal == (0.0, 0.0, 1.0)
    assert np.allclose(mirror.point, A)


def test_the_way_between_two_centres_is_the_translation() -> None:
    assert np.allclose(A + Translation("a", "b", (9.0, 9.0, 9.0)).between(A, B).offset, B)


@pytest.mark.parametrize("angle", [0.3, 2 * np.pi / 3, -1.2, np.pi])
def test_the_pivot_between_two_centres_turns_one_to_the_other(angle: float) -> None:
    axis = np.array([0.0, 1.0, 0.0])
    level = np.array([B[0], A[1], B[2]])
    turn = Rotation("a", "b", (9.0, 9.0, 9.0), (0.0, 1.0, 0.0), angle).between(A, level)
    pivot = np.array(turn.pivot)
    assert np.allclose(pivot + Turn.from_rotvec(angle * axis).apply(A - pivot), level)


def test_what_touches_still_touches() -> None:
    assert Adjacency("a", "b", 0.2).between(A, B) == Adjacency("a", "b", 0.2)
