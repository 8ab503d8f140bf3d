"""Table 1 (reconstruction of source shapes), Table 2 (held-out middle steps) and Edits, from figures by shape."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from cagesdf.errors import InputError
from cagesdf.evaluation.edits import FIGURES, OF_ALL
from cagesdf.evaluation.metrics import OF_KEY, PROGRESS

Rows = Iterable[Mapping[str, Any]]
TABLES = {"table1": lambda row: row["step"] == 0, "table2": lambda row: row["held_out"]}


def gather_tables(scores: Mapping[str, tuple[Mapping[str, Rows], Mapping[str, Any]]]) -> dict[str, Any]:
    """`{"about": …, "table1": {category: {arm: {metric: {"mean", "std", "min", "max", "n"}}}}, "table2": …}`.

    `scores[category]` are a file's contents: rows by arm as `score` gives them, with shape_id,
    step, held_out and seed; and what the figures mean, which becomes `about`. Step 0 goes to
    Table 1, held-out steps to Table 2; an arm without such rows isn't in that table.

    Raises InputError if there is no file, or two were not measured alike.
    """
    about = [definitions for _, definitions in scores.values()]
    if not about or any(other != about[0] for other in about):
        raise InputError("scores: wanted files that were all measured alike; rerun evaluate")
    tables: dict[str, Any] = {"about": dict(about[0])}
    for table, wanted in TABLES.items():
        tables[table] = {
            category: {
                arm: summarise(kept)
                for arm, rows in sorted(by_arm.items())
                if (kept := [row for row in rows if wanted(row)])
            }
            for category, (by_arm, _) in sorted(scores.items())
        }
    return tables


def summarise(rows: Rows) -> dict[str, dict[str, float | int | None]]:
    """Mean, sample standard deviation, least and largest over deformed shapes, and their number; seeds are averaged.

    A figure that a shape doesn't have (NaN: it has no detail) is left out, and `n` tells; with
    none left, all but n are None. The std of one shape is 0.
    """
    grouped: dict[tuple[str, int], list[Mapping[str, Any]]] = {}
    for row in rows:
        grouped.setdefault((row["shape_id"], row["step"]), []).append(row)
    result: dict[str, dict[str, float | int | None]] = {}
    for metric in OF_KEY:
        by_shape = [[row[metric] for row in group if not np.isnan(row[metric])] for group in grouped.values()]
        means = [float(np.mean(values)) for values in by_shape if values]
        result[metric] = {
            "mean": float(np.mean(means)) if means else None,
            "std": (float(np.std(means, ddof=1)) if len(means) > 1 else 0.0) if means else None,
            "min": min(means) if means else None,
            "max": max(means) if means else None,
            "n": len(means),
        }
    return result


def gather_progress(files: Mapping[str, tuple[Rows, Mapping[str, Any]]]) -> dict[str, Any]:
    """`{"about": …, "categories": {category: {arm: [{"points", "held_out", metric: mean}]}}}`.

    `files[category]` are a file's contents: rows as `io.progress` has them, `points` those trained on until then.
    Raises InputError if two files were not measured alike.
    """
    about = [definitions for _, definitions in files.values()]
    if any(other != about[0] for other in about):
        raise InputError("progress: wanted files that were all measured alike; rerun evaluate_progress")
    categories: dict[str, dict[str, list[dict[str, float]]]] = {}
    for category, (rows, _) in sorted(files.items()):
        groups: dict[tuple[str, int], list[Mapping[str, Any]]] = {}
        for row in rows:
            groups.setdefault((row["arm"], row["points"]), []).append(row)
        for (arm, points), group in sorted(groups.items()):
            means = {name: float(np.mean([row[name] for row in group])) for name in PROGRESS}
            key = {"points": points, "held_out": all(row["held_out"] for row in group)}
            categories.setdefault(category, {}).setdefault(arm, []).append(key | means)
    return {"about": dict(about[0]) if about else {}, "categories": categories}


def gather_edits(
    files: Mapping[str, Sequence[tuple[Rows, Mapping[str, Any]]]], arms: Mapping[str, Iterable[str]]
) -> dict[str, Any]:
    """`{"about": …, "categories": {category: {arm: {kind: {figure: {"median", "q25", "q75", …}}}}}}`.

    `files[category]` are files' contents: rows as `edit_row` gives them, and what they mean. One of the `arms`
    of a category without any row can't be edited and has no kinds. The kind `all` has OF_ALL over all trials.

    Raises InputError if two files were not measured alike.
    """
    about = [definitions for group in files.values() for _, definitions in group]
    if any(other != about[0] for other in about):
        raise InputError("edits: wanted files that were all measured alike; rerun make_trials and evaluate_edits")
    categories = {}
    for category, group in sorted(files.items()):
        of_arm: dict[str, list[Mapping[str, Any]]] = {arm: [] for arm in arms[category]}
        for row in (row for rows, _ in group for row in rows):
            of_arm.setdefault(row["arm"], []).append(row)
        categories[category] = {arm: summarise_edits(rows) for arm, rows in sorted(of_arm.items())}
    return {"about": dict(about[0]) if about else {}, "categories": categories}


def summarise_edits(rows: Rows) -> dict[str, dict[str, dict[str, float | int]]]:
    """By kind of trial and figure: median, quartiles, mean, largest and number; of gains the share above 0 too.

    A figure that no trial has (NaN) is left out.
    """
    groups: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        for figure in FIGURES:
            if not np.isnan(row[figure]):
                for kind in (row["kind"], "all") if figure in OF_ALL else (row["kind"],):
                    groups.setdefault((kind, figure), []).append(row[figure])
    result: dict[str, dict[str, dict[str, float | int]]] = {}
    for (kind, figure), values in sorted(groups.items()):
        q25, median, q75 = np.quantile(values, [0.25, 0.5, 0.75]).tolist()
        summary = {"median": median, "q25": q25, "q75": q75, "mean": float(np.mean(values)), "max": max(values)}
        if figure == "gain":
            summary["positive"] = float(np.mean(np.array(values) > 0))
        result.setdefault(kind, {})[figure] = summary | {"n": len(values)}
    return result
