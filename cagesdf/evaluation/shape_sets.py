"""How near a set of generated shapes comes to the shapes that it should be like (§4.4, Table 3)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

VERSION = 1
FEATURES = ("fd", "kpd")  # that need features alone
FIGURES = (
    *FEATURES, "gen", "cov", "var", "gen_squared", "cov_squared", "var_squared", "coverage", "told_apart",
)  # fmt: skip
# Figures of a set without any shape: the worst where there is one, undefined where distances have no end.
NOTHING = {
    **dict.fromkeys(FIGURES, float("nan")),
    **dict.fromkeys(("gen", "var", "gen_squared", "var_squared", "coverage"), 0.0),
    "told_apart": 1.0,
}


@dataclass(frozen=True, eq=False)
class Described:
    """A set of shapes as figures need them.

    A shape that failed is, in place of a surface, a cloud whose points are all at the origin, with its features.
    """

    points: Float[ndarray, "n p 3"]  # on each surface; float32, canonical
    features: Float[ndarray, "n d"]  # a classifier's
    failed: Bool[ndarray, " n"]  # has no surface

    def __len__(self) -> int:
        return len(self.points)

    def of(self, rows: Int[ndarray, " k"]) -> "Described":
        """Some of the shapes."""
        return Described(self.points[rows], self.features[rows], self.failed[rows])


@dataclass(frozen=True, eq=False)
class Draw:
    """References, equal in number to the generated shapes: for metrics of two sets of one size."""

    rows: Int[ndarray, " k"]  # among the references
    within: Float[ndarray, "k k"]  # squared Chamfer distances between them


@dataclass(frozen=True, eq=False)
class Scored:
    """The figures of one set of generated shapes, and how far each of them is from the training shapes."""

    figures: dict[str, float]  # by name, see FIGURES
    nearest: Int[ndarray, " n"]  # row of the nearest training shape
    distance: Float[ndarray, " n"]  # unsquared Chamfer distance to it, canonical units; infinite for a failed shape


def definitions(points: int, feature_points: int, draws: int, seed: int) -> dict[str, Any]:
    """How figures are measured, for files and tables."""
    return {
        "version": VERSION,
        "points": points,
        "feature_points": feature_points,
        "draws": draws,
        "seed": seed,
        "frame": "canonical; nothing is aligned or rescaled",
        "unsquared": "half the sum of the mean distances to the nearest point, both ways, canonical units",
        "squared": "the sum of the mean squared distances to the nearest point, both ways, squared canonical units",
        "failures": "counted as clouds at the origin in fd, kpd and cov; 0 in gen and var; told apart; cover nothing",
    }


def drawn(reference: Described, count: int, most: int, rng: np.random.Generator) -> list[Draw]:
    """At most `most` disjoint draws of `count` references."""
    order = rng.permutation(len(reference))
    parts = [order[i * count : (i + 1) * count] for i in range(min(most, len(order) // count))]
    return [Draw(rows, chamfer(reference.points[rows], reference.points[rows])[1]) for rows in parts]


def score(generated: Described, train: Described, reference: Described, draws: Sequence[Draw]) -> Scored:
    """All metrics. COV and 1-NNA, which need sets of equal size, are averaged over `draws` of the references.

    `reference` must not hold the generated shapes themselves: to score references, leave them out. A figure that
    too few shapes leave undefined is NaN: of one shape FD, KPD, COV and 1-NNA; of none also the distances of
    references, while the others are the worst there are.
    """
    if len(generated) == 0:
        return Scored(dict(NOTHING), np.zeros(0, np.int64), np.zeros(0))
    if len(generated) == 1:
        draws = ()
    to_train = chamfer(generated.points, train.points)
    to_reference = chamfer(generated.points, reference.points)
    within = [
        np.where(np.eye(len(generated), dtype=bool), np.inf, d) for d in chamfer(generated.points, generated.points)
    ]
    failed = generated.failed
    undefined = dict.fromkeys(FEATURES, np.nan)
    figures = feature_figures(generated.features, reference.features) if len(generated) > 1 else undefined
    for suffix, train_distance, distance, among in zip(("", "_squared"), to_train, to_reference, within):
        figures["gen" + suffix] = float(np.where(failed, 0, train_distance.min(axis=1)).mean())
        figures["cov" + suffix] = float(distance.min(axis=0).mean())
        figures["var" + suffix] = float(np.where(failed, 0, among.min(axis=1)).mean()) if len(generated) > 1 else 0.0
    pairs = [(to_reference[1][: len(draw.rows), draw.rows], draw) for draw in draws]
    alike = [(within[1][: len(draw.rows), : len(draw.rows)], failed[: len(draw.rows)]) for draw in draws]
    figures["coverage"] = _mean([coverage(between, lost) for (between, _), (_, lost) in zip(pairs, alike)])
    figures["told_apart"] = _mean(
        [one_nna(among, between, draw.within, lost) for (between, draw), (among, lost) in zip(pairs, alike)]
    )
    distance = np.where(failed, np.inf, to_train[0].min(axis=1))
    return Scored(figures, to_train[0].argmin(axis=1), distance)


def feature_figures(first: Float[ndarray, "n d"], second: Float[ndarray, "m d"]) -> dict[str, float]:
    """The figures that need features alone."""
    return {"fd": frechet_distance(first, second), "kpd": kernel_distance(first, second)}


def frechet_distance(first: Float[ndarray, "n d"], second: Float[ndarray, "m d"]) -> float:
    """Fréchet distance between the normal distributions with the means and covariances of two sets (Heusel et al.).

    ‖μ₁ − μ₂‖² + Tr(Σ₁ + Σ₂ − 2 (Σ₁Σ₂)^½). With Σ = AᵀA, where the rows of A are the centred features over √(n − 1),
    the trace of (Σ₁Σ₂)^½ is the sum of the singular values of A₁A₂ᵀ: exact also where there are fewer shapes than
    features. It is biased: small sets of one distribution are apart. Raises ValueError for fewer than two shapes.
    """
    if min(len(first), len(second)) < 2:
        raise ValueError(f"a covariance needs two shapes at least, got sets of {len(first)} and {len(second)}")
    a, b = ((x - x.mean(axis=0)) / np.sqrt(len(x) - 1) for x in (first, second))
    apart = first.mean(axis=0) - second.mean(axis=0)
    mixed = np.linalg.svd(a @ b.T, compute_uv=False).sum()
    return float(apart @ apart + (a * a).sum() + (b * b).sum() - 2 * mixed)


def kernel_distance(first: Float[ndarray, "n d"], second: Float[ndarray, "m d"]) -> float:
    """Squared maximum mean discrepancy with the kernel (x·y/d + 1)³, the unbiased estimate (Bińkowski et al.).

    Its mean over sets of one distribution is 0 whatever their size; so it may be below 0. Raises ValueError for
    fewer than two shapes.
    """
    if min(len(first), len(second)) < 2:
        raise ValueError(f"an unbiased estimate needs two shapes at least, got sets of {len(first)} and {len(second)}")
    between = _kernel(first, second).mean()
    inside = [
        (np.sum(k) - np.trace(k)) / (len(k) * (len(k) - 1)) for k in (_kernel(first, first), _kernel(second, second))
    ]
    return float(inside[0] + inside[1] - 2 * between)


def _kernel(x: Float[ndarray, "n d"], y: Float[ndarray, "m d"]) -> Float[ndarray, "n m"]:
    return (x @ y.T / x.shape[1] + 1) ** 3


def coverage(between: Float[ndarray, "g r"], failed: Bool[ndarray, " g"]) -> float:
    """COV: share of the references that are nearest to some generated shape; failed shapes are near nothing."""
    return len(np.unique(between[~failed].argmin(axis=1))) / between.shape[1] if not failed.all() else 0.0


def one_nna(
    among: Float[ndarray, "g g"],
    between: Float[ndarray, "g r"],
    within: Float[ndarray, "r r"],
    failed: Bool[ndarray, " g"],
) -> float:
    """1-NNA: share of generated and reference shapes whose nearest other shape is of their own set.

    ½ if the sets can't be told apart. A failed shape always can, and is nobody's neighbour.
    """
    among, within = among + np.diag(np.full(len(among), np.inf)), within + np.diag(np.full(len(within), np.inf))
    known, cross = among[:, ~failed], between[~failed]
    nearest = (x.min(axis=1, initial=np.inf) for x in (known, between, within, cross.T))
    same_set, other_set, same_reference, other_reference = nearest
    right = np.where(failed, True, same_set < other_set)
    return float(np.concatenate([right, same_reference < other_reference]).mean())


def chamfer(
    first: Float[ndarray, "n p 3"], second: Float[ndarray, "m q 3"]
) -> tuple[Float[ndarray, "n m"], Float[ndarray, "n m"]]:
    """Chamfer distances of all pairs of clouds: unsquared and squared, see `definitions`.

    Which point is nearest is found by a matrix product in float32, so of two points whose squared distances differ by
    less than about 1e-6 it may be either; distances themselves are exact.
    """
    unsquared, squared = np.empty((2, len(first), len(second)))
    lifted = [[_lifted(cloud) for cloud in clouds] for clouds in (first, second)]
    for i, (a, (query_a, data_a)) in enumerate(zip(first, lifted[0])):
        for j, (b, (query_b, data_b)) in enumerate(zip(second, lifted[1])):
            forth = ((a - b[(query_a @ data_b).argmin(axis=1)]) ** 2).sum(axis=1)
            back = ((b - a[(query_b @ data_a).argmin(axis=1)]) ** 2).sum(axis=1)
            unsquared[i, j] = (np.sqrt(forth).mean() + np.sqrt(back).mean()) / 2
            squared[i, j] = forth.mean() + back.mean()
    return unsquared, squared


def resampling_noise(points: Float[ndarray, "n p 3"], count: int) -> dict[str, float]:
    """Mean Chamfer distances between two samples of `count` points of one surface: what copies would have.

    Empty where there are too few points, or no shapes.
    """
    if len(points) == 0 or points.shape[1] < 2 * count:
        return {}
    pairs = [chamfer(cloud[None, :count], cloud[None, count : 2 * count]) for cloud in points]
    return {name: float(np.mean([pair[i] for pair in pairs])) for i, name in enumerate(("unsquared", "squared"))}


def _lifted(cloud: Float[ndarray, "p 3"]) -> tuple[Float[ndarray, "p 4"], Float[ndarray, "4 p"]]:
    """Queries and data whose products order points by distance: |b|² − 2 a·b."""
    ones, squares = np.ones((len(cloud), 1), cloud.dtype), (cloud**2).sum(axis=1, keepdims=True)
    return np.hstack([-2 * cloud, ones]), np.ascontiguousarray(np.hstack([cloud, squares]).T)


def _mean(values: Sequence[float]) -> float:
    """NaN where there is nothing to average."""
    return float(np.mean(values)) if values else float("nan")
