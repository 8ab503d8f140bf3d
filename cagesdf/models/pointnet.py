"""PointNet: a network over sets of points, whose largest values describe a shape."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn


class PointNet(nn.Module):
    """Each point through the same layers, the largest of each number over all points, and a classifier of those.

    After Qi et al., "PointNet" (2017), without the networks that align points (shapes come in the canonical frame)
    and without batch normalisation, so that a shape's features depend on nothing but the shape.
    """

    def __init__(self, widths: Sequence[int], hidden: int, classes: int) -> None:
        """`widths` of the points' layers, the last of them the number of features; `hidden` units of the classifier."""
        super().__init__()
        layers: list[nn.Module] = [nn.Linear(3, widths[0])]
        for into, out in pairwise(widths):
            layers += [nn.ReLU(), nn.Linear(into, out)]
        self.point = nn.Sequential(*layers)
        self.head = nn.Sequential(nn.ReLU(), nn.Linear(widths[-1], hidden), nn.ReLU(), nn.Linear(hidden, classes))

    def features(self, points: Float[Tensor, "b n 3"]) -> Float[Tensor, "b f"]:
        """Features of each cloud; the order of its points doesn't matter."""
        return self.point(points).max(dim=1).values

    def forward(self, points: Float[Tensor, "b n 3"]) -> Float[Tensor, "b c"]:
        """Logits of the classes."""
        return self.head(self.features(points))


def make_classifier(widths: Sequence[int], hidden: int, classes: int, seed: int) -> PointNet:
    """A PointNet with weights drawn from `seed`."""
    # Layers draw from torch's global generator; it is left as it was.
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return PointNet(widths, hidden, classes)
