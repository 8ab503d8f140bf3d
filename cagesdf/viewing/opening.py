"""Runs opened for the editor: from folders to the records that all tabs share."""

import threading
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from cagesdf.cage_generation.generator import Generator
from cagesdf.editing.session import Session
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.inference.shapes import FitSettings, Known, fit_code, prepare
from cagesdf.io.cage_generators import GENERATOR, read_generator
from cagesdf.io.residuals import read_residuals
from cagesdf.io.runs import Run, beside, read_run
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.shape import Shape
from cagesdf.shape_generation.surfaces import CodeSource, code_source, has_cuboids
from cagesdf.viewing.jobs import Progress
from cagesdf.viewing.styles import StyleSpace
from cagesdf.viewing.tab import Opened, Taken, Truths
from cagesdf.viewing.thumbnails import Thumbnails

Read = Callable[[Path], Shape]  # the one shape of a source; raises InputError

DIRECTIONS = 5  # principal directions with a slider
KEPT = 32  # true surfaces in memory


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
        session, StyleSpace.of(codes, DIRECTIONS), _codes(trained), _generator(run, programs), _truths(run, shapes),
        partial(_taken, trained, known, read, settings), Thumbnails(session), first,
    )  # fmt: skip


def named(runs: Sequence[Path]) -> dict[str, Path]:
    """Runs by the shortest distinct ends of their paths: chair/cagesdf and table/cagesdf.

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


def _codes(run: Run) -> Callable[[], CodeSource]:
    """The source of new codes, fitted by the first call, which takes seconds."""
    lock = threading.Lock()
    source: list[CodeSource] = []

    def codes() -> CodeSource:
        with lock:
            if not source:
                source.append(code_source(run, "dependent", None))
            return source[0]

    return codes


def _taken(
    run: Run, known: Known, read: Read, settings: FitSettings, source: Path, name: str, progress: Progress
) -> Taken:
    """Cuboids and codes of a source as `cagesdf fit` finds them, with progress; `name` is the user's name for it."""
    progress("reading and closing parts")
    shape = read(source)
    progress(f"fitting {len(shape.parts)} cuboids", 0.2)
    try:
        prepared = prepare(run, shape, settings, np.random.default_rng(0))
    except ShapeRejected as error:
        raise InputError(f"{name}: rejected: {error.reason}") from error
    progress("looking for the style that explains it best", 0.4)
    fit = fit_code(run, known, prepared, settings.inference, 0)
    cage = prepared.fitted.cage
    residuals = dict(zip(cage.part_ids, fit.inferred.residual.cpu().numpy().tolist(), strict=True))
    return Taken(
        shape.structure.with_cuboids(cage.cuboids()),
        fit.inferred.code.cpu().numpy(),
        residuals,
        shape.similarity,
        prepared.surface,
        str(fit.verdict),
    )


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
