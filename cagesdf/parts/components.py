"""The closed, connected solids that the faces of a whole shape make up.

Faces are connected if they share a vertex, after welding, whatever group or node they came in. Each component is made
solid by the chain of `solid.make_solid`; one that lies within another is no part of the surface and is left out.
"""

from dataclasses import dataclass, replace

import manifold3d
import numpy as np
from jaxtyping import Int
from numpy import ndarray

from cagesdf.errors import NotSolidError
from cagesdf.geometry.meshes import Mesh, compact, face_areas, face_components, is_closed, join, weld
from cagesdf.geometry.solid import METHODS, Solid, as_manifold, make_solid, pieces

MAX_COMPONENTS = 400  # made solid one by one, the largest first; the rest together
HIDDEN = 1e-3  # share of a component's volume that may lie outside another that hides it


@dataclass(frozen=True, eq=False)
class Component:
    """One connected solid."""

    solid: manifold3d.Manifold  # canonical, outward
    repair: Solid  # its mesh and what closing it took, maybe along with other components
    faces: int  # as read


def components(mesh: Mesh, tolerance: float, min_thickness: float) -> list[Component]:
    """The components of all faces of a shape, the largest volume first.

    `mesh` and the lengths, which are `make_solid`'s, are canonical. Sheets that make no solid by themselves are made
    solid together. Raises NotSolidError if nothing of the shape can be made solid, or sheets can't, and InputError as
    `make_solid`.
    """
    welded = weld(mesh, tolerance)
    if len(welded.faces) == 0:
        raise NotSolidError("has no faces with an area; export it again")
    first = "merged" if len(welded.vertices) < len(mesh.vertices) else "none"

    def closing(patch: Mesh) -> list[Component]:
        solid = make_solid(patch, tolerance, min_thickness)
        return _solids(replace(solid, method=max(first, solid.method, key=METHODS.index)), len(patch.faces))

    closed: list[Component] = []
    sheets: list[Mesh] = []
    for patch in _connected(welded):
        try:
            closed += closing(patch)
        except NotSolidError:
            sheets.append(patch)
    if sheets and (not closed or _share(sheets, mesh) > HIDDEN):
        closed += closing(join(sheets))
    return _visible(sorted(closed, key=lambda component: -component.solid.volume()))


def _share(sheets: list[Mesh], mesh: Mesh) -> float:
    """Share of a mesh's area that some of its faces have."""
    return float(face_areas(join(sheets)).sum() / face_areas(mesh).sum())


def _connected(welded: Mesh) -> list[Mesh]:
    """Connected faces; solids that only share vertices or edges with others are apart."""
    labels = face_components(welded)
    areas = np.bincount(labels, face_areas(welded))
    order = np.argsort(-areas, kind="stable")
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    result = []
    for connected in _split(welded, np.minimum(place[labels], MAX_COMPONENTS)):
        patches = pieces(connected)
        result += patches if len(patches) < MAX_COMPONENTS and all(map(is_closed, patches)) else [connected]
    return result


def _split(mesh: Mesh, labels: Int[ndarray, " f"]) -> list[Mesh]:
    ordered = mesh.faces[np.argsort(labels, kind="stable")]
    ends = np.cumsum(np.bincount(labels))[:-1]
    return [compact(Mesh(mesh.vertices, faces)) for faces in np.split(ordered, ends)]


def _solids(repaired: Solid, faces: int) -> list[Component]:
    """The connected solids of a closed mesh; all in one where some are cavities."""
    whole = as_manifold(repaired.mesh)
    parts = whole.decompose()
    if any(part.volume() <= 0 for part in parts):
        parts = [whole]
    shares = np.array([part.num_tri() for part in parts]) / max(whole.num_tri(), 1)
    return [Component(part, repaired, max(1, round(faces * share))) for part, share in zip(parts, shares)]


def _visible(closed: list[Component]) -> list[Component]:
    """The components that don't lie within a larger one."""
    boxes = np.array([component.solid.bounding_box() for component in closed]).reshape(-1, 2, 3)
    kept: list[int] = []
    for i, component in enumerate(closed):
        around = [k for k in kept if (boxes[k, 0] <= boxes[i, 0]).all() and (boxes[k, 1] >= boxes[i, 1]).all()]
        volume = component.solid.volume()
        if not any((component.solid - closed[k].solid).volume() < HIDDEN * volume for k in around):
            kept.append(i)
    return [closed[i] for i in kept]


def last_method(repairs: list[Solid]) -> str:
    """The last step of the repair that any component needed."""
    return max((repair.method for repair in repairs), key=METHODS.index)
