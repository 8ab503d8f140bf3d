"""Occupancy: a logit in place of the distance, joined by max."""

from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn.functional import binary_cross_entropy

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import InputError
from cagesdf.extraction import METHODS, CageField, extract
from cagesdf.frames import LARGEST_UNIT
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.models.arms import make_decoder
from cagesdf.models.occupancy import TEMPERATURE, OccupancyDecoder
from pipeline.params import check, read_yaml
from pipeline.workspace import ROOT, merged, profile_settings
from tests.support import spheres
from tests.support.analytic import box_sdf

BOX = (0.3, 0.5, 0.2)  # of the solid
LENGTHS = (0.5, 0.6, 0.4)  # of its cuboid
STEPS = 120


def network(seed: int = 0) -> OccupancyDecoder:
    decoder = make_decoder("OccupancyDecoder", **spheres.SIZES, seed=seed)
    assert isinstance(decoder, OccupancyDecoder)
    return decoder


UNTRAINED = network()


def cuboids(*units: float) -> torch.Tensor:
    """Vectors of cuboids with these smallest lengths."""
    vectors = torch.ones(len(units), 15, dtype=torch.float64)
    vectors[:, 13] = torch.tensor(units)
    return vectors


def cage_of(*centres: tuple[float, float, float]) -> Cage:
    lengths = np.array(LENGTHS)
    return Cage.of({f"p{i}": Cuboid(np.array(centre), np.eye(3), lengths) for i, centre in enumerate(centres)})


def points_of(cage: Cage, count: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Points in the first cuboid, and their distances to the box in its middle."""
    points = cage.from_unit(np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 3)), 0)
    sdf = box_sdf(points - cage.centre[0], BOX)
    return torch.tensor(points, dtype=torch.float32)[None], torch.tensor(sdf, dtype=torch.float32)[None]


def fitted() -> tuple[OccupancyDecoder, torch.Tensor]:
    """A network after a short fit to a box in the middle of its cuboid, and the part's code."""
    decoder, cage = network(), cage_of((0.0, 0.0, 0.0))
    cuboid = torch.from_numpy(cage.vectors()).float()
    code = torch.nn.Parameter(0.1 * torch.ones(1, spheres.SIZES["code_dim"]))
    optimiser = torch.optim.Adam([*decoder.parameters(), code], lr=0.02)
    for step in range(STEPS):
        points, sdf = points_of(cage, 512, step)
        optimiser.zero_grad()
        decoder.errors(decoder(points, code, cuboid), sdf, cuboid, 0.0).mean().backward()
        optimiser.step()
    return decoder.eval().requires_grad_(False), code.detach()


@pytest.fixture(scope="module")
def box() -> tuple[OccupancyDecoder, torch.Tensor]:
    return fitted()


def test_a_short_fit_says_inside_where_the_box_is(box: tuple[OccupancyDecoder, torch.Tensor]) -> None:
    decoder, code = box
    cage = cage_of((0.0, 0.0, 0.0))
    cuboid = torch.from_numpy(cage.vectors()).float()
    points, sdf = points_of(cage, 4000, STEPS)
    values = decoder(points, code, cuboid)
    clear = sdf.abs() > 0.03
    assert clear.double().mean() > 0.5
    assert torch.equal((decoder.logit(values, cuboid) > 0)[clear], (sdf < 0)[clear])
    assert torch.equal(decoder.logit(values, cuboid) > 0, values < 0)


def test_values_near_the_surface_are_distances(box: tuple[OccupancyDecoder, torch.Tensor]) -> None:
    decoder, code = box
    cage = cage_of((0.0, 0.0, 0.0))
    points, sdf = points_of(cage, 4000, STEPS)
    values = decoder(points, code, torch.from_numpy(cage.vectors()).float())
    near = sdf.abs() < TEMPERATURE * LARGEST_UNIT
    assert (values - sdf)[near].abs().mean() < 0.02


def test_the_surface_of_two_parts_is_that_of_their_largest_logit(box: tuple[OccupancyDecoder, torch.Tensor]) -> None:
    """Where both cuboids say something, and where one does."""
    decoder, code = box
    cage = cage_of((0.0, 0.0, 0.0), (0.2, 0.1, 0.05))
    field = CageField(decoder, code.expand(2, -1), cage)
    points = np.random.default_rng(0).uniform(-0.4, 0.6, (6000, 3))
    logits, values = np.full((2, len(points)), -np.inf), np.full((2, len(points)), np.inf)
    for k, vector in enumerate(torch.from_numpy(cage.vectors()).float()):
        held = (np.abs(cage.to_unit(points, k)) < 0.5).all(axis=1)
        values[k, held] = field.values(points[held], k)
        of_part = torch.from_numpy(values[k, held]).float()[None]
        logits[k, held] = decoder.logit(of_part, vector[None])[0].numpy()
    inside = logits.max(axis=0) > 0
    np.testing.assert_array_equal(inside, values.min(axis=0) < 0)
    assert (np.isfinite(logits).all(axis=0) & inside).any()
    cell = 2.1 / 64
    for method in METHODS.values():
        surface = SurfaceDistance(extract(field, 64, method).mesh)
        clear = surface.unsigned(points) > cell / 2
        np.testing.assert_array_equal(surface.inside(points[clear]), inside[clear])


@given(
    predicted=st.floats(-2, 2),
    sdf=st.floats(-2, 2),
    unit=st.floats(0.04, LARGEST_UNIT),
    factor=st.sampled_from([0.5, 1.0, 2.0]),
)
@settings(max_examples=60, deadline=None)
def test_errors_are_zero_for_the_truth_no_more_than_distances_errors_and_blind_to_sign_and_size(
    predicted: float, sdf: float, unit: float, factor: float
) -> None:
    decoder, cuboid = UNTRAINED, cuboids(unit)
    answer, truth = torch.tensor([[predicted]], dtype=torch.float64), torch.tensor([[sdf]], dtype=torch.float64)
    error = float(decoder.errors(answer, truth, cuboid, 0.0))
    assert -1e-9 <= error <= abs(predicted - sdf) / unit + 1e-9
    assert float(decoder.errors(truth, truth, cuboid, 0.0)) == 0
    assert float(decoder.errors(-answer, -truth, cuboid, 0.0)) == pytest.approx(error, abs=1e-9)
    grown = cuboids(min(factor * unit, LARGEST_UNIT))
    factor = float(decoder.unit(grown) / decoder.unit(cuboid))
    assert float(decoder.errors(factor * answer, factor * truth, grown, 0.0)) == pytest.approx(error, abs=1e-9)


def test_walls_of_large_parts_are_learnt_as_sharply_as_those_of_small_ones() -> None:
    decoder, values = UNTRAINED, torch.linspace(-0.05, 0.05, 11, dtype=torch.float64)
    large, small = cuboids(0.9), cuboids(LARGEST_UNIT)
    for truth in (0.0, 0.01, -0.02):
        sdf = torch.full_like(values, truth)[None]
        of_large, of_small = (decoder.errors(values[None], sdf, of, 0.0) for of in (large, small))
        assert torch.equal(of_large, of_small)
        assert of_large.max() > 0


def test_errors_are_cross_entropies_less_the_least_there_is() -> None:
    decoder, cuboid = network(), cuboids(0.08)
    values = torch.linspace(-0.04, 0.04, 9, dtype=torch.float64)
    predicted, sdf = (grid.reshape(1, -1) for grid in torch.meshgrid(values, values, indexing="ij"))
    probability, label = (1 / (1 + (value / (0.08 * TEMPERATURE)).exp()) for value in (predicted, sdf))
    expected = TEMPERATURE * (
        binary_cross_entropy(probability, label, reduction="none")
        - binary_cross_entropy(label, label, reduction="none")
    )
    torch.testing.assert_close(decoder.errors(predicted, sdf, cuboid, 0.0), expected)


def test_gradients_of_errors_are_their_finite_differences() -> None:
    decoder, cuboid = network(), cuboids(0.09, 0.05)
    generator = torch.Generator().manual_seed(0)
    predicted, sdf = 0.03 * torch.randn(2, 2, 40, generator=generator, dtype=torch.float64)
    predicted.requires_grad_()
    assert torch.autograd.gradcheck(lambda values: decoder.errors(values, sdf, cuboid, 0.0), (predicted,))
    (gradient,) = torch.autograd.grad(decoder.errors(predicted, sdf, cuboid, 0.0).sum(), predicted)
    assert torch.equal(gradient.sign(), (predicted - sdf).sign())
    assert (gradient.abs() <= 1 / decoder.unit(cuboid)[:, None]).all()


def test_gradients_of_weights_and_code_are_their_finite_differences() -> None:
    decoder, cage = network().double(), cage_of((0.1, 0.0, -0.1))
    cuboid = torch.from_numpy(cage.vectors()).double()
    points, sdf = (tensor.double() for tensor in points_of(cage, 30, 0))
    code = torch.full((1, spheres.SIZES["code_dim"]), 0.3, dtype=torch.float64)

    def loss() -> torch.Tensor:
        return decoder.errors(decoder(points, code, cuboid), sdf, cuboid, 0.0).mean()

    code.requires_grad_()
    leaves = [code, decoder.out.weight, decoder.out.bias, decoder.planes.weight]
    for leaf, gradient in zip(leaves, torch.autograd.grad(loss(), leaves)):
        place = int(gradient.abs().argmax())
        flat, step = leaf.data.view(-1), 1e-6
        with torch.no_grad():
            flat[place] += step
            above = loss()
            flat[place] -= 2 * step
            below = loss()
            flat[place] += step
        assert float(gradient.view(-1)[place]) == pytest.approx(float(above - below) / (2 * step), rel=1e-4)


def test_a_fit_repeats_to_the_bit(box: tuple[OccupancyDecoder, torch.Tensor]) -> None:
    decoder, code = fitted()
    assert torch.equal(code, box[1])
    weights = box[0].state_dict()
    assert all(torch.equal(tensor, weights[name]) for name, tensor in decoder.state_dict().items())


def test_a_clamp_of_distances_is_refused_with_what_to_do() -> None:
    with pytest.raises(InputError, match=r"learns a logit, and clamp 0\.6 is of distances; wanted clamp 0"):
        network().errors(torch.zeros(1, 2), torch.zeros(1, 2), cuboids(0.3), 0.6)


def test_the_profile_of_ablations_has_the_arm_which_differs_in_its_loss_alone(tmp_path: Path) -> None:
    defaults = read_yaml((ROOT / "params.yaml").read_bytes(), "params.yaml")
    (tmp_path / "params.yaml").write_text(
        yaml.safe_dump(merged(defaults, profile_settings("ablations"))), encoding="utf-8"
    )
    sections = check(tmp_path / "params.yaml")
    arm, default = (sections[f"arms.{name}"].model_dump() for name in ("cagesdf_distance", "cagesdf"))
    changed = {name for name in arm if arm[name] != default[name]}
    assert changed == {"decoder", "clamp"}
    assert (default["decoder"], default["clamp"]) == ("OccupancyDecoder", 0)
