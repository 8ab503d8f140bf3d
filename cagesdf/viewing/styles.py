"""Principal directions of the latent codes, limited to the range of the training codes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray


@dataclass(frozen=True, eq=False)
class StyleSpace:
    """Mean and principal directions of the training shapes' latent codes."""

    mean: Float[ndarray, " d"]
    directions: Float[ndarray, "k d"]  # unit, by falling spread
    spread: Float[ndarray, " k"]  # standard deviation of the codes along each
    ends: Float[ndarray, "k 2"]  # where the training codes begin and end along each, in standard deviations

    @staticmethod
    def of(codes: Float[ndarray, "n d"], most: int) -> "StyleSpace":
        """The `most` directions at most in which the codes differ most (principal component analysis)."""
        mean = codes.mean(axis=0)
        _, singular, directions = np.linalg.svd(codes - mean, full_matrices=False)
        count = min(most, int((singular > 1e-6 * max(singular.max(initial=0), 1e-12)).sum()))
        # Signs are arbitrary: the largest number of each direction is positive, so that sliders keep their sense.
        signs = np.sign(directions[np.arange(len(directions)), np.abs(directions).argmax(axis=1)])
        spread = singular / np.sqrt(max(len(codes) - 1, 1))
        chosen, along = (directions * signs[:, None])[:count], spread[:count]
        places = (codes - mean) @ chosen.T / along
        return StyleSpace(mean, chosen, along, np.stack([places.min(axis=0), places.max(axis=0)], axis=1))

    def places(self, code: Float32[ndarray, " d"]) -> Float[ndarray, " k"]:
        """Coordinates of a code along the directions, in standard deviations from the mean."""
        return self.directions @ (code - self.mean) / self.spread

    def moved(self, code: Float32[ndarray, " d"], direction: int, place: float) -> Float32[ndarray, " d"]:
        """The code with another place along one direction, elsewhere as it was; no further than training codes go."""
        change = np.clip(place, *self.ends[direction]) - self.places(code)[direction]
        return (code + change * self.spread[direction] * self.directions[direction]).astype(np.float32)
