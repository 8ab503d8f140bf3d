"""What a table holds, as text for people: schema, counts, ranges and a few rows."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from cagesdf.errors import InputError
from cagesdf.io.metadata import read_block
from cagesdf.io.points import KIND as POINTS_KIND

ROWS = 4  # shown of each table
COLUMNS = 12  # shown of each row
WIDTH = 36  # characters a value may take


def summarise(paths: Sequence[Path]) -> str:
    """Text about one table, or the shards of one.

    Raises InputError if a file is no Parquet file of this project.
    """
    table = pa.concat_tables([_read(path) for path in paths])
    block = read_block(table.schema, paths[0])
    facts = [f"{key} {_plain(value)}" for key, value in block.items() if key not in ("kind", "columns")]
    name = paths[0].name if len(paths) == 1 else f"{paths[0].name} … {paths[-1].name}"
    title = f"{name}: {block.get('kind')}, {len(table):,} rows" + (f" in {len(paths)} files" if len(paths) > 1 else "")
    meanings = block.get("columns", {})
    columns = [
        [field.name, _type(field.type), _range(table[field.name]), str(meanings.get(field.name, ""))]
        for field in table.schema
    ]
    shown = table.slice(0, ROWS).select(range(min(COLUMNS, table.num_columns)))
    rows = [shown.column_names, *([_short(value) for value in row.values()] for row in shown.to_pylist())]
    parts = [title, indented([", ".join(facts)]), indented(aligned([["column", "type", "range", "meaning"], *columns]))]
    if block.get("kind") == POINTS_KIND and len(table):
        parts.append(indented(_of_points(table)))
    if len(table):
        parts.append(indented(aligned(rows)))
    return "\n\n".join(parts)


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows as lines whose columns begin below each other."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows]


def indented(lines: Sequence[str]) -> str:
    """Lines as one text, two blanks before each."""
    return "\n".join(f"  {line}" for line in lines)


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
    """Lowest and highest number, or how many different texts there are."""
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


def _of_points(table: pa.Table) -> list[str]:
    """How many points are inside, near the surface, and in each cuboid of each step."""
    sdf = table["sdf"].to_numpy()
    near = pc.sum(pc.equal(pc.cast(table["where"], pa.string()), "near")).as_py() / len(table)
    keys = pa.table({name: pc.cast(table[name], pa.string()) for name in ("shape_id", "step", "part_id")})
    counts = keys.group_by(keys.column_names).aggregate([([], "count_all")])["count_all"].to_numpy()
    close = np.mean(np.abs(sdf) < 0.01)
    return [
        f"inside     {np.mean(sdf < 0):.1%} of the points; {close:.1%} are nearer than 0.01 to the surface",
        f"sampled    {near:.1%} near the surface, {1 - near:.1%} uniform",
        f"a cuboid   {counts.min():,} to {counts.max():,} points, median {np.median(counts):,.0f}, "
        f"in {len(counts):,} cuboids (shape, step, part)",
    ]
