"""Training: it learns, it repeats, and stopping it changes nothing."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch

from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.models.arms import DECODERS, make_decoder
from cagesdf.models.latents import LatentTable
from cagesdf.models.occupancy import TEMPERATURE
from cagesdf.models.triplane import TriplaneDecoder
from cagesdf.training import checkpoint as checkpoint_module
from cagesdf.training.batches import Batch, Cages, MemoryBatches
from cagesdf.training.checkpoint import Checkpoint, digest_of
from cagesdf.training.free_codes import DRAWN, STYLED, FreeCodes, code_distance
from cagesdf.training.gradients import SLICE, Gradients, slice_threads, slices
from cagesdf.training.loop import SPIKE, flatten_spike, rate
from tests.support import spheres
from tests.support.training import SETTINGS, Stopped, training

OF_DISTANCES = sorted(DECODERS.keys() - {"OccupancyDecoder"})  # they know what a clamp is


STEPS: dict[str, int] = {}  # decoders that need more than 90 steps for the spheres


@pytest.mark.parametrize("decoder", sorted(DECODERS))
def test_a_few_dozen_steps_learn_the_spheres(decoder: str, tmp_path: Path) -> None:
    settings = replace(SETTINGS, steps=STEPS.get(decoder, 90), learning_rate=1e-2)
    log = training(tmp_path, settings, decoder=decoder, batch=16)[1]
    assert log[-1]["l1"] < 0.2 * log[0]["l1"]
    assert log[-1]["l1"] < 0.1


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_the_same_seed_gives_the_same_bits_and_another_one_others(
    precision: Literal["float32", "bfloat16"], tmp_path: Path
) -> None:
    settings = replace(SETTINGS, precision=precision)
    one, same = training(tmp_path / "a", settings), training(tmp_path / "b", settings)
    assert all(torch.equal(one[0][name], same[0][name]) for name in one[0])
    assert one[1] == same[1]
    other = training(tmp_path / "c", settings, seed=1)[0]
    assert not torch.equal(one[0]["latents"], other["latents"])


@pytest.mark.parametrize(
    ("decoder", "stop"),
    [
        ("TriplaneDecoder", 6),
        ("TriplaneDecoder", 18),
        ("OccupancyDecoder", 6),
        ("CageDecoder", 12),
        ("DeepSdfDecoder", 12),
    ],
)
def test_a_training_that_was_stopped_and_resumed_ends_with_the_same_bits(
    decoder: str, stop: int, tmp_path: Path
) -> None:
    whole, log, _ = training(tmp_path / "whole", decoder=decoder)
    with pytest.raises(Stopped):
        training(tmp_path / "stopped", stop=stop, decoder=decoder)
    resumed, resumed_log, reported = training(tmp_path / "stopped", decoder=decoder)
    assert reported[0] == stop // 5 * 5
    assert all(torch.equal(whole[name], resumed[name]) for name in whole)
    assert log == resumed_log
    kept, whole_kept = (Checkpoint(tmp_path / name).kept() for name in ("stopped", "whole"))
    assert list(kept) == list(whole_kept) == [7]
    assert all(torch.equal(tensor, whole_kept[7][name]) for name, tensor in kept[7].items())


def test_what_is_kept_after_some_steps_is_what_was_trained_by_then(tmp_path: Path) -> None:
    training(tmp_path / "kept")
    with pytest.raises(Stopped):
        training(tmp_path / "stopped", replace(SETTINGS, log_every=1, checkpoint_every=7), stop=8)
    saved = Checkpoint(tmp_path / "stopped").load()
    assert saved is not None
    kept = Checkpoint(tmp_path / "kept").kept()[7]
    assert all(torch.equal(tensor, saved[0][name]) for name, tensor in kept.items())


def test_a_process_killed_while_it_writes_leaves_the_last_good_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = Checkpoint(tmp_path / "x")
    checkpoint.save({"a": torch.ones(3)}, {"step": 1})
    for name in ("fsync", "replace"):
        with monkeypatch.context() as patch:

            def kill(*_: object) -> None:
                raise Stopped

            patch.setattr(checkpoint_module.os, name, kill)
            with pytest.raises(Stopped):
                checkpoint.save({"a": torch.zeros(3)}, {"step": 2})
        loaded = checkpoint.load()
        assert loaded is not None
        assert loaded[1] == {"step": 1}
        assert torch.equal(loaded[0]["a"], torch.ones(3))
    checkpoint.save({"a": torch.zeros(3)}, {"step": 2})
    loaded = checkpoint.load()
    assert loaded is not None
    assert loaded[1] == {"step": 2}
    checkpoint.remove()
    assert checkpoint.load() is None


def test_a_checkpoint_that_is_none_of_ours_is_refused_by_name(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path)
    checkpoint.path.write_bytes(b"not tensors at all")
    with pytest.raises(InputError, match=r"training\.safetensors.*delete it"):
        checkpoint.load()


def test_a_digest_follows_the_facts_and_not_their_order() -> None:
    facts = {"params": {"steps": 3, "width": 4}, "library": {"a.py": "1"}}
    assert digest_of(facts) == digest_of({"library": {"a.py": "1"}, "params": {"width": 4, "steps": 3}})
    assert digest_of(facts) != digest_of({**facts, "params": {"steps": 3, "width": 5}})


@pytest.mark.parametrize("every", [1, 100])
def test_a_loss_that_is_no_longer_finite_stops_with_what_to_do(every: int, tmp_path: Path) -> None:
    settings = replace(SETTINGS, learning_rate=1e18, checkpoint_every=100, log_every=every)
    with pytest.raises(InputError, match=r"loss became .* in steps \d+ to \d+; lower learning_rate.*no checkpoint"):
        training(tmp_path, settings)
    assert not (tmp_path / "training.safetensors").exists()


def gradient_after(*gradients: float) -> float:
    """The last of these gradients after `flatten_spike`; Adam steps after each."""
    parameters = [torch.nn.Parameter(torch.zeros(n)) for n in (3, 5)]
    optimiser = torch.optim.Adam(parameters, fused=True)
    for gradient in gradients:
        for parameter in parameters:
            parameter.grad = torch.full_like(parameter, gradient)
        flatten_spike(optimiser)
        optimiser.step()
    assert parameters[0].grad is not None
    return float(parameters[0].grad[0])


@pytest.mark.parametrize("usual", [1e-4, 1.0, 300.0])
@pytest.mark.parametrize("spike", [1.0, 3.9, -3.9, 5.0, -1000.0])
def test_a_gradient_far_above_the_usual_ones_is_scaled_down_and_no_other(usual: float, spike: float) -> None:
    left = gradient_after(*[usual] * 20, spike * usual)
    if abs(spike) < SPIKE:
        assert left == np.float32(spike * usual), "to the bit"
    else:
        assert left == pytest.approx(np.sign(spike) * SPIKE * usual, rel=0.02)


def test_a_first_gradient_stays_and_one_that_is_not_finite_is_not_hidden() -> None:
    assert gradient_after(1000.0) == 1000
    assert not np.isfinite(gradient_after(1.0, 1.0, float("nan")))
    assert not np.isfinite(gradient_after(1.0, 1.0, float("inf")))


def test_gradients_that_were_all_zero_are_no_measure() -> None:
    assert gradient_after(0.0, 0.0, 1.0) == 1


class Spoilt(MemoryBatches):
    """From the seventh step on, truths of another kind."""

    truth = torch.nan

    def at(self, step: int) -> Batch:
        batch = super().at(step)
        return batch if step < 7 else replace(batch, sdf=torch.full_like(batch.sdf, self.truth))


@pytest.mark.parametrize(("truth", "every"), [(torch.nan, 5), (torch.nan, 1), (1e4, 5)])
def test_not_finite_and_diverging_trainings_stop_and_name_the_last_good_checkpoint(
    truth: float, every: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Spoilt, "truth", truth)
    monkeypatch.setitem(training.__globals__, "MemoryBatches", Spoilt)
    settings = replace(SETTINGS, checkpoint_every=every, log_every=3)
    good = 5 if every == 5 else 7
    with pytest.raises(InputError, match=rf"lower learning_rate.*step {good} is kept in .*training\.safetensors"):
        training(tmp_path, settings)
    saved = Checkpoint(tmp_path).load()
    assert saved is not None
    assert saved[1]["step"] == good
    assert all(torch.isfinite(tensor).all() for tensor in saved[0].values())


@pytest.mark.parametrize("decoder", sorted(DECODERS))
def test_any_number_of_threads_gives_the_same_bits(
    decoder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SLICE, "cpu", 2)  # several slices of a batch of seven
    before = torch.get_num_threads()
    results = []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            results.append(training(tmp_path / str(threads), decoder=decoder, batch=7)[0])
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    one, three = results
    assert all(torch.equal(one[name], three[name]) for name in one)


PARTS = (1, 2, 3)  # of the shapes of `two_parts`, by row of the latent table
STEP = 5


def two_parts(groups: int = 11) -> Batch:
    """Groups of three cages of one to three parts, some of them without groups, with weights of their own."""
    rng = np.random.default_rng(0)
    cages = [
        Cage(
            tuple("abc"[:parts]),
            rng.uniform(-0.4, 0.4, (parts, 3)),
            np.array([np.eye(3)] * parts),
            rng.uniform(0.1, 0.9, (parts, 3)),
        )
        for parts in (2, 1, 3)
    ]
    shape = rng.choice([0, 2], groups)
    part = rng.integers(0, 2, groups)
    points = rng.uniform(-0.6, 0.6, (groups, 64, 3))
    numbers = (points, rng.normal(0, 0.2, (groups, 64)), rng.uniform(0.5, 2, groups))
    xyz, sdf, weight = (torch.from_numpy(values.astype(np.float32)) for values in numbers)
    rows = Cages.of(zip(cages, (1, 0, 2)))
    return Batch(xyz, sdf, weight, torch.from_numpy(shape), torch.from_numpy(part), rows)


def slow_errors(
    decoder: str, predicted: torch.Tensor, truth: torch.Tensor, unit: torch.Tensor, clamp: float
) -> torch.Tensor:
    """The loss of each point of one group, spelt out."""
    predicted, truth = predicted / unit, truth / unit
    if decoder == "OccupancyDecoder":
        predicted, truth = predicted.double(), truth.double()  # in float32 probabilities far away are 0
        inside, label = (-predicted / TEMPERATURE).sigmoid(), (-truth / TEMPERATURE).sigmoid()
        outside = (predicted / TEMPERATURE).sigmoid()  # 1 - inside would round to 0
        divergence = label * (label / inside).log() + (1 - label) * ((truth / TEMPERATURE).sigmoid() / outside).log()
        return TEMPERATURE * divergence.float()
    if clamp:
        predicted, truth = predicted.clamp(-clamp, clamp), truth.clamp(-clamp, clamp)
    return (predicted - truth).abs()


@pytest.mark.parametrize(
    ("decoder", "clamp"), [(name, 0.0) for name in sorted(DECODERS)] + [(name, 0.3) for name in OF_DISTANCES]
)
@pytest.mark.parametrize("size", [1, 4, 64])
def test_gradients_are_those_of_the_whole_loss_at_once(
    decoder: str, size: int, clamp: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In slices and in one piece, against the sum over groups spelt out and autograd's gradient of it."""
    monkeypatch.setitem(SLICE, "cpu", size)
    network = make_decoder(decoder, **spheres.SIZES, seed=0)
    table = LatentTable.drawn(tuple((name, -1) for name in "xyz"), 4, 1.0, seed=0)
    batch, parameters = two_parts(), [*network.parameters(), table.values]

    loss = torch.zeros(())
    for group in range(len(batch.weight)):
        shape, part = int(batch.shape[group]), int(batch.part[group])
        cages = batch.cages.take(torch.tensor([shape]))
        code = network.codes(table(cages.latent), cages.cuboids, cages.present)[:, part]
        cuboid = cages.cuboids[:, part]
        said, truth = network(batch.points[group][None], code, cuboid), batch.sdf[group][None]
        errors = slow_errors(decoder, said, truth, network.unit(cuboid), clamp)
        loss = loss + 0.7 * batch.weight[group] * errors.mean() / len(batch.weight)
    expected = torch.autograd.grad(loss, parameters)

    with slice_threads() as (pool, threads):
        value = Gradients(network, table, clamp, "float32", pool, threads).add(batch.to("cpu"), 0.7)
    assert float(value) == pytest.approx(loss.item(), rel=1e-5)
    for parameter, gradient in zip(parameters, expected, strict=True):
        given = torch.zeros_like(parameter) if parameter.grad is None else parameter.grad
        torch.testing.assert_close(given, gradient, rtol=1e-3, atol=1e-5)
    assert table.values.grad is not None
    assert not table.values.grad[0].any(), "no group is of the second cage, which has the first latent"


def test_while_codes_come_first_the_decoder_reads_those_and_the_transformer_is_drawn_to_them() -> None:
    network = make_decoder("TriplaneDecoder", **spheres.SIZES, seed=0)
    assert isinstance(network, TriplaneDecoder)
    table = LatentTable.drawn(tuple((name, -1) for name in "xyz"), 4, 1.0, seed=0)
    free = FreeCodes(PARTS, spheres.SIZES["code_dim"])
    with torch.no_grad():
        free.values.normal_(generator=torch.Generator().manual_seed(0))
    batch = two_parts().to("cpu")
    cages = batch.cages
    transformer = [*network.transformer.parameters(), table.values]
    others = [p for name, p in network.named_parameters() if not name.startswith("transformer.")]

    read = free.values[cages.latent, : cages.cuboids.shape[1]][batch.shape, batch.part]
    errors = (network(batch.points, read, batch.cuboid) - batch.sdf).abs() / network.unit(batch.cuboid)[:, None]
    loss = 0.7 * (batch.weight * errors.mean(dim=1)).mean()
    codes = network.codes(table(cages.latent), cages.cuboids, cages.present)
    apart = [  # a group at a time
        (codes[shape, part] - free.values[cages.latent[shape], part]).detach().square().sum()
        for shape, part in zip(batch.shape.tolist(), batch.part.tolist())
    ]
    distance = code_distance(codes[batch.shape, batch.part], free(cages)[batch.shape, batch.part])
    assert distance.item() == pytest.approx(torch.stack(apart).mean().item(), rel=1e-5)
    styled = []  # the next shape's code at each cage, drawn to the nearest of that shape's parts
    for shape, part in zip(batch.shape.tolist(), batch.part.tolist()):
        other = (int(cages.latent[shape]) + 1 + STEP % 2) % 3
        latent = table.values[other].detach()[None]
        code = network.codes(latent, cages.cuboids[shape, None], cages.present[shape, None])[0, part]
        known = free.values[other, : PARTS[other]].detach()
        styled.append((code - min(known, key=lambda one: (one - code).square().sum().item())).square().sum())
    expected = torch.autograd.grad(loss, [*others, free.values])
    drawn = torch.autograd.grad(0.7 * DRAWN * (distance + STYLED * torch.stack(styled).mean()), transformer)

    with slice_threads() as (pool, threads):
        value = Gradients(network, table, 0.0, "float32", pool, threads).add(batch, 0.7, free, STEP)
    assert float(value) == pytest.approx(loss.item(), rel=1e-5)
    for parameter, gradient in zip([*others, free.values, *transformer], [*expected, *drawn], strict=True):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("shapes", [2, 3, 7])
def test_each_shape_is_at_the_cages_of_every_other_in_turn_and_never_at_its_own(shapes: int) -> None:
    free = FreeCodes([1] * shapes, 2)
    rows = torch.arange(shapes)
    turns = torch.stack([free.others(rows, step) for step in range(shapes - 1)])
    for row in range(shapes):
        assert sorted(turns[:, row].tolist()) == [other for other in range(shapes) if other != row]


def test_codes_that_come_first_are_taken_over_by_the_transformer(tmp_path: Path) -> None:
    """The loss of the last steps, by the shape's code alone, is about that of the free codes."""
    settings = replace(SETTINGS, steps=120, learning_rate=1e-2, codes_first=0.8, log_every=24, snapshots=())
    log = training(tmp_path, settings, batch=16)[1]
    assert log[-1]["l1"] < 0.2 * log[0]["l1"]
    assert log[-1]["l1"] < 2 * log[-2]["l1"]


def test_free_codes_that_never_come_first_change_nothing(tmp_path: Path) -> None:
    never = replace(SETTINGS, codes_first=0.0)
    one, other = (training(tmp_path / str(rate), replace(never, code_learning_rate=rate))[0] for rate in (1e-3, 1.0))
    assert all(torch.equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize("decoder", sorted(DECODERS))
def test_a_share_without_groups_adds_nothing(decoder: str) -> None:
    """Of more ranks than a batch has groups, some have none."""
    network = make_decoder(decoder, **spheres.SIZES, seed=0)
    table = LatentTable.drawn(tuple((name, -1) for name in "xyz"), 4, 1.0, seed=0)
    with slice_threads() as (pool, threads):
        value = Gradients(network, table, 0.0, "float32", pool, threads).add(
            two_parts().run(slice(4, 4)).to("cpu"), 0.0
        )
    assert value == 0
    assert not any(p.grad is not None and p.grad.any() for p in (*network.parameters(), table.values))


@pytest.mark.parametrize("most", [1, 5, 32])
def test_slices_cover_all_groups_once_and_none_is_too_long(most: int) -> None:
    for groups in (0, 1, 2, 16, 31, 100):
        parts = slices(groups, most)
        assert [i for part in parts for i in range(part.start, part.stop)] == list(range(groups))
        assert all(0 < part.stop - part.start <= most for part in parts)
        assert len(parts) == -(-groups // most)


def test_the_log_has_means_over_all_steps_and_no_times(tmp_path: Path) -> None:
    _, log, reported = training(tmp_path)
    assert [row["step"] for row in log] == [3, 6, 9, 12, 15, 18, 20]
    assert reported == [0, 3, 6, 9, 12, 15, 18, 20]
    assert set(log[0]) == {"step", "loss", "l1", "latent_norm"}
    singly = training(tmp_path / "singly", replace(SETTINGS, log_every=1))[1]
    assert log[0]["l1"] == pytest.approx(sum(row["l1"] for row in singly[:3]) / 3, rel=1e-5)


def test_learning_rates_fall_to_zero_along_a_cosine_or_by_halves() -> None:
    assert [rate(step, SETTINGS) for step in (0, 10, 20)] == pytest.approx([1, 0.5, 0])
    halves = replace(SETTINGS, schedule="halve", halve_every=8)
    assert [rate(step, halves) for step in (0, 7, 8, 16)] == [1, 1, 0.5, 0.25]
