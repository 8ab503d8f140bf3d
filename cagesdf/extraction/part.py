"""The closed solid of one part, from a field and one of its cuboids."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from manifold3d import Manifold

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.extraction.field import CageField
from cagesdf.extraction.lattice import Lattice
from cagesdf.extraction.marching import drawn, march
from cagesdf.extraction.merging import merged
from cagesdf.extraction.thinness import USUAL, Fineness, Thickness
from cagesdf.extraction.values import Method
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.meshes import Mesh, compact, face_components, face_normals
from cagesdf.geometry.resizing import keeping_warp, vulnerability
from cagesdf.geometry.solid import as_manifold, from_manifold

# A vertex on a face counts as clipped where the network's surface would go beyond it by more, in cells, or where the
# value is below -reach / 2.
CLIP_TOLERANCE = 0.25
# Cells below COARSE don't make the network more exact: in smaller ones faces are reduced with the movements that COARSE
# ones have, in canonical units, or at most EASE times the usual movements in steps.
COARSE, EASE = 2 * HALF_EXTENT / 128, 2.0
# Pieces smaller than both are the network's noise beside something larger: in steps, along every axis, of a lattice of
# cells of COARSE, or of those asked for if they are larger; and in its cells.
CRUMB_LENGTH, CRUMB_VOLUME = 8.0, 8.0


@dataclass(frozen=True, eq=False)
class Part:
    """The closed solid that a network has in one cuboid.

    It depends on the network, the part's code, the cuboid and the cells, not on other cuboids.
    """

    mesh: Mesh  # canonical; closed, manifold, outward, within the cuboid; no faces if the network says outside
    solid: Manifold  # the same, ready to be united
    vertices: int  # of marching cubes
    clipped: int  # of them on the cuboid's faces where the network would go on
    evaluations: int  # points given to the network

    def moved(self, cuboid: Cuboid) -> "Part":
        """A part of a cuboid at the origin, in a cuboid of the same lengths elsewhere."""
        if len(self.mesh.faces) == 0:
            return self
        solid = self.solid.transform(np.column_stack([cuboid.axes.T, cuboid.centre]))
        return replace(self, mesh=from_manifold(solid), solid=solid)


def part_of(field: CageField, cuboid: int, cell: float, fineness: Fineness, method: Method) -> Part:
    """The solid of a field in one of its cuboids, in cells of at most `cell`, canonical units.

    Cells are of the cuboid that the network is evaluated in. A part that turns out to be too thin for them is made
    again in cells that hold it (`Thickness`).
    """
    evaluated = field.evaluated[field.cage.part_ids[cuboid]]
    lattice = Lattice.of(evaluated, cell, fineness.least)
    part = _on_lattice(field, cuboid, lattice, cell, fineness, method)
    holding = Thickness(part.mesh, evaluated).holding_lattice(cell, fineness)
    if (holding.cells > lattice.cells).any():
        lattice, first = holding, part
        part = _on_lattice(field, cuboid, lattice, cell, fineness, method)
        part = replace(part, evaluations=first.evaluations + part.evaluations)
    if len(part.mesh.faces) and (field.evaluated.size[cuboid] != field.cage.size[cuboid]).any():
        mesh = with_details_kept(part.mesh, field.evaluated, field.cage, cuboid, lattice)
        part = replace(part, mesh=mesh, solid=as_manifold(mesh))
    return part


def _on_lattice(
    field: CageField, cuboid: int, lattice: Lattice, cell: float, fineness: Fineness, method: Method
) -> Part:
    sampled = method(field.on_lattice(lattice, cuboid), field.reach(cuboid), lattice)
    evaluations = sampled.evaluations
    marched = march(sampled.values, lattice)
    del sampled  # the largest thing in memory at 512 cells
    vertices = len(marched.places)
    clipped = int(np.count_nonzero(marched.clipped < -min(CLIP_TOLERANCE * cell, field.reach(cuboid) / 2)))
    ease = min(max(COARSE / cell, 1.0), EASE)
    mesh, further = drawn(merged(marched, lattice, ease * fineness.sag), partial(field.values, cuboid=cuboid), lattice)
    del marched
    solid = as_manifold(mesh).simplify(ease * fineness.even * float(lattice.steps.min()))
    mesh = from_manifold(solid)
    swept = without_crumbs(mesh, Lattice.of(lattice.cuboid, max(cell, COARSE), USUAL.least))
    if swept is not mesh:
        mesh, solid = swept, as_manifold(swept)
    return Part(mesh, solid, vertices, clipped, evaluations + further)


def without_crumbs(mesh: Mesh, lattice: Lattice) -> Mesh:
    """A closed part without pieces and voids smaller than CRUMB_LENGTH and CRUMB_VOLUME in the steps of a lattice.

    The mesh itself if there are none, or nothing else.
    """
    piece = face_components(mesh)
    count = int(piece.max(initial=0)) + 1
    if count < 2:
        return mesh
    places = (mesh.vertices - lattice.cuboid.centre) @ lattice.cuboid.axes.T / lattice.steps
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for corner in mesh.faces.T:
        np.minimum.at(low, piece, places[corner])
        np.maximum.at(high, piece, places[corner])
    scaled = mesh.with_vertices(places)
    volumes = np.einsum("ij,ij->i", places[mesh.faces].mean(axis=1), face_normals(scaled)) / 6
    large = (high - low).max(axis=1) >= CRUMB_LENGTH
    large |= np.abs(np.bincount(piece, volumes, count)) >= CRUMB_VOLUME
    return mesh if large.all() or not large.any() else compact(Mesh(mesh.vertices, mesh.faces[large[piece]]))


def with_details_kept(mesh: Mesh, evaluated: Cage, cage: Cage, cuboid: int, lattice: Lattice) -> Mesh:
    """A closed part resized from one cuboid to another of other lengths; its details keep their size. Canonical.

    It stays within the cuboid, as closed as before. `lattice` is the one that the part was evaluated on.
    """
    unit = mesh.with_vertices(evaluated.to_unit(mesh.vertices, cuboid).clip(-0.5, 0.5))
    before, after = evaluated.size[cuboid], cage.size[cuboid]
    warp = keeping_warp(vulnerability(unit, before, 1 / lattice.cells), before, after)
    return mesh.with_vertices(cage.from_unit(warp(unit.vertices), cuboid))
