"""Commands about shapes as their files give them."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cagesdf.cli.telling import Count, Json, for_people, tell, working
from cagesdf.errors import InputError
from cagesdf.io.files import check_folder, new_folder, replacing

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray

MAX_POINTS = 20_000_000


def check(*sources: Path, include: str = "*", as_json: Json = False) -> None:
    """Say of each shape whether it passes, how it was repaired, or why it was rejected.

    To a terminal in a line each, as it is done, and a sentence at the end; otherwise in one JSON object. A folder's
    shapes are those that `make own` would take; other files in it are listed first. Parts of a single mesh are found,
    and it is said whether those of a file were taken and why. Exit status 1 if any was rejected.

    Parameters
    ----------
    sources
        Folders of shapes (DATA of `make own`), PartNet shapes, and mesh files.
    include
        Glob over the names of a folder's shapes (INCLUDE of `make own`).
    """
    from cagesdf.api.sources import checked
    from cagesdf.formats.listing import find_shapes

    if not sources:
        raise InputError("wanted mesh files or folders. See cagesdf --help.")
    listings = [find_shapes(source, include) for source in sources]
    notes = [note for listing in listings for note in listing.notes]
    lines = for_people(as_json)
    if lines:
        print("".join(f"{note}\n" for note in notes), end="", flush=True)
    results = []
    done = Count("shapes", sum(map(len, listings)))
    for result in checked(shape for listing in listings for shape in listing):
        results.append(result)
        if lines:
            print(result, flush=True)
        else:
            done()
    rejected = sum(not result.usable for result in results)
    usable = len(results) - rejected
    shapes = [{"id": result.shape_id, "usable": result.usable, "verdict": result.verdict} for result in results]
    sentence = f"{len(results):,} shapes: {usable:,} can be used, {rejected:,} rejected"
    tell({"shapes": shapes, "usable": usable, "rejected": rejected, "notes": notes}, sentence, as_json)
    if rejected:
        raise InputError(f"{rejected:,} of {len(results):,} shapes rejected")


def parts(source: Path, out: Path, /, *, change: tuple[str, ...] = (), as_json: Json = False) -> None:
    """Find the parts of a whole shape and write them to be edited, SHAPE.parts.json, and SHAPE.glb to look at.

    Prints how well cuboids hold them: a sentence to a terminal, a JSON object otherwise. Beside the shape,
    `make own` prefers the file to finding parts.

    Parameters
    ----------
    source
        A mesh file or a folder of meshes: one shape, upright (y up). Its groups are joined.
    out
        A new folder, in one that exists.
    change
        A change of the parts by hand, after those before it: "merge part_1 part_2", "split part_1 y 0.4" (at a height
        in the file's frame and unit), "rename part_1 seat", "label seat seat".
    """
    import numpy as np

    from cagesdf.api.sources import IMPORT
    from cagesdf.errors import ShapeRejected
    from cagesdf.exported import ExportedShape
    from cagesdf.formats.listing import find_shape, read_shape
    from cagesdf.geometry.meshes import Mesh
    from cagesdf.geometry.solid import CUBE_FACES, union
    from cagesdf.io.exports import write_export
    from cagesdf.parts.changing import Dissection
    from cagesdf.parts.written import SUFFIX, written_json

    if out.exists():
        raise InputError(f"{out}: is there already; name a new folder")
    check_folder(out)
    try:
        with working(f"reading {source}"):
            raw = read_shape(replace(find_shape(source), written=None))
        with working("finding parts"):
            dissection = Dissection.of(raw, IMPORT["up"], IMPORT["weld"], IMPORT["min_thickness"])
    except ShapeRejected as error:
        raise InputError(f"{source}: rejected: {error.reason}") from error
    dissection = dissection.changed(list(change))
    result = dissection.result

    def as_given(mesh: Mesh) -> Mesh:
        return mesh.with_vertices(dissection.placement.to_raw(mesh.vertices))

    cage = dissection.cage()
    boxes = {
        name: as_given(Mesh(np.array(corners), CUBE_FACES)) for name, corners in zip(cage.part_ids, cage.corners())
    }
    solids = {part.name: as_given(part.mesh) for part in result.parts}
    with working("joining the parts"):
        exported = ExportedShape.of(as_given(union([part.mesh for part in result.parts])), solids, boxes)
    with new_folder(out) as folder:
        write_export(folder / f"{raw.shape_id}.glb", exported)
        text = written_json(dissection.written())
        (folder / f"{raw.shape_id}{SUFFIX}").write_text(text, encoding="utf-8", newline="\n")
    counts = {"components": len(result.components), "parts": len(result.parts), "boxes": round(result.boxes, 4)}
    tell({"out": str(out), **counts}, f"{out}: {counts['parts']} parts of {counts['components']} components", as_json)


def sdf(source: Path, points: Path, out: Path, /, *, as_json: Json = False) -> None:
    """Write the signed distances of points to a shape, in its own frame and unit, negative inside.

    Prints how the shape was repaired: a sentence to a terminal, a JSON object otherwise.

    Parameters
    ----------
    source
        A mesh file, a folder of part meshes, or a PartNet shape.
    points
        A .npy file of n rows: x, y, z.
    out
        A .npy file for n float32 numbers, in a folder that exists.
    """
    import numpy as np

    from cagesdf.api.sources import check_points, imported
    from cagesdf.importing import repair_report, signed_distances

    if out.suffix.lower() != ".npy" or out.resolve() == points.resolve():
        raise InputError(f"{out}: wanted a name that ends in .npy, and not that of the points")
    check_folder(out)
    places = _read_points(points)
    with working(f"reading {source} and closing its parts"):
        shape = imported(source, "given")
    with _named(points):
        check_points(places, shape)
    with working(f"measuring {len(places):,} distances"):
        distances = signed_distances(shape, places.astype(np.float64)).astype(np.float32)
    with replacing(out) as partial, partial.open("wb") as stream:
        np.save(stream, distances)
    inside = int((distances < 0).sum())
    figures = {**repair_report(shape), "points": len(distances), "points_inside": inside}
    tell(figures, f"{out}: {len(distances):,} distances, {inside:,} of points inside", as_json)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Name the file of what is refused inside."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _read_points(path: Path) -> "Float[ndarray, 'n 3']":
    """The points of a .npy file. Raises InputError for anything else."""
    import numpy as np

    from cagesdf.api.sources import check_points

    wanted = f"wanted a .npy file of at most {MAX_POINTS:,} rows x, y, z, finite floating-point numbers"
    if not path.is_file():
        raise InputError(f"{path}: no such file; {wanted}")
    try:
        # Mapped, so that nothing is read before its size is known.
        stored = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError, OSError, SyntaxError) as error:
        raise InputError(f"{path}: can't be read ({error}); {wanted}") from error
    if not isinstance(stored, np.ndarray):
        raise InputError(f"{path}: holds several arrays; {wanted}")
    if stored.size > 3 * MAX_POINTS:
        raise InputError(f"{path}: holds {stored.dtype} of shape {stored.shape}; {wanted}")
    with _named(path):
        check_points(stored)
    return np.array(stored)
