"""`cuboids/`: cages come back as they were."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage
from cagesdf.io.cuboids import CUBOIDS, read_cages, write_cuboids


def cage(seed: int, part_ids: tuple[str, ...]) -> Cage:
    rng = np.random.default_rng(seed)
    count = len(part_ids)
    return Cage(
        part_ids, rng.normal(size=(count, 3)), Rotation.random(count, rng=rng).as_matrix(), rng.uniform(size=(count, 3))
    )


def test_cages_come_back_exactly_in_the_structures_order(tmp_path: Path) -> None:
    cages = {"b": cage(0, ("z", "a", "m")), "a": cage(1, ("only",))}
    write_cuboids(tmp_path, {shape_id: (value, np.full(len(value), -1e-12)) for shape_id, value in cages.items()})
    back = read_cages(tmp_path)
    assert list(back) == ["a", "b"]
    for shape_id, wanted in cages.items():
        assert back[shape_id].part_ids == wanted.part_ids
        np.testing.assert_array_equal(back[shape_id].vectors(), wanted.vectors())


def test_each_row_has_its_parts_overshoot(tmp_path: Path) -> None:
    write_cuboids(tmp_path, {"a": (cage(0, ("x", "y")), np.array([-0.5, 0.25]))})
    rows = CUBOIDS.read(tmp_path / "cuboids.parquet")
    assert [(row["part_id"], row["overshoot"]) for row in rows] == [("x", -0.5), ("y", 0.25)]
