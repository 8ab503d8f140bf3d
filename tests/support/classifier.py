"""A small classifier that was never trained."""

from cagesdf.models.features import Features
from cagesdf.models.pointnet import make_classifier


def features() -> Features:
    return Features(make_classifier((8, 16), 8, 2, seed=1), (8, 16), 8, ("chair/arms", "vase/urn"), 32)
