"""How well cuboids of found parts fit shapes that come as one mesh, beside other ways to get boxes.

    python -m benchmarks.parts_found [--shapes 6] [--furniture FOLDER …]

Shapes: procedural chairs of `make repro`, their parts joined into one mesh, and united into one solid; and the mesh
files and folders of part meshes in FOLDERs, joined. Ways: `find_parts`; one box a component; CoACD and V-HACD (at most
16 hulls, a least box a hull) where `coacd` and `vhacdx` are installed. Figures: volumetric IoU of all boxes together
with the solid; volume of the boxes over the solid's; share of the solid that is covered; boxes, and how many there
should be; mean IoU of true cuboids with the boxes they are matched to; processor seconds. Prints a Markdown table of
means.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from cagesdf.cuboid import Cage
from cagesdf.distance import SurfaceDistance
from cagesdf.errors import InputError, NotSolidError, ShapeRejected
from cagesdf.fitting.boxes import fit_cuboid
from cagesdf.formats.listing import list_shapes, read_shape
from cagesdf.frames import canonical_similarity
from cagesdf.io.cuboids import read_cages
from cagesdf.io.shapes import read_shapes
from cagesdf.meshes import Mesh, join
from cagesdf.parts.components import components
from cagesdf.parts.finding import find_parts
from cagesdf.solid import from_manifold, union

WELD, THIN = 1e-5, 1e-4
POINTS = 40_000
HULLS = 16
MAX_FACES = 60_000  # of a stranger's shape


@dataclass(frozen=True, eq=False)
class Item:
    """A shape as one mesh."""

    mesh: Mesh  # canonical
    true: Cage | None  # cuboids of its parts, where they are known


def procedural(count: int, unite: bool) -> Iterator[Item]:
    shapes, cages = read_shapes(Path("data/shapes/chair")), read_cages(Path("data/cuboids/chair"))
    for shape_id in shapes.ids[:count]:
        meshes = [part.mesh for part in shapes.read(shape_id).parts]
        yield Item(union(meshes) if unite else join(meshes), cages[shape_id])


def strangers(folder: Path, count: int) -> Iterator[Item]:
    left = count
    for source in list_shapes(folder, "*"):
        try:
            raw = read_shape(source)
        except ShapeRejected:
            continue
        mesh = join([part.mesh for part in raw.parts])
        if left == 0 or len(mesh.faces) > MAX_FACES:
            continue
        left -= 1
        similarity = canonical_similarity(mesh.vertices, "y")
        parts = [similarity.to_canonical(part.mesh.vertices) for part in raw.parts]
        true = None if raw.whole else Cage.of({str(i): fit_cuboid(part, 0.01, 1e-3) for i, part in enumerate(parts)})
        yield Item(mesh.with_vertices(similarity.to_canonical(mesh.vertices)), true)


def found(mesh: Mesh) -> list[np.ndarray]:
    return [part.mesh.vertices for part in find_parts(mesh, WELD, THIN).parts]


def one_a_component(mesh: Mesh) -> list[np.ndarray]:
    return [from_manifold(component.solid).vertices for component in components(mesh, WELD, THIN)]


def by_coacd(mesh: Mesh) -> list[np.ndarray]:
    import coacd

    coacd.set_log_level("error")
    hulls = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), threshold=0.1, max_convex_hull=HULLS, seed=0)
    return [np.asarray(vertices) for vertices, _ in hulls]


def by_vhacd(mesh: Mesh) -> list[np.ndarray]:
    import vhacdx

    faces = np.column_stack([np.full(len(mesh.faces), 3), mesh.faces]).astype(np.uint32).ravel()
    return [vertices for vertices, _ in vhacdx.compute_vhacd(mesh.vertices, faces, maxConvexHulls=HULLS)]


def figures(solid: Mesh, boxes: Cage, true: Cage | None) -> list[float]:
    low, high = solid.vertices.min(0), solid.vertices.max(0)
    points = low + np.random.default_rng(0).random((POINTS, 3)) * (high - low)
    inside = SurfaceDistance(solid).inside(points)
    held = boxes.signed_distance(points) <= 1e-9
    any_box = held.any(axis=1)
    volume = inside.mean() * float((high - low).prod())
    row = [
        float((any_box & inside).sum() / (any_box | inside).sum()),
        float(boxes.size.prod(axis=1).sum() / volume),
        float((any_box & inside).sum() / inside.sum()),
        float(len(boxes)),
    ]
    if true is None:
        return [*row, np.nan, np.nan]
    wanted = true.signed_distance(points) <= 0.004  # thin boards hold few points: both are padded
    padded = boxes.signed_distance(points) <= 0.004
    common = (padded[:, :, None] & wanted[:, None]).sum(axis=0)
    either = padded.sum(axis=0)[:, None] + wanted.sum(axis=0)[None] - common
    iou = common / np.maximum(either, 1)
    return [*row, float(len(true)), float(iou[linear_sum_assignment(-iou)].sum() / len(true))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shapes", type=int, default=6)
    parser.add_argument("--furniture", type=Path, nargs="*", default=[])
    options = parser.parse_args()
    ways: dict[str, Callable[[Mesh], list[np.ndarray]]] = {"found": found, "one a component": one_a_component}
    for name, way in (("coacd", by_coacd), ("vhacdx", by_vhacd)):
        try:
            __import__(name)
            ways[name] = way
        except ImportError:
            print(f"{name} is not installed")
    sets = {
        "procedural, joined": procedural(options.shapes, False),
        "procedural, united": procedural(options.shapes, True),
    }
    sets |= {f"{folder.parent.name}/{folder.name}": strangers(folder, options.shapes) for folder in options.furniture}
    print("| shapes | way | n | IoU | boxes/volume | covered | boxes | true | matched IoU | s, median |")
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    for title, items in sets.items():
        rows: dict[str, list[list[float]]] = {name: [] for name in ways}
        for item in items:
            try:
                solid = union([from_manifold(one.solid) for one in components(item.mesh, WELD, THIN)])
            except (NotSolidError, InputError) as error:
                print(f"left out: {error}")
                continue
            for name, way in ways.items():
                begun = time.process_time()
                # The rivals want one closed mesh.
                points = way(item.mesh if name in ("found", "one a component") else solid)
                seconds = time.process_time() - begun
                cage = Cage.of({str(i): fit_cuboid(np.asarray(p), 0.01, 1e-3) for i, p in enumerate(points)})
                rows[name].append([*figures(solid, cage, item.true), seconds])
        for name, values in rows.items():
            table = np.array(values)
            *means, _ = table.mean(axis=0)
            print(f"| {title} | {name} | {len(table)} | " + " | ".join(f"{mean:.3g}" for mean in means), end="")
            print(f" | {np.median(table[:, -1]):.2g} |", flush=True)


if __name__ == "__main__":
    main()
