"""`points/`: chunks on disk, in shards that any reader understands."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from cagesdf.errors import InputError
from cagesdf.io.metadata import read_block
from cagesdf.io.points import (
    CHUNK,
    CHUNKS_PER_GROUP,
    POINTS,
    PointChunks,
    PointsOf,
    count_groups,
    count_points,
    join_chunks,
    read_groups,
    read_points,
    read_shard,
    shard_path,
    shard_paths,
    write_shard,
)


def chunks(shape_id: str, count: int, part_ids: tuple[str, ...] = ("seat", "leg")) -> PointChunks:
    rng = np.random.default_rng(count)
    return PointChunks(
        np.zeros(count, np.int64),
        rng.integers(0, 6, count),
        rng.integers(0, len(part_ids), count),
        rng.normal(size=(count, CHUNK, 3)).astype(np.float32),
        rng.normal(size=(count, CHUNK)).astype(np.float32),
        rng.random((count, CHUNK)) < 0.8,
        (shape_id,),
        part_ids,
    )


def keyed(points: PointChunks) -> dict[bytes, tuple]:
    """Each chunk by its coordinates: an order-free view."""
    return {
        points.xyz[i].tobytes(): (
            points.shape_ids[points.shape_id[i]],
            int(points.step[i]),
            points.part_ids[points.part[i]],
            points.sdf[i].tobytes(),
            points.near[i].tobytes(),
        )
        for i in range(len(points))
    }


def test_joined_chunks_keep_their_names() -> None:
    pieces = [chunks("b", 5), chunks("a", 7, ("arm", "seat"))]
    joined = join_chunks(pieces)
    assert (joined.shape_ids, joined.part_ids) == (("a", "b"), ("arm", "leg", "seat"))
    assert keyed(joined) == {**keyed(pieces[0]), **keyed(pieces[1])}


def test_chunks_come_back_whole_from_several_shards(tmp_path: Path) -> None:
    pieces = [chunks("b", 5), chunks("a", 300, ("arm", "seat"))]
    for i, piece in enumerate(pieces):
        assert write_shard(shard_path(tmp_path, "shape", i), [piece], np.random.default_rng(i)) == len(piece) * CHUNK
    assert keyed(read_points(tmp_path, "shape")) == keyed(join_chunks(pieces))


def test_a_row_group_is_256_chunks_and_its_chunks_come_from_all_over(tmp_path: Path) -> None:
    path = shard_path(tmp_path, "shape", 0)
    count = 2 * CHUNKS_PER_GROUP + 10
    pieces = [chunks("a", CHUNKS_PER_GROUP), chunks("b", CHUNKS_PER_GROUP + 10)]
    write_shard(path, pieces, np.random.default_rng(0))
    groups = list(read_shard(path))
    assert [len(group) for group in groups] == [CHUNKS_PER_GROUP, CHUNKS_PER_GROUP, count - 2 * CHUNKS_PER_GROUP]
    for group in groups[:2]:
        names = np.array(group.shape_ids)[group.shape_id]
        assert 0.35 < (names == "a").mean() < 0.65


def test_rows_of_the_file_have_the_documented_columns_and_types(tmp_path: Path) -> None:
    path = shard_path(tmp_path, "shape", 0)
    write_shard(path, [chunks("a", 4)], np.random.default_rng(0), beta=60.0)
    table = pq.read_table(path)
    assert table.schema.names == ["shape_id", "step", "part_id", "x", "y", "z", "sdf", "where"]
    assert str(table.schema.field("part_id").type).startswith("dictionary")
    assert set(table["where"].to_pylist()) == {"near", "uniform"}
    block = read_block(table.schema, path)
    assert (block["sign"], block["frame"], block["beta"]) == ("negative inside", "canonical", 60.0)
    assert set(block["columns"]) == set(table.schema.names)


def test_the_same_chunks_and_seed_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("x", "y"):
        write_shard(tmp_path / name, [chunks("a", 40)], np.random.default_rng(3))
    assert (tmp_path / "x").read_bytes() == (tmp_path / "y").read_bytes()


def test_a_folder_without_shards_of_a_kind_is_refused(tmp_path: Path) -> None:
    write_shard(shard_path(tmp_path, "shape", 0), [chunks("a", 4)], np.random.default_rng(0))
    with pytest.raises(InputError, match=r"holds no part-\*\.parquet; wanted the output of sample_points"):
        shard_paths(tmp_path, "part")


def test_points_of_shapes_and_of_parts_lie_in_one_folder_and_are_read_apart(tmp_path: Path) -> None:
    pieces: dict[PointsOf, PointChunks] = {"shape": chunks("a", 4), "part": chunks("a", 7)}
    for of, piece in pieces.items():
        write_shard(shard_path(tmp_path, of, 0), [piece], np.random.default_rng(0))
    for of, piece in pieces.items():
        assert keyed(read_points(tmp_path, of)) == keyed(piece)
        assert count_points(tmp_path, of) == len(piece) * CHUNK


def test_rows_that_are_no_whole_chunks_or_mix_parts_are_refused(tmp_path: Path) -> None:
    write_shard(tmp_path / "whole.parquet", [chunks("a", 4)], np.random.default_rng(0))
    table = pq.read_table(tmp_path / "whole.parquet")
    schema = POINTS.schema()
    pq.write_table(table.slice(0, 100).cast(schema), tmp_path / "cut.parquet")
    with pytest.raises(InputError, match="100 rows, wanted a multiple of 64"):
        list(read_shard(tmp_path / "cut.parquet"))
    step = table["step"].to_numpy().copy()
    step[10] += 1
    mixed = table.set_column(1, schema.field("step"), [step])
    pq.write_table(mixed.cast(schema), tmp_path / "mixed.parquet")
    with pytest.raises(InputError, match="mixes shapes, steps or parts"):
        list(read_shard(tmp_path / "mixed.parquet"))


def test_points_of_another_frame_sign_or_scale_are_refused_by_name(tmp_path: Path) -> None:
    path = shard_path(tmp_path, "shape", 0)
    for fact, value in {"frame": "raw", "sign": "positive inside", "scale": "metres", "version": 9}.items():
        write_shard(path, [chunks("a", 4)], np.random.default_rng(0), **{fact: value})
        with pytest.raises(InputError, match=rf"shape-0000\.parquet.*{fact}.*wanted"):
            read_points(tmp_path, "shape")


def test_pieces_are_written_as_if_they_had_been_joined(tmp_path: Path) -> None:
    pieces = [chunks("b", 130), chunks("a", 300, ("arm", "seat")), chunks("c", 1)]
    write_shard(shard_path(tmp_path, "shape", 0), pieces, np.random.default_rng(4))
    whole = join_chunks(pieces)
    expected = whole.take(np.random.default_rng(4).permutation(len(whole)))
    read = read_points(tmp_path, "shape")
    for name in ("xyz", "sdf", "near", "step", "shape_id", "part"):
        np.testing.assert_array_equal(getattr(read, name), getattr(expected, name))
    assert (read.shape_ids, read.part_ids) == (whole.shape_ids, whole.part_ids)


def test_some_row_groups_are_read_alone(tmp_path: Path) -> None:
    path = shard_path(tmp_path, "shape", 0)
    write_shard(path, [chunks("a", 3 * CHUNKS_PER_GROUP)], np.random.default_rng(0))
    assert (count_groups(path), count_points(tmp_path, "shape")) == (3, 3 * CHUNKS_PER_GROUP * CHUNK)
    whole = read_points(tmp_path, "shape")
    np.testing.assert_array_equal(read_groups(path, [0, 2]).xyz, whole.xyz[np.r_[0:256, 512:768]])
