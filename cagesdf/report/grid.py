"""Grids of scenes, of which pictures and views are made."""

from dataclasses import dataclass

from cagesdf.rendering import Scene


@dataclass(frozen=True, eq=False)
class Grid:
    """Pictures in rows and columns that share one camera and scale."""

    columns: tuple[str, ...]  # headings
    held_out: tuple[bool, ...]  # one a column: shown as kept from training
    names: tuple[str, ...]  # one a row
    scenes: tuple[tuple[Scene | None, ...], ...]  # by rows; None where there is nothing to show
