"""Codes of shapes that were not trained on, found with a network of balls in their boxes."""

import numpy as np
import pytest
import spheres
import torch
from cagesdf.models.shifted import ShiftedDecoder, film_size
from torch import nn

from cagesdf.cuboid import Cage, Cuboid, Sequence
from cagesdf.models.arms import make_decoder
from cagesdf.models.decoders import Decoder
from cagesdf.models.latents import LatentTable
from cagesdf.training.batches import Batch, training_set
from cagesdf.training.inference import InferenceSettings, Inferred, infer, mean_error, with_code, with_film

SETTINGS = InferenceSettings(
    tried=8,
    starts=3,
    code_steps=60,
    film_steps=60,
    batch=8,
    code_rate=0.03,
    film_rate=0.03,
    code_weight=1e-6,
    film_weight=1e-6,
)
PARTS = 2


class Film(nn.Module):
    """A mapping network that says nothing."""

    layers, width = 1, 1

    def forward(self, condition: torch.Tensor) -> torch.Tensor:
        return condition.new_zeros(len(condition), 1, 2, 1)


class Balls(Decoder):
    """In every cuboid a ball whose radius is its latent's first number, and what FiLM shifts; all else does nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = nn.Module()
        self.backbone.mapping = Film()

    def features(self, points: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return points - cuboid[:, None, :3]

    def condition(self, latent: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return latent[:, :1] + self.backbone.mapping(latent)[:, 0, 1]

    def at(self, features: torch.Tensor, condition: torch.Tensor, products: torch.dtype) -> torch.Tensor:
        return features.norm(dim=2) - condition


def two_balls(radii: tuple[float, float], groups: int = 24, seed: int = 0) -> tuple[Batch, torch.Tensor]:
    """Points in two boxes, with a ball in each."""
    rng = np.random.default_rng(seed)
    centre = np.array([[-0.5, 0, 0], [0.5, 0, 0]])
    vectors = Cage(("a", "b"), centre, np.array([np.eye(3)] * 2), np.full((2, 3), 0.9)).vectors()
    part = np.arange(groups) % PARTS
    xyz = rng.uniform(-0.45, 0.45, (groups, 64, 3))
    sdf = np.linalg.norm(xyz, axis=2) - np.array(radii)[part, None]
    numbers = [xyz + centre[part, None], sdf, vectors[part]]
    tensors = [torch.from_numpy(values.astype(np.float32)) for values in numbers]
    return Batch(*tensors, torch.zeros(groups, dtype=torch.int64), torch.ones(groups)), torch.from_numpy(part)


CANDIDATES = torch.tensor([[0.10, 0.3], [0.55, -0.3], [0.38, 0.1], [0.70, 0.0], [0.20, 0.2]])


def inferred(radii: tuple[float, float], candidates: torch.Tensor = CANDIDATES, seed: int = 0) -> Inferred:
    groups, part = two_balls(radii)
    return infer(Balls(), candidates, groups, part, PARTS, SETTINGS, seed)


def test_one_code_is_found_where_one_explains_the_shape() -> None:
    found = inferred((0.3, 0.3))
    assert found.code_error < 2e-3
    assert found.code[0] == pytest.approx(0.3, abs=2e-3)


def test_residuals_explain_parts_that_no_single_code_does() -> None:
    """With one code the best is the median: half of the points are wrong by the whole difference."""
    found = inferred((0.25, 0.35))
    assert found.code_error == pytest.approx(0.05, rel=0.02)
    assert found.error < 5e-3
    np.testing.assert_allclose(found.code[0] + found.film[:, 0, 1, 0], [0.25, 0.35], atol=5e-3)
    assert not found.film[:, 0, 0].any(), "scales, which do nothing, stay"


def test_a_training_code_that_explains_the_shape_is_never_made_worse() -> None:
    groups, part = two_balls((0.38, 0.38))
    trained = mean_error(with_code(Balls(), groups, CANDIDATES[2]), groups)
    found = infer(Balls(), CANDIDATES, groups, part, PARTS, SETTINGS, seed=0)
    assert found.error <= found.code_error <= trained < 1e-6
    assert found.start == 2


def test_the_order_of_the_candidates_plays_no_part() -> None:
    order = torch.tensor([3, 0, 4, 2, 1])
    one, other = inferred((0.25, 0.35)), inferred((0.25, 0.35), CANDIDATES[order])
    assert torch.equal(one.code, other.code)
    assert torch.equal(one.film, other.film)
    assert one.start == int(order[other.start])


def test_starts_do_not_feel_each_other() -> None:
    """The winner alone ends where it did among others."""
    one = inferred((0.25, 0.35))
    alone = inferred((0.25, 0.35), CANDIDATES[one.start][None])
    torch.testing.assert_close(one.code, alone.code, rtol=0, atol=1e-6)
    assert alone.start == 0


def test_the_same_seed_gives_the_same_bits_and_another_others() -> None:
    one, again, other = inferred((0.25, 0.35)), inferred((0.25, 0.35)), inferred((0.25, 0.35), seed=1)
    assert torch.equal(one.code, again.code)
    assert torch.equal(one.film, again.film)
    assert not torch.equal(one.code, other.code)


def test_the_error_is_the_mean_over_all_groups_each_with_its_own_residual() -> None:
    """More groups than go through the network together; one part is right, the other wrong by a tenth."""
    groups, part = two_balls((0.25, 0.35), groups=150)
    film = torch.zeros(PARTS, 1, 2, 1)
    film[1, 0, 1, 0] = 0.2
    predict = with_film(Balls(), groups, part, torch.tensor([0.25, 0.0]), film)
    assert mean_error(predict, groups) == pytest.approx(0.05, rel=1e-5)


def test_a_shifted_decoder_shares_the_weights_and_leaves_the_decoder_alone() -> None:
    decoder = make_decoder("LocalCageDecoder", 8, 3, 4, [8], 1, seed=0).requires_grad_(False)
    rng = torch.Generator().manual_seed(0)
    given = torch.rand(2, 5, 3, generator=rng), torch.rand(2, 4, generator=rng), torch.rand(2, 15, generator=rng)
    before = decoder(*given)
    none = torch.zeros(2, *film_size(decoder))
    assert torch.equal(ShiftedDecoder(decoder, none)(*given), before)
    first = none.clone()
    first[0] = 0.3
    shifted = ShiftedDecoder(decoder, first)
    assert torch.equal(shifted(*given)[1], before[1])
    assert not torch.equal(shifted(*given)[0], before[0])
    assert torch.equal(decoder(*given), before)
    assert {id(weight) for weight in shifted.parameters()} == {id(weight) for weight in decoder.parameters()}


def test_points_of_one_ball_are_a_batch_like_those_of_training() -> None:
    """Ids, cuboids and points keep together from chunks to the code."""
    chunks = spheres.chunks(reach=0.6)
    rest = chunks.take(np.flatnonzero((chunks.step == 0) & (chunks.shape_id == 0)))
    cage = Cage.of({"body": Cuboid(np.zeros(3), np.eye(3), np.full(3, 1.2))})
    sequences = {"large": Sequence("large", None, np.zeros(1), (False,), (cage,))}
    groups = training_set(rest, sequences, LatentTable((("large", -1),), torch.zeros(1, 2)))
    part = torch.from_numpy(rest.part).long()
    found = infer(Balls(), CANDIDATES, groups, part, 1, SETTINGS, seed=0)
    assert found.code[0] == pytest.approx(spheres.RADII["large"][0], abs=2e-3)
