"""`cuboids/`: cages and programs come back as they were."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cagesdf.cage_fitting.fitted import FittedCage
from cagesdf.cuboid import Cage
from cagesdf.frames import Similarity
from cagesdf.io.cuboids import CUBOIDS, read_assemblies, read_bounding, read_cages, write_cuboids
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.parsing import parse

PROGRAM = "Assembly P {\n bbox = Cuboid(1.0, 1.0, 1.0, True)\n cube0 = Cuboid(0.5, 0.25, 1.0, True)\n}\n"


def cage(seed: int, part_ids: tuple[str, ...]) -> Cage:
    rng = np.random.default_rng(seed)
    count = len(part_ids)
    return Cage(
        part_ids, rng.normal(size=(count, 3)), Rotation.random(count, rng=rng).as_matrix(), rng.uniform(size=(count, 3))
    )


def fitted(value: Cage, outside: tuple[float, ...], assembly: Assembly | None = None) -> FittedCage:
    shares = np.array(outside)
    return FittedCage(value, assembly, shares - 0.5, 2 * shares, shares, 1 + shares, 0.5, 0.25)


def test_cages_come_back_exactly_in_the_structures_order(tmp_path: Path) -> None:
    cages = {"b": cage(0, ("z", "a", "m")), "a": cage(1, ("only",))}
    write_cuboids(tmp_path, {shape_id: fitted(value, (0.0,) * len(value)) for shape_id, value in cages.items()})
    back = read_cages(tmp_path)
    assert list(back) == ["a", "b"]
    for shape_id, wanted in cages.items():
        assert back[shape_id].part_ids == wanted.part_ids
        np.testing.assert_array_equal(back[shape_id].vectors(), wanted.vectors())


def test_each_row_says_how_its_cuboid_bounds_its_part(tmp_path: Path) -> None:
    write_cuboids(tmp_path, {"a": fitted(cage(0, ("x", "y")), (0.004, 0.25))})
    rows = CUBOIDS.read(tmp_path / "cuboids.parquet")
    assert [(row["part_id"], row["overshoot"], row["outside"]) for row in rows] == [
        ("x", -0.496, 0.004),
        ("y", -0.25, 0.25),
    ]
    assert [row["bounded"] for row in rows] == [True, False]
    found = read_bounding(tmp_path)
    assert (found["parts"], found["unbounded"]) == (2, 1)
    assert found["outside_before"] == pytest.approx(0.254)
    assert found["outside"] == pytest.approx(0.127)
    assert found["volume_ratio"] == pytest.approx(1.127)


def test_programs_come_back_for_the_shapes_that_have_one(tmp_path: Path) -> None:
    assembly = Assembly(parse(PROGRAM), Similarity(0.7, np.eye(3), np.array([1.0, 2.0, 3.0])))
    free, tied = fitted(cage(0, ("x",)), (0.0,)), fitted(assembly.cage(), (0.0,), assembly)
    write_cuboids(tmp_path, {"free": free, "tied": tied})
    back = read_assemblies(tmp_path)
    assert list(back) == ["tied"]
    assert back["tied"].program == assembly.program
    np.testing.assert_array_equal(back["tied"].cage().vectors(), read_cages(tmp_path)["tied"].vectors())
