"""Commands that take surfaces out of trained networks, as they are or edited."""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cagesdf.cli.files import check_folder, replacing
from cagesdf.errors import InputError

if TYPE_CHECKING:
    from cagesdf.editing.state import State

LEAST = 8  # cells
MAX_BYTES = 4_000_000  # of a script: as many characters as `parse` takes, at most four bytes each


def extract(
    run: Path,
    shape_id: str,
    out: Path,
    /,
    *,
    resolution: int = 128,
    step: int = 0,
    method: Literal["sparse", "dense"] = "sparse",
    symmetry: Literal["none", "x"] = "none",
    loose: Literal["keep", "drop"] = "keep",
) -> None:
    """Write the surface that a trained network gives for one of its shapes, in the frame and unit of your files.

    Prints timings, evaluations of the network and what was checked of the mesh, as a JSON object.

    Parameters
    ----------
    run
        A folder that `train` wrote, such as data/runs/chair/cagesdf.
    shape_id
        One of its training shapes.
    out
        A .ply, .obj, .stl or .glb file in a folder that exists; .obj and .glb are cut into parts and have the
        cuboids too.
    resolution
        Cells along 2.1 times the radius of the shape's bounding sphere.
    step
        Step of the shape's deformation sequence; 0 is the shape itself.
    method
        sparse: ask the network where the surface can be; dense: at every grid point inside a cuboid, for comparison.
    symmetry
        x: a mirrored cage gets an exactly mirrored surface.
    loose
        drop: leave pieces out that hang on to nothing.
    """
    work = _Work(run, out, resolution, method=method, symmetry=symmetry, loose=loose)
    work.write(work.session.opened(shape_id, step))


def edit(
    run: Path,
    shape_id: str,
    script: Path,
    out: Path,
    /,
    *,
    resolution: int = 128,
    symmetry: Literal["none", "x"] = "none",
) -> None:
    """Edit one of a trained network's shapes by a script and write its surface, as `extract` does.

    Parameters
    ----------
    run
        A folder that `train` wrote, such as data/runs/chair/cagesdf.
    shape_id
        One of its training shapes.
    script
        A .json file: a list of operations, such as [{"op": "swap", "style_of": "chair_0007"}]; docs/editing.md has
        all of them, `cagesdf inspect RUN --shape ID` the names of parts and parameters.
    out
        A .ply, .obj, .stl or .glb file in a folder that exists.
    resolution
        Cells along 2.1 times the radius of the shape's bounding sphere.
    symmetry
        x: a mirrored cage gets an exactly mirrored surface.
    """
    from cagesdf.editing.script import parse

    operations = parse(_text(script))
    work = _Work(run, out, resolution, symmetry=symmetry)
    state = work.session.opened(shape_id)
    with work.timed("edit"):
        state = work.session.edited(state, operations).present
    work.write(state)


def swap(
    run: Path,
    cuboids_of: str,
    style_of: str,
    out: Path,
    /,
    *,
    resolution: int = 128,
    symmetry: Literal["none", "x"] = "none",
) -> None:
    """Write the surface of one shape's cuboids in another's style, as `extract` does.

    Parameters
    ----------
    run
        A folder that `train` wrote, such as data/runs/chair/cagesdf.
    cuboids_of
        The training shape whose cuboids are taken; its frame and unit, too.
    style_of
        The training shape whose latent code is taken.
    out
        A .ply, .obj, .stl or .glb file in a folder that exists.
    resolution
        Cells along 2.1 times the radius of the shape's bounding sphere.
    symmetry
        x: a mirrored cage gets an exactly mirrored surface.
    """
    from cagesdf.editing.script import Swap

    work = _Work(run, out, resolution, symmetry=symmetry)
    state = work.session.opened(cuboids_of)
    work.write(work.session.edited(state, (Swap(style_of=style_of),)).present)


class _Work:
    """One command's way from a run to a file: what it took, and what was checked."""

    def __init__(
        self,
        run: Path,
        out: Path,
        resolution: int,
        symmetry: str,
        method: str = "sparse",
        loose: str = "keep",
    ) -> None:
        """Choices are extraction's, by name. Raises InputError before anything is done in vain."""
        from cagesdf.io.exports import check_name

        if resolution < LEAST:
            raise InputError(f"--resolution {resolution}: wanted at least {LEAST} cells; 128 is usual, 256 is fine")
        check_name(out)
        check_folder(out)
        self.out = out
        self.seconds: dict[str, float] = {}
        with self.timed("read"):
            from cagesdf.editing.session import Session
            from cagesdf.io.runs import read_run

            self.session = Session(read_run(run))
            self.live = self.session.live(resolution, method, loose, symmetry)

    @contextmanager
    def timed(self, what: str) -> Iterator[None]:
        """Note how long the inside takes."""
        start = time.perf_counter()
        yield
        self.seconds[what] = round(time.perf_counter() - start, 4)

    def write(self, state: "State") -> None:
        """Extract a state's surface, check it, write it and print the line."""
        from cagesdf.editing.session import model_of
        from cagesdf.io.exports import write_model
        from cagesdf.meshes import is_closed, signed_volume

        with self.timed("extract"):
            found = self.live.surface(state)
        with self.timed("cut"):
            model = model_of(found.mesh, state)
        surface = model.surface
        if not is_closed(surface) or signed_volume(surface) <= 0:
            given = "a surface that isn't closed" if len(surface.faces) else "no surface at all"
            raise InputError(f"the network gives {given}, nothing was written; train longer or raise --resolution")
        with self.timed("write"), replacing(self.out) as partial:
            write_model(partial, model)
        told = {
            "out": str(self.out),
            "vertices": len(surface.vertices),
            "faces": len(surface.faces),
            "evaluations": found.asked,
            "closed": True,
            "components": found.components,
            "dropped": found.dropped,
            "clipped": round(found.clipped, 6),
            "overshoot": found.overshoot,
            "seconds": self.seconds,
        }
        print(json.dumps(told, ensure_ascii=False))


def _text(path: Path) -> str:
    """A script's text. Raises InputError if it can't be read."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; wanted a .json file with a list of operations")
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path}: {path.stat().st_size:,} bytes; wanted at most {MAX_BYTES:,}")
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is no text in UTF-8 ({error})") from error
