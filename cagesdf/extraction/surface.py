"""Closed surfaces of fields within their cages, at once or edit by edit (§3.6)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush

import numpy as np
from manifold3d import Manifold

from cagesdf.cuboid import Cage
from cagesdf.extraction.field import CageField
from cagesdf.extraction.marching import NOTHING
from cagesdf.extraction.part import Part, part_of
from cagesdf.extraction.promises import Meshes, check, count_pieces, keep_loose, symmetric_none
from cagesdf.extraction.thinness import USUAL, Fineness
from cagesdf.extraction.values import Method, sparse_values
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import from_manifold

Loose = Callable[[Mesh], Mesh]  # from a mesh to what of it is kept; one of LOOSE
Symmetry = Callable[[Mesh, Meshes, Cage], tuple[Mesh, Meshes]]  # one of SYMMETRIES
# `map`, or that of a pool: results in order of a function of a cuboid's number for many numbers.
Each = Callable[[Callable[[int], Part], Iterable[int]], Iterable[Part]]


@dataclass(frozen=True, eq=False)
class Extraction:
    """A surface, and figures of its extraction."""

    mesh: Mesh  # canonical, closed, manifold, outward, within the cuboids; no faces if the network says outside
    parts: Meshes  # by cuboid, closed; the mesh is their union without the components that `loose` drops
    evaluations: int  # points given to the network
    clipped: float  # share of the parts' vertices where the cage cut the network's surface off
    components: int  # connected components of the mesh
    dropped: int  # further components that were left out
    overshoot: float  # how far the mesh leaves the cuboids, in cells

    @staticmethod
    def nothing() -> "Extraction":
        """The extraction of a cage without cuboids."""
        return Extraction(NOTHING, {}, 0, 0.0, 0, 0, 0.0)


def extract(
    field: CageField,
    resolution: int,
    method: Method = sparse_values,
    loose: Loose = keep_loose,
    symmetry: Symmetry = symmetric_none,
    each: Each = map,
    fineness: Fineness = USUAL,
) -> Extraction:
    """The zero surface of a field (§3.6): cuboid by cuboid, each cut by its faces, and united exactly; canonical frame.

    Cells are at most as long as `resolution` of them along [-HALF_EXTENT, HALF_EXTENT], and each cuboid has at least
    `fineness.least` along each of its axes; thin parts have smaller ones (`Thickness`). `each` evaluates the
    cuboids, in as many threads as the caller wants; the surface is the same. Raises InputError if the network gives
    values that are not finite, or for a `symmetry` that the cage hasn't; ValueError if the surface doesn't keep what is
    promised (see `check`).
    """
    return LiveSurface(resolution, method, loose, symmetry, fineness).surface(field, each)


def extract_surface(field: CageField, resolution: int) -> Mesh:
    """The mesh that `extract` gives, alone."""
    return extract(field, resolution).mesh


class LiveSurface:
    """The surface of a cage that is being edited: only cuboids that are new are evaluated.

    A cuboid's surface depends on the part's code and on the cuboid, not on the others; where parts move with their
    cuboids, on its lengths alone. Such parts are evaluated at the origin and then moved, so that a cuboid that was
    moved or turned is not evaluated again. The solids of the last two surfaces are kept, so that an edit can be taken
    back at once.
    """

    def __init__(
        self,
        resolution: int,
        method: Method = sparse_values,
        loose: Loose = keep_loose,
        symmetry: Symmetry = symmetric_none,
        fineness: Fineness = USUAL,
    ) -> None:
        """Options are those of `extract`."""
        self.cell = 2 * HALF_EXTENT / resolution
        self.method = method
        self.loose = loose
        self.symmetry = symmetry
        self.fineness = fineness
        self._last: dict[bytes, Part] = {}  # by the keys of the field and of the unplaced field
        self._before: dict[bytes, Part] = {}
        self._unions: dict[tuple[bytes, ...], Manifold] = {}  # by the keys of their parts, of the last surface

    def surface(self, field: CageField, each: Each = map) -> Extraction:
        """The extraction of `extract` for this field; `evaluations` counts only the points that were evaluated now.

        All fields that are given are of one decoder, which does not change.
        """
        unplaced = field.unplaced()
        keys, unplaced_keys = field.keys(), unplaced.keys()
        known = self._before | self._last
        # The largest first, so that no thread is left alone with it.
        order = sorted(range(len(keys)), key=lambda k: -field.cage.size[k].prod())
        unknown = {unplaced_keys[k]: k for k in order if unplaced_keys[k] not in known}
        made = each(lambda k: part_of(unplaced, k, self.cell, self.fineness, self.method), unknown.values())
        new = dict(zip(unknown, made))
        known |= new
        for key, unplaced_key, part_id in zip(keys, unplaced_keys, field.cage.part_ids):
            if key not in known:
                known[key] = known[unplaced_key].moved(field.cage[part_id])
        parts = [known[key] for key in keys]
        self._before, self._last = self._last, {key: known[key] for key in (*keys, *unplaced_keys)}
        return self._finished(field.cage, keys, parts, sum(part.evaluations for part in new.values()))

    def _finished(self, cage: Cage, keys: Sequence[bytes], parts: Sequence[Part], evaluations: int) -> Extraction:
        meshes: Meshes = {part_id: part.mesh for part_id, part in zip(cage.part_ids, parts)}
        held = {key: part.solid for key, part in zip(keys, parts) if len(part.mesh.faces)}
        if not held:
            return Extraction(NOTHING, meshes, evaluations, 0.0, 0, 0, 0.0)
        unions: dict[tuple[bytes, ...], Manifold] = {}
        whole = in_order(from_manifold(self._united(held, unions)))
        self._unions = unions
        whole, meshes = self.symmetry(whole, meshes, cage)
        mesh = self.loose(whole)
        overshoot = check(mesh, cage, self.cell)
        components = count_pieces(mesh)
        dropped = 0 if mesh is whole else count_pieces(whole) - components
        clipped = sum(part.clipped for part in parts) / sum(part.vertices for part in parts)
        return Extraction(mesh, meshes, evaluations, clipped, components, dropped, overshoot)

    def _united(self, solids: Mapping[bytes, Manifold], unions: dict[tuple[bytes, ...], Manifold]) -> Manifold:
        """The union of solids, the two with the fewest faces first; `unions` gets all but the single ones.

        Least work, as in Huffman's codes: a large part is united once, with all that was united before. Unions of the
        last surface are taken again, so that an edit makes only those with the edited part anew; which part that was
        doesn't change the order.
        """
        waiting: list[tuple[int, int, tuple[bytes, ...], Manifold]] = [
            (solid.num_tri(), number, (key,), solid) for number, (key, solid) in enumerate(solids.items())
        ]
        heapify(waiting)
        while len(waiting) > 1:
            (_, number, first, solid), (_, _, second, other) = heappop(waiting), heappop(waiting)
            keys = first + second
            union = unions[keys] = self._unions[keys] if keys in self._unions else solid + other
            # The number of faces now: manifold3d would put the union off, and make it in another order with later ones.
            heappush(waiting, (union.num_tri(), number, keys, union))
        return waiting[0][3]


def in_order(mesh: Mesh) -> Mesh:
    """The faces of a closed, manifold mesh by their first edge.

    manifold3d orders faces by when their solids were made, which depends on threads and edits.
    """
    tail, head = mesh.faces[:, :2].T.astype(np.int64)
    return Mesh(mesh.vertices, mesh.faces[np.argsort(tail * len(mesh.vertices) + head)])
