"""Latent codes for new shapes, drawn from a density over those of the training shapes (§4.4)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.distance import cdist
from scipy.special import logsumexp, softmax

# Temperatures of the weights that are tried, the least dependent first; of equal ones the first is taken.
TAUS = np.geomspace(10, 1e-3, 41)
# Kernels over Silverman's width, which in 32 dimensions leaves codes as far from every training code as those are from
# each other: networks tear there, and feature distances are no better. At a quarter single parts still fail.
NARROW = 0.125


@dataclass(frozen=True, eq=False)
class LatentKde:
    """Gaussian kernels at the codes, one width a dimension: a full covariance is singular where there are fewer
    codes than dimensions."""

    codes: Float[ndarray, "n d"]
    bandwidth: Float[ndarray, " d"]  # standard deviations of a kernel

    @staticmethod
    def fit(codes: Float[ndarray, "n d"]) -> "LatentKde":
        """NARROW times Silverman's rule in d dimensions: (4 / ((d + 2) n))^(1 / (d + 4)) standard deviations."""
        n, d = codes.shape
        spread = codes.std(axis=0, ddof=1) if n > 1 else np.zeros(d)
        return LatentKde(codes, NARROW * (4 / ((d + 2) * n)) ** (1 / (d + 4)) * spread)

    def uniform(self, count: int) -> Float[ndarray, "m n"]:
        """Equal weights for `count` draws, as the method ⊥ has them."""
        return np.full((count, len(self.codes)), 1 / len(self.codes))

    def sample(
        self, rng: np.random.Generator, weights: Float[ndarray, "m n"], temperature: float
    ) -> Float[ndarray, "m d"]:
        """A code for each row of weights, which say how likely it comes from each kernel and have the sum 1.

        `temperature` scales the kernels' widths; 0 gives codes of training shapes.
        """
        places = rng.random((len(weights), 1)) * weights.sum(axis=1, keepdims=True)
        chosen = (weights.cumsum(axis=1) <= places).sum(axis=1).clip(max=len(self.codes) - 1)
        noise = rng.standard_normal((len(weights), self.codes.shape[1]))
        return self.codes[chosen] + temperature * self.bandwidth * noise

    def log_density(self, points: Float[ndarray, "m d"], weights: Float[ndarray, "m n"]) -> Float[ndarray, " m"]:
        """Log density of each point under its own weights, without the dimensions in which all codes are equal."""
        return _weighted(self._log_kernels(points), weights)

    def leave_one_out(self, distances: Float[ndarray, "n n"], taus: Float[ndarray, " t"]) -> Float[ndarray, " t"]:
        """Mean log density of at least two codes, each under the others, weighted by the nearness of their cages."""
        apart = distances.astype(np.float64)
        np.fill_diagonal(apart, np.inf)
        kernels = self._log_kernels(self.codes)
        return np.array([_weighted(kernels, similarity_weights(apart, tau)).mean() for tau in taus.tolist()])

    def likeliest_tau(self, distances: Float[ndarray, "n n"]) -> float:
        """The one of TAUS under which the codes are likeliest, each given its cage and the other shapes."""
        if len(self.codes) < 3:  # one other shape has all the weight, whatever its distance
            return float(TAUS[0])
        return float(TAUS[self.leave_one_out(distances, TAUS).argmax()])

    def _log_kernels(self, points: Float[ndarray, "m d"]) -> Float[ndarray, "m n"]:
        wide = self.bandwidth > 0
        apart = cdist(points[:, wide] / self.bandwidth[wide], self.codes[:, wide] / self.bandwidth[wide], "sqeuclidean")
        return -apart / 2 - np.log(np.sqrt(2 * np.pi) * self.bandwidth[wide]).sum()


def _weighted(log_kernels: Float[ndarray, "m n"], weights: Float[ndarray, "m n"]) -> Float[ndarray, " m"]:
    return np.asarray(logsumexp(log_kernels, b=weights, axis=1))


@dataclass(frozen=True, eq=False)
class IsotropicGaussian:
    """The density of DeepSDF's codes: a Gaussian with one width for all dimensions."""

    mean: Float[ndarray, " d"]
    deviation: float

    @staticmethod
    def fit(codes: Float[ndarray, "n d"]) -> "IsotropicGaussian":
        """The maximum-likelihood Gaussian of these codes."""
        return IsotropicGaussian(codes.mean(axis=0), float(np.sqrt(codes.var(axis=0).mean())))

    def sample(self, rng: np.random.Generator, count: int, temperature: float) -> Float[ndarray, "m d"]:
        """`temperature` scales the width; 0 gives the mean."""
        return self.mean + temperature * self.deviation * rng.standard_normal((count, len(self.mean)))


def similarity_weights(distances: Float[ndarray, "m n"], tau: float) -> Float[ndarray, "m n"]:
    """softmax(-distance / τ) over each row: the weights of the method that is not ⊥. `tau` > 0, in the distances' unit.

    The paper has no τ, which is τ = 1: distances between cages are far below 1, so that nearly all weights are equal.
    """
    return softmax(-distances / tau, axis=1)


def effective_number(weights: Float[ndarray, "m n"]) -> Float[ndarray, " m"]:
    """Effective number of kernels of each row of weights: 1 / Σ w²; n where all are equal."""
    return 1 / np.square(weights).sum(axis=1)
