"""A decoder with a cage and the codes of its parts."""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float, Float32, Int, Num
from numpy import ndarray
from torch import Tensor

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import InputError
from cagesdf.extraction.lattice import Lattice
from cagesdf.frames import HALF_EXTENT
from cagesdf.models.codes import part_codes
from cagesdf.models.decoders import Decoder

GROUP = 1920  # points that go through the network together, a multiple of ROWS: their layers fit into the cache
ROWS = 96  # numbers of points are rounded up to multiples: libraries compute incomplete blocks otherwise
# The cage of decoders that don't know cuboids.
CUBE = Cage.of({"shape": Cuboid(np.zeros(3), np.eye(3), np.full(3, 2 * HALF_EXTENT))})


class CageField:
    """A signed distance for each cuboid of a cage; the shape is the union of the solids within the cuboids."""

    def __init__(
        self, decoder: Decoder, codes: Float[Tensor, "p k"], cage: Cage, evaluated: Cage | None = None
    ) -> None:
        """`decoder` is in evaluation mode and on `codes`' device; the codes are of the cage's parts, in their order.

        `evaluated` are the cuboids that the network is evaluated in: the cage's, some with other lengths. A part's
        surface is resized from one to the other with details that keep their size (`resizing`). None: no part's is.
        """
        self.decoder = decoder
        self.codes = codes
        self.cage = cage
        self.evaluated = cage if evaluated is None else evaluated
        self._given: dict[int, tuple[Tensor, Tensor]] = {}  # by cuboid, its vector and the conditioning of the layers

    def unplaced(self) -> "CageField":
        """The same field of cuboids at the origin, if its parts move with their cuboids; otherwise the field itself."""
        if self.decoder.trains_on != "part":
            return self
        return CageField(self.decoder, self.codes, self.cage.at_origin(), self.evaluated.at_origin())

    def keys(self) -> tuple[bytes, ...]:
        """A key for each cuboid: everything that determines its values, except the decoder."""
        codes, cuboids = self.codes.cpu().numpy(), np.hstack([self.cage.vectors(), self.evaluated.size])
        return tuple(code.tobytes() + numbers.tobytes() for code, numbers in zip(codes, cuboids))

    @torch.inference_mode()
    def reach(self, cuboid: int) -> float:
        """The largest value in cuboid number `cuboid`, canonical units: beyond it only the sign counts."""
        return self.decoder.trusted * float(self.decoder.unit(self._vector(cuboid)))

    @torch.inference_mode()
    def values(self, points: Float[ndarray, "n 3"], cuboid: int) -> Float32[ndarray, " n"]:
        """The network's values, within ±`reach`, at canonical points of cuboid number `cuboid`.

        In float32: bfloat16's steps would show on the surface. A point's value doesn't depend on the
        points beside it, not even in its last bits. Raises InputError if a value is not finite.
        """
        vector, condition = self._conditioned(cuboid)

        def at_points(group: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
            return self.decoder.evaluate(self.decoder.features(group[None], vector), condition, group.dtype)[0]

        return self._values(at_points, points.astype(np.float32), cuboid)

    @torch.inference_mode()
    def on_lattice(self, lattice: Lattice, cuboid: int) -> Callable[[Int[ndarray, "n 3"]], Float32[ndarray, " n"]]:
        """`values` at nodes of a lattice of cuboid number `cuboid`, by their indices; equal to it but for rounding."""
        vector, condition = self._conditioned(cuboid)
        axes = [torch.from_numpy(axis).to(self.codes) for axis in lattice.unit_axes()]
        at_nodes = self.decoder.on_lattice(condition, vector, axes)
        return lambda places: self._values(at_nodes, places, cuboid)

    @torch.inference_mode()
    def _values(
        self, at: Callable[[Tensor], Float[Tensor, " n"]], places: Num[ndarray, "n 3"], cuboid: int
    ) -> Float32[ndarray, " n"]:
        rest = np.zeros_like(places, shape=(-len(places) % ROWS, 3))
        padded = np.concatenate([places, rest])
        groups = torch.from_numpy(padded).to(self.codes.device).split(GROUP)
        values = torch.cat([at(group) for group in groups]).cpu().numpy()[: len(places)]
        if not np.isfinite(values).all():
            raise InputError("the network gives values that are not finite, so its training diverged; train it again")
        reach = np.float32(self.reach(cuboid))
        return values.clip(-reach, reach)

    def _conditioned(self, cuboid: int) -> tuple[Tensor, Tensor]:
        if cuboid not in self._given:
            vector = self._vector(cuboid)
            self._given[cuboid] = vector, self.decoder.condition(self.codes[cuboid : cuboid + 1], vector)
        return self._given[cuboid]

    def _vector(self, cuboid: int) -> Float[Tensor, "1 15"]:
        return torch.from_numpy(self.evaluated.vectors()[cuboid : cuboid + 1]).to(self.codes)


def field_of(decoder: Decoder, latent: Float[Tensor, " d"], cage: Cage, seen: Cage | None = None) -> CageField:
    """The field of a decoder with a latent and a cage; parts have the codes of the cage `seen`, if that is another one.

    A decoder that doesn't know cuboids (DeepSDF) is evaluated in one, the cube [-HALF_EXTENT, HALF_EXTENT]³; the cages
    play no part.
    """
    if decoder.trains_on == "cube":
        cage = seen = CUBE
    return CageField(decoder, part_codes(decoder, latent, cage if seen is None else seen), cage)
