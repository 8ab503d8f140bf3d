"""The densities that codes are drawn from: laws of densities, and of weights."""

import numpy as np
import pytest
from scipy.stats import gaussian_kde, multivariate_normal

from cagesdf.cage_generation.latent_kde import (
    NARROW,
    TAUS,
    IsotropicGaussian,
    LatentKde,
    effective_number,
    similarity_weights,
)


def codes(n: int = 40, d: int = 3) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(n, d)) * [1.0, 0.1, 3.0][:d] + [5.0, 0.0, -1.0][:d]


def test_the_density_of_one_dimension_is_scipys_with_a_share_of_silvermans_rule() -> None:
    known = codes(d=1)
    kde = LatentKde.fit(known)
    places = np.linspace(3, 7, 50)[:, None]
    expected = gaussian_kde(known[:, 0], lambda density: NARROW * density.silverman_factor())(places[:, 0])
    np.testing.assert_allclose(np.exp(kde.log_density(places, kde.uniform(50))), expected, rtol=1e-10, atol=1e-300)


def test_the_density_integrates_to_one_whatever_the_weights() -> None:
    kde = LatentKde.fit(codes(n=8, d=2))
    weights = np.random.default_rng(1).dirichlet(np.ones(8))
    x, y = np.linspace(-5, 15, 900), np.linspace(-1.5, 1.5, 900)
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    density = np.exp(kde.log_density(places, np.tile(weights, (len(places), 1))))
    assert density.sum() * (x[1] - x[0]) * (y[1] - y[0]) == pytest.approx(1, abs=1e-3)


def test_the_density_is_a_sum_of_normal_ones() -> None:
    kde = LatentKde.fit(codes(n=5))
    weights = np.random.default_rng(1).dirichlet(np.ones(5))
    point = np.array([4.0, 0.1, 0.0])
    slow = sum(w * multivariate_normal(c, np.diag(kde.bandwidth**2)).pdf(point) for w, c in zip(weights, kde.codes))
    assert np.exp(kde.log_density(point[None], weights[None]))[0] == pytest.approx(slow)


def test_samples_have_the_mean_of_the_codes_and_their_covariance_and_the_kernels() -> None:
    kde = LatentKde.fit(codes())
    drawn = kde.sample(np.random.default_rng(2), kde.uniform(200_000), 1.0)
    np.testing.assert_allclose(drawn.mean(axis=0), kde.codes.mean(axis=0), atol=0.03)
    expected = np.cov(kde.codes.T, bias=True) + np.diag(kde.bandwidth**2)
    spread = kde.codes.std(axis=0)
    np.testing.assert_allclose(
        np.cov(drawn.T) / np.outer(spread, spread), expected / np.outer(spread, spread), atol=0.03
    )


def test_temperature_scales_the_kernels_and_at_zero_codes_are_known_ones() -> None:
    kde = LatentKde.fit(codes())
    cold = kde.sample(np.random.default_rng(3), kde.uniform(50), 0.0)
    assert {tuple(code) for code in cold} <= {tuple(code) for code in kde.codes}
    warm, hot = (kde.sample(np.random.default_rng(3), kde.uniform(50), t) for t in (1.0, 2.0))
    np.testing.assert_allclose(hot - cold, 2 * (warm - cold))


def test_a_kernel_without_weight_is_never_drawn() -> None:
    kde = LatentKde.fit(codes(n=4))
    weights = np.tile([0.0, 0.5, 0.0, 0.5], (1000, 1))
    cold = kde.sample(np.random.default_rng(4), weights, 0.0)
    assert {tuple(code) for code in cold} == {tuple(kde.codes[1]), tuple(kde.codes[3])}


def test_one_code_alone_is_drawn_as_it_is() -> None:
    kde = LatentKde.fit(np.array([[1.0, 2.0]]))
    np.testing.assert_array_equal(kde.sample(np.random.default_rng(0), kde.uniform(2), 1.0), [[1, 2], [1, 2]])
    assert kde.likeliest_tau(np.zeros((1, 1))) == TAUS[0]


def test_weights_have_the_sum_one_and_the_nearest_weighs_most() -> None:
    distances = np.array([[0.3, 0.1, 0.2], [0.0, 5.0, 1.0]])
    for tau in (0.01, 1.0, 100.0):
        weights = similarity_weights(distances, tau)
        np.testing.assert_allclose(weights.sum(axis=1), 1)
        np.testing.assert_array_equal(weights.argmax(axis=1), [1, 0])
    np.testing.assert_allclose(
        similarity_weights(distances, 1.0)[0], np.exp([-0.3, -0.1, -0.2]) / np.exp([-0.3, -0.1, -0.2]).sum()
    )


def test_dependent_draws_become_independent_ones_as_tau_grows_and_the_nearest_shapes_as_it_falls() -> None:
    kde = LatentKde.fit(codes(n=6))
    distances = np.random.default_rng(5).random((20, 6))
    drawn = kde.sample(np.random.default_rng(6), similarity_weights(distances, 1e9), 1.0)
    np.testing.assert_array_equal(drawn, kde.sample(np.random.default_rng(6), kde.uniform(20), 1.0))
    cold = kde.sample(np.random.default_rng(6), similarity_weights(distances, 1e-6), 0.0)
    np.testing.assert_array_equal(cold, kde.codes[distances.argmin(axis=1)])


def test_the_effective_number_is_that_of_equal_weights() -> None:
    np.testing.assert_allclose(effective_number(np.array([[0.25] * 4, [0.5, 0.5, 0, 0], [1.0, 0, 0, 0]])), [4, 2, 1])


def test_leaving_one_out_is_the_density_under_the_others() -> None:
    kde = LatentKde.fit(codes(n=6))
    distances = np.random.default_rng(7).random((6, 6))
    found = []
    for i in range(6):
        others = [j for j in range(6) if j != i]
        weights = similarity_weights(distances[i : i + 1, others], 0.3)
        left = LatentKde(kde.codes[others], kde.bandwidth)
        found.append(left.log_density(kde.codes[i : i + 1], weights)[0])
    assert kde.leave_one_out(distances, np.array([0.3]))[0] == pytest.approx(np.mean(found))


def test_the_likeliest_tau_is_small_where_cages_tell_codes_and_large_where_they_do_not() -> None:
    rng = np.random.default_rng(8)
    place = rng.random(60)
    apart = np.abs(place[:, None] - place)
    telling = np.stack([10 * place, -10 * place], axis=1) + 0.01 * rng.normal(size=(60, 2))
    assert LatentKde.fit(telling).likeliest_tau(apart) < 0.1
    assert LatentKde.fit(rng.normal(size=(60, 2))).likeliest_tau(apart) > 0.1


def test_an_isotropic_gaussian_has_the_codes_mean_and_mean_variance() -> None:
    gaussian = IsotropicGaussian.fit(codes())
    drawn = gaussian.sample(np.random.default_rng(9), 100_000, 1.0)
    np.testing.assert_allclose(drawn.mean(axis=0), codes().mean(axis=0), atol=0.03)
    np.testing.assert_allclose(drawn.var(axis=0), codes().var(axis=0).mean(), rtol=0.02)
    np.testing.assert_array_equal(gaussian.sample(np.random.default_rng(9), 2, 0.0), np.tile(gaussian.mean, (2, 1)))
