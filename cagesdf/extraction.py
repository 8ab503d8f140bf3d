"""From a network, a latent and a cage to a closed surface (§3.6).

The network is asked only where a cuboid is, and there only where a surface can be. What it says
is bounded by the cage: the field is max(network, signed distance to the boundary of the **union**
of the cuboids). A perfect network of two touching boxes then costs 0.02 % of the longest side at
128 cells; the paper's constant outside (`outside_constant`) costs 0.5 %, because the surface
staircases wherever a part touches its cuboid, and the minimum of the boxes' own distances would
cut a groove along every face that two cuboids share.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int, Int16, Integer, Shaped
from numpy import ndarray
from skimage.measure import marching_cubes
from torch import Tensor

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.distance import SurfaceDistance
from cagesdf.errors import InputError
from cagesdf.frames import HALF_EXTENT, OUTSIDE
from cagesdf.meshes import Mesh
from cagesdf.solid import cage_surface

NOBODY = -1  # the owner of lattice points outside every cuboid
GROUP = 512  # points of one cuboid that go through the network together
BATCH = 4  # groups a call: what the layers write stays in the processor's cache
# A block of lattice points is settled by its centre where |field| there exceeds this times the
# distance to the block's corners: 1 for a true distance, the rest for a network's slope.
LIPSCHITZ = 1.5
# Lattice values are kept this far from 0, in cells: marching cubes would else give faces without area.
NUDGE = 1e-3
# Surface counts as clipped where the network would have it beyond the cage by more, in cells.
CLIP_TOLERANCE = 0.25


@dataclass(frozen=True)
class Lattice:
    """A box of the lattice that has a point at -HALF_EXTENT on each axis; `cell` between neighbours."""

    start: tuple[int, int, int]  # its lowest point, counted in cells from -HALF_EXTENT
    shape: tuple[int, int, int]  # points along each axis
    cell: float  # canonical units

    @staticmethod
    def covering(low: Float[ndarray, " 3"], high: Float[ndarray, " 3"], resolution: int) -> "Lattice":
        """The box around [low, high] with a layer of points outside it; `resolution` cells are 2·HALF_EXTENT long.

        It reaches as far as it must: a cage that was edited may stick out of the unit sphere.
        """
        cell = 2 * HALF_EXTENT / resolution
        start = np.floor((low + HALF_EXTENT) / cell).astype(int) - 1
        end = np.ceil((high + HALF_EXTENT) / cell).astype(int) + 1
        return Lattice(_triple(start), _triple(end - start + 1), cell)

    def points(self, indices: Integer[ndarray, "n 3"] | Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Canonical positions of (possibly fractional) indices into the box."""
        return (indices + np.array(self.start)) * self.cell - HALF_EXTENT

    def axis(self, k: int) -> Float[ndarray, " r"]:
        """Canonical coordinates along axis `k`."""
        return (self.start[k] + np.arange(self.shape[k])) * self.cell - HALF_EXTENT


@dataclass(frozen=True, eq=False)
class Domain:
    """Which cuboid each lattice point belongs to."""

    lattice: Lattice
    owner: Int16[ndarray, "r s t"]  # the cuboid that most contains the point (§3.4), or NOBODY
    depth: Float32[ndarray, "r s t"]  # signed distance to the owner's or nearest cuboid; exact up to two cells outside


@dataclass(frozen=True, eq=False)
class Answers:
    """What the network said on a domain."""

    values: Float32[ndarray, "r s t"]  # within ±OUTSIDE; OUTSIDE where nobody owns the point
    asked: int  # points given to the network
    near: Bool[ndarray, "r s t"]  # corners of cells that the surface crosses; exact there


Values = Float32[ndarray, "r s t"]
# From the cage, its domain and the answers: the field, and the bound that the cage sets inside.
Outside = Callable[[Cage, Domain, Answers], tuple[Values, Values]]


@dataclass(frozen=True, eq=False)
class Extraction:
    """A surface, and what it took."""

    mesh: Mesh  # canonical, closed, outwards; no faces if the network says outside everywhere
    asked: int  # points given to the network
    clipped: float  # share of the vertices where the cage cut off what the network wanted


def outside_union(cage: Cage, domain: Domain, answers: Answers) -> tuple[Values, Values]:
    """max(network, signed distance to the boundary of the cuboids' union).

    Outside, that distance is the least of the cuboids'. Inside it is at most the owner's (both
    negative), so the surface of the union is asked only where the network goes below that.
    """
    bound = domain.depth.copy()
    below = np.nonzero(answers.near & (domain.owner != NOBODY) & (answers.values < domain.depth))
    points = domain.lattice.points(np.stack(below, axis=1))
    bound[below] = -SurfaceDistance(cage_surface(cage)).unsigned(points)
    return np.where(domain.owner == NOBODY, domain.depth, np.maximum(answers.values, bound)), bound


def outside_constant(cage: Cage, domain: Domain, answers: Answers) -> tuple[Values, Values]:
    """The paper's: the network in the cuboids, OUTSIDE elsewhere (§3.6)."""
    return answers.values, domain.depth


OUTSIDES: dict[str, Outside] = {"union": outside_union, "constant": outside_constant}


class CageField:
    """A decoder with one latent and one cage."""

    def __init__(self, decoder: torch.nn.Module, latent: Float[Tensor, " d"], cage: Cage, outside: Outside) -> None:
        """`decoder` is in evaluation mode and on `latent`'s device; `outside` is one of OUTSIDES."""
        self.decoder = decoder
        self.latent = latent
        self.cage = cage
        self.outside = outside

    def bounds(self) -> tuple[Float[ndarray, " 3"], Float[ndarray, " 3"]]:
        """Lowest and highest corner of what can be inside."""
        corners = self.cage.corners().reshape(-1, 3)
        return corners.min(axis=0), corners.max(axis=0)

    @torch.inference_mode()
    def ask(self, points: Float[ndarray, "n 3"], owner: Integer[ndarray, " n"]) -> Float32[ndarray, " n"]:
        """The network's values, within ±OUTSIDE, at canonical points of the cuboids `owner`.

        In float32: bfloat16's steps would show on the surface. Raises InputError if one is not finite.
        """
        order = np.argsort(owner, kind="stable")
        counts = np.bincount(owner, minlength=len(self.cage))
        groups = -(-counts // GROUP)
        # Each cuboid's points start at a group of their own.
        gaps = (np.cumsum(groups) - groups) * GROUP - (np.cumsum(counts) - counts)
        slots = np.arange(len(points)) + np.repeat(gaps, counts)
        padded = np.zeros((int(groups.sum()) * GROUP, 3), np.float32)
        padded[slots] = points[order]
        given = torch.from_numpy(padded).view(-1, GROUP, 3).to(self.latent.device)
        cuboids = torch.from_numpy(np.repeat(self.cage.vectors().astype(np.float32), groups, axis=0)).to(given.device)
        parts = [
            self.decoder(some, self.latent.expand(len(some), -1), boxes)
            for some, boxes in zip(given.split(BATCH), cuboids.split(BATCH))
        ]
        values = np.empty(len(points), np.float32)
        if parts:
            values[order] = torch.cat(parts).float().cpu().numpy().reshape(-1)[slots]
        if not np.isfinite(values).all():
            raise InputError("the network gives values that are not finite, so its training diverged; train it again")
        return values.clip(-OUTSIDE, OUTSIDE)


def cube_field(decoder: torch.nn.Module, latent: Float[Tensor, " d"], cage: Cage, outside: Outside) -> CageField:
    """The field of a decoder that was trained in the whole cube (DeepSDF); the cage plays no part.

    It is asked in one cuboid, the cube [-HALF_EXTENT, HALF_EXTENT]³, and is outside beyond.
    """
    cube = Cage.of({"cube": Cuboid(np.zeros(3), np.eye(3), np.full(3, 2 * HALF_EXTENT))})
    return CageField(decoder, latent, cube, outside_constant)


FIELDS: dict[str, Callable[[torch.nn.Module, Tensor, Cage, Outside], CageField]] = {
    "cage": CageField,
    "cube": cube_field,
}  # by where an arm's training points come from


def extract(field: CageField, resolution: int) -> Extraction:
    """The zero surface of a field by marching cubes (§3.6), canonical frame, outwards.

    `resolution` counts the cells along [-HALF_EXTENT, HALF_EXTENT]. All values have a sign and
    the outermost are positive, so that the surface has no hole.
    """
    domain = domain_of(field.cage, Lattice.covering(*field.bounds(), resolution))
    answers = ask_sparsely(field.ask, domain)
    if not (answers.values < 0).any():
        return Extraction(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), answers.asked, 0.0)
    values, bound = field.outside(field.cage, domain, answers)
    cell = domain.lattice.cell
    size = np.abs(values).clip(NUDGE * cell, OUTSIDE)
    # Signs are the network's: the union's distance is 0, of either sign, on the cage's own faces.
    values = np.where(answers.values < 0, -size, size)
    vertices, faces, _, _ = marching_cubes(values, level=0.0, gradient_direction="descent")
    beyond = (answers.values < 0) & (answers.values < bound - CLIP_TOLERANCE * cell)
    low, high = (tuple(part(vertices).astype(int).T) for part in (np.floor, np.ceil))
    nobody = domain.owner == NOBODY
    clipped = (beyond[low] & nobody[high]) | (beyond[high] & nobody[low])
    mesh = Mesh(domain.lattice.points(vertices.astype(np.float64)), faces.astype(np.int32))
    return Extraction(mesh, answers.asked, float(clipped.mean()))


def extract_surface(field: CageField, resolution: int) -> Mesh:
    """The mesh that `extract` gives, alone."""
    return extract(field, resolution).mesh


def domain_of(cage: Cage, lattice: Lattice) -> Domain:
    """Owners and depths of all lattice points, cuboid by cuboid; inside cuboids the same as `Cage.assign`."""
    owner = np.full(lattice.shape, NOBODY, np.int16)
    depth = np.full(lattice.shape, OUTSIDE, np.float32)
    # Two cells around: what shares a cell with a point inside has its nearest cuboid within √3 cells.
    reach = 2 * lattice.cell
    for i, corners in enumerate(cage.corners()):
        ends = np.stack([corners.min(axis=0) - reach, corners.max(axis=0) + reach], axis=1)
        box = tuple(slice(*np.searchsorted(lattice.axis(k), ends[k])) for k in range(3))
        x, y, z = np.ix_(*((lattice.axis(k)[box[k]] - cage.centre[i, k]).astype(np.float32) for k in range(3)))
        axes, half = cage.axes[i].astype(np.float32), (cage.size[i] / 2).astype(np.float32)
        beyond = [np.abs(a * x + b * y + c * z) - h for (a, b, c), h in zip(axes, half)]
        distance = np.maximum(np.maximum(beyond[0], beyond[1]), beyond[2])
        inside = distance <= 0
        distance[~inside] = np.sqrt(sum(np.maximum(part[~inside], 0) ** 2 for part in beyond))
        nearer = distance < depth[box]
        depth[box][nearer] = distance[nearer]
        owner[box][nearer & inside] = i
    return Domain(lattice, owner, depth)


def ask_sparsely(ask: Callable[[ndarray, ndarray], ndarray], domain: Domain) -> Answers:
    """Ask a network at the points that have an owner and may lie next to its surface.

    Blocks of points, half as large each time, are settled by the value at their centre if that
    exceeds LIPSCHITZ times the distance to their corners and all their points have one owner.
    What is left is asked point by point, then whatever shares a cell that the surface crosses:
    a surface once met is followed to its end, however steep the network. So the result is that
    of asking everywhere, but for pieces that lie wholly in settled blocks.
    """
    lattice = domain.lattice
    size = first_block(lattice.cell)
    owner = np.pad(domain.owner, [(0, -length % size) for length in lattice.shape], constant_values=NOBODY)
    values = np.full(owner.shape, OUTSIDE, np.float32)
    known = owner == NOBODY
    asked = 0

    def ask_at(places: Integer[ndarray, "m 3"]) -> int:
        where = tuple(places.T)
        values[where] = ask(lattice.points(places), owner[where])
        known[where] = True
        return len(places)

    blocks = np.argwhere(in_blocks(owner, size).max(axis=(3, 4, 5)) != NOBODY)
    while size > 1:
        owners = in_blocks(owner, size)[tuple(blocks.T)].reshape(len(blocks), -1)
        single = np.flatnonzero((owners == owners[:, :1]).all(axis=1) & (owners[:, 0] != NOBODY))
        centres = ask(lattice.points(blocks[single] * size + (size - 1) / 2), owners[single, 0])
        asked += len(centres)
        far = np.abs(centres) > LIPSCHITZ * half_diagonal(size, lattice.cell)
        signs = np.copysign(np.float32(OUTSIDE), centres[far])
        in_blocks(values, size)[tuple(blocks[single[far]].T)] = signs[:, None, None, None]
        blocks = (2 * np.delete(blocks, single[far], axis=0)[:, None] + np.argwhere(np.ones((2, 2, 2)))).reshape(-1, 3)
        size //= 2
    asked += ask_at(blocks[owner[tuple(blocks.T)] != NOBODY])
    near = beside_surface(values < 0)
    while (near & ~known).any():
        asked += ask_at(np.argwhere(near & ~known))
        near = beside_surface(values < 0)
    r, s, t = lattice.shape
    return Answers(values[:r, :s, :t], asked, near[:r, :s, :t])


def first_block(cell: float) -> int:
    """Points along the largest block that its centre may settle: networks say no more than OUTSIDE, far away."""
    size = 1
    while LIPSCHITZ * half_diagonal(2 * size, cell) < OUTSIDE:
        size *= 2
    return size


def half_diagonal(size: int, cell: float) -> float:
    """From the centre of a block of `size`³ points to its corner points."""
    return (size - 1) / 2 * 3**0.5 * cell


def in_blocks(array: Shaped[ndarray, "r s t"], size: int) -> Shaped[ndarray, "a b c size size size"]:
    """A view of an array by blocks of `size`³."""
    a, b, c = (length // size for length in array.shape)
    return array.reshape(a, size, b, size, c, size).transpose(0, 2, 4, 1, 3, 5)


def beside_surface(negative: Bool[ndarray, "r s t"]) -> Bool[ndarray, "r s t"]:
    """The points at corners of cells that have corners of both signs."""
    some = every = negative
    for axis in range(3):
        low, high = _ends(axis)
        some, every = some[low] | some[high], every[low] & every[high]
    near = some & ~every
    for axis in range(3):
        wider = np.zeros([length + (k == axis) for k, length in enumerate(near.shape)], dtype=bool)
        low, high = _ends(axis)
        wider[low] = near
        wider[high] |= near
        near = wider
    return near


def _ends(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    whole = (slice(None),) * axis
    return (*whole, slice(None, -1)), (*whole, slice(1, None))


def _triple(numbers: Int[ndarray, " 3"]) -> tuple[int, int, int]:
    x, y, z = numbers.tolist()
    return x, y, z
