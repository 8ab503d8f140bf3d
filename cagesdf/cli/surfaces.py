"""Commands that take surfaces out of trained networks, as they are or edited."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from cagesdf.cli.machine import workers
from cagesdf.cli.telling import Count, Json, tell, warn, working
from cagesdf.errors import InputError
from cagesdf.io.files import check_folder, replacing

if TYPE_CHECKING:
    from cagesdf.api.shapes import EditableShape
    from cagesdf.extraction import Each, Part

# Parameters that several commands have, with their help.
RunFolder = Annotated[Path, Parameter(help="A folder that `train` wrote, such as data/runs/chair/cagesdf; or demo.")]
OutFile = Annotated[
    Path,
    Parameter(
        help="A .ply, .obj, .stl or .glb file in a folder that exists; .obj and .glb are cut into parts, .glb has the "
        "cuboids too (as its last scene)."
    ),
]
Resolution = Annotated[int, Parameter(help="Cells along 2.1 times the radius of the shape's bounding sphere.")]
Symmetry = Annotated[Literal["none", "x"], Parameter(help="x: a mirrored cage gets an exactly mirrored surface.")]
Loose = Annotated[Literal["keep", "drop"], Parameter(help="drop: leave out components smaller than the largest.")]
CuboidsFile = Annotated[Path | None, Parameter(help="A file of these kinds for the cuboids alone.")]


def extract(
    run: RunFolder,
    shape_id: str,
    out: OutFile,
    /,
    *,
    resolution: Resolution = 128,
    step: int = 0,
    method: Literal["sparse", "dense"] = "sparse",
    symmetry: Symmetry = "none",
    loose: Loose = "keep",
    cuboids: CuboidsFile = None,
    as_json: Json = False,
) -> None:
    """Write the surface that a trained network gives for one of its shapes, in the frame and unit of your files.

    Prints timings, evaluations of the network and checks of the mesh: a sentence to a terminal, JSON otherwise.

    Parameters
    ----------
    shape_id
        One of its training shapes.
    step
        Step of the shape's deformation sequence; 0 is the shape itself.
    method
        sparse: evaluate the network where the surface can be; dense: at every grid point of a cuboid, for comparison.
    """
    work = _Work(run, out, cuboids, resolution, symmetry, method=method, loose=loose)
    work.write(work.run.open(shape_id, step), as_json)


def edit(
    run: RunFolder,
    shape_id: str,
    script: Path,
    out: OutFile,
    /,
    *,
    resolution: Resolution = 128,
    symmetry: Symmetry = "none",
    loose: Loose = "keep",
    cuboids: CuboidsFile = None,
    as_json: Json = False,
) -> None:
    """Edit one of a trained network's shapes by a script and write its surface, as `extract` does.

    Parameters
    ----------
    shape_id
        One of its training shapes.
    script
        A .json file: a list of operations, such as [{"op": "swap", "style_of": "chair_0007"}]; docs/editing.md has
        all of them, `cagesdf inspect RUN --shape ID` the names of parts and parameters.
    """
    from cagesdf.editing.script import MAX_BYTES, parse
    from cagesdf.text import read_text

    operations = parse(read_text(script, MAX_BYTES))
    work = _Work(run, out, cuboids, resolution, symmetry, loose=loose)
    shape = work.run.open(shape_id)
    with work.timed("edit", "editing"):
        shape.edit(operations)
    work.write(shape, as_json)


def swap(
    run: RunFolder,
    cuboids_of: str,
    style_of: str,
    out: OutFile,
    /,
    *,
    resolution: Resolution = 128,
    symmetry: Symmetry = "none",
    loose: Loose = "keep",
    cuboids: CuboidsFile = None,
    as_json: Json = False,
) -> None:
    """Write the surface of one shape's cuboids in another's style, as `extract` does.

    Parameters
    ----------
    cuboids_of
        The training shape whose cuboids are taken; its frame and unit, too.
    style_of
        The training shape whose latent code is taken.
    """
    work = _Work(run, out, cuboids, resolution, symmetry, loose=loose)
    work.write(work.run.open(cuboids_of).swap(style_of), as_json)


def mix(
    run: RunFolder,
    cuboids_of: str,
    parts: list[str],
    out: OutFile,
    /,
    *,
    weight: float = 1.0,
    source: Annotated[str | None, Parameter(name="--from")] = None,
    details: Literal["stretch", "keep"] = "stretch",
    resolution: Resolution = 128,
    symmetry: Symmetry = "none",
    loose: Loose = "keep",
    cuboids: CuboidsFile = None,
    as_json: Json = False,
) -> None:
    """Write the surface of one shape with some of its parts in the styles of others, as `extract` does.

    The run's arm is one whose parts have codes, such as cagesdf.

    Parameters
    ----------
    cuboids_of
        The training shape whose cuboids are taken; its frame and unit, and the style of the other parts, too.
    parts
        One or more of PART=SHAPE, such as 'leg_*=chair_0007' or 'seat|back=chair_0003': which parts take the style of
        which training shape's corresponding parts. Parts that mirror or repeat these follow.
    weight
        How far the parts go towards those styles: 0 stays, 1 arrives.
    source
        Parts of the other shapes whose styles are taken, such as leg; without it, those that correspond.
    details
        Whether details stretch with the cuboids, or keep the size that they have in the other shapes.
    """
    pairs = [text.rpartition("=") for text in parts]
    if wrong := next((text for text, (part, _, style_of) in zip(parts, pairs) if not part or not style_of), None):
        raise InputError(f"{wrong!r}: wanted PART=SHAPE, such as 'leg_*=chair_0007'")
    work = _Work(run, out, cuboids, resolution, symmetry, loose=loose)
    shape = work.run.open(cuboids_of)
    for part, _, style_of in pairs:
        shape.mix(part, style_of, source=source, weight=weight, details=details)
    work.write(shape, as_json)


@contextmanager
def side_by_side(cuboids: int) -> Iterator["Each"]:
    """A `map` over cuboids in a thread for each worker, which says how many are done.

    Torch has one thread meanwhile: its own would wait for each other on a busy machine.
    """
    from cagesdf.api.runs import one_thread

    with one_thread(), ThreadPoolExecutor(workers()) as pool:
        done = Count("surface, cuboids", cuboids)

        def each(work: Callable[[int], "Part"], numbers: Iterable[int]) -> Iterator["Part"]:
            for part in pool.map(work, numbers):
                done()
                yield part

        yield each


class _Work:
    """One command: reads a run, extracts a surface, checks and writes it; keeps the time of each step."""

    def __init__(
        self, run: Path, out: Path, cuboids: Path | None, resolution: int, symmetry: str, **choices: str
    ) -> None:
        """Choices are extraction's, by name. Raises InputError before anything is computed."""
        from cagesdf.io.exports import check_name

        for path in (out, *([cuboids] if cuboids else [])):
            check_name(path)
            check_folder(path)
        if cuboids is not None and cuboids.resolve() == out.resolve():
            raise InputError(f"--cuboids {cuboids}: is the surface's file; name another one")
        self.out, self.cuboids, self.resolution = out, cuboids, resolution
        self.choices = {"symmetry": symmetry, **choices}
        self.seconds: dict[str, float] = {}
        with self.timed("read", f"reading {run}"):
            from cagesdf.api.runs import load_run
            from cagesdf.api.shapes import check_resolution

            check_resolution(resolution)
            self.run = load_run(run)

    def timed(self, name: str, what: str) -> AbstractContextManager[None]:
        """Note the time that the context takes, and say what is done in it if that is long."""
        return working(what, self.seconds, name)

    def write(self, shape: "EditableShape", as_json: bool) -> None:
        """Extract a shape's surface, check it, write it and print the line."""
        from cagesdf.editing.health import Health
        from cagesdf.geometry.meshes import signed_volume
        from cagesdf.io.exports import write_boxes, write_export

        cells = f"{len(shape.cage)} parts with {self.resolution} cells"
        with self.timed("extract", f"evaluating {cells}"), side_by_side(len(shape.cage)) as each:
            surface = shape.extract(self.resolution, **self.choices, each=each)
        with self.timed("place", "placing it in the files' frame"):
            exported = shape.exported(surface)
        with self.timed("write", f"writing {self.out}"), ExitStack() as files:
            write_export(files.enter_context(replacing(self.out)), exported)
            if self.cuboids is not None:
                write_boxes(files.enter_context(replacing(self.cuboids)), exported)
        health = Health.of(surface, shape.state, self.resolution)
        warn(health.warnings())
        result = {
            "out": str(self.out),
            "vertices": len(exported.surface.vertices),
            "faces": len(exported.surface.faces),
            "evaluations": surface.evaluations,
            "closed": True,
            "volume": signed_volume(exported.surface),
            "components": surface.components,
            "dropped": surface.dropped,
            "thinnest": health.thinnest,
            "thickness": health.thickness,
            "cells": round(health.cells, 2),
            "clipped": round(surface.clipped, 6),
            "overshoot": surface.overshoot,
            "seconds": self.seconds,
        }
        faces, seconds = len(exported.surface.faces), sum(self.seconds.values())
        tell(result, f"{self.out}: {faces:,} faces, {health}; {seconds:.1f} s", as_json)
