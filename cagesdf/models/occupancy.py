"""A decoder of one part at a time that learns occupancy, a logit in place of the distance (the paper's §5).

The union of parts is where the largest of their logits is positive, as it is where the smallest of their distances is
negative. Each part is taught in all of its cuboid, so that the loss needs no term for the union.
"""

from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from cagesdf.errors import InputError
from cagesdf.frames import LARGEST_UNIT
from cagesdf.models.triplane import TriplaneDecoder

TEMPERATURE = 0.05  # distance from the surface at which the logit of a label is ±1, in the decoder's unit
# Logit up to which values count as distances. Labels hardly differ beyond 4 (sigmoid(4) = 0.98), but trained networks
# go on as if they did: with 16, no sign of four million points of lattices was another than by asking everywhere.
TRUSTED_LOGIT = 16.0


class OccupancyDecoder(TriplaneDecoder):
    """The part model with a logit of being inside: its values are −logit · TEMPERATURE · unit, negative inside.

    Labels are soft, sigmoid(−sdf / (TEMPERATURE · unit)), so that values near the surface are distances; beyond
    TRUSTED_LOGIT they are a sign alone. With labels of the sign alone nothing decides on the slope (docs/log.md).
    """

    trusted = TRUSTED_LOGIT * TEMPERATURE

    def unit(self, cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, " g"]:
        """The cuboid's smallest length, at least LEAST_UNIT and at most LARGEST_UNIT."""
        return super().unit(cuboid).clamp(max=LARGEST_UNIT)

    def logit(self, values: Float[Tensor, "g n"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n"]:
        """Logit of being inside, from values or from signed distances, canonical."""
        return -values / (TEMPERATURE * self.unit(cuboid)[:, None])

    def errors(
        self, predicted: Float[Tensor, "g n"], sdf: Float[Tensor, "g n"], cuboid: Float[Tensor, "g 15"], clamp: float
    ) -> Float[Tensor, "g n"]:
        """Cross-entropy with the label, less the label's own entropy, times TEMPERATURE: the decoder's unit.

        Zero where they agree, and at most |predicted − sdf| in that unit. Residuals of shapes are of it, too. Raises
        InputError for a `clamp` other than 0.
        """
        if clamp:
            raise InputError(f"OccupancyDecoder: learns a logit, and clamp {clamp:g} is of distances; wanted clamp 0")
        predicted, truth = self.logit(predicted, cuboid), self.logit(sdf, cuboid)
        label = truth.sigmoid()
        entropy, cross_entropy = (
            binary_cross_entropy_with_logits(logit, label, reduction="none") for logit in (truth, predicted)
        )
        return TEMPERATURE * (cross_entropy - entropy)
