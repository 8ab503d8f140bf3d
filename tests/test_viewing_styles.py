"""Principal directions against the eigenvectors of the covariance; sliders that do what they say."""

import numpy as np

from cagesdf.viewing.styles import StyleSpace

CODES = np.random.default_rng(0).normal(size=(40, 6)) @ np.diag([5, 3, 1, 0.5, 0.1, 0.0]) + 2


def test_directions_are_the_covariance_s_by_falling_spread() -> None:
    space = StyleSpace.of(CODES, 4)
    values, vectors = np.linalg.eigh(np.cov(CODES.T))
    np.testing.assert_allclose(space.spread**2, values[::-1][:4])
    np.testing.assert_allclose(np.abs(np.sum(space.directions * vectors.T[::-1][:4], axis=1)), 1)


def test_directions_without_spread_have_no_slider() -> None:
    assert len(StyleSpace.of(CODES, 10).directions) == 5
    assert len(StyleSpace.of(np.ones((3, 6)), 10).directions) == 0


def test_a_slider_goes_where_it_says_and_leaves_the_others() -> None:
    space = StyleSpace.of(CODES, 4)
    code = CODES[7].astype(np.float32)
    there = space.moved(code, 1, 1.5)
    expected = space.places(code)
    expected[1] = 1.5
    np.testing.assert_allclose(space.places(there), expected, atol=1e-5)
    np.testing.assert_allclose(space.moved(there, 1, float(space.places(code)[1])), code, atol=1e-5)


def test_new_codes_without_temperature_are_training_codes() -> None:
    code = StyleSpace.of(CODES, 4).drawn(np.random.default_rng(1), 0.0)
    assert code.dtype == np.float32
    assert np.abs(CODES - code).max(axis=1).min() < 1e-6
