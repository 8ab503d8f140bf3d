"""`rejected.parquet`: the shapes that a stage could not use, and why."""

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.io.metadata import Column, Layout

NAMED, REASONS = 20, 5  # rejected shapes, and reasons, that a message has

REJECTED = Layout(
    "rejected",
    1,
    (
        Column("shape_id", pa.string(), "unique in its category"),
        Column("stage", pa.string(), "the stage that could not use it"),
        Column("reason", pa.string(), "what came, what was wanted, what to do"),
    ),
)


def write_rejected(folder: Path, rejected: Sequence[ShapeRejected], total: int, max_rejected: float) -> None:
    """Write one row a rejected shape, sorted by id; none rejected gives an empty table.

    Raises InputError with their ids, the first reasons and what to do if more than the share `max_rejected` of
    `total` shapes were rejected, or all of them.
    """
    rows = sorted(({"shape_id": r.shape_id, "stage": r.stage, "reason": r.reason} for r in rejected), key=str)
    if len(rows) > max_rejected * total or len(rows) == total:
        most = min(int(max_rejected * total), max(total - 1, 0))
        limit = f"{rows[0]['stage']}.max_rejected: {max_rejected:g}" if rows else "there is none"
        ids = ", ".join(row["shape_id"] for row in rows[:NAMED])
        ids += f" and {len(rows) - NAMED:,} more" if len(rows) > NAMED else ""
        reasons = "".join(f"\n  {row['shape_id']}: {row['reason']}" for row in rows[:REASONS])
        raise InputError(
            f"{len(rows):,} of {total:,} shapes rejected, at most {most:,} wanted ({limit}): {ids}; repair or remove "
            f"them, or raise max_rejected (in a work folder: in settings.yaml). The first reasons:{reasons}"
        )
    REJECTED.write(folder / "rejected.parquet", rows)


def read_rejected(folder: Path) -> dict[str, str]:
    """Reasons by shape id."""
    return {row["shape_id"]: row["reason"] for row in REJECTED.read(folder / "rejected.parquet")}
