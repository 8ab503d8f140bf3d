"""The metrics of a surface against the true one (§4.1, §4.2): each once, for evaluation, files, report and docs.

A metric is an entry of METRICS. Its figures are calculated by `reconstruction.score`, stored by `io/scores.py` with its
meaning, averaged in `tables.json`, shown in the report by its title and listed in docs/metrics.md.
"""

from collections.abc import Callable
from dataclasses import dataclass

from cagesdf.evaluation.surfaces import Direction, Measured

SIDE = "% of side"  # of the longest side of the true surface's bounding box
UNITS = "canonical units"


@dataclass(frozen=True)
class Metric:
    """Key, title, unit, direction and meaning of a figure."""

    key: str  # its name in scores and tables
    title: str  # of its column in the report
    unit: str  # "" for shares and cosines
    higher: bool | None  # whether more is better; None: neither is, it describes
    meaning: str

    @property
    def arrow(self) -> str:
        """Which way is better, for the head of a column."""
        return {True: "↑", False: "↓", None: ""}[self.higher]

    @property
    def variants(self) -> dict[str, str]:
        """The measured part of the surface, in words, by figure key; "" stands for the whole surface."""
        return {self.key: ""}


@dataclass(frozen=True)
class PointMetric(Metric):
    """A metric of distances and normals at points; `_detail` is the same of detail alone."""

    # Arguments: from the true surface to the predicted one, back, and the longest side (canonical). A surface without
    # faces has the directions of `surfaces.nowhere`.
    of: Callable[[Direction, Direction, float], float]
    own_cuboids: bool = False  # whether `_own` is measured too: against parts that followed their own cuboids alone

    @property
    def variants(self) -> dict[str, str]:
        """The whole surface, against parts that followed their own cuboids where that is measured, and detail."""
        of_own = {f"{self.key}_own": "own cuboids"} if self.own_cuboids else {}
        return {self.key: "", **of_own, f"{self.key}_detail": "detail"}


@dataclass(frozen=True)
class SurfaceMetric(Metric):
    """A metric of whole surfaces; a surface without faces gets `worst`."""

    of: Callable[[Measured, Measured], float]  # of the predicted and the true surface
    worst: float  # the value of a surface without faces


def accuracy(forth: Direction, back: Direction, side: float) -> float:
    """Mean distance from the predicted surface to the true one, % of side."""
    return 100 / side * float(back.distance.mean())


def completeness(forth: Direction, back: Direction, side: float) -> float:
    """Mean distance from the true surface to the predicted one, % of side."""
    return 100 / side * float(forth.distance.mean())


def surface_distance(forth: Direction, back: Direction, side: float) -> float:
    """Mean of `accuracy` and `completeness`, % of side."""
    return (completeness(forth, back, side) + accuracy(forth, back, side)) / 2


def squared_chamfer(forth: Direction, back: Direction, side: float) -> float:
    """DeepSDF's Chamfer distance: mean squared distance between samples, both directions summed."""
    return sum(float((direction.sample**2).mean()) for direction in (forth, back))


def plain_chamfer(forth: Direction, back: Direction, side: float) -> float:
    """Chamfer-L1 distance: mean distance between samples, mean of both directions."""
    return sum(float(direction.sample.mean()) for direction in (forth, back)) / 2


def normal_consistency(forth: Direction, back: Direction, side: float) -> float:
    """Mean |cosine| between normals."""
    return sum(float(direction.aligned.mean()) for direction in (forth, back)) / 2


def signed_consistency(forth: Direction, back: Direction, side: float) -> float:
    """Mean cosine between normals."""
    return sum(float(direction.cosine.mean()) for direction in (forth, back)) / 2


def f_score(threshold: float) -> Callable[[Direction, Direction, float], float]:
    """F-score with a threshold that is a share of the longest side."""

    def score(forth: Direction, back: Direction, side: float) -> float:
        recall, precision = (float((direction.distance < threshold * side).mean()) for direction in (forth, back))
        return 2 * recall * precision / (recall + precision) if recall + precision else 0.0

    return score


METRICS: tuple[PointMetric | SurfaceMetric, ...] = (
    PointMetric(
        "surface_distance", "distance", SIDE, False,
        "mean exact distance from points on either surface to the other, mean of both directions; 0 is perfect",
        surface_distance, own_cuboids=True,
    ),
    PointMetric(
        "accuracy", "accuracy", SIDE, False,
        "mean exact distance from points of the predicted surface to the true one", accuracy,
    ),
    PointMetric(
        "completeness", "completeness", SIDE, False,
        "mean exact distance from points of the true surface to the predicted one", completeness,
    ),
    PointMetric(
        "cd_deepsdf", "Chamfer", f"squared {UNITS}", False,
        "as DeepSDF and the paper have it: mean squared distance to the nearest sampled point of the other surface, "
        "both directions summed; sampling alone makes it larger than 0, the arm ground_truth shows how much",
        squared_chamfer,
    ),
    PointMetric(
        "cd_l1", "Chamfer-L1", UNITS, False,
        "mean distance to the nearest sampled point of the other surface, not squared, mean of both directions",
        plain_chamfer,
    ),
    PointMetric(
        "f1", "F 1 %", "", True,
        "F-score: harmonic mean of the shares of points of either surface nearer to the other than 1 % of side",
        f_score(0.01),
    ),
    PointMetric("f2", "F 2 %", "", True, "the same with 2 % of side", f_score(0.02)),
    PointMetric(
        "nc", "normals", "", True,
        "normal consistency: mean |cosine| between the normals of a point and of the nearest point of the other "
        "surface, mean of both directions", normal_consistency,
    ),
    PointMetric(
        "nc_signed", "normals, signed", "", True,
        "the same with its sign: a surface that is inside out has -1", signed_consistency, own_cuboids=True,
    ),
    SurfaceMetric(
        "iou", "IoU", "", True,
        "volume of the solids' intersection over that of their union, exact; 0 of a surface that isn't closed",
        lambda predicted, truth: predicted.iou(truth), worst=0.0,
    ),
    SurfaceMetric(
        "closed", "closed", "", True, "1 if the surface has no hole and one orientation",
        lambda predicted, truth: float(predicted.closed), worst=0.0,
    ),
    SurfaceMetric(
        "same_components", "pieces", "", True,
        "1 if it has as many closed pieces as the true one, shells of cavities counted too",
        lambda predicted, truth: float(predicted.topology[0] == truth.topology[0]), worst=0.0,
    ),
    SurfaceMetric(
        "same_genus", "handles", "", True,
        "1 if it has as many handles (genus, summed over the pieces) as the true one: a pierced back has one a hole",
        lambda predicted, truth: float(predicted.topology[1] == truth.topology[1]), worst=0.0,
    ),
)  # fmt: skip
POINT_METRICS = tuple(metric for metric in METRICS if isinstance(metric, PointMetric))
SURFACE_METRICS = tuple(metric for metric in METRICS if isinstance(metric, SurfaceMetric))
OF_KEY = {key: metric for metric in METRICS for key in metric.variants}  # of every figure
PROGRESS = ("surface_distance", "cd_deepsdf", "nc_signed")  # along a training
