"""The latent table: whose row is whose."""

import pytest
import torch

from cagesdf.errors import InputError
from cagesdf.models.latents import SHARED, LatentTable


def test_a_shared_latent_serves_all_steps_of_its_shape_and_no_other() -> None:
    table = LatentTable.drawn((("a", SHARED), ("b", SHARED)), 4, 1.0, seed=0)
    assert table.row("b", 0) == table.row("b", 5) == 1
    with pytest.raises(InputError, match=r"shape c, step 0.*not trained on"):
        table.row("c", 0)


def test_a_latent_of_a_deformed_shape_serves_its_step_alone() -> None:
    table = LatentTable.drawn((("a", 0), ("a", 4), ("b", 0)), 4, 1.0, seed=0)
    assert [table.row("a", 0), table.row("a", 4), table.row("b", 0)] == [0, 1, 2]
    assert not table.has("a", 2)
    with pytest.raises(InputError, match=r"shape a, step 2.*steps 0, 4"):
        table.row("a", 2)


def test_drawn_latents_have_the_norm_asked_for_and_follow_their_seed() -> None:
    keys = tuple((f"s{i}", SHARED) for i in range(4000))
    values = LatentTable.drawn(keys, 16, 0.01, seed=1).values
    assert values.square().sum(1).mean().sqrt().item() == pytest.approx(0.01, rel=0.02)
    assert torch.equal(values, LatentTable.drawn(keys, 16, 0.01, seed=1).values)
    assert not torch.equal(values, LatentTable.drawn(keys, 16, 0.01, seed=2).values)
