"""Parts found in the surface of a shape: components, cut where a cuboid fits badly, merged where one fits."""

from dataclasses import dataclass

import manifold3d
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cage_fitting.boxes import fit_cuboid
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, face_areas, face_normals
from cagesdf.geometry.solid import from_manifold
from cagesdf.parts.components import Component, components
from cagesdf.parts.cutting import MIN_SIZE, SLACK, Fragment, Plane, fragments
from cagesdf.parts.merging import merged
from cagesdf.shape import WrittenPart, WrittenParts, WrittenPiece

PRICE = 0.04  # of one more cuboid, in volumes of the shape
THIN = 0.2  # share of its cuboid that a shape's volume counts as at least: thin shells aren't worth more cuboids
LEFT_OUT = 0.01  # share of a shape that written parts may leave out
DEPTHS = 2.0 ** -np.arange(2, 16)  # shares of a solid's extent, below a face, where a point inside is looked for


@dataclass(frozen=True, eq=False)
class FoundPart:
    """One part of a shape that came without."""

    name: str  # unique in its shape
    label: str  # semantic name, "" if there is none
    fragments: tuple[Fragment, ...]
    mesh: Mesh  # canonical, closed, outward

    @staticmethod
    def of(name: str, label: str, fragments: tuple[Fragment, ...]) -> "FoundPart":
        """The part that fragments make up together."""
        return FoundPart(name, label, fragments, from_manifold(_add([fragment.solid for fragment in fragments])))


@dataclass(frozen=True, eq=False)
class FoundParts:
    """The parts of a shape that came without."""

    components: tuple[Component, ...]  # the largest volume first
    parts: tuple[FoundPart, ...]
    volume: float  # of the shape, cubic canonical units

    @property
    def boxes(self) -> float:
        """Volume of all cuboids over the shape's."""
        return boxes_volume([part.mesh for part in self.parts]) / self.volume


def boxes_volume(meshes: list[Mesh]) -> float:
    """Volume of a cuboid around each mesh, summed; overlaps count twice."""
    return float(sum(fit_cuboid(mesh.vertices, SLACK, MIN_SIZE).size.prod() for mesh in meshes))


def find_parts(mesh: Mesh, tolerance: float, min_thickness: float) -> FoundParts:
    """The parts of a whole shape; `mesh` and the lengths, which are `make_solid`'s, are canonical.

    Raises NotSolidError if the shape can't be made solid, InputError as `make_solid`.
    """
    solids = components(mesh, tolerance, min_thickness)
    volume = _add([component.solid for component in solids]).volume()
    price = PRICE * max(volume, THIN * boxes_volume([mesh]))
    cuts = [piece for i, component in enumerate(solids) for piece in fragments(component.solid, i, price)]
    groups = [group.fragments for group in merged(cuts, price)]
    parts = [FoundPart.of(f"part_{i + 1}", "", group) for i, group in enumerate(groups)]
    return FoundParts(tuple(solids), tuple(parts), volume)


def parts_as_written(
    mesh: Mesh, written: WrittenParts, placement: Similarity, tolerance: float, min_thickness: float
) -> FoundParts:
    """The parts that a user wrote down, `placement` being raw → canonical; the rest as `find_parts`.

    Raises InputError if the mesh is not the one that they were written for, a piece isn't there, or they leave out more
    than the share LEFT_OUT of the shape; and as `find_parts`.
    """
    solids = components(mesh, tolerance, min_thickness)
    if len(solids) != written.components:
        raise InputError(
            f"parts were written for {written.components} components, the shape has {len(solids)}; it changed since: "
            "write them anew with cagesdf parts"
        )
    parts = []
    for part in written.parts:
        group = tuple(_fragment(solids, piece, placement, part.name) for piece in part.pieces)
        parts.append(FoundPart.of(part.name, part.label, group))
    volume = _add([component.solid for component in solids]).volume()
    missing = 1 - _add([fragment.solid for part in parts for fragment in part.fragments]).volume() / volume
    if missing > LEFT_OUT:
        raise InputError(f"the written parts leave out {missing:.0%} of the shape; add its pieces to a part")
    return FoundParts(tuple(solids), tuple(parts), volume)


def as_written(found: FoundParts, placement: Similarity) -> WrittenParts:
    """Parts as a file keeps them; `placement` is raw → canonical."""

    def piece(fragment: Fragment) -> WrittenPiece:
        planes = tuple(moved_plane(plane, placement.inverse()) for plane in fragment.planes)
        x, y, z = placement.to_raw(_point_inside(fragment.solid)[None])[0].tolist()
        return WrittenPiece(fragment.component, planes, (x, y, z))

    parts = (WrittenPart(part.name, part.label, tuple(map(piece, part.fragments))) for part in found.parts)
    return WrittenParts(len(found.components), tuple(parts))


def _fragment(solids: list[Component], piece: WrittenPiece, placement: Similarity, part: str) -> Fragment:
    """A piece of a component. Raises InputError if it isn't there."""
    if piece.component >= len(solids):
        raise InputError(f"part {part!r}: there is no component {piece.component}, the shape has {len(solids)}")
    solid = solids[piece.component].solid
    halves = tuple(moved_plane(plane, placement) for plane in piece.planes)
    for x, y, z, d in halves:
        solid = solid.trim_by_plane((-x, -y, -z), -d)
    point = placement.to_canonical(np.array([piece.inside]))
    for connected in solid.decompose() if len(halves) else [solid]:
        if SurfaceDistance(from_manifold(connected)).inside(point)[0]:
            return Fragment(connected, piece.component, halves)
    raise InputError(f"part {part!r}: component {piece.component} has no piece there around {list(piece.inside)}")


def moved_plane(plane: Plane, placement: Similarity) -> Plane:
    """A plane taken through a similarity."""
    normal = placement.rotation @ plane[:3]
    point = placement.to_canonical(np.array([plane[:3]]) * plane[3])[0]
    x, y, z = normal.tolist()
    return x, y, z, float(normal @ point)


def _point_inside(solid: manifold3d.Manifold) -> Float[ndarray, " 3"]:
    """A point of a solid, far from its surface."""
    mesh = from_manifold(solid)
    faces = np.argsort(-face_areas(mesh), kind="stable")[:8]
    normals = face_normals(mesh)[faces]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    steps = DEPTHS[:, None, None] * float(np.ptp(mesh.vertices, axis=0).max())
    points = (mesh.corners()[faces].mean(axis=1) - steps * normals).reshape(-1, 3)
    return points[int(SurfaceDistance(mesh).signed(points).argmin())]


def _add(solids: list[manifold3d.Manifold]) -> manifold3d.Manifold:
    if len(solids) == 1:
        return solids[0]
    return manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
