"""The contents of a table as text for people: schema, counts, ranges and a few rows."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from cagesdf.errors import InputError
from cagesdf.io.metadata import read_block
from cagesdf.io.points import CHUNK, PointChunks, read_shard
from cagesdf.io.points import KIND as POINTS_KIND

ROWS = 4  # shown of each table
COLUMNS = 12  # shown of each row
CLOSE = 0.01  # canonical units
FEW = 8  # counts that are listed one by one
WIDTH = 36  # characters a value may take


def summarise(paths: Sequence[Path]) -> str:
    """Text about one table, or the shards of one.

    Raises InputError if a file is no Parquet file of this project.
    """
    if _block(paths[0]).get("kind") == POINTS_KIND:
        return _summarise_points(paths)
    table = pa.concat_tables([_read(path) for path in paths])
    ranges = {name: _range(table[name]) for name in table.schema.names}
    return _text(paths, table, len(table), ranges, [])


def _text(paths: Sequence[Path], table: pa.Table, rows: int, ranges: dict[str, str], more: list[str]) -> str:
    """Title, facts, columns with their ranges, `more`, and the first rows of `table`."""
    block = read_block(table.schema, paths[0])
    facts = [f"{key} {_plain(value)}" for key, value in block.items() if key not in ("kind", "columns")]
    name = paths[0].name if len(paths) == 1 else f"{paths[0].name} … {paths[-1].name}"
    title = f"{name}: {block.get('kind')}, {rows:,} rows" + (f" in {len(paths)} files" if len(paths) > 1 else "")
    meanings = block.get("columns", {})
    columns = [
        [field.name, _type(field.type), ranges[field.name], str(meanings.get(field.name, ""))] for field in table.schema
    ]
    shown = table.slice(0, ROWS).select(range(min(COLUMNS, table.num_columns)))
    first = [shown.column_names, *([_short(value) for value in row.values()] for row in shown.to_pylist())]
    parts = [title, indented([", ".join(facts)]), indented(aligned([["column", "type", "range", "meaning"], *columns]))]
    if more:
        parts.append(indented(more))
    if len(table):
        parts.append(indented(aligned(first)))
    return "\n\n".join(parts)


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows as lines with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows]


def indented(lines: Sequence[str]) -> str:
    """Lines as one text, two blanks before each."""
    return "\n".join(f"  {line}" for line in lines)


def _block(path: Path) -> dict[str, object]:
    try:
        return read_block(pq.read_schema(path), path)
    except pa.ArrowInvalid as error:
        raise InputError(f"{path}: not a readable Parquet file ({error})") from error


def _read(path: Path) -> pa.Table:
    try:
        table = pq.read_table(path, partitioning=None)
    except pa.ArrowInvalid as error:
        raise InputError(f"{path}: not a readable Parquet file ({error})") from error
    read_block(table.schema, path)
    return table


def _type(kind: pa.DataType) -> str:
    if pa.types.is_dictionary(kind):
        return _type(kind.value_type)
    return f"list of {_type(kind.value_type)}" if pa.types.is_list(kind) else str(kind)


def _range(column: pa.ChunkedArray) -> str:
    """Lowest and highest number, or the number of different texts."""
    if len(column) == 0:
        return "empty"
    if pa.types.is_list(column.type):
        lengths = pc.min_max(pc.list_value_length(column)).as_py()
        counts = f"{lengths['min']:,}" + (f"–{lengths['max']:,}" if lengths["max"] > lengths["min"] else "")
        values = pc.list_flatten(column)
        return f"{counts} × {_range(values)}" if len(values) else "empty lists"
    if pa.types.is_boolean(column.type):
        return f"{pc.sum(column).as_py():,} true"
    if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        ends = pc.min_max(column).as_py()
        return f"{_number(ends['min'])} to {_number(ends['max'])}"
    different = pc.count_distinct(pc.cast(column, pa.string())).as_py()
    return f"{different:,} different"


def _number(value: int | float | None) -> str:
    return "none" if value is None else f"{value:,}" if isinstance(value, int) else f"{value:.4g}"


def _plain(value: object) -> str:
    """A fact of the schema's block without brackets and quotes."""
    if isinstance(value, dict):
        return "(" + "; ".join(f"{key} {_plain(item)}" for key, item in value.items()) + ")"
    return " ".join(map(_plain, value)) if isinstance(value, list) else str(value)


def _short(value: object) -> str:
    if isinstance(value, list):
        inside = ", ".join(_short(item) for item in value[:4]) + (", …" if len(value) > 4 else "")
        return f"[{inside}]"
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text if len(text) <= WIDTH else text[: WIDTH - 1] + "…"


class _Totals:
    """Counts and ranges of points, a row group after the other: shards may be larger than memory."""

    def __init__(self) -> None:
        self.cuboids: Counter[tuple[str, int, str]] = Counter()  # points by shape, step, part
        self.inside = self.close = self.near = 0
        self.low, self.high = np.full(4, np.inf), np.full(4, -np.inf)  # of x, y, z, sdf

    def add(self, chunks: PointChunks) -> None:
        shapes, parts = chunks.shape_ids, chunks.part_ids
        for shape, step, part in zip(chunks.shape_id.tolist(), chunks.step.tolist(), chunks.part.tolist()):
            self.cuboids[shapes[shape], step, parts[part]] += CHUNK
        self.inside += int((chunks.sdf < 0).sum())
        self.close += int((np.abs(chunks.sdf) < CLOSE).sum())
        self.near += int(chunks.near.sum())
        values = np.concatenate([chunks.xyz.reshape(-1, 3), chunks.sdf.reshape(-1, 1)], axis=1)
        self.low, self.high = np.minimum(self.low, values.min(axis=0)), np.maximum(self.high, values.max(axis=0))

    def by(self, *fields: int) -> Counter[tuple[str | int, ...]]:
        """Numbers of points, summed by the given fields: shape (0), step (1), part (2)."""
        counts: Counter[tuple[str | int, ...]] = Counter()
        for key, count in self.cuboids.items():
            counts[tuple(key[field] for field in fields)] += count
        return counts


def _summarise_points(paths: Sequence[Path]) -> str:
    totals = _Totals()
    for path in paths:
        for chunks in read_shard(path):
            totals.add(chunks)
    rows = totals.cuboids.total()
    batches = pq.ParquetFile(paths[0]).iter_batches(ROWS)
    head = pa.Table.from_batches([next(batches)] if rows else [], schema=pq.read_schema(paths[0]))
    if not rows:
        return _text(paths, head, 0, dict.fromkeys(head.schema.names, "empty"), [])
    steps = [step for _, step, _ in totals.cuboids]
    ranges = {"step": f"{min(steps)} to {max(steps)}", "where": f"{(totals.near > 0) + (totals.near < rows)} different"}
    ranges |= {name: f"{len(totals.by(field)):,} different" for name, field in (("shape_id", 0), ("part_id", 2))}
    for name, low, high in zip(("x", "y", "z", "sdf"), totals.low.tolist(), totals.high.tolist()):
        ranges[name] = f"{low:.4g} to {high:.4g}"
    return _text(paths, head, rows, ranges, _of_points(totals, rows))


def _of_points(totals: _Totals, rows: int) -> list[str]:
    """Numbers of points inside, near the surface, and per shape, step and cuboid."""
    near = totals.near / rows
    return [
        f"inside     {totals.inside / rows:.1%} of the points; {totals.close / rows:.1%} are nearer than {CLOSE} "
        "to the surface",
        f"sampled    {near:.1%} near the surface, {1 - near:.1%} uniform",
        "a shape    " + _counts(totals.by(0), "shapes"),
        "a step     " + _counts(totals.by(1), "steps"),
        "a cuboid   " + _counts(totals.by(0, 1, 2), "cuboids (shape, step, part)"),
    ]


def _counts(counts: Counter[tuple[str | int, ...]], what: str) -> str:
    """Each count if there are few, otherwise their range."""
    if len(counts) <= FEW:
        return "points: " + ", ".join(f"{' '.join(map(str, key))}: {count:,}" for key, count in sorted(counts.items()))
    values = np.array(list(counts.values()))
    median = f"median {np.median(values):,.0f}"
    return f"{values.min():,} to {values.max():,} points, {median}, in {len(counts):,} {what}"
