"""Table 3 (generated shapes), from the figures of each category, beside the paper's."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from cagesdf.errors import InputError
from cagesdf.evaluation.shape_sets import FIGURES

REAL = "real"  # in place of an arm: shapes that no network made
REFERENCES = {
    (REAL, "drawn"): "references against the other references, as many as there are generated shapes: the noise floor",
    (REAL, "halves"): "one half of the references against the other",
    (REAL, "training"): "training shapes themselves: a generator that only copies",
}
SUMMARISED = (*FIGURES, "recognised", "failed")
ORDERED = ("fd", "cov")  # figures by which methods are put in order, the best first: lower is better

# The paper's Table 3. Its data, network and features are others; what can be compared is the order.
PAPER = {
    "chair": {
        "DeepSDF": {"fd": 489.4, "gen": 0.125, "cov": 0.106, "var": 0.087},
        "independent": {"fd": 57.4, "gen": 0.093, "cov": 0.101, "var": 0.073},
        "dependent": {"fd": 55.0, "gen": 0.094, "cov": 0.100, "var": 0.073},
    },
    "table": {
        "DeepSDF": {"fd": 2121.8, "gen": 0.237, "cov": 0.134, "var": 0.098},
        "independent": {"fd": 563.9, "gen": 0.162, "cov": 0.117, "var": 0.082},
        "dependent": {"fd": 572.3, "gen": 0.164, "cov": 0.114, "var": 0.081},
    },
}


def gather_generation(
    files: Mapping[str, tuple[Iterable[Mapping[str, Any]], Mapping[str, Any]]],
) -> dict[str, Any]:
    """`{"about", "paper", "orders", "categories": {category: {"sets", "methods": [{"arm", "method", figure: …}]}}}`.

    `files[category]` are a file's contents: rows with arm, method, draw, shapes and figures; what they mean, with
    the category's own under `sets`. A figure is {"mean", "std", "n"} over draws, std 0 where there is one.
    Raises InputError if two files were not measured alike.
    """
    about = [{key: value for key, value in facts.items() if key != "sets"} for _, facts in files.values()]
    if any(other != about[0] for other in about):
        raise InputError("generation: wanted files that were all measured alike; rerun evaluate_generation")
    categories = {
        category: {"sets": facts["sets"], "methods": summarise_methods(rows)}
        for category, (rows, facts) in sorted(files.items())
    }
    ours = {category: ordered(found["methods"]) for category, found in categories.items()}
    papers = {
        category: ordered([{"arm": "", "method": m, **_means(f)} for m, f in methods.items()])
        for category, methods in PAPER.items()
    }
    return {
        "about": about[0] if about else {},
        "paper": PAPER,
        "orders": {category: {"here": order, "paper": papers.get(category)} for category, order in ours.items()},
        "categories": categories,
    }


def summarise_methods(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One entry an arm and method, as they come; a figure that none of its rows has (NaN) is left out."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["arm"], row["method"]), []).append(row)
    entries = []
    for (arm, method), group in groups.items():
        entry: dict[str, Any] = {"arm": arm, "method": method, "shapes": group[0]["shapes"]}
        for figure in SUMMARISED:
            values = [row[figure] for row in group if not np.isnan(row[figure])]
            if values:
                std = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
                entry[figure] = {"mean": float(np.mean(values)), "std": std, "n": len(values)}
        entries.append(entry)
    return entries


def ordered(methods: Iterable[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Names of the methods that networks made, the best first, by each of ORDERED; last those that have no figure."""
    made = [entry for entry in methods if entry["arm"] != REAL]

    def rank(entry: Mapping[str, Any], figure: str) -> float:
        return entry[figure]["mean"] if figure in entry else np.inf

    return {
        figure: [name_of(e["arm"], e["method"]) for e in sorted(made, key=lambda e: rank(e, figure))]
        for figure in ORDERED
        if not made or any(figure in entry for entry in made)
    }


def name_of(arm: str, method: str) -> str:
    """How a method is called: by its arm too, where it has one."""
    return f"{arm}, {method}" if arm else method


def _means(figures: Mapping[str, float]) -> dict[str, dict[str, float]]:
    return {name: {"mean": value} for name, value in figures.items()}
