"""Parquet tables that describe their contents.

Every table carries a JSON block under the key `cagesdf` in its schema: kind, version, facts
such as frame and sign, and the meaning of each column. Readers refuse what they don't
understand, by name.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from cagesdf.errors import InputError

KEY = b"cagesdf"
COMPRESSION = {"compression": "zstd", "compression_level": 3, "write_page_checksum": True}


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    name: str
    type: pa.DataType
    meaning: str  # with unit and frame


@dataclass(frozen=True)
class Layout:
    """The columns of one kind of table, and facts about all its rows."""

    kind: str
    version: int
    columns: tuple[Column, ...]
    facts: Mapping[str, Any] = field(default_factory=dict)  # frame, sign, units

    def schema(self, **facts: Any) -> pa.Schema:
        """The Arrow schema with its `cagesdf` block; `facts` are added to the layout's own."""
        block = {
            "kind": self.kind,
            "version": self.version,
            **self.facts,
            **facts,
            "columns": {column.name: column.meaning for column in self.columns},
        }
        fields = [pa.field(column.name, column.type, nullable=False) for column in self.columns]
        return pa.schema(fields, metadata={KEY: json.dumps(block, sort_keys=True).encode()})

    def table(self, rows: list[dict[str, Any]], **facts: Any) -> pa.Table:
        """Rows as a table; a row that lacks a column is a KeyError."""
        schema = self.schema(**facts)
        arrays = [pa.array([row[name] for row in rows], type=schema.field(name).type) for name in schema.names]
        return pa.Table.from_arrays(arrays, schema=schema)

    def write(self, path: Path, rows: list[dict[str, Any]], **facts: Any) -> None:
        """Write all rows as one file."""
        pq.write_table(self.table(rows, **facts), path, **COMPRESSION)

    def read(self, path: Path) -> list[dict[str, Any]]:
        """All rows. Raises InputError as `check` does, and for text that is none or a value that is missing."""
        table = self.open(path).read()
        missing = [name for name in table.schema.names if table[name].null_count]
        if missing:
            raise InputError(f"{path}: column {missing[0]} lacks values; rerun the stage that wrote it")
        try:
            return table.to_pylist()
        except UnicodeDecodeError as error:
            raise InputError(f"{path}: holds text that is not UTF-8 ({error}); rerun the stage") from error

    def open(self, path: Path) -> "TableFile":
        """Open a file of this layout. Raises InputError if it is missing or something else."""
        if not path.is_file():
            raise InputError(f"{path}: no such file; wanted a table of {self.kind}")
        file = TableFile(path)
        self.check(file.schema_arrow, path)
        return file

    def check(self, schema: pa.Schema, path: Path) -> None:
        """Raise InputError unless the schema is this layout's: kind, version, facts, columns and types."""
        block = read_block(schema, path)
        if block.get("kind") != self.kind or block.get("version") != self.version:
            raise InputError(
                f"{path}: holds {block.get('kind')} version {block.get('version')}, "
                f"wanted {self.kind} version {self.version}; rerun the stage that wrote it"
            )
        for fact, wanted in self.facts.items():
            if block.get(fact) != wanted:
                raise InputError(f"{path}: its {fact} is {block.get(fact)!r}, wanted {wanted!r}; rerun the stage")
        wrong = [
            column.name
            for column in self.columns
            if column.name not in schema.names or schema.field(column.name).type != column.type
        ]
        if wrong:
            raise InputError(f"{path}: column(s) {', '.join(wrong)} missing or of another type; rerun the stage")


class TableFile(pq.ParquetFile):
    """A Parquet file whose pages are checked as they are read. A damaged one is an InputError that names it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._readable():
            super().__init__(path, page_checksum_verification=True)

    def read(self, *args: Any, **options: Any) -> pa.Table:
        """The same as ParquetFile's method."""
        with self._readable():
            return super().read(*args, **options)

    def read_row_group(self, *args: Any, **options: Any) -> pa.Table:
        """The same as ParquetFile's method."""
        with self._readable():
            return super().read_row_group(*args, **options)

    @contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            reason = str(error).partition("\n")[0]
            raise InputError(
                f"{self.path}: not a readable Parquet file ({reason}); rerun the stage that wrote it"
            ) from error


def check_kind(folder: Path, file: str, kind: str, wanted: str) -> None:
    """Raise InputError unless the folder is of a kind, such as "a run", whose folders all hold this file.

    `wanted` says where such folders come from, with an example.
    """
    if not (folder / file).is_file():
        wrong = f"isn't {kind}: it has no {file}" if folder.is_dir() else "no such folder"
        raise InputError(f"{folder}: {wrong}; wanted {kind}, {wanted}")


def read_block(schema: pa.Schema, path: Path) -> dict[str, Any]:
    """The `cagesdf` block of a schema. Raises InputError if there is none."""
    if not schema.metadata or KEY not in schema.metadata:
        raise InputError(f"{path}: its schema has no cagesdf block, so it was not written by this project")
    try:
        block = json.loads(schema.metadata[KEY])
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: its cagesdf block is no JSON ({error}); rerun the stage that wrote it") from error
    if not isinstance(block, dict):
        raise InputError(f"{path}: its cagesdf block is no JSON object, got {str(block)[:60]}; rerun the stage")
    return block
