"""Quality of a generator: how well it rebuilds its training shapes, and how many of its draws are valid and new."""

from collections.abc import Mapping

import numpy as np

from cagesdf.cage_generation.generator import Generated, Samples
from cagesdf.cage_generation.novelty import TOLERANCE, Known

Figures = dict[str, int | float]


def sample_figures(samples: Samples, known: Known) -> Figures:
    """Figures of a number of draws.

    `drawn`, `valid`, `floating` (cuboids of these that were attached to nothing and left out), `copies` (of a known
    shape, by novelty.TOLERANCE), `new_cages` (of a known structure), `new_structures`, `structures` (different ones
    among the valid), and `difference`, the median over `new_cages` and `copies` from the nearest known shape.
    """
    apart = np.array([known.nearest(item.structure, item.cage)[1] for item in samples.kept])
    seen = apart[np.isfinite(apart)]
    return {
        "drawn": len(samples.kept) + sum(samples.failures.values()),
        "valid": len(samples.kept),
        "floating": sum(item.floating for item in samples.kept),
        "copies": int((seen <= TOLERANCE).sum()),
        "new_cages": int((seen > TOLERANCE).sum()),
        "new_structures": int(np.isinf(apart).sum()),
        "structures": len({item.structure.signature() for item in samples.kept}),
        "difference": float(np.median(seen)) if len(seen) else float("nan"),
    }


def rebuilding_figures(rebuilt: Mapping[str, Generated | str], known: Known) -> Figures:
    """Figures of known shapes that were rebuilt from their codes.

    `rebuilt` is their number, `same_structure` the number of those that kept their structure, and
    `rebuilding_difference` the mean `Known.difference` of the latter from the shape itself.
    """
    apart = [
        known.difference(item.structure, item.cage, name)
        for name, item in rebuilt.items()
        if isinstance(item, Generated)
    ]
    same = [difference for difference in apart if np.isfinite(difference)]
    mean = float(np.mean(same)) if same else float("nan")
    return {"rebuilt": len(rebuilt), "same_structure": len(same), "rebuilding_difference": mean}
