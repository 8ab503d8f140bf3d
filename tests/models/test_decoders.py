"""Networks: what each of them looks at, and that groups change nothing."""

from typing import Any

import numpy as np
import pytest
import torch

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import InputError
from cagesdf.models.arms import DECODERS, make_decoder
from cagesdf.models.decoders import CUBOID, Decoder, check_placement, to_unit
from cagesdf.models.sines import sine_features
from tests.support import spheres

SIZES: dict[str, Any] = {
    **spheres.SIZES,
    "width": 16,
    "layers": 4,
    "latent_dim": 5,
    "mapping": (12, 12),
    "octaves": 2,
    "code_dim": 5,
    "cells": 4,
    "channels": 3,
    "line_cells": 6,
    "context_layers": 2,
}


@pytest.fixture(params=sorted(DECODERS))
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def groups(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Three groups of seven points with codes and proper cuboids."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3, 3)))[0]
    axes[:, 0] *= np.linalg.det(axes)[:, None]
    cage = Cage(("a", "b", "c"), rng.uniform(-0.3, 0.3, (3, 3)), axes, rng.uniform(0.2, 0.9, (3, 3)))
    tensors = rng.uniform(-1, 1, (3, 7, 3)), rng.normal(size=(3, 5)), cage.vectors()
    points, code, cuboid = (torch.tensor(array, dtype=torch.float32) for array in tensors)
    return points, code, cuboid


def test_every_decoder_takes_the_same_call_and_answers_one_number_a_point(name: str) -> None:
    answer = make_decoder(name, **SIZES, seed=0)(*groups())
    assert answer.shape == (3, 7)
    assert torch.isfinite(answer).all()


def test_the_code_matters_to_every_decoder(name: str) -> None:
    decoder = make_decoder(name, **SIZES, seed=0)
    points, code, cuboid = groups()
    assert (decoder(points, code, cuboid) - decoder(points, code + 1, cuboid)).abs().min() > 1e-6


def test_the_cuboid_matters_to_cage_decoders_and_never_to_the_baseline(name: str) -> None:
    decoder = make_decoder(name, **SIZES, seed=0)
    points, code, cuboid = groups()
    change = (decoder(points, code, cuboid) - decoder(points, code, cuboid * 1.5)).abs()
    assert change.max() == 0 if name == "DeepSdfDecoder" else change.min() > 1e-6


def test_conditions_computed_once_a_group_equal_those_computed_for_every_point(name: str) -> None:
    decoder = make_decoder(name, **SIZES, seed=0)
    points, code, cuboid = groups()
    alone = [
        decoder(points[g : g + 1, n : n + 1], code[g : g + 1], cuboid[g : g + 1]) for g in range(3) for n in range(7)
    ]
    torch.testing.assert_close(decoder(points, code, cuboid), torch.cat(alone).reshape(3, 7))


def test_the_same_seed_gives_the_same_weights_and_leaves_the_global_generator_alone(name: str) -> None:
    before = torch.get_rng_state()
    one, same, other = (make_decoder(name, **SIZES, seed=seed).state_dict() for seed in (3, 3, 4))
    assert torch.equal(before, torch.get_rng_state())
    assert all(torch.equal(one[key], same[key]) for key in one)
    assert any(not torch.equal(one[key], other[key]) for key in one)


def test_an_unknown_decoder_is_refused_with_the_names_of_those_there_are() -> None:
    with pytest.raises(InputError, match=r"'Mlp'.*TriplaneDecoder"):
        make_decoder("Mlp", **SIZES, seed=0)


def test_a_size_that_is_missing_is_named() -> None:
    with pytest.raises(InputError, match="CageDecoder: no layers; wanted all of width, layers"):
        make_decoder("CageDecoder", 0, **{name: size for name, size in SIZES.items() if name != "layers"})


def test_unit_coordinates_are_those_of_the_cage() -> None:
    points, _, cuboid = groups()
    cage = Cage.from_vectors(("a", "b", "c"), cuboid.double().numpy())
    expected = np.stack([cage.to_unit(points[i].double().numpy(), i) for i in range(3)])
    np.testing.assert_allclose(to_unit(points, cuboid).numpy(), expected, atol=1e-5)


def test_unit_coordinates_do_not_change_when_point_and_cuboid_move_together() -> None:
    points, _, cuboid = groups()
    turn = torch.tensor(np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0], dtype=torch.float32)
    shift = torch.tensor([0.3, -0.2, 0.5])
    moved = [
        Cage.of({"a": Cuboid((turn @ v[:3] + shift).numpy(), (v[3:12].view(3, 3) @ turn.T).numpy(), v[12:].numpy())})
        for v in cuboid
    ]
    vectors = torch.tensor(np.concatenate([cage.vectors() for cage in moved]), dtype=torch.float32)
    assert vectors.shape == (3, CUBOID)
    torch.testing.assert_close(to_unit(points @ turn.T + shift, vectors), to_unit(points, cuboid), atol=1e-5, rtol=0)


def test_sine_features_are_sines_and_cosines_of_doubling_frequency() -> None:
    points, _, _ = groups()
    features = sine_features(points, 3)
    expected = torch.cat([f(np.pi * 2**k * points) for k in range(3) for f in (torch.sin, torch.cos)], dim=-1)
    torch.testing.assert_close(features, expected)
    assert sine_features(points, 0).shape == (3, 7, 0)


class Placed(Decoder):
    """Trains on parts and looks at the whole cuboid, its place too, or at the lengths alone."""

    trains_on = "part"

    def __init__(self, first: int) -> None:
        super().__init__()
        self.first = first
        self.layer = torch.nn.Linear(3 + CUBOID - first, 1)
        torch.nn.init.zeros_(self.layer.weight)

    def features(self, points: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return to_unit(points, cuboid)

    def condition(self, code: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return cuboid[:, self.first :]

    def evaluate(self, features: torch.Tensor, condition: torch.Tensor, compute_dtype: torch.dtype) -> torch.Tensor:
        inputs = torch.cat([features, condition[:, None].expand(*features.shape[:2], -1)], dim=-1)
        return self.layer(inputs).sum(dim=-1)


def test_a_decoder_of_parts_that_sees_where_its_cuboid_stands_is_refused() -> None:
    check_placement(Placed(first=12), 4)
    for first in (0, 3):
        with pytest.raises(InputError, match=r"Placed: trains on parts, but .* depend on where the cuboid stands"):
            check_placement(Placed(first), 4)


def test_the_decoders_that_there_are_pass(name: str) -> None:
    decoder = make_decoder(name, **SIZES, seed=0)
    before = {key: tensor.clone() for key, tensor in decoder.state_dict().items()}
    check_placement(decoder, SIZES["latent_dim"])
    assert all(torch.equal(before[key], tensor) for key, tensor in decoder.state_dict().items())
    assert all(parameter.requires_grad for parameter in decoder.parameters())
