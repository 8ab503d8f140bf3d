"""Which of many are shown."""

import math
from collections.abc import Sequence
from typing import TypeVar

Item = TypeVar("Item")


def spread(items: Sequence[Item], count: int) -> list[Item]:
    """At most `count` items, evenly spread over all, in their order."""
    count = min(count, len(items))
    return [items[math.floor((i + 0.5) * len(items) / count)] for i in range(count)]
