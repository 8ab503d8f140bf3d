"""Shapes on disk: what is written is read, and nothing else is."""

import re
from collections.abc import Callable
from pathlib import Path

import manifold3d
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.frames import Similarity
from cagesdf.geometry.solid import from_manifold
from cagesdf.io.cage_generators import read_generator
from cagesdf.io.cuboids import read_cages
from cagesdf.io.rejected import read_rejected, write_rejected
from cagesdf.io.runs import read_run
from cagesdf.io.shapes import PARTS, read_shapes, write_shapes
from cagesdf.shape import Part, Repair, Shape
from cagesdf.structure.hierarchy import PartHierarchy


def made(shape_id: str, split: str = "train", method: str = "none") -> Shape:
    meshes = [from_manifold(manifold3d.Manifold.sphere(1.0, n).translate([n, 0, 0])) for n in (8, 12)]
    parts = tuple(
        Part(str(i), "ball", mesh, Repair(method, 9, len(mesh.faces), 4.0, 0.5, 1, 2, 0.25))
        for i, mesh in enumerate(meshes)
    )
    similarity = Similarity(2.0, np.eye(3), np.arange(3.0))
    return Shape(shape_id, split, parts, PartHierarchy.flat(("0", "1"), ("ball", "ball"), "toy"), similarity)


def test_shapes_come_back_as_they_were_in_the_order_of_their_ids(tmp_path: Path) -> None:
    write_shapes(tmp_path, [made("b", method="merged"), made("a", split="val")])
    folder = read_shapes(tmp_path)
    assert folder.ids == ("a", "b")
    assert folder.ids_of("train") == ("b",)
    for shape, wanted in zip(folder, [made("a", split="val"), made("b", method="merged")]):
        assert (shape.shape_id, shape.split, shape.status) == (wanted.shape_id, wanted.split, wanted.status)
        assert shape.structure.to_json() == wanted.structure.to_json()
        assert shape.similarity.to_numbers() == wanted.similarity.to_numbers()
        for part, other in zip(shape.parts, wanted.parts, strict=True):
            np.testing.assert_array_equal(part.mesh.vertices, other.mesh.vertices)
            np.testing.assert_array_equal(part.mesh.faces, other.mesh.faces)
            assert (part.part_id, part.label, part.repair) == (other.part_id, other.label, other.repair)


def test_the_order_of_writing_does_not_change_the_bytes(tmp_path: Path) -> None:
    for name, order in (("x", "ab"), ("y", "ba")):
        (tmp_path / name).mkdir()
        write_shapes(tmp_path / name, [made(shape_id) for shape_id in order])
    for file in ("shapes.parquet", "parts.parquet"):
        assert (tmp_path / "x" / file).read_bytes() == (tmp_path / "y" / file).read_bytes()


def test_an_unknown_shape_is_refused_and_the_known_are_named(tmp_path: Path) -> None:
    write_shapes(tmp_path, [made("a")])
    with pytest.raises(InputError, match="no shape 'c'; it holds a"):
        read_shapes(tmp_path).read("c")


@pytest.mark.parametrize(
    ("read", "kind", "file"),
    [
        (read_run, "a run", "arm.json"),
        (read_generator, "a generator", "generator.json"),
        (read_shapes, "a folder of shapes", "shapes.parquet"),
    ],
)
def test_a_folder_of_another_kind_is_refused_with_the_kind_that_was_wanted(
    read: Callable[[Path], object], kind: str, file: str, tmp_path: Path
) -> None:
    for folder, wrong in ((tmp_path, f"isn't {kind}: it has no {file}"), (tmp_path / "none", "no such folder")):
        with pytest.raises(InputError, match=rf"^{folder}: {re.escape(wrong)}; wanted {kind}, .* such as data/"):
            read(folder)


def test_tables_of_another_kind_version_or_origin_are_refused_by_name(tmp_path: Path) -> None:
    write_shapes(tmp_path, [made("a")])
    with pytest.raises(InputError, match="no such file; wanted a table of cuboids"):
        read_cages(tmp_path)
    (tmp_path / "cuboids.parquet").write_bytes((tmp_path / "parts.parquet").read_bytes())
    with pytest.raises(InputError, match="holds parts version 3, wanted cuboids version 2"):
        read_cages(tmp_path)
    pq.write_table(pa.table({"x": [1]}), tmp_path / "cuboids.parquet")
    with pytest.raises(InputError, match="no cagesdf block"):
        read_cages(tmp_path)
    (tmp_path / "cuboids.parquet").write_bytes(b"PAR1 and then nothing")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        read_cages(tmp_path)


def test_a_table_that_lacks_a_column_is_refused_and_the_column_named(tmp_path: Path) -> None:
    write_shapes(tmp_path, [made("a")])
    table = pq.read_table(tmp_path / "parts.parquet").drop_columns(["volume"])
    pq.write_table(table, tmp_path / "parts.parquet")
    with pytest.raises(InputError, match=r"column\(s\) volume missing"):
        PARTS.open(tmp_path / "parts.parquet")


def test_rejected_shapes_are_rows_until_they_are_too_many(tmp_path: Path) -> None:
    rejected = [ShapeRejected(name, "test", f"{name} is bad") for name in "ba"]
    write_rejected(tmp_path, rejected, total=10, max_rejected=0.2)
    assert read_rejected(tmp_path) == {"a": "a is bad", "b": "b is bad"}
    with pytest.raises(InputError, match=r"2 of 10 shapes rejected, at most 1 wanted(.|\n)*a is bad"):
        write_rejected(tmp_path, rejected, total=10, max_rejected=0.1)
    with pytest.raises(InputError, match="2 of 2"):
        write_rejected(tmp_path, rejected, total=2, max_rejected=1.0)
