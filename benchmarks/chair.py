"""The chair that the benchmarks measure: twelve overlapping rounded parts, with a given number of faces."""

from collections.abc import Mapping

import numpy as np

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.frames import canonical_similarity
from cagesdf.geometry.meshes import Mesh

ROUND = 8  # exponent of the superellipsoids that the parts are
PLATE = 2.25  # times the faces of a bar has a plate

# Centre and full lengths, y up.
PLATES = {"seat": ((0, 0.45, 0), (0.5, 0.06, 0.5)), "back": ((0, 0.78, -0.24), (0.42, 0.26, 0.04))}
BARS = {
    **{f"leg {x} {z}": ((0.21 * x, 0.22, 0.21 * z), (0.05, 0.47, 0.05)) for x in (-1, 1) for z in (-1, 1)},
    **{f"post {x}": ((0.21 * x, 0.68, -0.24), (0.045, 0.52, 0.045)) for x in (-1, 1)},
    **{f"side rail {x}": ((0.21 * x, 0.2, 0), (0.03, 0.04, 0.42)) for x in (-1, 1)},
    **{f"cross rail {z}": ((0, 0.25, 0.21 * z), (0.42, 0.04, 0.03)) for z in (-1, 1)},
}


def chair(faces: int) -> tuple[Mapping[str, Mesh], Cage]:
    """Closed part meshes by name, about `faces` faces in all, and their cuboids; canonical."""
    bar = faces / (len(BARS) + PLATE * len(PLATES))
    boxes = PLATES | BARS
    meshes = {
        name: rounded_box(centre, size, bar * (PLATE if name in PLATES else 1))
        for name, (centre, size) in boxes.items()
    }
    similarity = canonical_similarity(np.concatenate([mesh.vertices for mesh in meshes.values()]), "y")
    cage = Cage.of({name: Cuboid(np.array(c, float), np.eye(3), np.array(s, float)) for name, (c, s) in boxes.items()})
    placed = {name: mesh.with_vertices(similarity.to_canonical(mesh.vertices)) for name, mesh in meshes.items()}
    return placed, cage.transformed(similarity)


def rounded_box(centre: tuple[float, ...], size: tuple[float, ...], faces: float) -> Mesh:
    """A superellipsoid of about `faces` triangles that touches the six faces of a box."""
    cells = max(1, round((faces / 12) ** 0.5))
    grid = np.arange(cells + 1)
    corner = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1)
    quads = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=2).reshape(-1, 4, 2)
    places = []
    for axis in range(3):
        for side in (0, cells):
            turned = quads if side else quads[:, ::-1]
            places.append(np.roll(np.insert(turned, 0, side, axis=2), axis, axis=2))
    lattice, index = np.unique(np.concatenate(places).reshape(-1, 3), axis=0, return_inverse=True)
    quad = index.reshape(-1, 4)
    cube = 2 * lattice / cells - 1
    sphere = cube / (np.abs(cube) ** ROUND).sum(axis=1, keepdims=True) ** (1 / ROUND)
    triangles = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]).astype(np.int32)
    return Mesh(sphere * np.array(size) / 2 + np.array(centre), triangles)
