"""`log.jsonl` of a run: the course of the training, read without the network."""

import json
from pathlib import Path

from cagesdf.errors import InputError


def read_losses(run: Path) -> list[tuple[int, float]]:
    """(optimiser step, loss) of each line. Raises InputError if the log is missing or damaged."""
    path = run / "log.jsonl"
    if not path.is_file():
        raise InputError(f"{path}: no such file; wanted a folder that the train stage wrote")
    try:
        rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        return [(int(row["step"]), float(row["loss"])) for row in rows]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: wanted lines with step and loss, got {error!r}; train again") from error
