"""A trained network for a shape that it has never seen: cuboids, code, surface, and whether to trust them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32
from numpy import ndarray

from cagesdf.cage_fitting.cages import fit_cage
from cagesdf.cage_fitting.fitted import FittedCage
from cagesdf.cuboid import Cage, Sequence
from cagesdf.deformation.sequences import solids_in_cuboids
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.reconstruction import score
from cagesdf.evaluation.surfaces import Measured, Truth
from cagesdf.extraction import LOOSE, CageField, Each, Extraction, extract
from cagesdf.extraction.surface import Loose
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import union
from cagesdf.inference.codes import InferenceSettings, Inferred, infer
from cagesdf.models.codes import part_codes
from cagesdf.models.latents import SHARED, LatentTable
from cagesdf.run import Run
from cagesdf.sampling.chunks import PointCounts, part_chunks, shape_chunks
from cagesdf.shape import Shape
from cagesdf.training.batches import Batch, training_chunks, training_set

STAGE = "fit"
MEAN = "mean"  # the start that is no shape's code: the mean of all
MEASURED = ("surface_distance", "accuracy", "completeness", "nc_signed", "iou")

# A shape is far from the training shapes beyond these; docs/fit.md has what they are drawn from.
FAR_RESIDUAL = 3.0  # times the training shapes' median residual, and beyond the largest of them
FAR_CODE = 1.75  # times the largest distance of a training code to its nearest one
FAR_SIDES = 1.1  # times the longest side of theirs along an axis, or shorter than the shortest divided by it


# Shapes are prepared and surfaces measured as params.yaml does; codes are found as was best on half of the default
# validation shapes (docs/fit.md).
CUBOIDS: dict[str, Any] = {"slack": 0.01, "min_size": 0.001, "margin": 1e-6, "points": 10_000}
SAMPLES: dict[str, Any] = {
    "near": 4_500, "uniform": 1_500, "per_cuboid": 256, "beta": 60.0, "part_near": 384.0, "part_uniform": 128.0,
}  # fmt: skip
MEASURE: dict[str, Any] = {"points": 20_000, "detail": 0.005}
INFERENCE: dict[str, Any] = {
    "tried": 32, "starts": 4, "code_steps": 100, "residual_steps": 200, "batch": 16,
    "code_rate": 0.03, "residual_rate": 0.01, "code_weight": 1e-4, "residual_weight": 1e-4,
}  # fmt: skip


@dataclass(frozen=True)
class FitSettings:
    """Settings for preparing a shape, as for training, and for finding its code."""

    slack: float  # these four as `fit_cage`'s
    min_size: float
    margin: float
    points: int
    counts: PointCounts
    inference: InferenceSettings


@dataclass(frozen=True, eq=False)
class Prepared:
    """A shape as the network is trained on shapes, but for its code."""

    shape: Shape
    fitted: FittedCage
    surface: Mesh  # the union of its parts, canonical
    groups: Batch  # its points, in groups of a part


@dataclass(frozen=True, eq=False)
class Known:
    """Statistics of the training shapes that a new shape is judged by."""

    residuals: Mapping[str, float]  # by shape id; see `rest_residuals`
    codes: Mapping[str, Float32[ndarray, " d"]]  # by shape id, at rest
    sides: Float[ndarray, "r 3"]  # of the boxes around their cages at rest, canonical

    @staticmethod
    def of(run: Run, residuals: Mapping[str, float]) -> "Known":
        """The training shapes of a run. Raises InputError for residuals of other shapes."""
        codes = {shape_id: run.latent(shape_id, 0).cpu().numpy() for shape_id in sorted(run.sequences)}
        if set(residuals) != set(codes):
            raise InputError("the run's residuals are of other shapes than its latents; train again")
        return Known(residuals, codes, np.array([sides(run.sequences[shape_id].cages[0]) for shape_id in codes]))

    def spacing(self) -> Float[ndarray, " r"]:
        """The distance of each code to the nearest other one; empty for a single code."""
        codes = np.stack([*self.codes.values()])
        apart = np.linalg.norm(codes[:, None] - codes, axis=2)
        np.fill_diagonal(apart, np.inf)
        nearest = apart.min(axis=1)
        return nearest[np.isfinite(nearest)]


@dataclass(frozen=True)
class Verdict:
    """The place of a shape among the training shapes. Residuals are mean |sdf error|, in the decoder's unit."""

    residual: float  # with one code for the whole shape
    median: float  # of the training shapes' residuals
    largest: float  # of them
    nearest: str  # the training shape with the nearest code
    distance: float  # of its code
    widest: float  # the largest distance of a training code to its nearest one; 0 for a single code
    sides: tuple[float, float, float]  # of the box around its cage along x, y, z, canonical
    shortest: tuple[float, float, float]  # of these sides of the training shapes
    longest: tuple[float, float, float]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons why the shape is far from the training shapes; none if it is not."""
        result = []
        if self.residual > max(FAR_RESIDUAL * self.median, self.largest):
            result.append(
                f"no code explains it: its residual is {self.residual / self.median:.1f} times the training shapes' "
                f"median, theirs at most {self.largest / self.median:.1f} times"
            )
        if self.widest and self.distance > FAR_CODE * self.widest:
            result.append(
                f"its code lies {self.distance:.2f} from the nearest one ({self.nearest}), "
                f"training codes at most {self.widest:.2f}"
            )
        beyond = [
            f"{side:.2f} along {axis} (theirs {low:.2f} to {high:.2f})"
            for axis, side, low, high in zip("xyz", self.sides, self.shortest, self.longest)
            if not low / FAR_SIDES <= side <= high * FAR_SIDES
        ]
        if beyond:
            result.append(f"in a sphere of radius 1, y up, it measures {', '.join(beyond)}")
        return tuple(result)

    @property
    def far(self) -> bool:
        """Whether the network should not be trusted with the shape."""
        return bool(self.reasons)

    def __str__(self) -> str:
        return f"far from the training shapes: {'; '.join(self.reasons)}" if self.far else "like the training shapes"


@dataclass(frozen=True, eq=False)
class Fit:
    """A shape that was not trained on, as the network represents it."""

    prepared: Prepared
    inferred: Inferred
    start: str  # the training shape whose code it was optimised from, or MEAN
    verdict: Verdict


def usual_settings() -> FitSettings:
    """The settings of `cagesdf fit`, of the editor and of the Python API."""
    return FitSettings(**CUBOIDS, counts=PointCounts(**SAMPLES), inference=InferenceSettings(**INFERENCE))


def fit_shape(run: Run, known: Known, shape: Shape, settings: FitSettings, seed: int) -> Fit:
    """The cuboids and the code of a shape. Raises InputError if it can't be prepared; see `prepare`."""
    try:
        prepared = prepare(run, shape, settings, np.random.default_rng(seed))
    except ShapeRejected as error:
        raise InputError(f"{shape.shape_id}: rejected: {error.reason}") from error
    return fit_code(run, known, prepared, settings.inference, seed)


def prepare(run: Run, shape: Shape, settings: FitSettings, rng: np.random.Generator) -> Prepared:
    """Cuboids and points of a shape, as those that the run was trained on.

    Raises ShapeRejected as `fit_cage` does, and for parts that have no closed union; InputError for an arm that was
    trained without cuboids.
    """
    if run.decoder.trains_on == "cube":
        raise InputError("this arm was trained without cuboids, so that it has no place for these; take cagesdf")
    fitted = fit_cage(shape, settings.slack, settings.min_size, settings.margin, settings.points, rng)
    try:
        surface = union([part.mesh for part in shape.parts])
        solids = solids_in_cuboids(shape, fitted.cage)
    except ValueError as error:
        raise ShapeRejected(shape.shape_id, STAGE, str(error)) from error
    if run.decoder.trains_on == "part":
        chunks = part_chunks(shape.shape_id, 0, solids, fitted.cage, settings.counts, rng)
    else:
        chunks = shape_chunks(shape.shape_id, 0, SurfaceDistance(surface), fitted.cage, settings.counts, rng)
    sequences = {shape.shape_id: Sequence(shape.shape_id, None, np.zeros(1), (False,), (fitted.cage,))}
    chunks = training_chunks(chunks, sequences, "rest", run.decoder.trains_on, run.params["reach"], rng)
    table = LatentTable(((shape.shape_id, SHARED),), torch.zeros(1, run.params["latent_dim"]))
    groups = training_set(chunks, sequences, table).to(run.latents.values.device)
    return Prepared(shape, fitted, surface, groups)


def fit_code(run: Run, known: Known, prepared: Prepared, settings: InferenceSettings, seed: int) -> Fit:
    """The code of a prepared shape, and whether it is like the training shapes."""
    codes = torch.from_numpy(np.stack([*known.codes.values()])).to(run.latents.values.device)
    candidates = torch.cat([codes, codes.mean(dim=0, keepdim=True)])
    names = (*known.codes, MEAN)
    inferred = infer(run.decoder, candidates, prepared.groups, run.params["clamp"], settings, seed)
    return Fit(prepared, inferred, names[inferred.start], judge(known, prepared.fitted.cage, inferred))


def sides(cage: Cage) -> Float[ndarray, " 3"]:
    """Sides of the box around a cage along the canonical axes, canonical units."""
    return np.ptp(cage.corners().reshape(-1, 3), axis=0)


def judge(known: Known, cage: Cage, inferred: Inferred) -> Verdict:
    """The verdict on a shape with this cage and code."""
    code = inferred.code.cpu().numpy()
    distances = {shape_id: float(np.linalg.norm(other - code)) for shape_id, other in known.codes.items()}
    nearest = min(distances, key=lambda shape_id: distances[shape_id])
    residuals = [*known.residuals.values()]
    box, low, high = (tuple(row.tolist()) for row in (sides(cage), known.sides.min(axis=0), known.sides.max(axis=0)))
    return Verdict(
        inferred.code_error,
        float(np.median(residuals)),
        max(residuals),
        nearest,
        distances[nearest],
        float(max(known.spacing(), default=0.0)),
        box,
        low,
        high,
    )


def fitted_field(run: Run, fit: Fit) -> CageField:
    """The network's field for a fitted shape: each part has its code plus its residual."""
    cage = fit.prepared.fitted.cage
    return CageField(run.decoder, part_codes(run.decoder, fit.inferred.code, cage) + fit.inferred.residual, cage)


def fitted_surface(run: Run, fit: Fit, resolution: int, loose: Loose = LOOSE["keep"], each: Each = map) -> Extraction:
    """The surface of a fitted shape, canonical; see `extract`. Raises InputError if the network gives none."""
    surface = extract(fitted_field(run, fit), resolution, loose=loose, each=each)
    if len(surface.mesh.faces) == 0:
        raise InputError(f"{fit.prepared.shape.shape_id}: the network gives no surface at all for it; {fit.verdict}")
    return surface


def measure(fit: Fit, mesh: Mesh, points: int, detail: float, rng: np.random.Generator) -> dict[str, float]:
    """Distance of a fitted surface from the shape's own: the figures MEASURED of `score`, in its units."""
    truth = Truth(fit.prepared.surface, fit.prepared.fitted.cage, detail)
    figures = score(Measured(mesh), truth, truth.drawn(points, rng), rng)
    return {name: figures[name] for name in MEASURED}


def report(fit: Fit, surface: Extraction, measured: Mapping[str, float]) -> dict[str, Any]:
    """The result for a shape, for JSON. Residuals are in the decoder's unit, as the training shapes' are."""
    shape, verdict, inferred = fit.prepared.shape, fit.verdict, fit.inferred
    return {
        "shape_id": shape.shape_id,
        "verdict": str(verdict),
        "far": verdict.far,
        "parts": len(shape.parts),
        "whose_parts": f"{shape.origin.parts}: {shape.origin.reason}",
        "bounded": int(fit.prepared.fitted.bounded.sum()),
        "repair": shape.status,
        "scale": shape.similarity.scale,
        "points": fit.prepared.groups.sdf.numel(),
        "start": fit.start,
        "nearest": verdict.nearest,
        "sides": [round(side, 4) for side in verdict.sides],
        "code_distance": round(verdict.distance, 4),
        "code_distance_of_training": round(verdict.widest, 4),
        "residual_one_code": round(inferred.code_error, 6),
        "residual": round(inferred.error, 6),
        "residual_over_training": round(verdict.residual / verdict.median, 3),
        **{name: round(value, 4) for name, value in measured.items()},
        "evaluations": surface.evaluations,
        "vertices": len(surface.mesh.vertices),
        "faces": len(surface.mesh.faces),
        "components": surface.components,
        "clipped": round(surface.clipped, 6),
        "overshoot": surface.overshoot,
    }
