"""A decoder with one latent and one cage, and what it is where cuboids overlap or end."""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float, Float32
from numpy import ndarray
from torch import Tensor

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import InputError
from cagesdf.frames import HALF_EXTENT, OUTSIDE
from cagesdf.models.decoders import Decoder

GROUP = 480  # points that go through the network together, a multiple of ROWS: their layers fit into the cache
ROWS = 96  # numbers of points are rounded up to this: libraries compute what is left over of their blocks otherwise

# From each point's depth in each cuboid (canonical, ≤ 0; inf where that doesn't contain it) and what the network says
# in each of these: the field.
Overlap = Callable[[Float32[ndarray, "n p"], Float32[ndarray, "n p"]], Float32[ndarray, " n"]]
# From the cage and points outside its cuboids: the field there, positive.
Outside = Callable[[Cage, Float[ndarray, "n 3"]], Float[ndarray, " n"]]


def overlap_deepest(depth: Float32[ndarray, "n p"], values: Float32[ndarray, "n p"]) -> Float32[ndarray, " n"]:
    """The paper's: the cuboid that most contains a point decides (§3.4, §3.6). It jumps where another one does."""
    return np.take_along_axis(values, depth.argmin(axis=1)[:, None], axis=1)[:, 0]


def overlap_union(depth: Float32[ndarray, "n p"], values: Float32[ndarray, "n p"]) -> Float32[ndarray, " n"]:
    """The least value of all containing cuboids: the union of what each of them holds."""
    return np.where(depth <= 0, values, np.float32(np.inf)).min(axis=1)


def overlap_blend(depth: Float32[ndarray, "n p"], values: Float32[ndarray, "n p"]) -> Float32[ndarray, " n"]:
    """The mean of all containing cuboids, weighted by depth: continuous, as a cuboid's weight is 0 on its surface."""
    inside = depth <= 0
    weights = np.where(inside, np.float32(1e-9) - depth, np.float32(0))  # points on a surface count too
    return (weights * np.where(inside, values, np.float32(0))).sum(axis=1) / weights.sum(axis=1)


def outside_union(cage: Cage, points: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
    """The distance to the cuboids.

    A perfect network of two touching boxes then costs 0.02 % of the longest side at 128 cells; the
    paper's constant costs 0.5 %, because the surface staircases wherever a part touches its cuboid.
    """
    return cage.assign(points)[1]


def outside_constant(cage: Cage, points: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
    """The paper's: OUTSIDE (§3.6)."""
    return np.full(len(points), OUTSIDE)


OVERLAPS: dict[str, Overlap] = {"deepest": overlap_deepest, "union": overlap_union, "blend": overlap_blend}
OUTSIDES: dict[str, Outside] = {"union": outside_union, "constant": outside_constant}


class CageField:
    """A decoder with one latent and one cage."""

    def __init__(
        self,
        decoder: Decoder,
        latent: Float[Tensor, " d"],
        cage: Cage,
        outside: Outside,
        overlap: Overlap = overlap_blend,
    ) -> None:
        """`decoder` is in evaluation mode and on `latent`'s device; see OUTSIDES and OVERLAPS."""
        self.decoder = decoder
        self.latent = latent
        self.cage = cage
        self.outside = outside
        self.overlap = overlap
        self._given: dict[int, tuple[Tensor, Tensor]] = {}  # by cuboid, its vector and what it does to the layers

    @torch.inference_mode()
    def ask(self, points: Float[ndarray, "n 3"], cuboid: int) -> Float32[ndarray, " n"]:
        """The network's values, within ±OUTSIDE, at canonical points of cuboid number `cuboid`.

        In float32: bfloat16's steps would show on the surface. A point's value doesn't depend on the
        points beside it, not even in its last bits. Raises InputError if a value is not finite.
        """
        padded = np.zeros((1, -(-len(points) // ROWS) * ROWS, 3), np.float32)
        padded[0, : len(points)] = points
        given = torch.from_numpy(padded).to(self.latent.device)
        if cuboid not in self._given:
            vector = torch.from_numpy(self.cage.vectors()[cuboid : cuboid + 1].astype(np.float32)).to(given.device)
            self._given[cuboid] = vector, self.decoder.condition(self.latent[None], vector)
        vector, condition = self._given[cuboid]
        features = (self.decoder.features(group, vector) for group in given.split(GROUP, dim=1))
        parts = [self.decoder.at(group, condition, group.dtype)[0] for group in features]
        values = torch.cat(parts).cpu().numpy()[: len(points)]
        if not np.isfinite(values).all():
            raise InputError("the network gives values that are not finite, so its training diverged; train it again")
        return values.clip(-OUTSIDE, OUTSIDE)


def cube_field(
    decoder: Decoder,
    latent: Float[Tensor, " d"],
    cage: Cage,
    outside: Outside,
    overlap: Overlap = overlap_blend,
) -> CageField:
    """The field of a decoder that was trained in the whole cube (DeepSDF); the cage plays no part.

    It is asked in one cuboid, the cube [-HALF_EXTENT, HALF_EXTENT]³, and is outside beyond.
    """
    cube = Cage.of({"cube": Cuboid(np.zeros(3), np.eye(3), np.full(3, 2 * HALF_EXTENT))})
    return CageField(decoder, latent, cube, outside_constant, overlap)


MakeField = Callable[[Decoder, Tensor, Cage, Outside, Overlap], CageField]
FIELDS: dict[str, MakeField] = {"cage": CageField, "cube": cube_field}  # by where an arm's training points come from
