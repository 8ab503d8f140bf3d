"""New shapes, as a trained network makes them."""

from collections.abc import Mapping
from dataclasses import dataclass

from jaxtyping import Float32
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.geometry.meshes import Mesh
from cagesdf.structure.base import Structure

OK, EMPTY, BROKEN = "ok", "empty", "broken"


@dataclass(frozen=True, eq=False)
class GeneratedShape:
    """A shape made by a generator."""

    method: str  # how its code was drawn
    shape_id: str  # unique in its method
    seed: int
    draw: int  # number of its cage's draw
    structure: Structure | None  # canonical; None where the arm knows no cuboids
    cage: Cage  # canonical; no cuboids where the arm knows none
    floating: int  # cuboids that were drawn attached to nothing, and left out
    latent: Float32[ndarray, " d"]
    part_latents: Mapping[str, Float32[ndarray, " d"]]  # by id, of the parts that have another one
    effective: float  # number of kernels that its code could be from
    status: str  # OK, EMPTY, or BROKEN and why
    mesh: Mesh  # canonical; closed, or without faces
    components: int  # connected components
    clipped: float  # share of the vertices where the cage cut the network's surface off
    evaluations: int  # points at which the network was evaluated
    rooted: bool  # as `static_stability` has it; False without cuboids
    stable: bool
    points: Float32[ndarray, "n 3"]  # on the surface, canonical; none where there is no surface
    parts: Mapping[str, Mesh]  # closed, whose union the mesh is; not written
