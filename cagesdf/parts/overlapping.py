"""Parts that reach into their neighbours where both end in one plane, so that learnt surfaces leave no void there.

The two pieces of a cut, and solids that were closed where they touch another, share a plane. Each surface is learnt for
itself and is off by some thousandths, to either side: between the two a thin void would stay. So one of them is
continued into the other, straight across the plane. All parts together are the same solid as before.
"""

from dataclasses import dataclass

import manifold3d
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cage_fitting.boxes import fit_cuboid
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, face_normals, is_closed, join, sample_surface, weld
from cagesdf.geometry.solid import as_manifold, from_manifold
from cagesdf.parts.cutting import ASIDE, CRUMB, MIN_SIZE, SLACK, hull_points

REACH = 0.01  # canonical units: how far a part is continued; several times the error of a learnt surface
CONTACT = 5 * ASIDE  # canonical units: surfaces of two parts that are nearer touch
OPPOSITE = -0.9  # cosine between the normals of two surfaces that face each other, at most
ALONG = 0.9  # cosine between normals of one contact, at least
SAMPLES = 2000  # points of a part's surface that are probed for contacts, beside the centres of its faces
DIRECTIONS = 6  # of the contacts with one neighbour, at most
HALVINGS = 3  # of REACH in a neighbour that is thin
CROWDED = 8  # times as many faces as those of the solids has a union of surfaces that cross each other everywhere
THROUGH = 1.9  # times as much of a neighbour is met twice as far: less, and a part would come out on its other side


@dataclass(frozen=True, eq=False)
class _Body:
    """A part, and what its contacts are looked for with."""

    solid: manifold3d.Manifold
    surface: SurfaceDistance
    normals: Float[ndarray, "f 3"]  # unit, of the faces
    points: Float[ndarray, "n 3"]  # of its surface
    directions: Float[ndarray, "n 3"]  # unit normals there
    low: Float[ndarray, " 3"]
    high: Float[ndarray, " 3"]

    @staticmethod
    def of(mesh: Mesh) -> "_Body":
        normals = face_normals(mesh)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        places, faces = sample_surface(mesh, SAMPLES, np.random.default_rng(0))
        points = np.concatenate([mesh.corners().mean(axis=1), places])
        directions = np.concatenate([normals, normals[faces]])
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        return _Body(as_manifold(mesh), SurfaceDistance(mesh), normals, points, directions, low, high)

    def is_near(self, other: "_Body") -> bool:
        return bool((self.low <= other.high + CONTACT).all() and (other.low <= self.high + CONTACT).all())


def overlapping(meshes: list[Mesh], tolerance: float) -> list[Mesh]:
    """The parts of a shape, closed and canonical, each continued by up to REACH into neighbours that it ends at.

    Of two that touch the one is continued whose cuboid grows less. Parts that touch none come back as they are, and so
    do those that would have gaps if vertices nearer than `tolerance`, a canonical length, were one.
    """
    bodies = [_Body.of(mesh) for mesh in meshes]
    growths: list[list[manifold3d.Manifold]] = [[] for _ in bodies]
    for i, first in enumerate(bodies):
        for j in range(i + 1, len(bodies)):
            if not first.is_near(bodies[j]):
                continue
            pieces = {i: _continued(first, bodies[j]), j: _continued(bodies[j], first)}
            costs = [(_added(bodies[k], some), k) for k, some in pieces.items() if some]
            if costs:
                owner = min(costs)[1]
                growths[owner] += pieces[owner]
    return [
        _with(mesh, [body.solid, *growth], tolerance) if growth else mesh
        for mesh, body, growth in zip(meshes, bodies, growths)
    ]


def _with(mesh: Mesh, solids: list[manifold3d.Manifold], tolerance: float) -> Mesh:
    """The union of a part and its pieces without crumbs, which lie where faces coincide; the part if that isn't closed.

    A crumb has no thickness, and the repair would take all of the part for a sheet. The part comes back, too, where
    surfaces nearly coincide and cross each other everywhere: taking that apart takes gigabytes.
    """
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add).simplify(tolerance)
    if whole.num_tri() > CROWDED * sum(solid.num_tri() for solid in solids):
        return mesh
    least = CRUMB * whole.volume()
    result = join([from_manifold(piece) for piece in whole.decompose() if abs(piece.volume()) > least])
    return result if is_closed(result) and is_closed(weld(result, tolerance)) else mesh


def _continued(body: _Body, neighbour: _Body) -> list[manifold3d.Manifold]:
    """The pieces of the neighbour that a part is continued by, one for each direction of their contacts."""
    pieces = (_piece(body, neighbour, direction) for direction in _contacts(body, neighbour))
    return [piece for piece in pieces if not piece.is_empty()]


def _contacts(body: _Body, neighbour: _Body) -> list[Float[ndarray, " 3"]]:
    """Mean normals of a part's surface where the neighbour's faces it, those of most points first."""
    inside = ((body.points >= neighbour.low - CONTACT) & (body.points <= neighbour.high + CONTACT)).all(axis=1)
    if not inside.any():
        return []
    directions = body.directions[inside]
    distance, faces, _ = neighbour.surface.closest(body.points[inside])
    facing = np.einsum("nx,nx->n", directions, neighbour.normals[faces]) < OPPOSITE
    left = directions[(distance < CONTACT) & facing]
    left = left[:: 1 + len(left) // SAMPLES]
    result: list[Float[ndarray, " 3"]] = []
    while len(left) and len(result) < DIRECTIONS:
        alike = left @ left.T > ALONG
        chosen = alike[int(alike.sum(axis=1).argmax())]
        mean = left[chosen].mean(axis=0)
        result.append(mean / np.linalg.norm(mean))
        left = left[~chosen]
    return result


def _piece(body: _Body, neighbour: _Body, direction: Float[ndarray, " 3"]) -> manifold3d.Manifold:
    """The share of the neighbour that a part meets when it is moved by REACH, or less where that is thin.

    Nothing of a neighbour that the part already reaches into as far, such as a sheet that comes twice.
    """
    reach = REACH
    piece = _met(body, neighbour, reach * direction)
    for _ in range(HALVINGS):
        if _met(body, neighbour, 2 * reach * direction).volume() >= THROUGH * piece.volume():
            break
        reach /= 2
        piece = _met(body, neighbour, reach * direction)
    held = (body.solid ^ neighbour.solid).volume()
    return piece if held < piece.volume() / 2 else manifold3d.Manifold()


def _met(body: _Body, neighbour: _Body, offset: Float[ndarray, " 3"]) -> manifold3d.Manifold:
    return body.solid.translate(offset.tolist()) ^ neighbour.solid


def _added(body: _Body, pieces: list[manifold3d.Manifold]) -> float:
    """Volume that its cuboid gains if a part takes pieces in."""
    before = hull_points(body.solid)
    after = np.concatenate([before, *(hull_points(piece) for piece in pieces)])
    volumes = [float(fit_cuboid(points, SLACK, MIN_SIZE).size.prod()) for points in (before, after)]
    return volumes[1] - volumes[0]
