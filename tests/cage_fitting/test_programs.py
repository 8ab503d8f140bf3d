"""Fitting programs: no worse than the appendix's Adam, exact beside the obvious sums, and bounding where it can be."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from cagesdf.cage_fitting.hinge import Hinge
from cagesdf.cage_fitting.programs import (
    DAMPING,
    _Overshoot,
    _Penalty,
    _Problem,
    _Sticking,
    bound_program,
    fit_program,
    fitting_loss,
    match_axes,
)
from cagesdf.cuboid import PROPER_PERMUTATIONS, Cage
from cagesdf.structure.executor import differentiate, execute
from cagesdf.structure.parsing import parse
from cagesdf.structure.program import AssemblyProgram
from tests.support.adam import fit_by_adam, loss_of

SEEDS = st.integers(0, 2**32 - 1)
CHAIR = """
Assembly Program_0 {
    bbox = Cuboid(0.8, 1.5, 0.8, True)
    Program_1 = Cuboid(0.7, 0.6, 0.7, True)
    cube1 = Cuboid(0.8, 0.1, 0.8, True)
    cube2 = Cuboid(0.8, 0.8, 0.1, False)
    attach(Program_1, bbox, 0.5, 0.0, 0.5, 0.5, 0.0, 0.5)
    attach(cube1, Program_1, 0.5, 0.0, 0.5, 0.5, 1.0, 0.5)
    attach(cube2, cube1, 0.5, 0.0, 0.5, 0.5, 1.0, 0.1)
    attach(cube2, bbox, 0.5, 1.0, 0.5, 0.5, 1.0, 0.0)
}
Assembly Program_1 {
    bbox = Cuboid(0.7, 0.6, 0.7, True)
    cube0 = Cuboid(0.05, 0.6, 0.05, True)
    cube1 = Cuboid(0.05, 0.6, 0.05, False)
    squeeze(cube0, bbox, bbox, top, 0.05, 0.95)
    attach(cube1, bbox, 0.5, 1.0, 0.5, 0.1, 1.0, 0.15)
    attach(cube1, bbox, 0.5, 0.0, 0.5, 0.05, 0.0, 0.03)
    reflect(cube0, X)
    reflect(cube1, X)
}
"""
LEANING = """
Assembly Program_0 {
    bbox = Cuboid(1.0, 1.0, 1.0, True)
    cube0 = Cuboid(1.0, 0.1, 1.0, True)
    cube1 = Cuboid(0.1, 0.9, 0.1, False)
    attach(cube0, bbox, 0.5, 1.0, 0.5, 0.5, 1.0, 0.5)
    attach(cube1, cube0, 0.5, 1.0, 0.5, 0.3, 0.0, 0.5)
    attach(cube1, bbox, 0.5, 0.0, 0.5, 0.1, 0.0, 0.5)
}
"""
SLATS = """
Assembly Program_0 {
    bbox = Cuboid(1.0, 1.0, 0.2, True)
    cube0 = Cuboid(1.0, 0.1, 0.2, True)
    cube1 = Cuboid(0.1, 0.9, 0.05, True)
    attach(cube0, bbox, 0.5, 0.0, 0.5, 0.5, 0.0, 0.5)
    squeeze(cube1, bbox, cube0, top, 0.1, 0.5)
    translate(cube1, X, 3, 0.8)
}
"""


def parts_of(program: AssemblyProgram, seed: int, noise: float, count: int = 300) -> tuple[Cage, np.ndarray]:
    """Boxes near the program's leaves, and points on rounded parts that touch all their faces."""
    rng = np.random.default_rng(seed)
    cage = execute(program)
    size = cage.size * np.exp(noise * rng.normal(size=cage.size.shape))
    centre = cage.centre + noise * rng.normal(size=size.shape) * size / 2
    boxes = Cage(cage.part_ids, centre, cage.axes, size)
    ball = rng.normal(size=(len(cage), count, 3))
    ball /= (np.abs(ball) ** 6).sum(axis=2, keepdims=True) ** (1 / 6)
    ball[:, :6] = np.concatenate([np.eye(3), -np.eye(3)])
    return boxes, np.array([boxes.from_unit(ball[i] / 2, i) for i in range(len(cage))])


def overshoots(cage: Cage, points: np.ndarray) -> np.ndarray:
    return np.array([cage.signed_distance(own)[:, i].max() for i, own in enumerate(points)])


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_the_points_sorted_once_give_the_hinge_and_its_slope_as_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes, points = parts_of(parse(CHAIR), seed, 0.1)
    hinge = Hinge(points)
    for step in (0.0, 1e-4, 1e-3, 3e-3, 0.03):
        numbers = boxes.vectors() + step * rng.normal(size=(len(boxes), 15))
        vectors = torch.tensor(numbers, requires_grad=True)
        loss = loss_of(vectors, vectors.detach(), torch.tensor(points))
        loss.backward()
        value, slope = hinge(numbers)
        assert value == pytest.approx(loss.item(), rel=1e-5)
        # float32 may put a point or two on the other side of an edge.
        assert vectors.grad is not None
        np.testing.assert_allclose(slope, vectors.grad.numpy(), atol=3 / points.shape[1] / len(boxes))


def test_the_loss_is_the_appendixs() -> None:
    program = parse(CHAIR)
    boxes, points = parts_of(program, 0, 0.1)
    cage = execute(program)
    wanted = loss_of(*map(torch.tensor, (cage.vectors(), boxes.vectors(), points)))
    assert fitting_loss(cage, boxes, points) == pytest.approx(float(wanted))


@given(SEEDS, st.floats(1e-4, 0.3))
@settings(max_examples=20, deadline=None)
def test_no_leaves_have_a_lower_loss_than_the_boxes_themselves(seed: int, noise: float) -> None:
    boxes, points = parts_of(parse(CHAIR), seed, 0.1)
    change = np.random.default_rng(seed).normal(size=(len(boxes), 15)) * noise
    leaves = Cage.from_vectors(boxes.part_ids, boxes.vectors() + change * np.random.default_rng(seed).uniform(size=15))
    least = fitting_loss(boxes, boxes, points)
    assert fitting_loss(leaves, boxes, points) >= least
    larger = Cage(boxes.part_ids, boxes.centre, boxes.axes, boxes.size + noise)
    assert fitting_loss(larger, boxes, points) >= least


@given(SEEDS, st.floats(1e-3, 0.2), st.booleans())
@settings(max_examples=15, deadline=None)
def test_a_step_lowers_the_extrapolated_loss_as_far_as_the_obvious_linear_program(
    seed: int, radius: float, bounding: bool
) -> None:
    """Parameters that go up and down, and what each number is above its box's at least: dense, by another entry."""
    program = parse(LEANING)
    boxes, points = parts_of(program, seed, 0.1, 50)
    penalty: _Penalty = _Overshoot(list(points)) if bounding else _Sticking(Hinge(points))
    problem = _Problem(boxes.vectors(), penalty, np.full(len(program.parameters()), -np.inf))
    start = problem._state(program)
    jacobian = differentiate(program)[1]
    step, expected = problem._step(start, jacobian, radius)

    (p, _, t), model = jacobian.shape, start.penalty
    slopes, residual = jacobian.reshape(-1, t), (start.vectors - boxes.vectors()).ravel()
    m, c = len(residual), len(model.heights)
    drift = np.tensordot(model.slope, jacobian, 2)
    cuts = np.array([face @ jacobian[i] for i, face in zip(model.parts, model.faces)]).reshape(c, t)
    part = np.eye(p)[model.parts]
    over = np.block([[slopes, -slopes, -np.eye(m), np.zeros((m, p))], [cuts, -cuts, np.zeros((c, m)), -part]])
    under = np.hstack([-slopes, slopes, -np.eye(m), np.zeros((m, p))])
    found = linprog(
        np.concatenate([DAMPING + drift, DAMPING - drift, np.full(m, 1 / p), np.ones(p)]),
        A_ub=np.concatenate([over, under]),
        b_ub=np.concatenate([-residual, -model.heights, residual]),
        bounds=[(0, radius)] * (2 * t) + [(0, None)] * (m + p),
    )
    before = np.abs(residual).sum() / p + model.value * bounding
    assert np.abs(step).max() <= radius + 1e-9
    assert expected - DAMPING * np.abs(step).sum() == pytest.approx(before - found.fun, rel=1e-5, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "seed"),
    [(LEANING, 0), (SLATS, 0), (CHAIR, 1)],
)
def test_the_fit_ends_no_higher_than_the_appendixs_adam(text: str, seed: int) -> None:
    program = parse(text)
    boxes, points = parts_of(program, seed, 0.05, 100)
    fitted = fit_program(program, boxes, points)
    # In a process of its own: without this suite's checks of every sum of dual numbers.
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        _, losses = pool.submit(fit_by_adam, program, boxes, points).result()
    loss = fitting_loss(execute(fitted), match_axes(boxes, execute(program)), points)
    assert loss <= 1.01 * losses[-1]
    assert loss < 0.8 * losses[0]


@given(SEEDS)
@settings(max_examples=3, deadline=None)
def test_naming_the_axes_of_the_boxes_otherwise_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    program = parse(LEANING)
    boxes, points = parts_of(program, seed, 0.05, 50)
    renamed = Cage.of({name: box.permuted(rng.choice(PROPER_PERMUTATIONS)) for name, box in boxes.cuboids().items()})
    given_cage = execute(program)
    assert fitting_loss(given_cage, match_axes(renamed, given_cage), points) == pytest.approx(
        fitting_loss(given_cage, match_axes(boxes, given_cage), points), rel=1e-12
    )
    np.testing.assert_allclose(
        fit_program(program, renamed, points).parameters(), fit_program(program, boxes, points).parameters(), atol=1e-9
    )


def test_a_program_whose_leaves_are_the_boxes_stays_as_it_is() -> None:
    program = parse(CHAIR)
    cage = execute(program)
    corners = cage.corners()
    for found in (fit_program(program, cage, corners), bound_program(program, cage, list(corners))):
        np.testing.assert_allclose(found.parameters(), program.parameters(), atol=1e-6)


@pytest.mark.parametrize("text", [LEANING, SLATS, CHAIR])
@pytest.mark.parametrize("seed", [0, 1])
def test_grown_cuboids_bound_their_parts(seed: int, text: str) -> None:
    program = parse(text)
    boxes, points = parts_of(program, seed, 0.05, 100)
    assert overshoots(execute(program), points).max() > 1e-3
    grown = execute(bound_program(program, boxes, list(points)))
    assert overshoots(grown, points).max() < 1e-5
    assert (grown.size.prod(axis=1) < 3 * boxes.size.prod(axis=1)).all()


def test_a_leaf_that_can_turn_does_so_to_bound_a_leaning_part() -> None:
    program = parse(CHAIR)
    cage = execute(program)
    i = cage.part_ids.index("cube2")
    lean = Rotation.from_euler("x", -0.1).as_matrix()
    boxes = Cage(cage.part_ids, cage.centre, cage.axes.copy(), cage.size)
    boxes.axes[i] = cage.axes[i] @ lean.T
    corners = boxes.corners()
    grown = execute(bound_program(fit_program(program, boxes, corners), boxes, list(corners)))
    assert overshoots(grown, corners).max() < 1e-5
    assert grown.size[i].prod() < 1.1 * boxes.size[i].prod()


def test_lengths_stay_positive_where_a_part_is_thinner_than_any() -> None:
    program = parse(SLATS)
    cage = execute(program)
    flat = Cage(cage.part_ids, cage.centre, cage.axes, cage.size * [1, 1, 1e-6])
    fitted = fit_program(program, flat, flat.corners())
    assert (execute(fitted).size > 0).all()
