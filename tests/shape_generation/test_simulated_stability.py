"""What stays standing in Bullet: what must by the laws, as the support polygon has it, and wherever it is."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation as Turn

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import InputError
from cagesdf.shape_generation import simulated_stability as simulation
from cagesdf.shape_generation.simulated_stability import inertia, stays_standing
from cagesdf.shape_generation.static_stability import stable


@pytest.fixture(scope="module")
def _bullet() -> None:
    pytest.importorskip(
        "pybullet", reason="the extra `physics` is not installed; it has wheels for Python 3.11 on Linux"
    )


bullet = pytest.mark.usefixtures("_bullet")
DENSE = np.stack(np.meshgrid(*[(np.arange(40) + 0.5) / 40 - 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


def box(x: float, y: float, z: float, width: float, height: float, depth: float) -> Cuboid:
    """An upright one; x, y, z are the middle of its bottom."""
    return Cuboid(np.array([x, y + height / 2, z]), np.eye(3), np.array([width, height, depth], float))


def table(*legs: tuple[float, float]) -> Cage:
    """A top of 1 by 1 on legs below these shares of its half width."""
    found = {f"leg{i}": box(0.45 * x, 0, 0.45 * z, 0.1, 0.8, 0.1) for i, (x, z) in enumerate(legs)}
    return Cage.of({"top": box(0, 0.8, 0, 1, 0.1, 1)} | found)


def beside(cuboid: Cuboid, x: float) -> Cuboid:
    return Cuboid(cuboid.centre + np.array([x, 0, 0]), cuboid.axes, cuboid.size)


SQUARE = ((-1, -1), (-1, 1), (1, -1), (1, 1))
ROOF = Cage.of({"roof": Cuboid(np.array([0, 0.5, 0]), Turn.from_rotvec([0, 0, np.pi / 4]).as_matrix(), np.ones(3))})
STANDING = {
    "cube": Cage.of({"cube": box(0, 0, 0, 1, 1, 1)}),
    "table": table(*SQUARE),
    "on three legs": table((-1, -1), (1, -1), (0, 1)),
    "two tables": Cage.of(
        {f"{name}{i}": beside(part, 3 * i) for i in range(2) for name, part in table(*SQUARE).cuboids().items()}
    ),
}  # fmt: skip
FALLING = {
    "on one leg": table((1, 1)),
    "on two legs of a side": table((1, -1), (1, 1)),
    "on its edge": ROOF,
    "one table of two": Cage.of(
        {**STANDING["table"].cuboids(),
         **{f"other {name}": beside(part, 3) for name, part in table((1, -1), (1, 1)).cuboids().items()}}
    ),
    "in the air": Cage.of({"cube": box(0, 0, 0, 1, 1, 1), "lamp": box(0, 2, 0, 0.1, 0.1, 0.1)}),
}  # fmt: skip


@bullet
@pytest.mark.parametrize("name", STANDING)
def test_what_stands_by_the_support_polygon_stays_standing(name: str) -> None:
    assert stable(STANDING[name])
    assert stays_standing(STANDING[name])


@bullet
@pytest.mark.parametrize("name", FALLING)
def test_what_falls_by_the_support_polygon_falls(name: str) -> None:
    assert not stable(FALLING[name])
    assert not stays_standing(FALLING[name])


@bullet
@settings(deadline=None, max_examples=15)
@given(st.floats(-np.pi, np.pi), st.floats(-3, 3), st.floats(-3, 3))
def test_it_is_the_same_wherever_a_cage_stands(angle: float, x: float, height: float) -> None:
    turn = Turn.from_rotvec([0, angle, 0])
    for cage, stays in ((STANDING["table"], True), (FALLING["on two legs of a side"], False)):
        there = Cage(
            cage.part_ids,
            turn.apply(cage.centre) + np.array([x, height, -x]),
            cage.axes @ turn.as_matrix().T,
            cage.size,
        )
        assert stays_standing(there) == stays


@given(st.integers(0, 2**32 - 1))
def test_inertia_is_that_of_the_points_of_the_cuboids(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 4))
    cage = Cage(
        tuple(f"p{i}" for i in range(count)),
        rng.uniform(-1, 1, (count, 3)),
        Turn.random(count, rng=rng).as_matrix(),
        rng.uniform(0.1, 1, (count, 3)),
    )
    points = np.concatenate([cage.from_unit(DENSE, i) for i in range(count)])
    mass = np.repeat(cage.size.prod(axis=1) / len(DENSE), len(DENSE))
    centre = np.average(points, axis=0, weights=mass)
    arm = points - centre
    tensor = (mass[:, None] * arm).T @ arm
    tensor = np.trace(tensor) * np.eye(3) - tensor
    found_mass, found_centre, found = inertia(cage)
    np.testing.assert_allclose([found_mass, *found_centre], [mass.sum(), *centre], atol=1e-9)
    np.testing.assert_allclose(found, tensor, rtol=2e-3, atol=2e-3 * np.trace(tensor))


def test_without_the_simulator_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(InputError, match=r"pip install 'cagesdf\[physics\]'"):
        simulation.stays_standing(STANDING["cube"])
