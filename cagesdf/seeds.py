"""Random numbers of single items, independent of the order, the number of workers and other draws."""

import zlib
from collections.abc import Iterable

import numpy as np


def item_rng(seed: int, *ids: str | int) -> np.random.Generator:
    """Random generator of one item, given by `seed` and its names; independent of order and number of workers."""
    return np.random.default_rng([seed, *(zlib.crc32(str(part).encode()) for part in ids)])


def draw(seed: int, ids: Iterable[str], count: int) -> list[str]:
    """At most `count` of `ids`, sorted: the same ones even where some of the others are missing."""
    return sorted(sorted(ids, key=lambda name: (item_rng(seed, "draw", name).random(), name))[:count])
