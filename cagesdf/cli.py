"""The `cagesdf` command: look into artefacts, run programs, take surfaces out of trained networks."""

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal

import cyclopts

from cagesdf.errors import InputError, ProgramError
from cagesdf.meshes import Mesh
from pipeline import artefact

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray

    from cagesdf.cuboid import Cage
    from cagesdf.structure.program import AssemblyProgram

FORMATS = (".ply", ".obj", ".stl", ".glb")
# How `check` and `sdf` import: as params.yaml does.
IMPORT: dict[str, Any] = {
    "up": "y", "weld": 1e-5, "max_faces": 2_000_000, "max_parts": 150, "min_thickness": 1e-4,
}  # fmt: skip
MAX_POINTS = 20_000_000

app = cyclopts.App(
    "cagesdf",
    help="Neural implicit shapes with explicit bounding cuboids.",
    version=lambda: version("cagesdf"),
    version_flags=["--version"],
)


@app.command
def inspect(path: Path, /, *, picture: Path | None = None) -> None:
    """Say what an artefact holds: manifest, schema, counts, ranges and a few rows.

    Parameters
    ----------
    path
        A folder that a stage wrote, one of its .parquet files, or a .ply mesh.
    picture
        A .png file for a slice through a shape's distances; for a shard of points or a folder of them.
    """
    print("\n\n".join(_described(path)))
    if picture is not None:
        _draw(path, picture)


@app.command
def extract(run: Path, shape_id: str, out: Path, /, *, resolution: int = 128, step: int = 0) -> None:
    """Write the surface that a trained network gives for one of its shapes, in the frame and unit of your files.

    Parameters
    ----------
    run
        A folder that `train` wrote, such as data/runs/chair/cagesdf.
    shape_id
        One of its training shapes.
    out
        A .ply, .obj, .stl or .glb file in a folder that exists.
    resolution
        Cells along 2.1 times the radius of the shape's bounding sphere.
    step
        Step of the shape's deformation sequence; 0 is the shape itself.
    """
    if resolution < 8:
        raise InputError(f"--resolution {resolution}: wanted at least 8 cells; 128 is usual, 256 is fine")
    if out.suffix.lower() not in FORMATS:
        raise InputError(f"{out}: wanted a name that ends in {', '.join(FORMATS)}")
    _check_folder(out)
    mesh = _surface(run, shape_id, step, resolution)
    _write(mesh, out)
    print(f"{out}: {len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces, closed")


@app.command(name="execute")
def execute_programs(*paths: Path, out: Path | None = None, mesh: Path | None = None) -> None:
    """Say which cuboids ShapeAssembly programs make: a JSON object a program, on a line of its own.

    {"id": file name without .txt, "cuboids": [[centre 3, x axis 3, y axis 3, z axis 3, full lengths 3], ...]},
    or {"id": ..., "error": ...}; then the exit status is 1.

    Parameters
    ----------
    paths
        Program files, and folders with any number of them, at any depth; lists of ids such as train.txt are left out.
    out
        A .jsonl file for the lines, instead of standard output.
    mesh
        An .obj file for a single program's cuboids, each an object of its own.
    """
    from cagesdf.formats.shapeassembly import list_programs
    from cagesdf.structure.executor import execute
    from cagesdf.structure.parsing import read_program

    files = list_programs(_some(paths))
    if mesh is not None and (len(files) != 1 or mesh.suffix.lower() != ".obj"):
        raise InputError(f"{mesh}: wanted one program and a name that ends in .obj; got {len(files):,} programs")
    for target in (out, mesh):
        if target is not None:
            _check_folder(target)

    if mesh is not None:
        content = _obj(files[0].stem, execute(read_program(files[0])))
        with _replacing(mesh) as partial:
            partial.write_text(content, encoding="utf-8")

    failures: list[ProgramError] = []
    lines = _answers(files, lambda program: {"cuboids": execute(program).vectors().tolist()}, failures)
    if out is None:
        for line in lines:
            print(line, flush=True)
    else:
        with _replacing(out) as partial, partial.open("w", encoding="utf-8") as stream:
            stream.writelines(f"{line}\n" for line in lines)
        print(f"{out}: cuboids of {len(files) - len(failures):,} of {len(files):,} programs")
    _complain(failures, len(files))


@app.command
def signature(*paths: Path, kind: Literal["exact", "canonical"] = "canonical", summary: bool = False) -> None:
    """Say which ShapeAssembly programs are equal up to continuous parameters: their signatures are.

    {"id": file name without .txt, "signature": text} on a line of its own, or {"id": ..., "error": ...}; then the
    exit status is 1.

    Parameters
    ----------
    paths
        Program files, and folders with any number of them, at any depth; lists of ids such as train.txt are left out.
    kind
        exact: equal programs have the same text but for the numbers; canonical: also the names of cuboids and the
        order of statements may differ.
    summary
        Count the classes of equal programs instead.
    """
    from cagesdf.formats.shapeassembly import list_programs
    from cagesdf.structure.canonical import canonical_signature, exact_signature

    sign = {"exact": exact_signature, "canonical": canonical_signature}[kind]
    files = list_programs(_some(paths))
    failures: list[ProgramError] = []
    classes: Counter[str] = Counter()

    def answer(program: "AssemblyProgram") -> dict[str, Any]:
        text = sign(program)
        classes[text] += 1
        return {"signature": text}

    for line in _answers(files, answer, failures):
        if not summary:
            print(line, flush=True)
    if summary:
        print("\n".join(_class_counts(classes)))
    _complain(failures, len(files))


@app.command
def check(*sources: Path) -> None:
    """Say of each shape whether it passes, how it was repaired, or why it was rejected: a line each, as it is done.

    Exit status 1 if any was rejected.

    Parameters
    ----------
    sources
        Mesh files, folders of part meshes, PartNet shapes, and folders of any of these.
    """
    from cagesdf.errors import ShapeRejected
    from cagesdf.formats.listing import find_shapes, read_shape
    from cagesdf.importing import import_shape, verdict

    if not sources:
        raise InputError("wanted mesh files or folders. See cagesdf --help.")
    found = [shape for source in sources for shape in find_shapes(source)]
    rejected = 0
    for source in found:
        try:
            told = verdict(import_shape(read_shape(source), **IMPORT))
        except ShapeRejected as error:
            told = f"rejected: {error.reason}"
            rejected += 1
        print(f"{source.shape_id}: {told}", flush=True)
    if rejected:
        raise InputError(f"{rejected:,} of {len(found):,} shapes rejected")


@app.command
def sdf(source: Path, points: Path, out: Path, /) -> None:
    """Write the signed distances of points to a shape, in its own frame and unit, negative inside.

    Prints how the shape was repaired as a JSON object.

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

    from cagesdf.errors import ShapeRejected
    from cagesdf.formats.listing import find_shapes, read_shape
    from cagesdf.importing import import_shape, repair_report, signed_distances

    if out.suffix.lower() != ".npy" or out.resolve() == points.resolve():
        raise InputError(f"{out}: wanted a name that ends in .npy, and not that of the points")
    _check_folder(out)
    places = _read_points(points)
    found = find_shapes(source)
    if len(found) != 1 or found[0].path.resolve() != source.resolve():
        raise InputError(f"{source}: holds {len(found):,} shapes, such as {found[0].shape_id}; name one")
    try:
        shape = import_shape(read_shape(found[0]), **IMPORT)
    except ShapeRejected as error:
        raise InputError(f"{source}: rejected: {error.reason}") from error
    distances = signed_distances(shape, places).astype(np.float32)
    with _replacing(out) as partial, partial.open("wb") as stream:
        np.save(stream, distances)
    print(json.dumps({**repair_report(shape), "points": len(distances), "points_inside": int((distances < 0).sum())}))


def _read_points(path: Path) -> "Float[ndarray, 'n 3']":
    """The points of a .npy file. Raises InputError for anything else."""
    import numpy as np

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
    if stored.dtype.kind != "f" or stored.ndim != 2 or stored.shape[1] != 3 or len(stored) > MAX_POINTS:
        raise InputError(f"{path}: holds {stored.dtype} of shape {stored.shape}; {wanted}")
    points = np.array(stored, dtype=np.float64)
    if not (finite := np.isfinite(points).all(1)).all():
        raise InputError(f"{path}: row {int(finite.argmin())} is {points[finite.argmin()].tolist()}; {wanted}")
    return points


@app.command
def plan(*, profile: str | None = None) -> None:
    """Say what a run will cost: shapes, points, and disk, memory and time of each stage on this machine.

    Runs the stages on two shapes a category, which takes about a minute, and scales that up.

    Parameters
    ----------
    profile
        One of profiles/, such as paper; without it, the default run.
    """
    from cagesdf.io.points import CHUNK
    from cagesdf.training.points import BYTES_A_POINT
    from pipeline.planning import Groups
    from pipeline.planning import plan as estimated

    with TemporaryDirectory() as folder:
        print("\n".join(estimated(profile, Path(folder), Groups(CHUNK, BYTES_A_POINT))))


def _some(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    if not paths:
        raise InputError("wanted files or folders with ShapeAssembly programs. See cagesdf --help.")
    return paths


def _answers(
    files: Iterable[Path], answer: Callable[["AssemblyProgram"], dict[str, Any]], failures: list[ProgramError]
) -> Iterator[str]:
    """A line of JSON for each program: its id, and the answer or what is wrong, which is noted too."""
    from cagesdf.structure.parsing import read_program

    for file in files:
        try:
            found = answer(read_program(file))
        except ProgramError as error:
            failures.append(error)
            found = {"error": str(error)}
        yield json.dumps({"id": file.stem, **found}, ensure_ascii=False)


def _complain(failures: list[ProgramError], programs: int) -> None:
    if failures:
        raise InputError(f"{len(failures):,} of {programs:,} programs failed; the first: {failures[0]}")


def _class_counts(classes: Counter[str]) -> list[str]:
    from cagesdf.io.summary import aligned

    programs = classes.total()
    partnered = sum(count for count in classes.values() if count > 1)
    return aligned(
        [
            ["programs", f"{programs:,}"],
            ["classes", f"{len(classes):,}"],
            ["largest class", f"{max(classes.values(), default=0):,}"],
            ["with a partner", f"{partnered:,}" + (f" ({partnered / programs:.1%})" if programs else "")],
        ]
    )


def _obj(name: str, cage: "Cage") -> str:
    """Wavefront OBJ with an object for each cuboid."""
    from cagesdf.solid import CUBE_FACES

    lines = []
    for i, (part_id, corners) in enumerate(zip(cage.part_ids, cage.corners().tolist())):
        lines += [f"o {name}/{part_id}", *(f"v {x!r} {y!r} {z!r}" for x, y, z in corners)]
        lines += [f"f {a} {b} {c}" for a, b, c in (CUBE_FACES + 8 * i + 1).tolist()]
    return "\n".join(lines) + "\n"


def _described(path: Path) -> list[str]:
    """Paragraphs about a folder or file."""
    from cagesdf.io.summary import summarise

    if path.is_dir():
        return _artefact(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file or folder; wanted an artefact such as data/points/chair")
    if path.suffix == ".parquet":
        return [summarise([path])]
    if path.suffix == ".ply":
        return [_mesh(path)]
    raise InputError(f"{path}: wanted an artefact's folder, a .parquet or a .ply file")


def _draw(path: Path, picture: Path) -> None:
    """A slice through the distances of the first shape in a shard."""
    from cagesdf.io.points import shard_paths
    from cagesdf.io.slices import draw_slice, middle_slice

    if picture.suffix.lower() != ".png":
        raise InputError(f"{picture}: wanted a name that ends in .png")
    _check_folder(picture)
    found = middle_slice(shard_paths(path)[0] if path.is_dir() else path)
    with _replacing(picture) as partial:
        draw_slice(found, partial)


def _artefact(folder: Path) -> list[str]:
    """Paragraphs about a folder that a stage wrote: its manifest, then each of its tables."""
    from cagesdf.io.summary import aligned, indented, summarise

    inside = sorted(item.name for item in folder.iterdir() if (item / artefact.MANIFEST).is_file())
    if inside and not (folder / artefact.MANIFEST).is_file():
        raise InputError(f"{folder}: holds the artefacts {', '.join(inside)}; inspect one of them")
    manifest = artefact.read_manifest(folder)
    files: dict[str, dict[str, Any]] = manifest["files"]
    size = sum(item["bytes"] for item in files.values())
    facts = [
        ["kind", f"{manifest['kind']}, format {manifest['format']}"],
        ["files", f"{len(files):,}, {size / 1e6:,.1f} MB"],
        ["inputs", ", ".join(f"{name} {digest[:8]}" for name, digest in manifest.get("inputs", {}).items()) or "none"],
        *([name, json.dumps(value)] for name, value in manifest.get("params", {}).items()),
    ]
    by_ending = Counter(Path(name).suffix for name in files)
    others = [
        [name, f"{item['bytes']:,} bytes"]
        for name, item in files.items()
        if not name.endswith(".parquet") and by_ending[Path(name).suffix] <= 8
    ]
    paragraphs = [f"{folder}\n{indented(aligned([*facts, *others]))}"]
    tables = [folder / name for name in files if name.endswith(".parquet")]
    # Shards are one table in several files.
    stems = sorted({table.stem.rstrip("0123456789") for table in tables})
    shards = [[table for table in tables if table.stem.rstrip("0123456789") == stem] for stem in stems]
    return paragraphs + [summarise(paths) for paths in shards]


def _mesh(path: Path) -> str:
    """What can be said of one mesh."""
    from cagesdf.io.meshes import read_ply
    from cagesdf.io.summary import aligned, indented
    from cagesdf.meshes import is_closed, signed_volume

    mesh = read_ply(path)
    if len(mesh.faces) == 0:
        return f"{path}: no faces"
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    facts = [["vertices", f"{len(mesh.vertices):,}"], ["faces", f"{len(mesh.faces):,}"]]
    if is_closed(mesh):
        facts += [["closed", "yes: no hole, one orientation"], ["volume", f"{signed_volume(mesh):.4g}"]]
    else:
        facts += [["closed", "no"]]
    facts += [[axis, f"{a:.4g} to {b:.4g}"] for axis, a, b in zip("xyz", low, high)]
    return f"{path}\n{indented(aligned(facts))}"


def _surface(folder: Path, shape_id: str, step: int, resolution: int) -> Mesh:
    """What a trained network gives for one step of one shape, raw frame, closed."""
    from cagesdf.extraction import FIELDS, OUTSIDES, extract_surface
    from cagesdf.io.runs import read_run
    from cagesdf.meshes import is_closed

    trained = read_run(folder)
    known = sorted(trained.sequences)
    if shape_id not in known:
        near = get_close_matches(shape_id, known, n=3, cutoff=0.5) or known[:3]
        raise InputError(f"{folder}: has no shape {shape_id!r} among its {len(known)}; did you mean {', '.join(near)}?")
    steps = trained.steps(shape_id)
    if step not in steps:
        raise InputError(f"--step {step}: {shape_id} has the steps {', '.join(map(str, steps))}")
    make_field = FIELDS[trained.params["points_of"]]
    cage = trained.sequences[shape_id].cages[step]
    field = make_field(trained.decoder, trained.latent(shape_id, step), cage, OUTSIDES["union"])
    mesh = extract_surface(field, resolution)
    if not is_closed(mesh):
        state = "no surface at all" if len(mesh.faces) == 0 else "a surface with holes"
        raise InputError(
            f"{shape_id}: the network gives {state}, nothing was written; train longer or raise --resolution"
        )
    return mesh.with_vertices(trained.similarities[shape_id].to_raw(mesh.vertices))


def _write(mesh: Mesh, out: Path) -> None:
    """Write a mesh whole or not at all, in the format of the name's ending."""
    from cagesdf.io.meshes import write_ply

    with _replacing(out) as partial:
        if out.suffix.lower() == ".ply":
            write_ply(partial, mesh)
        else:
            import trimesh

            solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
            solid.export(partial, file_type=out.suffix.lower().removeprefix("."))


def _check_folder(out: Path) -> None:
    if not out.resolve().parent.is_dir():
        raise InputError(f"{out}: there is no folder {out.parent}; make it first")


@contextmanager
def _replacing(out: Path) -> Iterator[Path]:
    """A path beside `out`, which takes its place once what is written there is whole."""
    partial = out.with_name(f".{out.name}.partial")
    try:
        yield partial
        os.replace(partial, out)
    finally:
        partial.unlink(missing_ok=True)


def run() -> None:
    """Run the command line. What is wrong is said in one line on standard error, with exit status 1."""
    try:
        app(sys.argv[1:], exit_on_error=False, print_error=False)
    except BrokenPipeError:
        # Who read the output has seen enough; what is still buffered must go somewhere when Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except (cyclopts.CycloptsError, ValueError, OSError) as error:
        text = " ".join(str(error).split())
        sys.exit(f"cagesdf: {text}{' See cagesdf --help.' if isinstance(error, cyclopts.CycloptsError) else ''}")
    except KeyboardInterrupt:
        sys.exit("cagesdf: interrupted")
