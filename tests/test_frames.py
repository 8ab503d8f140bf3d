"""The canonical frame and the way there and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.errors import InputError
from cagesdf.frames import UP_AXES, Similarity, canonical_similarity

scales = st.floats(1e-3, 1e4)
seeds = st.integers(0, 2**32 - 1)


@given(seed=seeds, scale=scales, up=st.sampled_from(["y", "z"]))
def test_a_shape_in_any_unit_ends_centred_in_the_unit_sphere(seed: int, scale: float, up: str) -> None:
    rng = np.random.default_rng(seed)
    raw = scale * (rng.normal(size=(20, 3)) + 10 * rng.normal(size=3))
    canonical = canonical_similarity(raw, up).to_canonical(raw)
    np.testing.assert_allclose(canonical.min(0) + canonical.max(0), 0, atol=1e-9)
    assert np.linalg.norm(canonical, axis=1).max() == pytest.approx(1)


@given(seed=seeds, scale=scales, up=st.sampled_from(["y", "z"]))
def test_raw_to_canonical_and_back_is_the_identity(seed: int, scale: float, up: str) -> None:
    raw = scale * np.random.default_rng(seed).normal(size=(20, 3))
    similarity = canonical_similarity(raw, up)
    np.testing.assert_allclose(similarity.to_raw(similarity.to_canonical(raw)), raw, atol=1e-9 * scale)
    again = Similarity.from_numbers(similarity.to_numbers())
    np.testing.assert_array_equal(again.to_canonical(raw), similarity.to_canonical(raw))


def test_z_up_files_stand_upright_and_keep_their_handedness() -> None:
    assert np.linalg.det(UP_AXES["z"]) == pytest.approx(1)
    raw = np.array([[0, 0, 0], [0, 0, 2], [1, 0, 0], [0, 1, 0.0]])
    canonical = canonical_similarity(raw, "z").to_canonical(raw)
    assert canonical[1, 1] > canonical[0, 1], "up is +y"
    assert canonical[3, 2] < canonical[0, 2], "what was behind (+y) stays behind (−z)"


@pytest.mark.parametrize("bad", [np.zeros((0, 3)), np.full((4, 3), np.nan), np.ones((4, 3)), np.full((4, 3), 1e12)])
def test_a_shape_without_extent_or_with_nan_is_refused(bad: np.ndarray) -> None:
    with pytest.raises(InputError):
        canonical_similarity(bad, "y")


def test_an_unknown_up_axis_is_named() -> None:
    with pytest.raises(InputError, match="'x'"):
        canonical_similarity(np.eye(3), "x")


def test_one_similarity_then_another_is_both_in_turn() -> None:
    rng = np.random.default_rng(0)
    first, second = (
        Similarity(float(rng.uniform(0.5, 2)), Rotation.random(random_state=i).as_matrix(), rng.normal(size=3))
        for i in (1, 2)
    )
    points = rng.normal(size=(9, 3))
    both = first.then(second)
    np.testing.assert_allclose(both.to_canonical(points), second.to_canonical(first.to_canonical(points)), atol=1e-12)
    np.testing.assert_allclose(both.to_raw(both.to_canonical(points)), points, atol=1e-12)


def test_a_similarity_is_read_from_thirteen_finite_numbers_only() -> None:
    numbers = Similarity(2.0, np.eye(3), np.arange(3.0)).to_numbers()
    assert Similarity.from_numbers(numbers).to_numbers() == numbers
    for wrong in (numbers[:-1], [*numbers, 1.0], [float("nan"), *numbers[1:]]):
        with pytest.raises(InputError, match="13 finite numbers"):
            Similarity.from_numbers(wrong)
