"""Familiar cages: known ones, and those as like them as they are to each other, whatever their size and place."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from cagesdf.cage_generation.familiarity import LEAST, USUAL, Familiarity
from cagesdf.cuboid import Cage
from cagesdf.deformation.likeness import relative_boxes
from cagesdf.frames import Similarity


def random_cage(rng: np.random.Generator, parts: int) -> Cage:
    names = tuple(f"part{number}" for number in range(parts))
    axes = np.linalg.qr(rng.normal(size=(parts, 3, 3)))[0]
    axes[np.linalg.det(axes) < 0] *= -1
    return Cage(names, rng.normal(size=(parts, 3)), axes, rng.uniform(0.1, 1, (parts, 3)))


@given(st.integers(0, 1000), st.lists(st.integers(1, 6), min_size=1, max_size=6))
def test_the_limit_is_what_known_shapes_are_to_the_others(seed: int, sizes: list[int]) -> None:
    rng = np.random.default_rng(seed)
    cages = [random_cage(rng, parts) for parts in sizes]
    boxes = [relative_boxes(cage) for cage in cages]
    slow = [
        max(min(cdist(own, other).min(axis=1)[i] for j, other in enumerate(boxes) if j != k) for i in range(len(own)))
        for k, own in enumerate(boxes)
        if len(boxes) > 1
    ]
    wanted = max(LEAST, float(np.quantile(slow, USUAL))) if slow else np.inf
    assert Familiarity.of(cages).limit == pytest.approx(wanted, abs=1e-12)


@given(st.integers(0, 1000), st.integers(1, 5), st.floats(0.1, 10))
def test_known_cages_are_familiar_wherever_they_stand_and_however_large_they_are(
    seed: int, count: int, scale: float
) -> None:
    rng = np.random.default_rng(seed)
    cages = [random_cage(rng, 4) for _ in range(count)]
    familiarity = Familiarity.of(cages)
    moved = cages[-1].transformed(Similarity(scale, np.eye(3), rng.normal(size=3)))
    assert familiarity.strangeness(moved) == pytest.approx(0, abs=1e-9)
    assert familiarity.familiar(moved)


def test_a_cage_is_as_strange_as_its_strangest_part() -> None:
    rng = np.random.default_rng(0)
    known = [random_cage(rng, 5) for _ in range(3)]
    familiarity, new = Familiarity.of(known), random_cage(rng, 4)
    nearest = cdist(relative_boxes(new), np.concatenate([relative_boxes(cage) for cage in known])).min(axis=1)
    assert familiarity.strangeness(new) == pytest.approx(nearest.max())


def test_shapes_that_are_all_the_same_let_new_ones_differ_a_little() -> None:
    def stool(height: float) -> Cage:
        return Cage(
            ("seat", "leg"),
            np.array([[0, 1, 0], [0, height / 2, 0]]),
            np.stack([np.eye(3)] * 2),
            np.array([[1, 0.1, 1], [0.1, height, 0.1]]),
        )

    familiarity = Familiarity.of([stool(0.95)] * 4)
    assert familiarity.limit == LEAST
    assert familiarity.familiar(stool(0.99))
    assert not familiarity.familiar(stool(0.5)), "its leg ends in mid-air"
