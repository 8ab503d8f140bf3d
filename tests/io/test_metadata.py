"""Tables say what they hold, and readers refuse what they don't understand."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cagesdf.errors import InputError
from cagesdf.io.metadata import Column, Layout, read_block

LAYOUT = Layout(
    "toys", 2, (Column("name", pa.string(), "unique"), Column("x", pa.float64(), "metres")), {"frame": "canonical"}
)
ROWS = [{"name": "a", "x": 1.5}, {"name": "b", "x": -2.0}]


def test_rows_come_back_in_order(tmp_path: Path) -> None:
    LAYOUT.write(tmp_path / "t.parquet", ROWS)
    assert LAYOUT.read(tmp_path / "t.parquet") == ROWS


def test_an_empty_table_keeps_its_columns(tmp_path: Path) -> None:
    LAYOUT.write(tmp_path / "t.parquet", [])
    assert LAYOUT.read(tmp_path / "t.parquet") == []
    assert pq.read_schema(tmp_path / "t.parquet").names == ["name", "x"]


def test_the_schema_tells_kind_version_facts_and_meanings(tmp_path: Path) -> None:
    LAYOUT.write(tmp_path / "t.parquet", ROWS, seed=7)
    block = read_block(pq.read_schema(tmp_path / "t.parquet"), tmp_path)
    assert block == {
        "kind": "toys",
        "version": 2,
        "frame": "canonical",
        "seed": 7,
        "columns": {"name": "unique", "x": "metres"},
    }


def test_the_same_rows_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        LAYOUT.write(tmp_path / name, ROWS)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_row_without_a_column_is_refused(tmp_path: Path) -> None:
    with pytest.raises(KeyError, match="x"):
        LAYOUT.write(tmp_path / "t.parquet", [{"name": "a"}])


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (Layout("toys", 1, LAYOUT.columns), "holds toys version 1, wanted toys version 2"),
        (Layout("tools", 2, LAYOUT.columns), "holds tools version 2, wanted toys"),
        (Layout("toys", 2, (LAYOUT.columns[0], Column("x", pa.float32(), "")), LAYOUT.facts), r"column\(s\) x missing"),
        (Layout("toys", 2, LAYOUT.columns[1:], LAYOUT.facts), r"column\(s\) name missing"),
    ],
)
def test_another_layout_is_refused_by_name(tmp_path: Path, other: Layout, message: str) -> None:
    other.write(tmp_path / "t.parquet", ROWS)
    with pytest.raises(InputError, match=message):
        LAYOUT.read(tmp_path / "t.parquet")


def test_files_that_are_missing_damaged_or_foreign_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file; wanted a table of toys"):
        LAYOUT.read(tmp_path / "none.parquet")
    (tmp_path / "cut.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        LAYOUT.read(tmp_path / "cut.parquet")
    pq.write_table(pa.table({"name": ["a"], "x": [1.0]}), tmp_path / "foreign.parquet")
    with pytest.raises(InputError, match="no cagesdf block"):
        LAYOUT.read(tmp_path / "foreign.parquet")
