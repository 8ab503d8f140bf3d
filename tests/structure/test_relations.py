"""How cuboids relate is read off them, whatever frame they are in and however they are written down."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.models.relations import CONTACT, RELATIONS, relations


def kinds(cage: Cage) -> torch.Tensor:
    return relations(torch.from_numpy(cage.vectors())[None])[0]


def between(cage: Cage, a: str, b: str) -> set[str]:
    row = kinds(cage)[cage.part_ids.index(a), cage.part_ids.index(b)]
    return {name for name, holds in zip(RELATIONS, row.tolist()) if holds}


def box(centre: tuple[float, float, float], size: tuple[float, float, float], turn: float = 0.0) -> Cuboid:
    """Turned about y by so many radians."""
    c, s = np.cos(turn), np.sin(turn)
    return Cuboid(np.array(centre, float), np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]), np.array(size))


def stool() -> Cage:
    leg = (0.1, 0.5, 0.06)
    return Cage.of(
        {
            "seat": box((0, 0, 0), (0.8, 0.1, 0.8)),
            "left": box((-0.3, -0.3, 0.3), leg, 0.4),
            "right": box((0.3, -0.3, 0.3), leg, -0.4),
            "back": box((-0.3, -0.3, -0.3), leg, 0.4),
            "far": box((0, 0.9, 0), (0.3, 0.2, 0.4)),
        }
    )


def test_a_stool_has_the_relations_that_one_sees() -> None:
    cage = stool()
    assert between(cage, "seat", "seat") == {"self"}
    assert between(cage, "seat", "left") == {"attached"}
    assert between(cage, "left", "right") == {"mirrored"}
    assert between(cage, "left", "back") == {"repeated"}
    assert between(cage, "seat", "far") == between(cage, "left", "far") == set()


@pytest.mark.parametrize(("gap", "attached"), [(-0.1, True), (0.5 * CONTACT, True), (2 * CONTACT, False)])
def test_cuboids_are_attached_up_to_a_gap(gap: float, attached: bool) -> None:
    cage = Cage.of({"a": box((0, 0, 0), (0.2, 0.2, 0.2)), "b": box((0.2 + gap, 0.05, 0.1), (0.2, 0.4, 0.1))})
    assert ("attached" in between(cage, "a", "b")) == attached


def random_cage(seed: int, parts: int = 6) -> Cage:
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(parts, 3, 3)))[0]
    axes[:, 0] *= np.linalg.det(axes)[:, None]
    centre, size = rng.uniform(-0.5, 0.5, (parts, 3)), rng.uniform(0.1, 0.6, (parts, 3))
    axes[1], size[1] = axes[0], size[0]  # repeated
    mirror = np.diag([-1.0, 1.0, 1.0])
    centre[2], size[2] = mirror @ centre[0], size[0]
    axes[2] = axes[0] @ mirror * np.array([-1.0, 1.0, 1.0])[:, None]  # mirrored, right-handed
    return Cage(tuple(map(str, range(parts))), centre, axes, size)


def margin(cage: Cage) -> bool:
    """Whether small errors of rounding change nothing: no pair is near a threshold."""
    apart = Cage(cage.part_ids, cage.centre * (1 + 1e-4), cage.axes, cage.size)
    return torch.equal(kinds(cage), kinds(apart))


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_relations_hold_both_ways_and_do_not_depend_on_frame_or_notation(seed: int) -> None:
    cage, rng = random_cage(seed), np.random.default_rng(seed)
    expected = kinds(cage)
    assert torch.equal(expected, expected.transpose(0, 1))
    assert expected[0, 1, RELATIONS.index("repeated")]
    assert expected[0, 2, RELATIONS.index("mirrored")] or abs(cage.centre[0, 0]) < CONTACT
    if not margin(cage):
        return
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation[0] *= np.linalg.det(rotation)
    turned = Cage(cage.part_ids, cage.centre @ rotation.T + 0.1, cage.axes @ rotation.T, cage.size)
    assert torch.equal(kinds(turned), expected)
    order = np.array([rng.permutation(3) for _ in cage.part_ids])
    signs = rng.choice([-1.0, 1.0], (len(cage), 3, 1))
    axes = np.take_along_axis(cage.axes, order[..., None], axis=1) * signs
    renamed = Cage(cage.part_ids, cage.centre, axes, np.take_along_axis(cage.size, order, axis=1))
    assert torch.equal(kinds(renamed), expected)


def test_cuboids_in_one_place_are_repeated_but_have_no_plane_between_them() -> None:
    cage = Cage.of({"a": box((0, 0, 0), (0.2, 0.3, 0.4)), "b": box((0, 0, 0), (0.2, 0.3, 0.4))})
    assert between(cage, "a", "b") == {"attached", "repeated"}
