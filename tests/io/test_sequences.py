"""`sequences/`: the cages of every step come back as they were."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage, Sequence
from cagesdf.deformation.sequences import KeptDetails, Trilinear
from cagesdf.geometry.resizing import AxisWarp
from cagesdf.io.sequences import SEQUENCES, read_sequences, read_transfers, write_sequences, write_transfers


def sequence(shape_id: str, target_id: str | None, steps: int) -> Sequence:
    rng = np.random.default_rng(len(shape_id) + steps)
    cages = tuple(
        Cage(("z", "a"), rng.normal(size=(2, 3)), Rotation.random(2, rng=rng).as_matrix(), rng.uniform(size=(2, 3)))
        for _ in range(steps)
    )
    return Sequence(shape_id, target_id, np.linspace(0, 1, steps), tuple(k == 1 for k in range(steps)), cages)


@pytest.fixture
def written(tmp_path: Path) -> dict[str, Sequence]:
    sequences = {"b": sequence("b", "a", 6), "a": sequence("a", None, 12)}
    outside = {name: np.arange(2.0 * len(s.cages)).reshape(-1, 2) for name, s in sequences.items()}
    write_sequences(tmp_path, sequences.values(), outside)
    return sequences


def test_sequences_come_back_exactly(tmp_path: Path, written: dict[str, Sequence]) -> None:
    back = read_sequences(tmp_path)
    assert list(back) == ["a", "b"]
    for shape_id, wanted in written.items():
        ours = back[shape_id]
        assert (ours.shape_id, ours.target_id, ours.held_out) == (wanted.shape_id, wanted.target_id, wanted.held_out)
        np.testing.assert_array_equal(ours.t, wanted.t)
        for cage, other in zip(ours.cages, wanted.cages, strict=True):
            assert cage.part_ids == other.part_ids
            np.testing.assert_array_equal(cage.vectors(), other.vectors())


def test_each_row_has_the_share_outside_of_its_step_and_part(tmp_path: Path, written: dict[str, Sequence]) -> None:
    rows = SEQUENCES.read(tmp_path / "sequences.parquet")
    row = next(row for row in rows if (row["shape_id"], row["step"], row["part_id"]) == ("b", 4, "a"))
    assert row["outside"] == 9.0
    assert row["t"] == pytest.approx(0.8)


def test_warps_come_back_exactly_and_only_where_there_are_any(tmp_path: Path, written: dict[str, Sequence]) -> None:
    rng = np.random.default_rng(0)
    warps = tuple(tuple(AxisWarp(rng.normal(size=(3, 5))) for _ in range(2)) for _ in range(6))
    write_transfers(tmp_path, written.values(), {"a": Trilinear(), "b": KeptDetails(warps)})
    back = read_transfers(tmp_path, written)
    assert back["a"] == Trilinear()
    for ours, wanted in zip(back["b"].warps, warps, strict=True):
        for warp, other in zip(ours, wanted, strict=True):
            np.testing.assert_array_equal(warp.knots, other.knots)


def test_where_surfaces_follow_their_cuboids_alone_no_file_of_warps_is_written(
    tmp_path: Path, written: dict[str, Sequence]
) -> None:
    write_transfers(tmp_path, written.values(), dict.fromkeys(written, Trilinear()))
    assert [path.name for path in tmp_path.iterdir()] == ["sequences.parquet"]
    assert read_transfers(tmp_path, written) == dict.fromkeys(written, Trilinear())
