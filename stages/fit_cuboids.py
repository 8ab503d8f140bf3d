"""Fit the cuboids of every shape's parts: of its program if it has one, of least volume if not (§3.2).

python -m stages.fit_cuboids data/shapes/chair data/cuboids/chair
"""

from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np

from cagesdf.cage_fitting.cages import fit_cage
from cagesdf.cage_fitting.fitted import FittedCage
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.io.cuboids import write_cuboids
from cagesdf.io.rejected import write_rejected
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.seeds import item_rng
from pipeline import FitParams, artefact, parallel_map, run_stage
from pipeline.cost import Cost, shapes

COST = Cost("shapes", shapes)


def main(shapes: Path, out: Path, params: FitParams) -> None:
    """Read `shapes/`, write `cuboids/`; print how much of the parts is outside."""
    with artefact.write("cuboids", out, inputs={"shapes": shapes}, params=params) as folder:
        source = read_shapes(shapes)

        fit = partial(fit_one, source, params)
        fitted, rejected = parallel_map(fit, source.ids, rejects=ShapeRejected, label="fit_cuboids", lost=lost)
        write_cuboids(folder, dict(fitted))
        write_rejected(folder, rejected, len(source), params.max_rejected)
        print(summary([cage for _, cage in fitted]))


def fit_one(source: ShapeFolder, params: FitParams, shape_id: str) -> tuple[str, FittedCage]:
    """A shape's id and its cage."""
    rng = item_rng(params.seed, "fit_cuboids", shape_id)
    fitted = fit_cage(source.read(shape_id), params.slack, params.min_size, params.margin, params.points, rng)
    return shape_id, fitted


def lost(shape_id: str, reason: str) -> ShapeRejected:
    """The rejection of a shape that kills its worker."""
    return ShapeRejected(shape_id, "fit_cuboids", reason)


def summary(fitted: Iterable[FittedCage]) -> str:
    """One line: the share of surface points outside their cuboids, each part counting the same, and flagged parts."""
    cages = list(fitted)
    if not cages:
        return "no cages"
    before, after, bounded = (
        np.concatenate([getattr(cage, name) for cage in cages]) for name in ("outside_before", "outside", "bounded")
    )
    programs = sum(cage.assembly is not None for cage in cages)
    return (
        f"{len(cages)} cages, {programs} from programs; part surface outside its cuboid: {before.mean():.2%} before, "
        f"{after.mean():.3%} after fitting; {(~bounded).sum()} of {len(bounded)} parts not bounded"
    )


if __name__ == "__main__":
    run_stage(main, InputError)
