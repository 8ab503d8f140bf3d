"""Runs opened for the editor: from folders to the records that all tabs share."""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cagesdf.cage_generation.generator import Generated
from cagesdf.cage_generation.trained import TrainedGenerator
from cagesdf.editing.naming import KnownParts
from cagesdf.editing.script import Build
from cagesdf.editing.session import Session
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.formats.listing import find_shape, read_shape
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.importing import import_shape
from cagesdf.inference.shapes import FitSettings, Known, fit_code, prepare
from cagesdf.io.cage_generators import GENERATOR, read_generator
from cagesdf.io.residuals import read_residuals
from cagesdf.io.runs import beside, read_run
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.parts.changing import Dissection
from cagesdf.run import Run
from cagesdf.shape import RawShape
from cagesdf.shape_generation.surfaces import CodeSource, code_source, has_cuboids, usual_method
from cagesdf.viewing import files
from cagesdf.viewing.jobs import Progress
from cagesdf.viewing.styles import StyleSpace
from cagesdf.viewing.thumbnails import Thumbnails
from cagesdf.viewing.uploads import Taken

Truths = Callable[[str], Mesh | None]  # the parts of a shape, canonical, as one mesh; None where it isn't known

DIRECTIONS = 5  # principal directions with a slider
KEPT = 32  # true surfaces in memory


@dataclass(frozen=True, eq=False)
class Importer:
    """Takes users' shapes into the network of a run."""

    run: Run
    known: Known
    imports: Mapping[str, Any]  # of `import_shape`, by name
    settings: FitSettings

    def read(self, name: str, content: bytes) -> RawShape:
        """An uploaded shape, by the user's name for it. Raises InputError."""
        with TemporaryDirectory() as folder:
            try:
                return read_shape(find_shape(files.meshes_of(name, content, Path(folder))))
            except (InputError, ShapeRejected) as error:
                reason = f"{name}: rejected: {error.reason}" if isinstance(error, ShapeRejected) else str(error)
                raise InputError(reason.replace(f"{folder}/", "").replace(folder, name)) from error

    def take(self, raw: RawShape, name: str, progress: Progress) -> Taken:
        """Its cuboids and codes as `cagesdf fit` finds them, with progress. Raises InputError."""
        try:
            progress("reading and closing parts")
            shape = import_shape(raw, **self.imports)
            progress(f"fitting {len(shape.parts)} cuboids", 0.2)
            prepared = prepare(self.run, shape, self.settings, np.random.default_rng(0))
        except ShapeRejected as error:
            raise InputError(f"{name}: rejected: {error.reason}") from error
        progress("looking for the style that explains it best", 0.4)
        fit = fit_code(self.run, self.known, prepared, self.settings.inference, 0)
        cage = prepared.fitted.cage
        residuals = dict(zip(cage.part_ids, fit.inferred.residual.cpu().numpy().tolist(), strict=True))
        return Taken(
            shape.structure.with_cuboids(cage.cuboids()),
            fit.inferred.code.cpu().numpy(),
            residuals,
            shape.similarity,
            prepared.surface,
            shape.origin,
            str(fit.verdict),
        )

    def dissect(self, raw: RawShape, name: str) -> Dissection:
        """The parts that are found in its surface, whatever groups its file has. Raises InputError."""
        try:
            return Dissection.of(raw, self.imports["up"], self.imports["weld"], self.imports["min_thickness"])
        except ShapeRejected as error:
            raise InputError(f"{name}: rejected: {error.reason}") from error


@dataclass(frozen=True, eq=False)
class Opened:
    """A run that tabs share; nothing of it changes."""

    session: Session
    styles: StyleSpace
    codes: Callable[[], CodeSource]  # the source of new styles; the first call takes seconds
    generator: TrainedGenerator | None
    truth: Truths
    importer: Importer
    known_parts: KnownParts  # after which parts of new programs are called
    thumbnails: Thumbnails
    first: str  # id of the shape that a tab begins with

    def build(self, generated: Generated) -> Build:
        """The operation that leads to new cuboids, their parts named."""
        return Build(structure=self.known_parts.document(generated.structure, generated.cage))


def opened(
    run: Path,
    shape: str | None,
    programs: Path | None,
    shapes: Path | None,
    imports: Mapping[str, Any],
    settings: FitSettings,
) -> Opened:
    """A run; its generator and true shapes from these folders, or, if there are any, from the run's siblings.

    Uploaded shapes are imported by `import_shape` with `imports`, and taken into the network with `settings`.

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
        Importer(trained, known, imports, settings), KnownParts.of(session.styles.shapes.values()),
        Thumbnails(session), first,
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
                source.append(code_source(run, usual_method(run), None))
            return source[0]

    return codes


def _generator(run: Path, programs: Path | None) -> TrainedGenerator | None:
    folder = programs or beside(run, "programs")
    if programs is None and not (folder / GENERATOR).is_file():
        return None
    return read_generator(folder)


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
