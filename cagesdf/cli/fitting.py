"""The command that takes shapes into a trained network that it has never seen."""

from pathlib import Path

from cagesdf.cli.surfaces import Loose, RunFolder, side_by_side
from cagesdf.cli.telling import Json, tell, warn, working
from cagesdf.errors import InputError
from cagesdf.io.files import check_folder, new_folder


def fit(
    run: RunFolder,
    source: Path,
    out_dir: Path,
    /,
    *,
    resolution: int = 128,
    seed: int = 0,
    loose: Loose = "keep",
    as_json: Json = False,
) -> None:
    """Find the cuboids and the code of a shape that a network was not trained on, and write the surface it gives.

    Prints the result: a sentence to a terminal, a JSON object otherwise. Its verdict says whether the
    shape is like those that the network was trained on; the surface of one that is far from them should not be trusted.

    Parameters
    ----------
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
    if out_dir.exists():
        raise InputError(f"{out_dir}: is there already; name a new folder")
    check_folder(out_dir)
    seconds: dict[str, float] = {}
    with working("reading the run", seconds, "read"):
        from cagesdf.api.runs import check_seed, load_run
        from cagesdf.api.shapes import check_resolution
        from cagesdf.editing.health import Health
        from cagesdf.io.fits import write_fit

        check_resolution(resolution)
        check_seed(seed)
        trained = load_run(run)
    with working("fitting cuboids, and looking for the code that explains the shape best", seconds, "fit"):
        fitted = trained.fit(source, seed)
    cells = f"{len(fitted.cage)} parts with {resolution} cells"
    with working(f"evaluating {cells}", seconds, "extract"), side_by_side(len(fitted.cage)) as each:
        surface = fitted.extract(resolution, loose, each)
        exported = fitted.exported(surface)
    with working("measuring how far the surface is from the shape", seconds, "measure"):
        report = fitted.report(surface, seed)
    health = Health.of(surface, fitted.editable().state, resolution)
    report |= {
        "vertices": len(exported.surface.vertices),
        "faces": len(exported.surface.faces),
        "dropped": surface.dropped,
    }
    fit = fitted.fit
    with new_folder(out_dir) as folder:
        write_fit(folder, fit.prepared.fitted, fit.inferred.code, fit.inferred.residual, exported, report)
    warn(health.warnings())
    distance = f"surface {report['surface_distance']} % of the longest side from the shape's"
    sentence = (
        f"{out_dir}: {report['parts']} parts, {distance}; {health}; {report['verdict']}; {sum(seconds.values()):.1f} s"
    )
    tell({"out": str(out_dir), **report, "seconds": seconds}, sentence, as_json)
