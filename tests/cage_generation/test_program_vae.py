"""The autoencoder: many programs at once are each one by itself, and it learns."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from torch import Tensor

from cagesdf.cage_generation.batching import Batch
from cagesdf.cage_generation.program_vae import TERMS, ProgramVAE
from cagesdf.cage_generation.tokens import COMMAND, END, START, ProgramTokens, tokens_of
from cagesdf.cage_generation.training import Settings, _batches, train_programs
from cagesdf.structure.parsing import parse
from tests.support import one_program, programs

FEW = Settings(width=24, code=6, steps=60, batch=8, learning_rate=5e-3, divergence=0.1, hidden=0.2, seed=3)


def examples() -> list[ProgramTokens]:
    """Programs of three, two and one levels, of one and several blocks at once."""
    flat = parse(str(programs.CHAIR.blocks[2]))
    variants = [programs.CHAIR, programs.GROWN, flat, programs.mirrored(programs.CHAIR), programs.scaled(flat, 1.7)]
    return [tokens_of(program) for program in variants]


def small(seed: int = 0) -> ProgramVAE:
    return ProgramVAE.drawn(16, 5, seed)


def noise(count: int) -> Tensor:
    return torch.randn(count, 5, generator=torch.Generator().manual_seed(5))


def losses_of(model: ProgramVAE, batch: Batch) -> Tensor:
    return model(batch, noise(batch.count), torch.ones(len(batch.targets)))


def check_against_one_by_one(batch: Sequence[ProgramTokens]) -> None:
    batched, single = small(), small()
    losses = losses_of(batched, Batch.of(batch))
    one_by_one = torch.stack([one_program.losses(single, p, n) for p, n in zip(batch, noise(len(batch)))])
    torch.testing.assert_close(losses, one_by_one, rtol=1e-4, atol=1e-5)

    weights = torch.linspace(0.5, 2.0, len(TERMS)) * torch.linspace(1.0, 3.0, len(batch))[:, None]
    (losses * weights).sum().backward()
    (one_by_one * weights).sum().backward()
    reached = 0
    for (name, ours), theirs in zip(batched.named_parameters(), single.parameters()):
        if theirs.grad is None:
            assert ours.grad is None or not ours.grad.any(), name
            continue
        torch.testing.assert_close(ours.grad, theirs.grad, rtol=1e-3, atol=2e-4, msg=partial("{}: {}".format, name))
        reached += 1
    assert reached > 40


def test_losses_and_gradients_of_a_batch_are_those_of_its_programs_one_by_one() -> None:
    check_against_one_by_one(examples())


@pytest.mark.parametrize("category", ["chair", "table", "storage"])
def test_so_they_are_for_published_programs(category: str) -> None:
    check_against_one_by_one([tokens_of(parse(text)) for _, text, _ in programs.real_programs(category, 6)])


def test_a_programs_losses_do_not_depend_on_those_beside_it() -> None:
    all_five, model = examples(), small()
    together = losses_of(model, Batch.of(all_five))
    for i, program in enumerate(all_five):
        batch = Batch.of([program])
        alone = model(batch, noise(5)[i : i + 1], torch.ones(len(batch.targets)))[0]
        torch.testing.assert_close(together[i], alone, rtol=1e-4, atol=1e-5)


def test_a_hidden_line_says_nothing_to_those_after_it() -> None:
    batch = Batch.of(examples()[1:2])
    changed = batch.levels[0].lines.clone()
    changed[3] += 1.0
    other = replace(batch, levels=(replace(batch.levels[0], lines=changed),))
    codes, model = torch.randn(1, 5), small()
    shown = torch.ones(len(batch.targets))
    hidden = shown.clone()
    hidden[3] = 0
    assert torch.equal(model.decoder(batch, codes, hidden), model.decoder(other, codes, hidden))
    assert not torch.equal(model.decoder(batch, codes, shown), model.decoder(other, codes, shown))


def test_what_is_given_is_what_was_to_be_written_one_line_before() -> None:
    batch = Batch.of(examples())
    start = 0
    for level in batch.levels:
        targets = batch.targets[start : start + len(level.lines)]
        start += len(level.lines)
        for block in range(len(level.size)):
            own = level.block == block
            assert level.lines[own][0, START] == 1
            assert targets[own][-1, END] == 1
            assert torch.equal(level.lines[own][1:], targets[own][:-1])
    assert (batch.targets[:, COMMAND].sum(dim=1) == 1).all()
    assert start == len(batch.targets)


def test_each_block_but_the_roots_comes_from_the_line_that_declares_its_cuboid() -> None:
    programs_ = examples()
    batch = Batch.of(programs_)
    for level, above in zip(batch.levels[1:], batch.levels):
        for i, (line, shape) in enumerate(zip(level.outer_given.tolist(), level.shape.tolist())):
            assert above.lines[line, 1] == 1
            assert above.shape[above.block[line]] == shape
            assert above.block[level.outer[i]] == above.block[line]


def test_the_mean_code_is_that_of_no_noise_and_the_divergence_of_the_prior_is_none() -> None:
    model, batch = small(), Batch.of(examples())
    assert torch.equal(model.codes(examples()), model.encoder(batch)[0])
    for layer in (model.encoder.mean, model.encoder.log_variance):
        torch.nn.init.zeros_(layer.weight)
        torch.nn.init.zeros_(layer.bias)
    assert torch.equal(losses_of(model, batch)[:, TERMS.index("divergence")], torch.zeros(5))


def test_the_seed_decides_the_weights_and_leaves_the_callers_generator_alone() -> None:
    torch.manual_seed(1)
    first = ProgramVAE.drawn(8, 4, seed=2).state_dict()
    drawn = torch.rand(1)
    torch.manual_seed(1)
    assert torch.equal(torch.rand(1), drawn)
    assert all(torch.equal(first[name], value) for name, value in ProgramVAE.drawn(8, 4, seed=2).state_dict().items())
    assert not all(
        torch.equal(first[name], value) for name, value in ProgramVAE.drawn(8, 4, seed=3).state_dict().items()
    )


def test_training_lowers_every_kind_of_loss_and_repeats() -> None:
    model, log = train_programs(examples(), FEW)
    again, _ = train_programs(examples(), FEW)
    assert all(torch.equal(a, b) for a, b in zip(model.state_dict().values(), again.state_dict().values()))
    for term in set(TERMS) - {"divergence", "face", "copies"}:
        assert log[-1][term] < log[0][term], term
    assert log[-1]["step"] == FEW.steps


def test_every_program_comes_once_before_any_comes_again() -> None:
    rng, settings = np.random.default_rng(0), replace(FEW, batch=2, steps=10)
    turns = [Batch.of(examples()[i : i + 1]).levels[0].size.sum().item() for i in range(5)]
    drawn = [set(batch.levels[0].size.sum(dim=1).tolist()) for batch in _batches(examples(), settings, rng)]
    for start in (0, 5):
        assert set().union(*drawn[start : start + 5]) == set(turns)
    assert drawn[:5] != drawn[5:]
