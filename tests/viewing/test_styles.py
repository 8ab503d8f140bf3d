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
    there = space.moved(code, 1, 1.0)
    expected = space.places(code)
    expected[1] = 1.0
    np.testing.assert_allclose(space.places(there), expected, atol=1e-5)
    np.testing.assert_allclose(space.moved(there, 1, float(space.places(code)[1])), code, atol=1e-5)


def test_a_slider_ends_where_the_training_codes_do() -> None:
    space = StyleSpace.of(CODES, 3)
    places = np.stack([space.places(code) for code in CODES.astype(np.float32)])
    np.testing.assert_allclose(space.ends, np.stack([places.min(axis=0), places.max(axis=0)], axis=1), atol=1e-4)
    for direction, (low, high) in enumerate(space.ends):
        for place, end in ((-100.0, low), (100.0, high)):
            moved = space.moved(CODES[3].astype(np.float32), direction, place)
            np.testing.assert_allclose(space.places(moved)[direction], end, atol=1e-4)
