"""Batches: which points, with whose cuboid and latent, in which order, of what weight."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.io.points import CHUNK
from cagesdf.models.latents import LatentTable
from cagesdf.training.batches import (
    Batch,
    BatchOrder,
    Cages,
    Owners,
    bundled,
    cuboid_distance,
    latent_keys,
    rechunk,
    shape_weights,
    training_chunks,
    training_set,
)
from cagesdf.training.losses import latent_penalty, shape_mean
from tests.support import spheres


def select(steps_of="all", trains_on="cage", reach=0.02, chunks=None):
    chunks = spheres.chunks() if chunks is None else chunks
    return training_chunks(chunks, spheres.sequences(), steps_of, trains_on, reach, np.random.default_rng(0))


def test_distances_to_own_cuboids_are_those_of_the_cage() -> None:
    rng = np.random.default_rng(0)
    axes = np.linalg.qr(rng.normal(size=(4, 3, 3)))[0]
    axes[:, 0] *= np.linalg.det(axes)[:, None]
    cage = Cage(tuple("abcd"), rng.uniform(-1, 1, (4, 3)), axes, rng.uniform(0.1, 1, (4, 3)))
    points = rng.uniform(-1, 1, (4, 30, 3))
    expected = np.stack([cage.signed_distance(points[i])[:, i] for i in range(4)])
    np.testing.assert_allclose(cuboid_distance(points, cage.vectors()), expected, atol=1e-12)


def test_every_chunk_gets_the_cuboid_of_its_own_shape_step_and_part() -> None:
    chunks = spheres.chunks()
    sizes = Owners.of(chunks, spheres.sequences()).cuboids()[:, 12]
    expected = [2 * spheres.RADII[chunks.shape_ids[a]][b] for a, b in zip(chunks.shape_id, chunks.step)]
    np.testing.assert_allclose(sizes, expected, rtol=1e-6)


def test_points_without_a_cage_are_refused_by_name() -> None:
    sequences = spheres.sequences()
    chunks = spheres.chunks()
    with pytest.raises(InputError, match=r"shape small, step 0.*no cage"):
        Owners.of(chunks, {"large": sequences["large"]})
    with pytest.raises(InputError, match=r"shape large, step 0.*part limb"):
        Owners.of(replace(chunks, part_ids=("limb",)), sequences)


@given(reach=st.floats(0, 0.6), seed=st.integers(0, 100))
@settings(max_examples=20, deadline=None)
def test_a_cage_arm_keeps_points_within_reach_alone_and_loses_less_than_a_chunk_a_group(
    reach: float, seed: int
) -> None:
    chunks = spheres.chunks((20, 15, 9, 12), seed=seed)
    cuboids = Owners.of(chunks, spheres.sequences()).cuboids()
    within = cuboid_distance(chunks.xyz, cuboids) <= reach
    kept = rechunk(chunks, within, np.random.default_rng(seed))
    if len(kept):
        assert cuboid_distance(kept.xyz, Owners.of(kept, spheres.sequences()).cuboids()).max() <= reach
    pool = {tuple(row) for row in chunks.xyz[within].tolist()}
    rows = [tuple(row) for row in kept.xyz.reshape(-1, 3).tolist()]
    assert len(set(rows)) == len(rows)
    assert set(rows) <= pool
    for shape in (0, 1):
        for step in (0, 1):
            own = (chunks.shape_id == shape) & (chunks.step == step)
            count = ((kept.shape_id == shape) & (kept.step == step)).sum()
            assert count == within[own].sum() // CHUNK
    # Distances stay beside their points.
    radii = np.array([spheres.RADII[kept.shape_ids[a]][b] for a, b in zip(kept.shape_id, kept.step)]).reshape(-1, 1)
    np.testing.assert_allclose(np.linalg.norm(kept.xyz, axis=2) - radii, kept.sdf, atol=1e-6)


def test_the_cube_arm_keeps_all_points_and_rest_keeps_the_source_shapes_alone() -> None:
    assert len(select(trains_on="cube")) == 18
    rest = select(steps_of="rest", trains_on="cube")
    assert len(rest) == 9
    assert set(rest.step.tolist()) == {0}


def test_a_selection_that_leaves_nothing_of_a_shape_is_refused_by_its_name() -> None:
    chunks = spheres.chunks((1, 0, 0, 0))
    far = replace(chunks, xyz=np.full_like(chunks.xyz, 1.0))
    with pytest.raises(
        InputError, match=r"points to train on of shape\(s\) large.*cage, .*within 0\.02 of their cuboid"
    ):
        select(chunks=far)


@pytest.mark.parametrize("trains_on", ["part", "cage", "cube"])
def test_a_selection_that_leaves_nothing_at_all_is_refused_as_one(trains_on: str) -> None:
    with pytest.raises(InputError, match=r"shape\(s\) large, small with steps_of rest"):
        select("rest", trains_on, chunks=spheres.chunks((0, 4, 0, 5)))


def test_latents_are_one_a_source_or_one_a_deformed_shape_and_batches_name_their_rows() -> None:
    chunks = spheres.chunks()
    assert latent_keys(chunks, "source") == (("large", -1), ("small", -1))
    assert latent_keys(chunks, "deformed") == (("large", 0), ("large", 1), ("small", 0), ("small", 1))
    for latents in ("source", "deformed"):
        table = LatentTable.drawn(latent_keys(chunks, latents), 3, 1.0, seed=0)
        groups = training_set(chunks, spheres.sequences(), table)
        rows = groups.cages.latent[groups.shape].tolist()
        assert rows == [table.row(chunks.shape_ids[a], int(b)) for a, b in zip(chunks.shape_id, chunks.step)]


def test_weighted_batches_average_to_the_papers_objective() -> None:
    """§3.5 spelt out in loops, against the mean over all batches of one epoch."""
    chunks = spheres.chunks((6, 4, 3, 5))
    table = LatentTable.drawn(latent_keys(chunks, "source"), 3, 1.0, seed=0)
    groups = training_set(chunks, spheres.sequences(), table)
    predicted = torch.randn(groups.sdf.shape, generator=torch.Generator().manual_seed(0))

    means = []
    for shape in (0, 1):
        for step in (0, 1):
            differences = []
            for c in range(len(chunks)):
                if chunks.shape_id[c] == shape and chunks.step[c] == step:
                    differences += [abs(float(predicted[c, n]) - float(chunks.sdf[c, n])) for n in range(CHUNK)]
            means.append(sum(differences) / len(differences))
    expected = sum(means) / len(means)

    order = BatchOrder(groups.shape.numpy(), 3, 1, seed=0)
    batches = [order.at(step) for step in range(len(chunks) // 3)]
    errors = (predicted - groups.sdf).abs()
    losses = [shape_mean(errors[b], groups.weight[b]).item() for b in batches]
    assert np.mean(losses) == pytest.approx(expected, rel=1e-5)
    assert latent_penalty(table.values).item() == pytest.approx(
        sum(float(value) ** 2 for row in table.values.detach() for value in row) / len(table), rel=1e-5
    )


def test_weights_give_every_deformed_shape_the_same_say() -> None:
    chunks = spheres.chunks((6, 4, 3, 5))
    weights = shape_weights(chunks)
    totals = [weights[(chunks.shape_id == a) & (chunks.step == b)].sum() for a in (0, 1) for b in (0, 1)]
    np.testing.assert_allclose(totals, len(chunks) / 4, rtol=1e-6)


def rows_of_cages(seed: int = 0) -> list[tuple[Cage, int]]:
    """Cages of several sizes with rows of latents."""
    rng = np.random.default_rng(seed)
    return [
        (Cage(tuple("abcd"[:n]), rng.normal(size=(n, 3)), np.array([np.eye(3)] * n), rng.uniform(0.1, 1, (n, 3))), row)
        for n, row in ((2, 5), (4, 0), (1, 3), (3, 3))
    ]


def says(cages: Cages, row: int) -> tuple[list, int]:
    """The cuboids and the latent of one cage."""
    return cages.cuboids[row][cages.present[row]].tolist(), int(cages.latent[row])


def test_cages_hold_each_cage_and_its_latent_and_what_is_taken_of_them_is_the_same() -> None:
    known = rows_of_cages()
    cages = Cages.of(known)
    for row, (cage, latent) in enumerate(known):
        assert says(cages, row) == (cage.vectors().astype(np.float32).tolist(), latent)
    for rows in ([2, 0], [3], [1, 1, 2, 3], []):
        taken = cages.take(torch.tensor(rows, dtype=torch.int64))
        assert [says(taken, i) for i in range(len(rows))] == [says(cages, row) for row in rows]
        assert taken.cuboids.shape[1] == max([len(known[row][0]) for row in rows], default=0)


def test_a_batch_on_its_way_keeps_what_it_says_and_leaves_other_cages_behind() -> None:
    cages = Cages.of(rows_of_cages())
    shape, part = torch.tensor([3, 0, 3, 2]), torch.tensor([2, 1, 0, 0])
    points = torch.rand(4, CHUNK, 3, generator=torch.Generator().manual_seed(0))
    batch = Batch(points, points[..., 0], torch.arange(4.0), shape, part, cages)
    sent = batch.to("cpu")
    for name in ("points", "sdf", "weight", "part", "cuboid"):
        assert torch.equal(getattr(sent, name), getattr(batch, name))
    assert torch.equal(sent.cages.latent[sent.shape], cages.latent[shape])
    assert len(sent.cages.latent) == 3
    assert sent.cages.cuboids.shape[1] == 3
    assert len(batch.run(slice(2, 2)).to("cpu").cages.latent) == 0
    joined = Batch.joined([batch.run(slice(0, 1)), batch.take(torch.tensor([1, 2, 3]))])
    assert torch.equal(joined.cuboid, batch.cuboid)
    assert torch.equal(joined.points, batch.points)


def test_a_batch_names_the_cuboid_of_each_groups_own_part() -> None:
    """Parts that chunks number in another order than the cage has them."""
    sequences = spheres.sequences()
    cages = {name: Cage(("arm", *item.cages[0].part_ids), *spread(item.cages[0])) for name, item in sequences.items()}
    sequences = {name: replace(item, cages=(cages[name],) * 2) for name, item in sequences.items()}
    chunks = spheres.chunks()
    groups = training_set(chunks, sequences, LatentTable.drawn(latent_keys(chunks, "source"), 3, 1.0, seed=0))
    assert set(groups.part.tolist()) == {1}
    expected = [cages[chunks.shape_ids[shape]].vectors()[1] for shape in chunks.shape_id]
    np.testing.assert_allclose(groups.cuboid, expected, rtol=1e-6)


def spread(cage: Cage) -> tuple[np.ndarray, ...]:
    """The numbers of a cage, behind those of another cuboid."""
    return tuple(np.concatenate([values * 0.5, values]) for values in (cage.centre + 1, cage.axes * 2, cage.size))


@given(owner=st.lists(st.integers(0, 4), min_size=1, max_size=60), bundle=st.integers(1, 9), seed=st.integers(0, 9))
def test_bundles_hold_every_group_once_and_run_of_one_owner_each(owner: list[int], bundle: int, seed: int) -> None:
    owners = np.array(owner)
    order = bundled(owners, bundle, np.random.default_rng(seed))
    assert sorted(order.tolist()) == list(range(len(owner)))
    assert np.array_equal(order, bundled(owners, bundle, np.random.default_rng(seed)))
    # Cut greedily, there are no more runs than each owner's bundles.
    runs, start = 0, 0
    changes = [*np.flatnonzero(np.diff(owners[order])) + 1, len(order)]
    whole: Counter[int] = Counter()
    for stop in changes:
        whole[int(owners[order[start]])] += (stop - start) // bundle
        runs, start = runs + 1, stop
    counts = np.bincount(owners)
    assert runs <= sum(-(-count // bundle) for count in counts)
    for number, count in enumerate(counts):
        assert whole[number] >= count // bundle - (count % bundle > 0)


def test_bundles_of_one_are_any_order_and_bundles_of_several_are_in_any_order() -> None:
    owner = np.repeat([0, 1], 2)
    single = {tuple(bundled(owner, 1, np.random.default_rng(seed))) for seed in range(400)}
    pairs = {tuple(bundled(owner, 2, np.random.default_rng(seed))) for seed in range(100)}
    assert len(single) == 24
    assert len(pairs) == 8


@given(groups=st.integers(1, 20), batch=st.integers(1, 25), bundle=st.integers(1, 4), seed=st.integers(0, 5))
def test_every_group_is_used_equally_often_and_the_order_depends_on_seed_and_step_alone(
    groups: int, batch: int, bundle: int, seed: int
) -> None:
    owner = np.random.default_rng(seed).integers(0, 3, groups)
    order = BatchOrder(owner, batch, bundle, seed)
    drawn = [order.at(step) for step in range(groups)]
    assert all(len(item) == batch for item in drawn)
    assert Counter(torch.cat(drawn).tolist()) == dict.fromkeys(range(groups), batch)
    for step in (groups - 1, 0):
        assert torch.equal(BatchOrder(owner, batch, bundle, seed).at(step), drawn[step])
