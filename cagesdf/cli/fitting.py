"""The command that takes shapes into a trained network that it has never seen."""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cagesdf.cli.files import check_folder, new_folder
from cagesdf.cli.shapes import IMPORT
from cagesdf.cli.surfaces import LEAST
from cagesdf.errors import InputError, ShapeRejected

if TYPE_CHECKING:
    from cagesdf.inference import FitSettings
    from cagesdf.shape import Shape

# How `fit` prepares shapes and measures surfaces: as params.yaml does.
CUBOIDS: dict[str, Any] = {"slack": 0.01, "min_size": 0.001, "margin": 1e-6, "points": 10_000}
SAMPLES: dict[str, Any] = {
    "near": 6_000, "uniform": 2_000, "per_cuboid": 256, "beta": 60.0, "part_near": 192.0, "part_uniform": 64.0,
}  # fmt: skip
MEASURE: dict[str, Any] = {"points": 20_000, "detail": 0.005}
# How it finds codes: tried on half of the default validation shapes (docs/fit.md).
INFERENCE: dict[str, Any] = {
    "tried": 32, "starts": 4, "code_steps": 100, "residual_steps": 200, "batch": 16,
    "code_rate": 0.03, "residual_rate": 0.01, "code_weight": 1e-4, "residual_weight": 1e-4,
}  # fmt: skip


def fit(run: Path, source: Path, out_dir: Path, /, *, resolution: int = 128, seed: int = 0) -> None:
    """Find the cuboids and the code of a shape that a network was not trained on, and write the surface it gives.

    Prints what became of it as a JSON object. Its verdict says whether the shape is like those that the network was
    trained on; the surface of one that is far from them should not be trusted.

    Parameters
    ----------
    run
        A folder that `train` wrote, such as data/runs/chair/cagesdf.
    source
        A mesh file, a folder of part meshes, or a PartNet shape: one shape, upright (y up).
    out_dir
        A new folder, in one that exists: cuboids.parquet, latent.safetensors, surface.ply in the frame and unit of
        your files, report.json.
    resolution
        Cells along 2.1 times the radius of the shape's bounding sphere.
    seed
        Of the points that are drawn.
    """
    if resolution < LEAST:
        raise InputError(f"--resolution {resolution}: wanted at least {LEAST} cells; 128 is usual, 256 is fine")
    if seed < 0:
        raise InputError(f"--seed {seed}: wanted 0 or more")
    if out_dir.exists():
        raise InputError(f"{out_dir}: is there already; name a new folder")
    check_folder(out_dir)
    seconds: dict[str, float] = {}
    with _timed(seconds, "read"):
        import numpy as np
        import torch

        from cagesdf import inference
        from cagesdf.editing.session import as_given
        from cagesdf.io.fits import write_fit
        from cagesdf.io.residuals import read_residuals
        from cagesdf.io.runs import read_run
        from cagesdf.meshes import is_closed, signed_volume

        # With several, sums would be taken in another order on another machine.
        torch.set_num_threads(1)
        trained = read_run(run)
        known = inference.Known.of(trained, read_residuals(run))
        shape = imported(source)
    settings = settings_of()
    rng = np.random.default_rng(seed)
    with _timed(seconds, "prepare"):
        try:
            prepared = inference.prepare(trained, shape, settings, rng)
        except ShapeRejected as error:
            raise InputError(f"{source}: rejected: {error.reason}") from error
    with _timed(seconds, "code"):
        found = inference.fit_code(trained, known, prepared, settings.inference, seed)
    with _timed(seconds, "extract"):
        surface = inference.fitted_surface(trained, found, resolution)
    model = as_given(surface.mesh, surface.parts, prepared.fitted.cage, shape.structure, shape.similarity)
    if not is_closed(model.surface) or signed_volume(model.surface) <= 0:
        raise InputError(f"{source}: the network gives a surface with holes, nothing was written; {found.verdict}")
    with _timed(seconds, "measure"):
        measured = inference.measure(found, surface.mesh, **MEASURE, rng=rng)
    counts = {"vertices": len(model.surface.vertices), "faces": len(model.surface.faces)}
    told = inference.report(found, surface, measured) | counts
    with new_folder(out_dir) as folder:
        write_fit(folder, prepared.fitted, found.inferred.code, found.inferred.residual, model, told)
    print(json.dumps({"out": str(out_dir), **told, "seconds": seconds}, ensure_ascii=False))


def settings_of() -> "FitSettings":
    """How `fit` works."""
    from cagesdf.inference import FitSettings
    from cagesdf.point_chunks import PointCounts
    from cagesdf.training.inference import InferenceSettings

    return FitSettings(**CUBOIDS, counts=PointCounts(**SAMPLES), inference=InferenceSettings(**INFERENCE))


def imported(source: Path) -> "Shape":
    """The one shape of a source. Raises InputError if there are others, or it can't be used."""
    from cagesdf.formats.listing import find_shape, read_shape
    from cagesdf.importing import import_shape

    try:
        return import_shape(read_shape(find_shape(source)), **IMPORT, parts="auto")
    except ShapeRejected as error:
        raise InputError(f"{source}: rejected: {error.reason}") from error


@contextmanager
def _timed(seconds: dict[str, float], what: str) -> Iterator[None]:
    """Note how long the inside takes."""
    start = time.perf_counter()
    yield
    seconds[what] = round(time.perf_counter() - start, 4)
