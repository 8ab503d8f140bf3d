"""A shape as files hold it: in the frame and unit of the user's files, of numbers that float32 holds."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.geometry.meshes import Mesh, compact

# Beyond FAR times its longest side from the origin a shape is written from an origin of its own. Up to there float32
# changes volumes by less than 1e-5 (docs/editing.md); at 1,000 times it makes edges where four faces meet.
FAR = 64
FARTHEST = 2.0**36  # longest sides from the origin: there float64 is as exact as float32 at FAR
SMALLEST, LARGEST = 1e-30, 1e30  # longest sides, user's unit, whose squares float32 holds


@dataclass(frozen=True, eq=False)
class ExportedShape:
    """A surface, the parts whose union it is, and their cuboids. Frame: the user's, from `origin`."""

    surface: Mesh  # closed, outward; as `Place.stored` makes it
    parts: Mapping[str, Mesh]  # by name, those that have faces; closed, outward, stored in the same way
    cuboids: Mapping[str, Mesh]  # by name
    origin: Float[ndarray, " 3"]  # user's frame; 0 for all shapes but those that are far from there

    @staticmethod
    def of(mesh: Mesh, parts: Mapping[str, Mesh], cuboids: Mapping[str, Mesh]) -> "ExportedShape":
        """A surface, parts and cuboids in the user's frame; names are distinct, on one line each.

        Raises InputError as `Place.of`.
        """
        place = Place.of(mesh)
        stored = {part: place.stored(solid) for part, solid in parts.items()}
        boxes = {part: box.with_vertices(box.vertices - place.origin) for part, box in cuboids.items()}
        held = {part: solid for part, solid in stored.items() if len(solid.faces)}
        return ExportedShape(place.stored(mesh), held, boxes, place.origin)


@dataclass(frozen=True, eq=False)
class Place:
    """Origin and step of a shape's stored vertices."""

    origin: Float[ndarray, " 3"]  # of the stored vertices, in the mesh's own frame
    step: float  # between possible coordinates, mesh units; 0: float32's

    @staticmethod
    def of(mesh: Mesh) -> "Place":
        """The place for a mesh, and for meshes beside it.

        Raises InputError for a mesh that is too large, too small or too far from the origin for the numbers of files.
        """
        if not len(mesh.faces):
            return Place(np.zeros(3), 0.0)
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        side, reach = float((high - low).max()), float(np.abs(mesh.vertices).max())
        if not (SMALLEST <= side <= LARGEST and reach <= FARTHEST * side):
            raise InputError(
                f"the surface is {side:.3g} long and {reach:.3g} from the origin; files hold lengths from "
                f"{SMALLEST:g} to {LARGEST:g}, at most {FARTHEST:.2g} times as far from the origin; move it there, or "
                "use another unit"
            )
        if reach <= FAR * side:
            return Place(np.zeros(3), 0.0)
        unit = 2.0 ** np.ceil(np.log2(side))
        step = max(unit * 2.0**-23, 2.0 ** (np.ceil(np.log2(reach)) - 52))
        return Place(np.round((low + high) / 2 / unit) * unit, step)

    def stored(self, mesh: Mesh) -> Mesh:
        """A mesh from the origin, as all formats hold it.

        Positions are float32's, and origin plus position is exact in float64. Vertices that so fall together are made
        one: readers that merge what is in one place would find faces without corners otherwise. A closed mesh stays
        closed: what merging takes away are faces between an edge and its opposite.
        """
        if not len(mesh.faces):
            return mesh
        positions = mesh.vertices
        if self.step:
            # Adding 0 makes -0 be 0.
            positions = np.round((mesh.vertices - self.origin) / self.step) * self.step + 0.0
        places, place = np.unique(positions.astype(np.float32), axis=0, return_inverse=True)
        a, b, c = place.ravel()[mesh.faces].T
        faces = np.stack([a, b, c], axis=1)[(a != b) & (b != c) & (c != a)]
        return compact(Mesh(places.astype(np.float64), faces.astype(np.int32)))
