"""Features of shapes: the classifier that they are read from, and what its classes are."""

from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.models.pointnet import PointNet


@dataclass(frozen=True, eq=False)
class Features:
    """A trained classifier of shapes."""

    model: PointNet  # in eval mode, its parameters without gradients
    widths: tuple[int, ...]  # of the points' layers; the last is the number of features
    hidden: int  # units of the classifier
    classes: tuple[str, ...]  # in the order of the logits: a category, or <category>/<family>
    points: int  # of each cloud in its input

    def category(self, number: int) -> str:
        """The category of a class."""
        return self.classes[number].split("/")[0]

    @property
    def categories(self) -> set[str]:
        """The categories of all classes."""
        return {self.category(number) for number in range(len(self.classes))}

    def taken(self, points: Float[ndarray, "n p 3"]) -> Float[ndarray, "n q 3"]:
        """The first `points` points of each cloud, the classifier's input. Raises InputError if there are fewer."""
        if points.shape[1] < self.points:
            raise InputError(f"features: wanted clouds of at least {self.points} points, got {points.shape[1]}")
        return points[:, : self.points]
