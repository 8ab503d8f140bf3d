"""The command that makes new shapes with a trained network."""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cagesdf.cli.machine import workers
from cagesdf.cli.surfaces import Loose, RunFolder
from cagesdf.cli.telling import Count, Json, tell, working
from cagesdf.errors import InputError
from cagesdf.io.files import check_folder, new_folder

if TYPE_CHECKING:
    from cagesdf.api.runs import TrainedRun
    from cagesdf.cuboid import Cage
    from cagesdf.shape_generation.generated import GeneratedShape
    from cagesdf.shape_generation.surfaces import Order

POINTS = 2048  # samples of each surface
COLUMNS = 8  # pictures in a row of the sheet
CELL = 220  # pixels along a side of one of them
SHOWN = 64  # shapes on the sheet at most
AHEAD = 2  # shapes for each worker that may be made before they are written


def generate(
    run: RunFolder,
    /,
    *,
    out: Path,
    count: int = 16,
    latent: Literal["independent", "dependent", "by_part"] | None = None,
    seed: int = 0,
    temperature: float = 1.0,
    program: Path | None = None,
    programs: Path | None = None,
    resolution: int = 128,
    loose: Loose = "keep",
    ending: Literal["ply", "obj", "stl", "glb"] = "glb",
    stability: Literal["support", "simulation"] = "support",
    as_json: Json = False,
) -> None:
    """Make new shapes: new cuboids, new latent codes, and the surfaces that a trained network gives for them.

    Prints how many have a surface, stand, and how long it took: a sentence to a terminal, a JSON object otherwise.

    Parameters
    ----------
    out
        A new folder, in one that exists: a mesh and a program (.txt) or hierarchy (.json) for each shape, canonical
        (y up, centred, in the unit sphere); index.jsonl with a line for each, its
        health and warnings too; sheet.png, a picture of the first 64.
    count
        How many shapes.
    latent
        How codes are drawn: independent of the cuboids; dependent, so that codes of shapes with similar cuboids are
        likelier; or by_part (the default where parts have codes of their own), from shapes that have parts like the
        new ones. An arm without cuboids has one way only.
    seed
        Of all that is drawn.
    temperature
        How far new cuboids and codes are from those trained on; 1 draws as they are spread, 0 their middles.
    program
        A ShapeAssembly program whose cuboids all shapes get, instead of new ones.
    programs
        A folder that `train_programs` wrote; without it, data/programs/chair for the run above.
    resolution
        Cells along 2.1 times the radius of the unit sphere.
    ending
        The format of the meshes; .obj and .glb are cut into parts, .glb has the cuboids too (as its last scene).
    stability
        How it is tested whether shapes stand: by the polygon that they stand on, or by letting them go and pushing them
        in a simulation (pip install 'cagesdf[physics]').
    """
    if out.exists():
        raise InputError(f"{out}: is there already; name a new folder")
    check_folder(out)
    if program is not None and programs is not None:
        raise InputError("--program and --programs: wanted one of them")
    seconds = time.perf_counter()
    import torch

    from cagesdf.api.runs import load_run
    from cagesdf.api.shapes import check_resolution
    from cagesdf.shape_generation.surfaces import STABILITIES, counts, in_order

    check_resolution(resolution)
    torch.set_num_threads(1)  # for each of the pool's
    with working(f"reading {run}"):
        trained = load_run(run, programs)
    new = trained.draw(count, seed, latent=latent, temperature=temperature, program=program)
    make = _maker(trained, resolution, loose, STABILITIES[stability], seed)
    threads = workers()
    with new_folder(out) as folder, ThreadPoolExecutor(threads) as pool:
        shapes = in_order(pool, make, new.orders, AHEAD * threads)
        warned: list[str] = []
        outcomes = counts(_written(folder, shapes, ending, resolution, warned, Count("shapes", count)))
        outcomes["warned"] = len(warned)
    summary = {
        "out": str(out),
        "method": new.method,
        **new.source.about(),
        "asked": count,
        **outcomes,
        "seconds": round(time.perf_counter() - seconds, 2),
    }
    text = ", ".join(f"{number:,} {name}" for name, number in outcomes.items() if isinstance(number, int))
    tell(summary, f"{out}: of {count:,} shapes {text}; {summary['seconds']:.1f} s", as_json)


def _maker(
    trained: "TrainedRun", resolution: int, loose: str, stability: "Callable[[Cage], bool]", seed: int
) -> "Callable[[Order], GeneratedShape]":
    """The function that makes the shape of an order, its parts named; each order has random numbers of its own."""
    from cagesdf.extraction import LOOSE
    from cagesdf.seeds import item_rng
    from cagesdf.shape_generation.surfaces import Extracting, make_shape

    settings = Extracting(resolution, LOOSE[loose], POINTS, stability)

    def make(order: "Order") -> "GeneratedShape":
        rng = item_rng(seed, "points", order.method, order.shape_id)
        shape = make_shape(trained.session.run, settings, rng, order)
        if shape.structure is None:
            return shape
        return replace(shape, structure=trained.known_parts.labelled(shape.structure, shape.cage))

    return make


def _written(
    folder: Path,
    shapes: "Iterable[GeneratedShape]",
    ending: str,
    resolution: int,
    warned: list[str],
    done: Callable[[], None],
) -> Iterator[dict[str, Any]]:
    """Write each shape's files and its line of the index as it comes, then the sheet; yields rows of the index.

    Ids of shapes with warnings are appended to `warned`.

    Only the first SHOWN shapes are held.
    """
    from cagesdf.io.generated_shapes import index_row

    shown: list[GeneratedShape] = []
    with (folder / "index.jsonl").open("w", encoding="utf-8", newline="\n") as stream:
        for shape in shapes:
            row = index_row(shape)
            entry = _entry(folder, shape, row, ending) | _health(shape, resolution)
            stream.write(json.dumps(entry, ensure_ascii=False) + "\n")
            warned += [shape.shape_id] if entry["warnings"] else []
            shown += [shape] if len(shown) < SHOWN else []
            done()
            yield row
    with working("drawing the sheet"):
        _sheet(folder / "sheet.png", shown)


def _health(shape: "GeneratedShape", resolution: int) -> dict[str, Any]:
    """A line about the surface, and its warnings; of an arm without cuboids neither."""
    import numpy as np

    from cagesdf.editing.health import Health
    from cagesdf.editing.state import State
    from cagesdf.frames import Similarity

    if shape.structure is None:
        return {"health": None, "warnings": []}
    state = State.opened(shape.cage, shape.structure, shape.latent, Similarity(1.0, np.eye(3), np.zeros(3)))
    health = Health.of(shape, state, resolution)
    return {"health": str(health), "warnings": [*health.warnings()]}


def _entry(folder: Path, shape: "GeneratedShape", row: Mapping[str, Any], ending: str) -> dict[str, Any]:
    """Write a shape's files; its line of the index."""
    from cagesdf.editing.parts import part_names
    from cagesdf.io.exports import write_export

    entry: dict[str, Any] = {"id": shape.shape_id, "status": shape.status, "mesh": None, "structure": None}
    if len(shape.mesh.faces):
        entry["mesh"] = f"{shape.shape_id}.{ending}"
        write_export(folder / entry["mesh"], _exported(shape))
    if shape.structure is not None:
        placed = shape.structure.placed_program()
        entry["structure"] = f"{shape.shape_id}.{'txt' if placed else 'json'}"
        text = str(placed[0]) if placed else shape.structure.to_json() + "\n"
        (folder / entry["structure"]).write_text(text, encoding="utf-8", newline="\n")
    kept = ("method", "seed", "draw", "effective", "vertices", "faces", "closed", "components", "clipped", "rooted",
            "stable", "floating", "part_ids")  # fmt: skip
    numbers = {"cuboids": shape.cage.vectors().tolist(), "latent": shape.latent.tolist()}
    numbers["part_latents"] = {part: latent.tolist() for part, latent in shape.part_latents.items()}
    names = [] if shape.structure is None else [*part_names(shape.structure).values()]
    return entry | {name: row[name] for name in kept} | {"part_names": names} | numbers


def _exported(shape: "GeneratedShape") -> Any:
    """The surface and its parts, with the cuboids; of an arm without cuboids it is one part in its bounding box."""
    import numpy as np

    from cagesdf.cuboid import CORNER_ORDER
    from cagesdf.editing.session import as_given
    from cagesdf.exported import ExportedShape
    from cagesdf.frames import Similarity
    from cagesdf.geometry.meshes import Mesh
    from cagesdf.geometry.solid import CUBE_FACES

    if shape.structure is not None:
        return as_given(shape.mesh, shape.parts, shape.cage, shape.structure, Similarity(1.0, np.eye(3), np.zeros(3)))
    low, high = shape.mesh.vertices.min(axis=0), shape.mesh.vertices.max(axis=0)
    box = Mesh((low + high) / 2 + CORNER_ORDER * (high - low), CUBE_FACES)
    return ExportedShape.of(shape.mesh, shape.parts, {"shape": box})


def _sheet(path: Path, shapes: "list[GeneratedShape]") -> None:
    """A picture of shapes, each beside its cuboids."""
    from PIL import Image

    from cagesdf.rendering import render_rows, side_by_side

    scenes = list(_scenes(shapes))
    [pictures], _ = render_rows([scenes], CELL)
    Image.fromarray(side_by_side(pictures, COLUMNS)).save(path)


def _scenes(shapes: "list[GeneratedShape]") -> Iterator[Any]:
    from cagesdf.rendering import CLAY, PART_COLOURS, Scene

    for shape in shapes:
        if len(shape.cage):
            colours = tuple(PART_COLOURS[i % len(PART_COLOURS)] for i in range(len(shape.cage)))
            yield Scene(cage=shape.cage, cage_colours=colours)
        yield Scene((shape.mesh,), (CLAY,))
