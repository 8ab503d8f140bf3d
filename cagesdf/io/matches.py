"""`matches/`: one row a source shape."""

from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa

from cagesdf.deformation.matching import Match
from cagesdf.io.metadata import Column, Layout

KIND = "matches"
MATCHES = Layout(
    "matches",
    1,
    (
        Column("shape_id", pa.string(), "the source"),
        Column("target_id", pa.string(), "structurally equal shape; empty where the whole cage is scaled"),
        Column("scale", pa.list_(pa.float64()), "factors along the canonical axes; ones where there is a target"),
        Column("source_parts", pa.list_(pa.string()), "part ids of the source"),
        Column("target_parts", pa.list_(pa.string()), "their partners in the target, in the same order"),
        Column("cost", pa.float64(), "mean distance of partners' centres, canonical units"),
        Column("candidates", pa.int32(), "structurally equal shapes there were to choose from"),
        Column("reason", pa.string(), "why this target, or why scaled"),
    ),
    {"frame": "canonical"},
)


def write_matches(folder: Path, matches: Iterable[Match]) -> None:
    """Write matches, sorted by source."""
    MATCHES.write(
        folder / "matches.parquet",
        [
            {
                "shape_id": match.shape_id,
                "target_id": match.target_id or "",
                "scale": list(match.scale),
                "source_parts": [a for a, _ in match.pairs],
                "target_parts": [b for _, b in match.pairs],
                "cost": match.cost,
                "candidates": match.candidates,
                "reason": match.reason,
            }
            for match in sorted(matches, key=lambda match: match.shape_id)
        ],
    )


def read_matches(folder: Path) -> list[Match]:
    """All matches, sorted by source."""
    return [
        Match(
            row["shape_id"],
            row["target_id"] or None,
            tuple(row["scale"]),
            tuple(zip(row["source_parts"], row["target_parts"])),
            row["cost"],
            row["candidates"],
            row["reason"],
        )
        for row in MATCHES.read(folder / "matches.parquet")
    ]
