"""Shapes broken on purpose, each beside the clean one, and how far the repaired one is from that.

Used by the tests and by benchmarks/repair.py.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import manifold3d
import numpy as np

from cagesdf.frames import canonical_similarity
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, compact, join, sample_surface
from cagesdf.geometry.solid import SHEET, TIGHT, as_manifold, from_manifold, union
from cagesdf.importing import import_shape, signed_distances
from cagesdf.shape import RawPart, RawShape, Shape
from cagesdf.structure.hierarchy import PartHierarchy
from tests.support import toy

LIMITS: dict[str, Any] = {"up": "y", "weld": 1e-5, "max_faces": 2_000_000, "max_parts": 150, "min_thickness": 1e-4}
SPREAD = 0.02  # standard deviation of the points near the surface, share of the shape's radius

Meshes = list[Mesh]


@dataclass(frozen=True, eq=False)
class Case:
    """One way to break a shape."""

    name: str
    clean: Meshes  # closed, outward; their union is the truth
    broken: Meshes  # the parts as a file would give them


@dataclass(frozen=True)
class Errors:
    """What `measure` finds; distances in shares of the clean shape's radius."""

    sign: float  # share of the points in the box whose side differs
    sign_near: float  # share of the points near the surface whose side differs
    mean: float  # of | |d| − |d of the clean shape| |
    worst: float
    seconds: float  # to import the shape


def stool() -> Meshes:
    """A box, a ball and three tapered rods that overlap: faces large and small."""
    legs = [toy.rod([x, 0, z], [0.7 * x, 1, 0.7 * z], 0.06) for x, z in ((0.4, 0.3), (-0.4, 0.3), (0, -0.4))]
    return [toy.box([0, 1, 0], [1, 0.12, 0.9]), toy.ball([0, 1.1, 0], 0.22, 48), *legs]


def flipped(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces[:, ::-1]))


def some_flipped(mesh: Mesh) -> Mesh:
    turned = np.random.default_rng(1).random(len(mesh.faces)) < 0.3
    return Mesh(mesh.vertices, np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces).astype(np.int32))


def doubled(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces]))


def both_sided(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[:, ::-1]]))


def soup(mesh: Mesh) -> Mesh:
    """No two faces share a vertex."""
    return Mesh(mesh.corners().reshape(-1, 3), np.arange(3 * len(mesh.faces), dtype=np.int32).reshape(-1, 3))


def opened(mesh: Mesh) -> Mesh:
    """Without the faces that reach its highest 5 %: a side of the box, an end of a rod, a cap of the ball."""
    height = mesh.corners()[:, :, 1]
    low, high = height.min(), height.max()
    return Mesh(mesh.vertices, mesh.faces[height.min(1) < high - 0.05 * (high - low)])


def pricked(mesh: Mesh) -> Mesh:
    """Without one face in fifty, and at least one."""
    return Mesh(mesh.vertices, np.delete(mesh.faces, np.arange(0, len(mesh.faces), 50), axis=0))


def slivers(mesh: Mesh) -> Mesh:
    """Each face cut in two through a point a millionth away from a corner: needles, not matched by the neighbours."""
    a, b, c = mesh.faces.T
    corners = mesh.corners()
    added = corners[:, 0] + 1e-6 * (corners[:, 1] - corners[:, 0])
    d = np.arange(len(mesh.faces), dtype=np.int32) + len(mesh.vertices)
    faces = np.concatenate([np.stack([a, d, c], axis=1), np.stack([d, b, c], axis=1)])
    return Mesh(np.concatenate([mesh.vertices, added]), faces.astype(np.int32))


def sheet(mesh: Mesh, side: int) -> Mesh:
    """The middle plane of a box, two triangles."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    low[side] = high[side] = (low[side] + high[side]) / 2
    u, v = np.delete(np.eye(3), side, axis=0) * (high - low)
    return Mesh(np.stack([low, low + u, low + u + v, low + v]), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))


def middle(board: Mesh, side: int) -> Mesh:
    """The middle plane of a flat board of any outline: its upper faces, lowered."""
    value = board.vertices[:, side]
    faces = board.faces[(value[board.faces] > value.mean()).all(axis=1)]
    vertices = board.vertices.copy()
    vertices[:, side] = (value.min() + value.max()) / 2
    return compact(Mesh(vertices, faces))


def loop(start: float, end: float) -> Mesh:
    """A closed tube along a rising coil from angle `start` to `end`: beyond a full turn it runs into itself."""
    angles = np.arange(round(16 * start), round(16 * end) + 1) / 16
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([1 + 0.2 * np.cos(around), 0.2 * np.sin(around)], axis=1)
    rise = 0.05 * angles[:, None] / (2 * np.pi)
    points = np.stack(
        [np.outer(np.cos(angles), ring[:, 0]), ring[:, 1] + rise, np.outer(np.sin(angles), ring[:, 0])], axis=2
    )
    m, n = points.shape[:2]
    i, j = np.divmod(np.arange((m - 1) * n), n)
    a, b, c, d = i * n + j, i * n + (j + 1) % n, (i + 1) * n + (j + 1) % n, (i + 1) * n + j
    fan = np.arange(1, n - 1)
    first = np.stack([0 * fan, fan + 1, fan], axis=1)
    last = (m - 1) * n + first[:, ::-1]
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1), first, last]).astype(np.int32)
    mesh = Mesh(points.reshape(-1, 3), faces)
    return mesh if as_manifold(mesh).volume() > 0 else flipped(mesh)


def scaled(meshes: Meshes, factor: float, place: float) -> Meshes:
    return [mesh.with_vertices(factor * (mesh.vertices + place)) for mesh in meshes]


def cases() -> Iterator[Case]:
    """All but the largest."""
    clean = stool()
    yield Case("clean", clean, clean)
    damages: dict[str, Callable[[Mesh], Mesh]] = {
        "opened": opened,
        "small holes": pricked,
        "parts inside out": flipped,
        "faces turned": some_flipped,
        "doubled": doubled,
        "both-sided": both_sided,
        "soup": soup,
        "slivers": slivers,
        "turned, both-sided soup": lambda mesh: soup(both_sided(some_flipped(mesh))),
        "opened, turned soup": lambda mesh: soup(some_flipped(opened(mesh))),
    }
    for name, damage in damages.items():
        yield Case(name, clean, [damage(mesh) for mesh in clean])
    yield Case("one part inside out", clean, [flipped(clean[0]), *clean[1:]])
    yield Case("overlapping in a part", clean, [join(clean)])
    yield Case(
        "overlapping, some inside out", clean, [join([flipped(clean[0]), clean[1], flipped(clean[2]), *clean[3:]])]
    )

    coil = [loop(0, 4), loop(3.5, 7)]
    yield Case("self-intersecting", coil, [loop(0, 7)])

    middle_plane = sheet(toy.box([0, 1.4, -0.4], [0.8, 0.6, 0]), 2)
    scale = canonical_similarity(join([*clean, middle_plane]).vertices, LIMITS["up"]).scale
    panel = toy.box([0, 1.4, -0.4], [0.8, 0.6, SHEET / scale])
    lining = sheet(clean[0], 1)
    yield Case("sheet in a solid", clean, [join([clean[0], lining]), *clean[1:]])
    yield Case("sheet alone", [*clean, panel], [*clean, sheet(panel, 2)])
    hole = toy.box([0, 1.4, -0.4], [0.5, 0.3, 1])
    frame = from_manifold(as_manifold(panel) - as_manifold(hole))
    yield Case("frame alone", [*clean, frame], [*clean, middle(frame, 2)])
    flap = toy.box([0, 1.06, 0.65], [0.6, 2 * TIGHT, 0.4])
    yield Case("flap in a lid's plane", [*clean, flap], [join([opened(clean[0]), sheet(flap, 1)]), *clean[1:]])
    ball = toy.ball([0, 0, 0], 1, 48)
    yield Case("nested", [ball], [join([ball, toy.ball([0.2, 0, 0], 0.5)])])
    apart = [toy.ball([x, 0, z], 0.3) for x in (-1, 0, 1) for z in (-1, 0, 1)]
    yield Case("disjoint in a part", apart, [join(apart)])
    touching = [toy.box([-0.5, -0.5, 0], [1, 1, 1]), toy.box([0.5, 0.5, 0], [1, 1, 1])]
    fin = Mesh(np.array([[0.0, 0, -0.5], [0, 0, 0.5], [-0.5, -0.5, 0]]), np.array([[0, 1, 2]], dtype=np.int32))
    yield Case("non-manifold edges", touching, [join([*touching, fin])])
    tree = [toy.box([0, 0.1 * i, 0.05 * i], [1 - 0.05 * i, 0.12, 0.5]) for i in range(10)]
    yield Case("ten parts in one", tree, [join(tree)])
    yield Case("tiny and far away", scaled(clean, 1e-6, 50), scaled(clean, 1e-6, 50))
    yield Case("huge", scaled(clean, 1e8, 0), [opened(mesh) for mesh in scaled(clean, 1e8, 0)])


def million() -> Case:
    """A ball of a million faces and its stand, opened and some faces turned."""
    fine = from_manifold(manifold3d.Manifold.sphere(1, 1416))
    stand = toy.box([0, -1, 0], [1, 0.3, 1])
    return Case("a million faces, turned", [fine, stand], [some_flipped(fine), opened(stand)])


def imported(case: Case) -> Shape:
    names = tuple(f"part{i}" for i in range(len(case.broken)))
    parts = tuple(RawPart(name, "", mesh) for name, mesh in zip(names, case.broken))
    return import_shape(RawShape(case.name, "train", parts, PartHierarchy.flat(names, names, "")), **LIMITS)


def measure(case: Case, count: int) -> tuple[Shape, Errors]:
    """Import the broken shape and compare it with the clean one.

    At `count` points uniform in the clean one's box, made a tenth larger, and `count` normally
    distributed about points uniform on its surface, with deviation SPREAD.
    """
    rng = np.random.default_rng(0)
    truth = union(case.clean)
    low, high = truth.vertices.min(0), truth.vertices.max(0)
    radius = np.linalg.norm(high - low) / 2
    box = rng.uniform(low - 0.05 * (high - low), high + 0.05 * (high - low), (count, 3))
    surface, _ = sample_surface(truth, count, rng)
    points = np.concatenate([box, surface + rng.normal(0, SPREAD * radius, (count, 3))])
    start = time.perf_counter()
    shape = imported(case)
    seconds = time.perf_counter() - start
    found, wanted = signed_distances(shape, points), SurfaceDistance(truth).signed(points)
    differs = (found < 0) != (wanted < 0)
    off = np.abs(np.abs(found) - np.abs(wanted)) / radius
    sign, sign_near = differs.reshape(2, count).mean(1)
    return shape, Errors(float(sign), float(sign_near), float(off.mean()), float(off.max()), seconds)
