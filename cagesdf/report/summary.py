"""The few figures of all tables that two runs are compared by: what `dvc metrics` and `dvc plots` show."""

from collections.abc import Mapping
from typing import Any

Tables = Mapping[str, Any]  # as in metrics/tables.json


def summary(tables: Tables) -> dict[str, dict[str, dict[str, float]]]:
    """By category and arm: mean surface distances (% of the longest side) and median gains of swaps; what there is."""
    categories: dict[str, dict[str, dict[str, float]]] = {}
    for name, arms in tables["table1"].items():
        held_out, edits = tables["table2"].get(name, {}), tables["edits"]["categories"].get(name, {})
        for arm in arms:
            places = {
                "source": (arms[arm], "surface_distance", "mean"),
                "held_out": (held_out.get(arm, {}), "surface_distance", "mean"),
                "gain_warp": (edits.get(arm, {}).get("warp", {}), "gain", "median"),
                "gain_recipe": (edits.get(arm, {}).get("swap", {}), "gain", "median"),
            }
            figures = {key: block.get(metric, {}).get(of) for key, (block, metric, of) in places.items()}
            categories.setdefault(name, {})[arm] = {key: value for key, value in figures.items() if value is not None}
    return categories


def progress_rows(tables: Tables) -> list[dict[str, Any]]:
    """A row for each point of the curves of surface distance over points trained on."""
    return [
        {"category": name, "arm": arm, "held_out": row["held_out"], "points": row["points"],
         "surface_distance": row["surface_distance"]}
        for name, arms in tables["progress"]["categories"].items()
        for arm, rows in arms.items()
        for row in rows
    ]  # fmt: skip
