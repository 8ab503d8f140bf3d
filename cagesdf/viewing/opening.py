"""From folders to what tabs share."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from cagesdf.editing.session import Session
from cagesdf.errors import InputError
from cagesdf.generating import has_cuboids
from cagesdf.generation.generator import Generator
from cagesdf.inference import FitSettings, Known, fit_shape
from cagesdf.io.generators import GENERATOR, read_generator
from cagesdf.io.residuals import read_residuals
from cagesdf.io.runs import Run, beside, read_run
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.meshes import Mesh, join
from cagesdf.shape import Shape
from cagesdf.viewing.styles import StyleSpace
from cagesdf.viewing.tab import Opened, Taken, Truths

Read = Callable[[Path], Shape]  # the one shape of a source; raises InputError

DIRECTIONS = 5  # principal ones that have a slider
KEPT = 32  # true surfaces that are held at once


def opened(
    run: Path, shape: str | None, programs: Path | None, shapes: Path | None, read: Read, settings: FitSettings
) -> Opened:
    """A run; its generator and true shapes from these folders, or, if there are any, from the run's siblings.

    Uploaded shapes are read by `read` and taken into the network with `settings`.

    Raises InputError for an arm without cuboids, an unknown shape, and a folder that is named and isn't there.
    """
    trained = read_run(run)
    if not has_cuboids(trained):
        raise InputError(f"{run}: was trained without cuboids, there is nothing to drag; take an arm such as cagesdf")
    session = Session(trained)
    first = shape or min(trained.sequences)
    session.opened(first)
    codes = session.styles.latents().astype(np.float64)
    known = Known.of(trained, read_residuals(run))
    return Opened(
        session, StyleSpace.of(codes, DIRECTIONS), _generator(run, programs), _truths(run, shapes),
        lambda source: _taken(trained, known, read(source), settings), first,
    )  # fmt: skip


def named(runs: Sequence[Path]) -> dict[str, Path]:
    """Runs by the shortest ends of their paths that tell them apart: chair/cagesdf and table/cagesdf.

    Raises InputError for one that is given twice.
    """
    parts = [run.resolve().parts for run in runs]
    if len(set(parts)) < len(parts):
        raise InputError(f"{', '.join(map(str, runs))}: a run is given twice")
    for first in range(1, max(map(len, parts)) + 1):
        ends = ["/".join(path[-first:]) for path in parts]
        if len(set(ends)) == len(ends):
            return dict(zip(ends, runs))
    raise AssertionError("equal paths")


def _taken(run: Run, known: Known, shape: Shape, settings: FitSettings) -> Taken:
    fit = fit_shape(run, known, shape, settings, 0)
    structure = shape.structure.with_cuboids(fit.prepared.fitted.cage.cuboids())
    return Taken(structure, fit.inferred.code.cpu().numpy(), shape.similarity, fit.prepared.surface, str(fit.verdict))


def _generator(run: Path, programs: Path | None) -> Generator | None:
    folder = programs or beside(run, "programs")
    if programs is None and not (folder / GENERATOR).is_file():
        return None
    return read_generator(folder).generator


class _Truths:
    """True surfaces of the shapes in a folder, of which the last few are held."""

    def __init__(self, folder: ShapeFolder) -> None:
        self._ids = frozenset(folder.ids)
        self._read = lru_cache(KEPT)(lambda shape_id: join([part.mesh for part in folder.read(shape_id).parts]))

    def __call__(self, shape_id: str) -> Mesh | None:
        return self._read(shape_id) if shape_id in self._ids else None


def _nothing(shape_id: str) -> Mesh | None:
    return None


def _truths(run: Path, shapes: Path | None) -> Truths:
    folder = shapes or beside(run, "shapes")
    if shapes is None and not (folder / "shapes.parquet").is_file():
        return _nothing
    return _Truths(read_shapes(folder))
