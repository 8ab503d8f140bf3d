"""The result of fitting: a shape's cage, and how well it bounds the parts."""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.structure.assembly import Assembly

TOLERANCE = 1e-4  # a point farther outside its cuboid is not bounded, canonical units
BOUNDED = 0.005  # share of a part's surface points that may be outside of a cuboid that bounds it


@dataclass(frozen=True, eq=False)
class FittedCage:
    """The cuboids of a shape, and how they fit its parts."""

    cage: Cage  # canonical, in the order of the structure's parts
    assembly: Assembly | None  # the fitted program that the cuboids follow from; None: they are free
    overshoot: Float[ndarray, " p"]  # largest signed distance of a part's surface to its cuboid, canonical
    outside_before: Float[ndarray, " p"]  # share of surface points over TOLERANCE outside, of the program as given
    outside: Float[ndarray, " p"]  # the same of `cage`
    volume_ratio: Float[ndarray, " p"]  # volume over that of the part's minimum-volume box
    loss_before: float  # the appendix's, the program's unit: of the program as given; NaN where there is none
    loss: float  # at its minimum, before the cuboids were made to bound their parts; NaN where there is no program

    @property
    def bounded(self) -> Bool[ndarray, " p"]:
        """Whether a cuboid bounds its part: but for BOUNDED of the surface points."""
        return self.outside <= BOUNDED
