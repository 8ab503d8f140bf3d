"""Codes of shapes that were not trained on, found with a network of balls in their boxes."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from cagesdf.cuboid import Cage, Cuboid, Sequence
from cagesdf.inference.codes import InferenceSettings, Inferred, OneShape, infer
from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import LatentTable
from cagesdf.training.batches import Batch, Cages, training_set
from tests.support import spheres
from tests.support.balls import Balls

SETTINGS = InferenceSettings(
    tried=8,
    starts=3,
    code_steps=60,
    residual_steps=60,
    batch=8,
    code_rate=0.03,
    residual_rate=0.03,
    code_weight=1e-6,
    residual_weight=1e-6,
)
PARTS = 2


def two_balls(radii: tuple[float, float], groups: int = 24, seed: int = 0) -> Batch:
    """Points in two boxes, with a ball in each."""
    rng = np.random.default_rng(seed)
    centre = np.array([[-0.5, 0, 0], [0.5, 0, 0]])
    cage = Cage(("a", "b"), centre, np.array([np.eye(3)] * 2), np.full((2, 3), 0.9))
    part = np.arange(groups) % PARTS
    xyz = rng.uniform(-0.45, 0.45, (groups, 64, 3))
    sdf = np.linalg.norm(xyz, axis=2) - np.array(radii)[part, None]
    points, truth = (torch.from_numpy(values.astype(np.float32)) for values in (xyz + centre[part, None], sdf))
    zeros = torch.zeros(groups, dtype=torch.int64)
    return Batch(points, truth, torch.ones(groups), zeros, torch.from_numpy(part), Cages.of([(cage, 0)]))


CANDIDATES = torch.tensor([[0.10, 0.3], [0.55, -0.3], [0.38, 0.1], [0.70, 0.0], [0.20, 0.2]])


def inferred(radii: tuple[float, float], candidates: torch.Tensor = CANDIDATES, seed: int = 0) -> Inferred:
    return infer(Balls(), candidates, two_balls(radii), 0.0, SETTINGS, seed)


def test_one_code_is_found_where_one_explains_the_shape() -> None:
    found = inferred((0.3, 0.3))
    assert found.code_error < 2e-3
    assert found.code[0] == pytest.approx(0.3, abs=2e-3)


def test_residuals_explain_parts_that_no_single_code_does() -> None:
    """With one code the best is the median: half of the points are wrong by the whole difference."""
    found = inferred((0.25, 0.35))
    assert found.code_error == pytest.approx(0.05, rel=0.02)
    assert found.error < 5e-3
    np.testing.assert_allclose(found.code[0] + found.residual[:, 0], [0.25, 0.35], atol=5e-3)
    assert not found.residual[:, 1].any(), "what does nothing stays"


def test_a_training_code_that_explains_the_shape_is_never_made_worse() -> None:
    groups = two_balls((0.38, 0.38))
    trained = OneShape(Balls(), groups, 0.0).mean_error(CANDIDATES[2].expand(PARTS, -1))
    found = infer(Balls(), CANDIDATES, groups, 0.0, SETTINGS, seed=0)
    assert found.error <= found.code_error <= trained < 1e-6
    assert found.start == 2


def test_the_order_of_the_candidates_plays_no_part() -> None:
    order = torch.tensor([3, 0, 4, 2, 1])
    one, other = inferred((0.25, 0.35)), inferred((0.25, 0.35), CANDIDATES[order])
    assert torch.equal(one.code, other.code)
    assert torch.equal(one.residual, other.residual)
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
    assert torch.equal(one.residual, again.residual)
    assert not torch.equal(one.code, other.code)


def test_the_error_is_the_mean_over_all_groups_each_with_its_own_residual() -> None:
    """More groups than go through the network together; one part is right, the other wrong by a tenth."""
    shape = OneShape(Balls(), two_balls((0.25, 0.35), groups=150), 0.0)
    assert shape.mean_error(torch.tensor([[0.25, 0], [0.45, 0]])) == pytest.approx(0.05, rel=1e-5)


def test_the_clamp_is_in_the_decoders_unit() -> None:
    """Where a unit is a twentieth, and a clamp of two of those is a tenth, nothing farther is asked for."""

    class Small(Balls):
        def unit(self, cuboid: torch.Tensor) -> torch.Tensor:
            return torch.full_like(cuboid[:, 0], 0.05)

    groups = two_balls((0.25, 0.35))
    codes, rows = torch.tensor([[0.3, 0], [0.3, 0]]), torch.arange(len(groups.sdf))
    wanted = groups.points - groups.cuboid[:, None, :3]
    expected = ((wanted.norm(dim=2) - 0.3).clamp(-0.1, 0.1) - groups.sdf.clamp(-0.1, 0.1)).abs() / 0.05
    torch.testing.assert_close(OneShape(Small(), groups, 2.0).errors(codes, rows), expected)


def test_a_network_that_sees_the_whole_cage_is_fitted_and_stays_as_it_is() -> None:
    """A shape that the network draws with one of the candidates has that one, and keeps it."""
    decoder = make_decoder("TriplaneDecoder", **spheres.SIZES, seed=0).requires_grad_(False)
    before = {name: tensor.clone() for name, tensor in decoder.state_dict().items()}
    groups = two_balls((0.3, 0.3))
    candidates = torch.randn(5, spheres.SIZES["latent_dim"], generator=torch.Generator().manual_seed(0))
    (codes,) = OneShape(decoder, groups, 0.0).codes(candidates[3:4])
    truth = decoder(groups.points, codes[groups.part], groups.cuboid)
    found = infer(decoder, candidates, replace(groups, sdf=truth), 0.0, SETTINGS, seed=0)
    assert found.residual.shape == (PARTS, spheres.SIZES["code_dim"])
    assert found.start == 3
    assert found.error <= found.code_error < 1e-6
    assert all(torch.equal(tensor, before[name]) for name, tensor in decoder.state_dict().items())


def test_points_of_one_ball_are_a_batch_like_those_of_training() -> None:
    """Ids, cuboids and points keep together from chunks to the code."""
    chunks = spheres.chunks(reach=0.6)
    rest = chunks.take(np.flatnonzero((chunks.step == 0) & (chunks.shape_id == 0)))
    cage = Cage.of({"body": Cuboid(np.zeros(3), np.eye(3), np.full(3, 1.2))})
    sequences = {"large": Sequence("large", None, np.zeros(1), (False,), (cage,))}
    groups = training_set(rest, sequences, LatentTable((("large", -1),), torch.zeros(1, 2)))
    found = infer(Balls(), CANDIDATES, groups, 0.0, SETTINGS, seed=0)
    assert found.code[0] == pytest.approx(spheres.RADII["large"][0], abs=2e-3)
