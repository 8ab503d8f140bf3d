"""Deformation sequences: cages interpolated towards a target, and surfaces that follow them (§3.3)."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage, Sequence
from cagesdf.deformation.matching import Match
from cagesdf.errors import InputError, ProgramError, ShapeRejected
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.resizing import AxisWarp, keeping_warp, vulnerability
from cagesdf.geometry.solid import outer_surface
from cagesdf.shape import Shape
from cagesdf.structure.assembly import Assembly

SMALLEST = 1e-3  # the program's unit: a millimetre, for furniture; a thinner cuboid on the way is degenerate
CONTAINED = 1e-6  # a cuboid contains a point whose signed distance to it is at most this, canonical units


class CuboidPath:
    """The paper's way from cage to cage: each cuboid by itself."""

    def __init__(self, source: Cage, target: Cage) -> None:
        """`target` has the source's parts, its axes named as there: see `aligned_cage`."""
        self.source = source
        self.target = target

    def __call__(self, t: float) -> Cage:
        """The cage at `t` in [0, 1]."""
        return interpolated_cage(self.source, self.target, t)


class ProgramPath:
    """From program to program: continuous parameters linearly, so that each cage on the way is a program's."""

    def __init__(self, source: Assembly, target: Assembly, pairs: tuple[tuple[str, str], ...]) -> None:
        """Programs of equal signature, and their corresponding parts."""
        self.source = source
        self.ends = source.program.parameters(), source.parameters_of(target, pairs)
        self.placements = source.placement, target.placement

    def __call__(self, t: float) -> Cage:
        """The cage at `t` in [0, 1]. Raises ProgramError if the program on the way executes badly."""
        program = self.source.program.with_parameters((1 - t) * self.ends[0] + t * self.ends[1])
        first, last = self.placements
        placement = Similarity(
            (1 - t) * first.scale + t * last.scale,
            first.rotation,
            (1 - t) * first.translation + t * last.translation,
        )
        cage = Assembly(program, placement).cage()
        least = cage.size.min(axis=1) / placement.scale
        if least.min() < SMALLEST:
            part = cage.part_ids[int(least.argmin())]
            wanted = f"cuboid {part} is {least.min():.2g} thin; wanted {SMALLEST:g} or more"
            raise ProgramError(f"program at t = {t:g}", 0, "", wanted)
        return cage


def make_sequence(
    match: Match, cages: Mapping[str, Cage], path: Callable[[float], Cage], steps: int, held_out: tuple[int, ...]
) -> Sequence:
    """The sequence from a match's source along a path: `steps` cages at even values of t.

    Step 0 is the source's own cage. Raises InputError if a held-out step is not one of 1 … steps − 1,
    ShapeRejected if a program on the way executes badly.
    """
    if not set(held_out) <= set(range(1, steps)):
        raise InputError(f"held_out: got {', '.join(map(str, held_out))}; wanted steps among 1 to {steps - 1}")
    t = np.linspace(0, 1, steps)
    try:
        moved = [path(float(value)) for value in t[1:]]
    except ProgramError as error:
        raise ShapeRejected(match.shape_id, "deform_sequences", f"towards {match.target_id}: {error}") from error
    return Sequence(
        match.shape_id,
        match.target_id,
        t,
        tuple(step in held_out for step in range(steps)),
        (cages[match.shape_id], *moved),
    )


def cuboid_path(match: Match, cages: Mapping[str, Cage]) -> CuboidPath:
    """Towards the target's cuboids, or the source's own, scaled."""
    source = cages[match.shape_id]
    if match.target_id is None:
        return CuboidPath(source, scaled_cage(source, np.array(match.scale)))
    return CuboidPath(source, aligned_cage(source, cages[match.target_id], match.pairs))


def aligned_cage(source: Cage, target: Cage, pairs: tuple[tuple[str, str], ...]) -> Cage:
    """The target's cuboids under the ids of their partners in the source, axes named as there."""
    partners = dict(pairs)
    return Cage.of({part_id: target[partners[part_id]].nearest_to(source[part_id].axes) for part_id in source.part_ids})


def interpolated_cage(source: Cage, target: Cage, t: float) -> Cage:
    """The cage at `t`: centres and sizes linearly, axes along the shortest rotation.

    Parts correspond by position.
    """
    turns = Rotation.from_matrix(source.axes.swapaxes(1, 2) @ target.axes).as_rotvec()
    return Cage(
        source.part_ids,
        (1 - t) * source.centre + t * target.centre,
        source.axes @ Rotation.from_rotvec(t * turns).as_matrix(),
        (1 - t) * source.size + t * target.size,
    )


def scaled_cage(cage: Cage, factors: Float[ndarray, " 3"]) -> Cage:
    """The cage under an anisotropic scaling along the canonical axes.

    A rotated cuboid's edges don't stay perpendicular. Its axes become the rotation nearest to the
    scaled edges (their orthogonal polar factor, in which long edges count more, so that a leaning leg
    still reaches the seat), its sizes the scaled edges' lengths.
    """
    edges = cage.size[:, :, None] * cage.axes * factors
    u, _, v = np.linalg.svd(edges)
    return Cage(cage.part_ids, cage.centre * factors, u @ v, np.linalg.norm(edges, axis=2))


def deform_vertices(vertices: Float[ndarray, "v 3"], owner: int, rest: Cage, moved: Cage) -> Float[ndarray, "v 3"]:
    """Move the vertices of part number `owner` from its rest cage to a moved one; canonical.

    Each cuboid takes its points along by trilinear interpolation of its corners. Where these are
    a cuboid again that is the affine map between the two unit frames. A vertex goes to the average
    over all cuboids that contain it, its own always among them.
    """
    contains = rest.signed_distance(vertices) <= CONTAINED
    contains[:, owner] = True
    total = np.zeros_like(vertices)
    for i in np.flatnonzero(contains.any(axis=0)).tolist():
        inside = contains[:, i]
        total[inside] += moved.from_unit(rest.to_unit(vertices[inside], i), i)
    return total / contains.sum(axis=1)[:, None]


def deform_shape(shape: Shape, rest: Cage, moved: Cage) -> list[Mesh]:
    """The parts' meshes after their vertices have followed the cage from `rest` to `moved`; canonical.

    The parts are as closed as they were at rest: only vertices move.
    """
    return [
        part.mesh.with_vertices(deform_vertices(part.mesh.vertices, i, rest, moved))
        for i, part in enumerate(shape.parts)
    ]


def follow_own_cuboids(shape: Shape, rest: Cage, moved: Cage) -> list[Mesh]:
    """The parts' meshes, each moved by its own cuboid alone from `rest` to `moved`; canonical."""
    return [
        part.mesh.with_vertices(moved.from_unit(rest.to_unit(part.mesh.vertices, i), i))
        for i, part in enumerate(shape.parts)
    ]


def solids_in_cuboids(shape: Shape, rest: Cage) -> list[Mesh]:
    """The parts, each in the unit frame of its own cuboid.

    A part that follows its own cuboid alone has this surface at every step, without the faces inside it where
    its components overlap or touch. Raises ValueError if one isn't closed.
    """
    solids = [outer_surface(part.mesh) for part in shape.parts]
    return [mesh.with_vertices(rest.to_unit(mesh.vertices, i)) for i, mesh in enumerate(solids)]


def keep_details(shape: Shape, rest: Cage, moved: Cage, detail: float = 1.0) -> list[Mesh]:
    """The parts' meshes, each moved by its own cuboid alone, details as long as at rest; canonical.

    Lengths in `moved` are `detail` times those in `rest` where both mean the same; see `resizing.keeping_warp`.
    """
    meshes = []
    for i, part in enumerate(shape.parts):
        unit = part.mesh.with_vertices(rest.to_unit(part.mesh.vertices, i))
        warp = keeping_warp(vulnerability(unit, rest.size[i]), rest.size[i], moved.size[i], detail)
        meshes.append(unit.with_vertices(moved.from_unit(warp(unit.vertices), i)))
    return meshes


class Transfer(ABC):
    """How surfaces follow the cages of a sequence."""

    warps: tuple[tuple[AxisWarp, ...], ...]  # by step and part, in unit frames; () if surfaces follow cuboids alone

    @classmethod
    @abstractmethod
    def of(cls, shape: Shape, sequence: Sequence, details: Float[ndarray, " s"]) -> "Transfer":
        """The transfer for a sequence; at step s a detail that keeps its size has `details[s]` times its length."""

    @abstractmethod
    def parts(self, shape: Shape, sequence: Sequence, step: int) -> list[Mesh]:
        """The parts of the whole shape at a step, closed; canonical."""

    @abstractmethod
    def own_parts(self, shape: Shape, sequence: Sequence, step: int) -> list[Mesh]:
        """The parts at a step where each has followed its own cuboid alone; canonical."""

    @abstractmethod
    def in_cuboids(self, solids: list[Mesh], step: int) -> list[Mesh]:
        """The surfaces at a step of parts that are given at rest, all in the unit frames of their cuboids."""


@dataclass(frozen=True)
class Trilinear(Transfer):
    """The paper's (§3.3): details stretch with their cuboid."""

    warps: tuple[tuple[AxisWarp, ...], ...] = ()

    @classmethod
    def of(cls, shape: Shape, sequence: Sequence, details: Float[ndarray, " s"]) -> "Trilinear":
        """The same for all shapes."""
        return cls()

    def parts(self, shape: Shape, sequence: Sequence, step: int) -> list[Mesh]:
        """The same as `deform_shape`: vertices follow all cuboids that contain them."""
        return deform_shape(shape, sequence.cages[0], sequence.cages[step])

    def own_parts(self, shape: Shape, sequence: Sequence, step: int) -> list[Mesh]:
        """The same as `follow_own_cuboids`."""
        return follow_own_cuboids(shape, sequence.cages[0], sequence.cages[step])

    def in_cuboids(self, solids: list[Mesh], step: int) -> list[Mesh]:
        """The same at every step."""
        return solids


@dataclass(frozen=True, eq=False)
class KeptDetails(Transfer):
    """Details keep their size, each part by its own cuboid alone; both kinds of truth are the same."""

    warps: tuple[tuple[AxisWarp, ...], ...]

    @classmethod
    def of(cls, shape: Shape, sequence: Sequence, details: Float[ndarray, " s"]) -> "KeptDetails":
        """A warp for each step and part."""
        rest, solids = sequence.cages[0], [part.mesh for part in shape.parts]
        units = [mesh.with_vertices(rest.to_unit(mesh.vertices, i)) for i, mesh in enumerate(solids)]
        weights = [vulnerability(unit, size) for unit, size in zip(units, rest.size)]
        return cls(
            tuple(
                tuple(keeping_warp(*lengths, detail) for lengths in zip(weights, rest.size, cage.size))
                for cage, detail in zip(sequence.cages, details.tolist(), strict=True)
            )
        )

    def parts(self, shape: Shape, sequence: Sequence, step: int) -> list[Mesh]:
        """The parts warped in their cuboids."""
        return self.own_parts(shape, sequence, step)

    def own_parts(self, shape: Shape, sequence: Sequence, step: int) -> list[Mesh]:
        """The parts warped in their cuboids."""
        rest, moved = sequence.cages[0], sequence.cages[step]
        return [
            part.mesh.with_vertices(moved.from_unit(warp(rest.to_unit(part.mesh.vertices, i)), i))
            for i, (part, warp) in enumerate(zip(shape.parts, self.warps[step], strict=True))
        ]

    def in_cuboids(self, solids: list[Mesh], step: int) -> list[Mesh]:
        """The solids warped."""
        return [mesh.with_vertices(warp(mesh.vertices)) for mesh, warp in zip(solids, self.warps[step], strict=True)]


def detail_lengths(sequence: Sequence, source: Similarity, target: Similarity) -> Float[ndarray, " s"]:
    """At each step, the length of a detail that keeps its size in the files' unit, over its length at rest.

    Both shapes were scaled into the unit sphere, each by a factor of its own; a sequence goes from one to the other.
    """
    return 1 + sequence.t * (target.scale / source.scale - 1)


def share_outside(meshes: list[Mesh], cage: Cage) -> Float[ndarray, " p"]:
    """For each part, the share of its vertices outside its own cuboid: averaging puts them there."""
    return np.array([np.mean(cage.signed_distance(mesh.vertices)[:, i] > CONTAINED) for i, mesh in enumerate(meshes)])
