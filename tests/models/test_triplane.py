"""The decoder of parts: codes that see their whole cage, planes and lines that are read as pictures are."""

from itertools import combinations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.frames import BEYOND, LEAST_UNIT
from cagesdf.models.arms import DECODERS, make_decoder
from cagesdf.models.codes import part_codes
from cagesdf.models.decoders import Decoder
from cagesdf.models.triplane import TriplaneDecoder
from cagesdf.training.batches import Cages
from tests.support import spheres

PARTS = 5


def network() -> TriplaneDecoder:
    decoder = make_decoder("TriplaneDecoder", **spheres.SIZES, seed=0)
    assert isinstance(decoder, TriplaneDecoder)
    return decoder.requires_grad_(False)


def cage(parts: int = PARTS, seed: int = 0) -> Cage:
    rng = np.random.default_rng([parts, seed])
    axes = np.linalg.qr(rng.normal(size=(parts, 3, 3)))[0]
    axes[:, 0] *= np.linalg.det(axes)[:, None]
    names = tuple(f"p{i}" for i in range(parts))
    return Cage(names, rng.uniform(-0.5, 0.5, (parts, 3)), axes, rng.uniform(0.05, 0.9, (parts, 3)))


def latents(count: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(count, spheres.SIZES["latent_dim"], generator=torch.Generator().manual_seed(seed))


@given(order=st.permutations(range(PARTS)), seed=st.integers(0, 50))
@settings(max_examples=20, deadline=None)
def test_codes_follow_the_parts_when_these_change_places(order: list[int], seed: int) -> None:
    decoder, given, (latent,) = network(), cage(seed=seed), latents(1, seed)
    turned = Cage(tuple(given.part_ids[i] for i in order), given.centre[order], given.axes[order], given.size[order])
    codes = part_codes(decoder, latent, given)
    torch.testing.assert_close(part_codes(decoder, latent, turned), codes[order], rtol=1e-4, atol=1e-5)


def test_codes_of_a_cage_depend_on_all_its_cuboids_and_on_the_shapes_code() -> None:
    decoder, given, (latent, other) = network(), cage(), latents(2)
    codes = part_codes(decoder, latent, given)
    centre = given.centre.copy()
    centre[3] += 0.2
    moved = Cage(given.part_ids, centre, given.axes, given.size)
    for changed in (part_codes(decoder, latent, moved), part_codes(decoder, other, given)):
        assert (changed - codes).abs().amax(dim=1).min() > 1e-5


@pytest.mark.parametrize("name", sorted(DECODERS))
def test_codes_depend_neither_on_absent_parts_nor_on_the_other_cages_of_a_batch(name: str) -> None:
    decoder = make_decoder(name, **spheres.SIZES, seed=0).requires_grad_(False)
    given = [cage(parts) for parts in (2, 5, 1, 3)]
    cages = Cages.of((item, row) for row, item in enumerate(given))
    table = latents(4)
    cuboids = torch.where(cages.present[..., None], cages.cuboids, torch.tensor(7.0))
    for whole in (cages.cuboids, cuboids):
        codes = decoder.codes(table, whole, cages.present)
        for row, item in enumerate(given):
            alone = part_codes(decoder, table[row], item)
            torch.testing.assert_close(codes[row, : len(item)], alone, rtol=1e-4, atol=1e-5)


def test_absent_parts_send_no_gradient_back() -> None:
    decoder = network()
    cages = Cages.of([(cage(2), 0), (cage(4), 1)])
    cuboids = cages.cuboids.clone().requires_grad_()
    codes = decoder.codes(latents(2), cuboids, cages.present)
    (gradient,) = torch.autograd.grad(codes[cages.present].sum(), cuboids)
    assert not gradient[~cages.present].any()
    assert gradient[cages.present].abs().amax(dim=1).min() > 0


@pytest.mark.parametrize("name", ["CageDecoder", "DeepSdfDecoder"])
def test_codes_of_the_other_decoders_are_the_shapes_own(name: str) -> None:
    decoder = make_decoder(name, **spheres.SIZES, seed=0)
    (latent,) = latents(1)
    assert torch.equal(part_codes(decoder, latent, cage()), latent.expand(PARTS, -1))
    assert torch.equal(decoder.unit(torch.from_numpy(cage().vectors()).float()), torch.ones(PARTS))


def place(coordinate: float, cells: int) -> float:
    """A coordinate of the unit frame in cells."""
    return float(np.clip((coordinate + 0.5 + BEYOND) / (1 + 2 * BEYOND), 0, 1)) * (cells - 1)


def slowly(planes: np.ndarray, lines: np.ndarray, point: np.ndarray) -> np.ndarray:
    """The features of one point: of each plane the four cells around it, of each line the two, each by its nearness.

    `planes` 3 c h w, `lines` 3 c r.
    """
    features = []
    for plane, (a, b) in zip(planes, combinations(range(3), 2)):
        cells = plane.shape[-1]
        u, v = (place(point[k], cells) for k in (a, b))
        total = np.zeros(len(plane))
        for row in range(cells):
            for column in range(cells):
                total += plane[:, row, column] * max(0, 1 - abs(u - column)) * max(0, 1 - abs(v - row))
        features.append(total)
    for line, coordinate in zip(lines, point):
        u = place(coordinate, line.shape[-1])
        features.append(sum(line[:, i] * max(0, 1 - abs(u - i)) for i in range(line.shape[-1])))
    return np.concatenate(features)


def test_planes_and_lines_are_read_linearly_to_their_ends_and_hold_their_border_beyond() -> None:
    decoder, rng = network(), np.random.default_rng(0)
    planes = rng.normal(size=(2, 3, decoder.channels, decoder.cells, decoder.cells)).astype(np.float32)
    lines = rng.normal(size=(2, 3, decoder.line_channels, decoder.line_cells)).astype(np.float32)
    unit = rng.uniform(-0.8, 0.8, (2, 40, 3)).astype(np.float32)
    unit[:, 0], unit[:, 1] = 0.5 + BEYOND, 0.5
    of_planes, of_lines = (torch.from_numpy(numbers).flatten(1) for numbers in (planes, lines))
    read = decoder.read(of_planes, of_lines, torch.from_numpy(unit)).numpy()
    expected = np.array([[slowly(planes[g], lines[g], point) for point in unit[g]] for g in range(2)])
    np.testing.assert_allclose(read, expected, atol=1e-5)


def test_planes_and_lines_are_linear_in_the_code() -> None:
    decoder, (a, b) = network(), torch.randn(2, 1, 6, generator=torch.Generator().manual_seed(0))
    cuboid, count = torch.from_numpy(cage(1).vectors()).float(), 3 * (4 * 25 + 2 * 8)
    planes = [decoder.condition(code, cuboid)[:, :count] for code in (a, b, 0.3 * a + 0.7 * b)]
    torch.testing.assert_close(planes[2], 0.3 * planes[0] + 0.7 * planes[1])


def test_distances_are_in_the_smallest_length_of_the_cuboid_and_no_length_is_too_small() -> None:
    cuboids = torch.cat([torch.zeros(3, 3), torch.eye(3).flatten().expand(3, 9), torch.ones(3, 3)], dim=1)
    cuboids[:, 13] = torch.tensor([0.3, LEAST_UNIT, 1e-4])
    decoder = network()
    torch.testing.assert_close(decoder.unit(cuboids), torch.tensor([0.3, LEAST_UNIT, LEAST_UNIT]))
    points = torch.zeros(3, 1, 3)
    condition = decoder.condition(torch.zeros(3, 6), cuboids)
    features = decoder.features(points, cuboids)
    doubled = condition.clone()
    doubled[:, -1] *= 2
    one, two = (decoder.evaluate(features, values, torch.float32) for values in (condition, doubled))
    torch.testing.assert_close(two, 2 * one)


def test_errors_are_in_the_cuboids_unit_and_the_clamp_cuts_prediction_and_truth_there() -> None:
    cuboids = torch.ones(2, 15)
    cuboids[1, 13] = 0.5  # its smallest length
    predicted, sdf = torch.tensor([[0.5, -0.05]]).expand(2, 2), torch.tensor([[0.2, 0.5]]).expand(2, 2)
    decoder = network()
    clamped, free = (decoder.errors(predicted, sdf, cuboids, clamp) for clamp in (0.1, 0.0))
    torch.testing.assert_close(clamped, torch.tensor([[0.0, 0.15], [0.0, 0.2]]))
    torch.testing.assert_close(free, torch.tensor([[0.3, 0.55], [0.6, 1.1]]))


@pytest.mark.parametrize("factor", [0.5, 1.7])
def test_a_part_grows_with_its_cuboid_and_its_distances_with_it(factor: float) -> None:
    """With what its code and lengths do to the layers held, and its smallest length still a unit."""
    decoder, rng = network(), np.random.default_rng(1)
    given = Cage(("p",), np.full((1, 3), 0.1), cage(1).axes, np.array([[0.3, 0.5, 0.9]]))
    grown = Cage(("p",), factor * given.centre, given.axes, factor * given.size)
    cuboids = [torch.from_numpy(item.vectors()).float() for item in (given, grown)]
    code = torch.randn(1, spheres.SIZES["code_dim"], generator=torch.Generator().manual_seed(0))
    condition = decoder.condition(code, cuboids[0])
    other = torch.cat([condition[:, :-1], decoder.unit(cuboids[1])[:, None]], dim=1)
    points = torch.from_numpy(given.from_unit(rng.uniform(-0.5, 0.5, (20, 3)), 0)).float()[None]
    before = decoder.evaluate(decoder.features(points, cuboids[0]), condition, torch.float32)
    after = decoder.evaluate(decoder.features(factor * points, cuboids[1]), other, torch.float32)
    torch.testing.assert_close(after, factor * before, rtol=1e-3, atol=1e-5)


def test_a_part_is_the_same_wherever_its_cuboid_stands() -> None:
    """With its code held, a part moves and turns with its cuboid."""
    decoder, given = network(), cage(1)
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn[0] *= np.linalg.det(turn)
    moved = Cage(given.part_ids, given.centre @ turn.T + 0.3, given.axes @ turn.T, given.size)
    unit, code = rng.uniform(-0.5, 0.5, (20, 3)), torch.randn(1, 6, generator=torch.Generator().manual_seed(0))
    answers = [distances(decoder, code, item, item.from_unit(unit, 0)) for item in (given, moved)]
    torch.testing.assert_close(*answers, rtol=1e-3, atol=1e-5)


def distances(decoder: Decoder, code: torch.Tensor, given: Cage, points: np.ndarray) -> torch.Tensor:
    cuboid = torch.from_numpy(given.vectors()).float()
    return decoder(torch.from_numpy(points).float()[None], code, cuboid)[0]


def test_heads_that_do_not_share_the_width_are_refused_with_both_numbers() -> None:
    with pytest.raises(InputError, match=r"8 units.*3 heads"):
        make_decoder("TriplaneDecoder", **{**spheres.SIZES, "heads": 3}, seed=0)
