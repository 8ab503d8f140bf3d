"""From a field to a closed surface within the cage, at once or edit by edit (§3.6)."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray
from skimage.measure import marching_cubes
from torch import Tensor

from cagesdf.cuboid import Cage
from cagesdf.distance import SurfaceDistance
from cagesdf.extraction.asking import Method, ask_sparsely
from cagesdf.extraction.bounding import bounded, check, count_pieces, keep_loose, symmetric_none
from cagesdf.extraction.field import CageField, MakeField, Outside, Overlap, outside_union, overlap_blend
from cagesdf.extraction.joining import Joined, Part, part_of
from cagesdf.frames import HALF_EXTENT
from cagesdf.meshes import Mesh
from cagesdf.models.decoders import Decoder
from cagesdf.solid import cage_surface

# Marching cubes is given values of at least and at most so many cells: at 0 it gives faces without
# area, and far from it the surface lies on a lattice point.
NUDGE, FAR = 1e-3, 4.0
# Surface counts as clipped where the network would have it beyond the cage by more, in cells.
CLIP_TOLERANCE = 0.25
NOTHING = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))

Loose = Callable[[Mesh], Mesh]  # from a mesh to what of it is kept; one of LOOSE
Symmetry = Callable[[Mesh, Cage], Mesh]  # one of SYMMETRIES
# From what is to be done with a cuboid's number, and numbers, to what comes of each, in order: `map`, or a pool's.
Each = Callable[[Callable[[int], Part], Iterable[int]], Iterable[Part]]


@dataclass(frozen=True, eq=False)
class Extraction:
    """A surface, and what it took."""

    mesh: Mesh  # canonical, closed, manifold, outwards, within the cuboids; no faces if the network says outside
    asked: int  # points given to the network
    clipped: float  # share of the vertices where the cage cut off what the network wanted
    components: int  # pieces of the mesh that hang together
    dropped: int  # further pieces that were left out
    overshoot: float  # how far the mesh leaves the cuboids, in cells


def extract(
    field: CageField,
    resolution: int,
    method: Method = ask_sparsely,
    loose: Loose = keep_loose,
    symmetry: Symmetry = symmetric_none,
    each: Each = map,
) -> Extraction:
    """The zero surface of a field by marching cubes (§3.6), cut by the cuboids exactly; canonical frame.

    `resolution` counts the cells along [-HALF_EXTENT, HALF_EXTENT]; the lattice reaches as far as the
    cage does. `each` goes through the cuboids that are asked, in as many threads as the caller wants; the
    surface is the same. Raises InputError if the network gives values that are not finite, or for a
    `symmetry` that the cage hasn't; ValueError if the surface doesn't keep what is promised (see `check`).
    """
    cell = 2 * HALF_EXTENT / resolution
    parts = list(each(lambda k: part_of(field, k, cell, method), range(len(field.cage))))
    marched = march(field, parts, cell)
    del parts  # the largest thing in memory at 512 cells
    return _finished(marched, field.cage, cell, loose, symmetry)


def extract_surface(field: CageField, resolution: int) -> Mesh:
    """The mesh that `extract` gives, alone."""
    return extract(field, resolution).mesh


class LiveSurface:
    """The surface of a cage that is being edited: only cuboids that are new are asked.

    What the network says of a cuboid depends on the latent and on the cuboid, not on the others.
    The answers of the last two surfaces are kept, so that an edit can be taken back at once.
    """

    def __init__(
        self,
        decoder: Decoder,
        resolution: int,
        make_field: MakeField = CageField,
        outside: Outside = outside_union,
        overlap: Overlap = overlap_blend,
        method: Method = ask_sparsely,
        loose: Loose = keep_loose,
        symmetry: Symmetry = symmetric_none,
        each: Each = map,
    ) -> None:
        """As for `extract`; `decoder` is in evaluation mode and must not change."""
        self.decoder = decoder
        self.cell = 2 * HALF_EXTENT / resolution
        self.make_field = make_field
        self.outside = outside
        self.overlap = overlap
        self.method = method
        self.loose = loose
        self.symmetry = symmetry
        self.each = each
        self._last: dict[bytes, Part] = {}
        self._before: dict[bytes, Part] = {}

    def surface(self, latent: Float[Tensor, " d"], cage: Cage) -> Extraction:
        """What `extract` gives for this latent and cage, but for `asked`, which counts what was asked now."""
        field = self.make_field(self.decoder, latent, cage, self.outside, self.overlap)
        code = latent.cpu().numpy().tobytes()
        keys = [code + vector.tobytes() for vector in field.cage.vectors()]
        known = self._before | self._last
        unknown = {key: k for k, key in enumerate(keys) if key not in known}
        found = self.each(lambda k: part_of(field, k, self.cell, self.method), unknown.values())
        new = dict(zip(unknown, found))
        parts = [(known | new)[key] for key in keys]
        before = sum(part.answers.asked for key, part in zip(keys, parts) if key not in new)
        self._before, self._last = self._last, dict(zip(keys, parts))
        marched = march(field, parts, self.cell)
        marched = replace(marched, asked=marched.asked - before)
        return _finished(marched, field.cage, self.cell, self.loose, self.symmetry)


@dataclass(frozen=True, eq=False)
class Marched:
    """A surface that still leaves the cage by less than a cell where the network would go on."""

    mesh: Mesh  # canonical, closed
    asked: int  # points that the network was given for it
    clipped: float  # share of the vertices that the cage will cut off


def march(field: CageField, parts: Sequence[Part], cell: float) -> Marched:
    """Marching cubes of what is known of the cage's cuboids."""
    joined = Joined(field, parts, cell)
    asked = sum(part.answers.asked for part in parts) + joined.asked
    if not joined.negative.any():
        return Marched(NOTHING, asked, 0.0)
    values = _ready(joined)
    # Lorensen's table reads signs alone, so that values matter at the ends of edges only.
    vertices, faces, _, _ = marching_cubes(values, level=0.0, gradient_direction="descent", method="lorensen")
    mesh = Mesh(joined.lattice.points(vertices.astype(np.float64)), faces.astype(np.int32))
    return Marched(mesh, asked, clipped_share(joined, values, vertices))


def _ready(joined: Joined) -> Float32[ndarray, "r s t"]:
    """Values for marching cubes: exact at the ends of edges with two signs, elsewhere the sign.

    They take the place of `joined.values`, which at 512 cells are the largest thing in memory.
    """
    field, lattice, values = joined.field, joined.lattice, joined.values
    inner, outer = np.flatnonzero(~np.isnan(values)), np.flatnonzero(beyond_cage(joined))
    ends = np.concatenate([inner, outer])
    there = lattice.points(np.stack(np.unravel_index(outer, lattice.shape), axis=1))
    exact = np.concatenate([values.reshape(-1)[inner], field.outside(field.cage, there).astype(np.float32)])
    far = np.float32(FAR * lattice.cell)
    values.fill(far)
    values.reshape(-1)[ends] = np.abs(exact).clip(NUDGE * lattice.cell, far)
    return np.negative(values, out=values, where=joined.negative)


def _finished(marched: Marched, cage: Cage, cell: float, loose: Loose, symmetry: Symmetry) -> Extraction:
    if len(marched.mesh.faces) == 0:
        return Extraction(NOTHING, marched.asked, 0.0, 0, 0, 0.0)
    whole = symmetry(bounded(marched.mesh, cage), cage)
    mesh = loose(whole)
    overshoot = check(mesh, cage, cell)
    components = count_pieces(mesh)
    dropped = 0 if mesh is whole else count_pieces(whole) - components
    return Extraction(mesh, marched.asked, marched.clipped, components, dropped, overshoot)


def beyond_cage(joined: Joined) -> Bool[ndarray, "r s t"]:
    """Lattice points outside the cage that have a neighbour inside the surface."""
    beside = np.zeros(joined.negative.shape, dtype=bool)
    for axis in range(3):
        low, high = (slice(None),) * axis + (slice(None, -1),), (slice(None),) * axis + (slice(1, None),)
        beside[low] |= joined.negative[high]
        beside[high] |= joined.negative[low]
    return beside & ~joined.covered


def clipped_share(joined: Joined, values: Float32[ndarray, "r s t"], vertices: Float32[ndarray, "v 3"]) -> float:
    """The share of vertices (lattice indices) between a point inside and one outside the cage, where the network's
    value inside is below minus the distance to the cage's surface by more than CLIP_TOLERANCE cells."""
    ends = [tuple(part(vertices).astype(int).T) for part in (np.floor, np.ceil)]
    inner = [np.where(joined.covered[ends[0]], low, high) for low, high in zip(*ends)]
    leaves = ~(joined.covered[ends[0]] & joined.covered[ends[1]])
    places = np.stack(inner, axis=1)[leaves]
    slack = values[tuple(places.T)] + CLIP_TOLERANCE * joined.lattice.cell
    # A cuboid's own surface is no further than the cage's.
    candidates = slack < 0
    points = joined.lattice.points(places[candidates])
    nearer = slack[candidates] < joined.field.cage.assign(points)[1]
    distance = SurfaceDistance(cage_surface(joined.field.cage)).unsigned(points[nearer])
    return int((slack[candidates][nearer] < -distance).sum()) / len(vertices)
