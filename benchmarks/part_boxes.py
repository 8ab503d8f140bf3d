"""Fit of the cuboids of found parts to shapes that come as one mesh, beside other methods to get boxes.

    python -m benchmarks.part_boxes [--shapes 6] [--ways found …] [--procedural chair …] [--united chair …]
        [--whole FOLDER[:GLOB] …] [--parts FOLDER[:GLOB] …] [--each]

Shapes: procedural ones of `make repro`, their parts joined into one mesh, or united into one solid; mesh files in
FOLDERs; with `--parts`, mesh files and folders of part meshes whose groups, nodes and files are the true parts, joined.
If there are more shapes than `--shapes`, the sample is evenly spaced in the sorted names, the same for all ways.
Ways: `find_parts`; one box a component; CoACD and V-HACD (at most 16 hulls, a least box a hull) where `coacd` and
`vhacdx` are installed; CoACD with its cheapest search, as the solids are closed already. Figures: volumetric IoU of all
boxes together with the solid; volume of the boxes over that of the outer solid, with what is enclosed from five of six
sides; share of the solid that is covered; share of the boxes' union that is in several of them; boxes, and how many
there should be; mean IoU of true cuboids with the boxes they are matched to; mean IoU of true parts' surfaces with what
lies in these; processor seconds. Prints a Markdown table of means, with `--each` also a row for each shape.
"""

import argparse
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from cagesdf.cage_fitting.boxes import fit_cuboid
from cagesdf.cuboid import Cage
from cagesdf.errors import InputError, NotSolidError, ShapeRejected
from cagesdf.formats.listing import list_shapes, read_shape
from cagesdf.frames import canonical_similarity
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, join, sample_surface
from cagesdf.geometry.solid import from_manifold, union
from cagesdf.io.shapes import read_shapes
from cagesdf.parts.components import components
from cagesdf.parts.finding import find_parts
from cagesdf.parts.overlapping import overlapping

T = TypeVar("T")

WELD, THIN = 1e-5, 1e-4
POINTS = 40_000
SURFACE = 10_000  # points
GRID = 40  # cells along each axis
HULLS = 16
CHEAP = {"preprocess_mode": "off", "resolution": 1000, "mcts_nodes": 10, "mcts_iterations": 60, "mcts_max_depth": 2}
MAX_FACES = 100_000  # of a stranger's shape


@dataclass(frozen=True, eq=False)
class Item:
    """A shape as one mesh."""

    name: str
    mesh: Mesh  # canonical
    true: list[Mesh] | None  # its parts, where they are known


def procedural(category: str, count: int, unite: bool) -> Iterator[Item]:
    shapes = read_shapes(Path("data/shapes") / category)
    for shape_id in spread(shapes.ids, count):
        meshes = [part.mesh for part in shapes.read(shape_id).parts]
        yield Item(shape_id, union(meshes) if unite else join(meshes), meshes)


def strangers(place: str, count: int, has_parts: bool) -> Iterator[Item]:
    folder, _, glob = place.partition(":")
    items = []
    for source in list_shapes(Path(folder), glob or "*"):
        try:
            raw = read_shape(source)
        except ShapeRejected:
            continue
        mesh = join([part.mesh for part in raw.parts])
        if len(mesh.faces) > MAX_FACES:
            continue
        similarity = canonical_similarity(mesh.vertices, "y")
        parts = [part.mesh.with_vertices(similarity.to_canonical(part.mesh.vertices)) for part in raw.parts]
        items.append(Item(source.shape_id, join(parts), parts if has_parts else None))
    yield from spread(items, count)


def spread(items: Sequence[T], count: int) -> list[T]:
    """`count` items at equal steps, or all."""
    places = np.linspace(0, len(items) - 1, min(count, len(items)))
    return [items[round(place)] for place in places.tolist()]


def found(mesh: Mesh) -> list[np.ndarray]:
    parts = [part.mesh for part in find_parts(mesh, WELD, THIN).parts]
    return [part.vertices for part in overlapping(parts, WELD)]


def one_a_component(mesh: Mesh) -> list[np.ndarray]:
    return [from_manifold(component.solid).vertices for component in components(mesh, WELD, THIN)]


def by_coacd(mesh: Mesh) -> list[np.ndarray]:
    import coacd

    coacd.set_log_level("error")
    mesh_of = coacd.Mesh(mesh.vertices, mesh.faces)
    hulls = coacd.run_coacd(mesh_of, threshold=0.1, max_convex_hull=HULLS, seed=0, **CHEAP)
    return [np.asarray(vertices) for vertices, _ in hulls]


def by_vhacd(mesh: Mesh) -> list[np.ndarray]:
    import vhacdx

    faces = np.column_stack([np.full(len(mesh.faces), 3), mesh.faces]).astype(np.uint32).ravel()
    return [vertices for vertices, _ in vhacdx.compute_vhacd(mesh.vertices, faces, maxConvexHulls=HULLS)]


WAYS: dict[str, Callable[[Mesh], list[np.ndarray]]] = {
    "found": found,
    "one a component": one_a_component,
    "coacd": by_coacd,
    "vhacdx": by_vhacd,
}
RIVALS = {"coacd", "vhacdx"}  # want one closed mesh


def cage_of(points: Iterable[np.ndarray]) -> Cage:
    return Cage.of({str(i): fit_cuboid(np.asarray(p), 0.01, 1e-3) for i, p in enumerate(points)})


def figures(solid: Mesh, boxes: Cage, true: list[Mesh] | None) -> list[float]:
    low, high = solid.vertices.min(0), solid.vertices.max(0)
    points = low + np.random.default_rng(0).random((POINTS, 3)) * (high - low)
    surface = SurfaceDistance(solid)
    inside = surface.inside(points)
    held = boxes.signed_distance(points) <= 1e-9
    any_box = held.any(axis=1)
    row = [
        float((any_box & inside).sum() / (any_box | inside).sum()),
        float(boxes.size.prod(axis=1).sum() / outer_volume(surface, low, high)),
        float((any_box & inside).sum() / inside.sum()),
        float((held.sum(axis=1) > 1).sum() / any_box.sum()),
        float(len(boxes)),
    ]
    if true is None:
        return [*row, np.nan, np.nan, np.nan]
    # Thin boards hold few points: both are padded.
    wanted = cage_of(part.vertices for part in true).signed_distance(points) <= 0.004
    padded = boxes.signed_distance(points) <= 0.004
    return [*row, float(len(true)), mean_iou(padded, wanted), face_iou(solid, boxes, true)]


def outer_volume(surface: SurfaceDistance, low: np.ndarray, high: np.ndarray) -> float:
    """Volume of a solid and of the space that it encloses from five of six sides, on a grid."""
    cells = (np.indices((GRID,) * 3).reshape(3, -1).T + 0.5) / GRID * (high - low) + low
    inside = surface.inside(cells).reshape((GRID,) * 3)
    sides = np.zeros(inside.shape, np.int64)
    for axis in range(3):
        sides += np.logical_or.accumulate(inside, axis)
        sides += np.flip(np.logical_or.accumulate(np.flip(inside, axis), axis), axis)
    return float((inside | (sides >= 5)).mean() * (high - low).prod())


def face_iou(solid: Mesh, boxes: Cage, true: list[Mesh]) -> float:
    """Surface points belong to the nearest true part, and to the least box that they lie in, or else the nearest."""
    points = sample_surface(solid, SURFACE, np.random.default_rng(0))[0]
    owner = np.argmin([SurfaceDistance(part).unsigned(points) for part in true], axis=0)
    outside = np.maximum(boxes.signed_distance(points), 0.002)
    box = np.argmin(outside + 1e-6 * boxes.size.prod(axis=1), axis=1)
    return mean_iou(box[:, None] == np.arange(len(boxes)), owner[:, None] == np.arange(len(true)))


def mean_iou(sets: np.ndarray, wanted: np.ndarray) -> float:
    """Mean IoU of the columns of `wanted` with those of `sets` that they are matched to."""
    common = wanted.T.astype(float) @ sets
    either = wanted.sum(axis=0)[:, None] + sets.sum(axis=0)[None] - common
    iou = common / np.maximum(either, 1)
    return float(iou[linear_sum_assignment(-iou)].sum() / wanted.shape[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shapes", type=int, default=6)
    parser.add_argument("--ways", nargs="*", choices=WAYS, default=[*WAYS])
    parser.add_argument("--procedural", nargs="*", default=[])
    parser.add_argument("--united", nargs="*", default=[])
    parser.add_argument("--whole", nargs="*", default=[])
    parser.add_argument("--parts", nargs="*", default=[])
    parser.add_argument("--each", action="store_true")
    options = parser.parse_args()
    methods = {name: WAYS[name] for name in options.ways}
    for rival in RIVALS & methods.keys():
        if find_spec(rival) is None:
            print(f"{rival} is not installed")
            del methods[rival]
    count = options.shapes
    sets = {f"{name}, joined": procedural(name, count, False) for name in options.procedural}
    sets |= {f"{name}, united": procedural(name, count, True) for name in options.united}
    for has_parts, places in ((False, options.whole), (True, options.parts)):
        sets |= {"/".join(place.split("/")[-2:]): strangers(place, count, has_parts) for place in places}
    print(
        "| shapes | way | n | IoU | boxes/outer | covered | overlap | boxes | true | box IoU | face IoU | s, median |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|---|", flush=True)
    for title, items in sets.items():
        rows: dict[str, list[list[float]]] = {name: [] for name in methods}
        for item in items:
            try:
                solid = union([from_manifold(one.solid) for one in components(item.mesh, WELD, THIN)])
            except (NotSolidError, InputError) as error:
                print(f"left out: {item.name}: {error}")
                continue
            for name, method in methods.items():
                begun = time.process_time()
                points = method(solid if name in RIVALS else item.mesh)
                seconds = time.process_time() - begun
                rows[name].append([*figures(solid, cage_of(points), item.true), seconds])
                if options.each:
                    row = " | ".join(f"{value:.3g}" for value in rows[name][-1])
                    print(f"| {item.name} | {name} | 1 | {row} |", flush=True)
        for name, values in rows.items():
            table = np.array(values)
            *means, _ = table.mean(axis=0)
            print(f"| {title} | {name} | {len(table)} | " + " | ".join(f"{mean:.3g}" for mean in means), end="")
            print(f" | {np.median(table[:, -1]):.2g} |", flush=True)


if __name__ == "__main__":
    main()
