"""Streamed points: the objective of those in memory, every point as often, the same bits after an interruption."""

from collections import Counter
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.errors import InputError
from cagesdf.io.points import CHUNK, join_chunks, write_shard
from cagesdf.models.latents import LatentTable
from cagesdf.training import points as points_module
from cagesdf.training.batches import Batch
from cagesdf.training.points import LoadedPoints, StreamedPoints, filled, open_points
from tests.support import spheres

COUNTS = (300, 500, 200, 400)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pools of two blocks of a row group, so that an epoch has several."""
    monkeypatch.setattr(points_module, "BLOCK", 1)
    monkeypatch.setattr(points_module, "POOL", 2)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for shard in range(2):
        pieces = [spheres.chunks(COUNTS, seed=shard)]
        write_shard(tmp_path / f"shape-{shard:04d}.parquet", pieces, np.random.default_rng(shard))
    return tmp_path


def streamed(folder: Path, steps_of="all", trains_on="cube", reach=0.02) -> StreamedPoints:
    return StreamedPoints(folder, spheres.sequences(), steps_of, trains_on, reach)


def loaded(folder: Path, steps_of="all", trains_on="cube", reach=0.02) -> LoadedPoints:
    rng = np.random.default_rng(0)
    return LoadedPoints(folder, spheres.sequences(), steps_of, trains_on, reach, rng)


def table(data, latents="deformed") -> LatentTable:
    return LatentTable.drawn(data.latent_keys(latents), 3, 1.0, seed=0)


def latent(batch: Batch) -> torch.Tensor:
    """The row of each group's latent."""
    return batch.cages.latent[batch.shape]


def rows(batch: Batch) -> list[tuple]:
    """Each chunk's points, in an order of their own."""
    return [tuple(sorted(map(tuple, chunk))) for chunk in batch.points.tolist()]


def test_an_epoch_of_whole_chunks_is_that_in_memory_in_another_order(folder: Path) -> None:
    stream, memory = streamed(folder), loaded(folder)
    assert (stream.sampled, stream.used) == (memory.sampled, memory.used)
    latents = table(stream)
    chunks = stream.used // CHUNK
    one = stream.batches(latents, chunks, 1, 0).at(0)
    other = memory.batches(latents, chunks, 1, 0).at(0)
    for field in (latent, attrgetter("weight"), attrgetter("cuboid")):
        # Groups by their first point, in order.
        pairs = [sorted(zip(rows(batch), field(batch).tolist())) for batch in (one, other)]
        assert [points for points, _ in pairs[0]] == [points for points, _ in pairs[1]]
        np.testing.assert_allclose([x for _, x in pairs[0]], [x for _, x in pairs[1]], rtol=1e-6)
    torch.testing.assert_close(one.points.norm(dim=2) - one.cuboid[:, 12:13] / 2, one.sdf, rtol=0, atol=1e-6)
    assert rows(one) != rows(other)


@pytest.mark.parametrize("source", [LoadedPoints, StreamedPoints])
def test_groups_of_one_deformed_shape_follow_each_other_in_bundles(source: type, folder: Path) -> None:
    """A batch of as many bundles as it has shapes: few cages a batch, but where a shape's last bundle is short."""
    data = loaded(folder) if source is LoadedPoints else streamed(folder)
    batches = data.batches(table(data), 64, 8, 0)
    for step in range(20):
        shape = batches.at(step).shape
        changes = int((shape[1:] != shape[:-1]).sum())
        assert changes <= 64 // 8 + 4


@pytest.mark.parametrize(("batch", "steps"), [(100, 28), (140, 40), (1500, 4), (6000, 1)])
def test_every_group_is_used_equally_often_give_or_take_one(folder: Path, batch: int, steps: int) -> None:
    stream = streamed(folder)
    batches = stream.batches(table(stream), batch, 1, 3)
    drawn = [batches.at(step) for step in range(steps)]
    assert all(len(item.weight) == batch for item in drawn)
    seen = Counter(point for item in drawn for point in map(tuple, item.points.amax(dim=1).tolist()))
    assert len(seen) == stream.used // CHUNK
    assert max(seen.values()) - min(seen.values()) <= 1


def test_batches_depend_on_seed_and_step_alone(folder: Path) -> None:
    stream = streamed(folder, trains_on="cage")
    latents = table(stream)
    forward = stream.batches(latents, 200, 4, 5)
    expected = {step: forward.at(step) for step in range(20)}
    for step in (19, 0, 7):
        again = streamed(folder, trains_on="cage").batches(latents, 200, 4, 5).at(step)
        for field in ("points", "sdf", "weight", "cuboid", "part"):
            assert torch.equal(getattr(again, field), getattr(expected[step], field))
        assert torch.equal(latent(again), latent(expected[step]))
    assert not torch.equal(stream.batches(latents, 200, 4, 6).at(0).points, expected[0].points)


def test_where_a_chunk_is_used_in_part_the_objective_is_still_that_of_all_kept_points(folder: Path) -> None:
    """§3.5 spelt out over the points within reach, against the mean over an epoch of an error that differs by point."""
    stream = streamed(folder, trains_on="cage", reach=0.05)
    chunks = join_chunks(spheres.chunks(COUNTS, seed=shard) for shard in range(2))
    means = []
    for shape in (0, 1):
        for step in (0, 1):
            own = (chunks.shape_id == shape) & (chunks.step == step)
            half = spheres.RADII[chunks.shape_ids[shape]][step]
            beyond = np.maximum(np.abs(chunks.xyz[own].reshape(-1, 3)) - half, 0)
            within = np.linalg.norm(beyond, axis=1) <= 0.05
            means.append(np.abs(chunks.sdf[own].reshape(-1)[within]).mean())
    batches = stream.batches(table(stream), sum(stream.chunks), 1, 0)
    estimates = []
    for epoch in range(6):
        batch = batches.at(epoch)
        estimates.append(float((batch.weight * batch.sdf.abs().mean(dim=1)).mean()))
    assert np.mean(estimates) == pytest.approx(np.mean(means), rel=2e-3)


def test_a_selection_keeps_the_points_it_says(folder: Path) -> None:
    stream = streamed(folder, steps_of="rest", trains_on="cage", reach=0.1)
    memory = loaded(folder, steps_of="rest", trains_on="cage", reach=0.1)
    assert 0 <= stream.used - memory.used < 2 * CHUNK
    assert stream.latent_keys("deformed") == memory.latent_keys("deformed") == (("large", 0), ("small", 0))
    assert stream.latent_keys("source") == memory.latent_keys("source")
    batch = stream.batches(table(stream), 300, 1, 0).at(0)
    beyond = (batch.points.abs() - batch.cuboid[:, None, 12:] / 2).clamp(min=0).norm(dim=2)
    assert beyond.max() <= 0.1 + 1e-6


@given(kept=st.lists(st.integers(1, 64), min_size=1, max_size=20), seed=st.integers(0, 99))
@settings(deadline=None, max_examples=30)
def test_kept_points_fill_a_chunk_in_turn(kept: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    keep = np.array([rng.permutation(np.arange(CHUNK) < count) for count in kept])
    for row, flags in zip(filled(keep, rng), keep):
        counts = np.bincount(row, minlength=CHUNK)
        assert not counts[~flags].any()
        assert counts[flags].max() - counts[flags].min() <= 1


def test_what_doesnt_fit_into_memory_is_streamed(folder: Path) -> None:
    need = 2 * sum(COUNTS) * CHUNK * points_module.BYTES_A_POINT
    for memory, kind in ((need, LoadedPoints), (need - 1, StreamedPoints)):
        rng = np.random.default_rng(0)
        assert type(open_points(folder, spheres.sequences(), "all", "cube", 0.0, rng, memory)) is kind


def test_a_selection_that_leaves_nothing_of_a_shape_is_refused_by_its_name(tmp_path: Path) -> None:
    write_shard(tmp_path / "shape-0000.parquet", [spheres.chunks((0, 9, 5, 5))], np.random.default_rng(0))
    with pytest.raises(InputError, match=r"points to train on of shape\(s\) large with steps_of rest"):
        streamed(tmp_path, steps_of="rest")


def test_a_damaged_shard_is_said_by_the_step_that_needs_it(folder: Path) -> None:
    stream = streamed(folder)
    batches = stream.batches(table(stream), 100, 1, 0)
    for shard in folder.glob("*.parquet"):
        shard.write_bytes(b"not points")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        batches.at(0)
