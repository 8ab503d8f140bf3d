"""Closed surfaces spanned over rings of points: what every procedural part is made of.

A surface is given as m rings of n points. `capped` closes its two ends with a point each
(a ball, topologically), `looped` joins the last ring to the first (a torus). Parts are made in
their cuboid's local frame and `fill` it: they touch all six faces of [-size/2, size/2].
Lengths are those of the raw frame, in which furniture is about one unit high.
"""

from collections.abc import Callable

import manifold3d
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.geometry.meshes import Mesh, signed_volume
from cagesdf.geometry.solid import as_manifold, from_manifold

EDGE = 0.05  # longest edge after booleans, so that a trilinear map bends the mesh

Vector = Float[ndarray, " 3"]


def capped(rings: Float[ndarray, "m n 3"]) -> Mesh:
    """Rings in order, the first and the last closed by a fan around their mean."""
    m, n, _ = rings.shape
    ids = np.arange(m * n).reshape(m, n)
    poles = np.stack([rings[0].mean(0), rings[-1].mean(0)])
    first, last = (np.stack([ring, np.roll(ring, -1)], axis=1) for ring in (ids[0], ids[-1]))
    fans = np.concatenate([np.insert(first[:, ::-1], 0, m * n, axis=1), np.insert(last, 0, m * n + 1, axis=1)])
    return _outward(np.concatenate([rings.reshape(-1, 3), poles]), np.concatenate([_bands(ids), fans]))


def looped(rings: Float[ndarray, "m n 3"]) -> Mesh:
    """Rings in order, the last joined to the first: one handle."""
    ids = np.arange(rings.shape[0] * rings.shape[1]).reshape(rings.shape[:2])
    return _outward(rings.reshape(-1, 3), _bands(np.concatenate([ids, ids[:1]])))


def _bands(ids: ndarray) -> ndarray:
    a, b = ids[:-1], ids[1:]
    a_next, b_next = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    return np.concatenate([np.stack([a, a_next, b_next], -1), np.stack([a, b_next, b], -1)]).reshape(-1, 3)


def _outward(vertices: ndarray, faces: ndarray) -> Mesh:
    mesh = Mesh(vertices, faces.astype(np.int32))
    return mesh if signed_volume(mesh) > 0 else Mesh(vertices, mesh.faces[:, ::-1].copy())


def fill(mesh: Mesh, size: Vector) -> Mesh:
    """The mesh stretched to touch all faces of [-size/2, size/2]."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    return mesh.with_vertices((mesh.vertices - (low + high) / 2) / (high - low) * size)


def warped(mesh: Mesh, move: Callable[[ndarray, ndarray, ndarray], tuple[ndarray, ndarray, ndarray]]) -> Mesh:
    """The mesh with `move(x, y, z)` in place of its coordinates."""
    return mesh.with_vertices(np.stack(move(*mesh.vertices.T), axis=1))


def laid(mesh: Mesh) -> Mesh:
    """An upright thing laid down: its y becomes x, its x becomes −y."""
    return warped(mesh, lambda x, y, z: (y, -x, z))


def stood(mesh: Mesh) -> Mesh:
    """A lying plate stood up: its top (+y) becomes its front (+z)."""
    return warped(mesh, lambda x, y, z: (x, -z, y))


def united(meshes: list[Mesh]) -> Mesh:
    """The union, its edges cut to EDGE."""
    return _cut(manifold3d.Manifold.batch_boolean([as_manifold(mesh) for mesh in meshes], manifold3d.OpType.Add))


def pierced(mesh: Mesh, holes: list[Mesh]) -> Mesh:
    """The mesh minus the holes, its edges cut to EDGE."""
    solids = [as_manifold(item) for item in [mesh, *holes]]
    return _cut(manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Subtract))


def _cut(solid: manifold3d.Manifold) -> Mesh:
    return from_manifold(solid.simplify(1e-6).refine_to_length(EDGE))


def superellipse(half_x: float, half_z: float, power: float, count: int) -> Float[ndarray, "n 2"]:
    """|x|ᵖ + |z|ᵖ = 1 as `count` points, evenly spaced once stretched to the half lengths.

    `count` is a multiple of four; the four points on the axes are among them, so that rings
    touch their cuboid. Power 2 is an ellipse, higher powers tend to the rectangle.
    """
    angle = np.linspace(0, np.pi / 2, 400)
    quarter = np.stack([np.cos(angle) ** (2 / power), np.sin(angle) ** (2 / power)], axis=1)
    return _round_quarter(quarter, half_x, half_z, count)


def rounded_rectangle(half_x: float, half_z: float, radius: float, count: int) -> Float[ndarray, "n 2"]:
    """[-1, 1]² with corners that have this radius once stretched; otherwise as `superellipse`."""
    radius = min(radius, 0.999 * half_x, 0.999 * half_z)
    angle = np.linspace(0, np.pi / 2, 100)
    arc = np.stack([half_x - radius + radius * np.cos(angle), half_z - radius + radius * np.sin(angle)], axis=1)
    quarter = np.concatenate([[[half_x, 0.0]], arc, [[0.0, half_z]]]) / [half_x, half_z]
    return _round_quarter(quarter, half_x, half_z, count)


def _round_quarter(quarter: ndarray, half_x: float, half_z: float, count: int) -> ndarray:
    """A full outline of four mirrored quarters, resampled evenly."""
    steps = np.linalg.norm(np.diff(quarter, axis=0) * [half_x, half_z], axis=1)
    length = np.concatenate([[0], np.cumsum(steps)])
    even = np.linspace(0, length[-1], count // 4 + 1)
    x, z = np.interp(even, length, quarter[:, 0]), np.interp(even, length, quarter[:, 1])
    xs = np.concatenate([x[:-1], -x[:0:-1], -x[:-1], x[:0:-1]])
    zs = np.concatenate([z[:-1], z[:0:-1], -z[:-1], -z[:0:-1]])
    return np.stack([xs, zs], axis=1)


def stack(
    outline: Float[ndarray, "*m n 2"],
    half_x: Float[ndarray, " m"],
    half_z: Float[ndarray, " m"],
    y: Float[ndarray, " m"],
) -> Float[ndarray, "m n 3"]:
    """Rings above each other: one outline, or one for each ring, stretched to the half lengths."""
    x = half_x[:, None] * outline[..., 0]
    z = half_z[:, None] * outline[..., 1]
    return np.stack([x, np.broadcast_to(y[:, None], x.shape), z], axis=-1)


def sweep(
    path: Float[ndarray, "m 2"], section: Float[ndarray, "n 2"], across: Float[ndarray, " m"], along: float
) -> Float[ndarray, "m n 3"]:
    """A section carried along a path in the yz plane.

    `path` holds (y, z); `section` is an outline in [-1, 1]²; `across` is half its height in the
    path's plane at each point, `along` half its width, in x.
    """
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    plane = path[:, None] + across[:, None, None] * section[None, :, 1:] * normal[:, None]
    x = np.broadcast_to(along * section[:, 0], plane.shape[:2])
    return np.concatenate([x[..., None], plane], axis=-1)


def smooth(values: Float[ndarray, "*n"], start: float, end: float) -> Float[ndarray, "*n"]:
    """0 before `start`, 1 after `end`, and a smooth step between."""
    u = np.clip((values - start) / (end - start), 0, 1)
    return u * u * (3 - 2 * u)
