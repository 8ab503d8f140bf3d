"""Table 1 (reconstruction of source shapes) and Table 2 (held-out middle steps) from figures by shape."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from cagesdf.errors import InputError
from cagesdf.evaluation.reconstruction import METRICS

Rows = Iterable[Mapping[str, Any]]
TABLES = {"table1": lambda row: row["step"] == 0, "table2": lambda row: row["held_out"]}


def gather_tables(scores: Mapping[str, Sequence[tuple[Mapping[str, Rows], Mapping[str, Any]]]]) -> dict[str, Any]:
    """`{"about": …, "table1": {category: {arm: {metric: {"mean", "std", "n"}}}}, "table2": …}`.

    `scores[category]` are the files' contents: rows by arm as `score` gives them, with shape_id,
    step, held_out and seed; and what the figures mean, which becomes `about`. Step 0 goes to
    Table 1, held-out steps to Table 2; an arm without such rows isn't in that table.

    Raises InputError if there is no file, or two were not measured alike.
    """
    about = [definitions for files in scores.values() for _, definitions in files]
    if not about or any(other != about[0] for other in about):
        raise InputError("scores: wanted files that were all measured alike; rerun evaluate and evaluate_references")
    tables: dict[str, Any] = {"about": dict(about[0])}
    for table, wanted in TABLES.items():
        tables[table] = {
            category: {
                arm: summarise(kept)
                for arm, rows in sorted((arm, rows) for by_arm, _ in files for arm, rows in by_arm.items())
                if (kept := [row for row in rows if wanted(row)])
            }
            for category, files in sorted(scores.items())
        }
    return tables


def summarise(rows: Rows) -> dict[str, dict[str, float | int | None]]:
    """Mean and sample standard deviation over deformed shapes, and their number, of each metric; seeds are averaged.

    A figure that a shape doesn't have (NaN: it has no detail) is left out, and `n` tells; with
    none left, mean and std are None. The std of one shape is 0.
    """
    grouped: dict[tuple[str, int], list[Mapping[str, Any]]] = {}
    for row in rows:
        grouped.setdefault((row["shape_id"], row["step"]), []).append(row)
    result: dict[str, dict[str, float | int | None]] = {}
    for metric in METRICS:
        by_shape = [[row[metric] for row in group if not np.isnan(row[metric])] for group in grouped.values()]
        means = [float(np.mean(values)) for values in by_shape if values]
        result[metric] = {
            "mean": float(np.mean(means)) if means else None,
            "std": (float(np.std(means, ddof=1)) if len(means) > 1 else 0.0) if means else None,
            "n": len(means),
        }
    return result
