"""Derivatives: of each operator, and of whole programs, against finite differences."""

import operator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.structure.dual_numbers import DualNumber, seed
from cagesdf.structure.executor import differentiate, execute
from cagesdf.structure.parsing import parse
from cagesdf.structure.program import AssemblyProgram
from tests.support import programs

STEP = 1e-6
numbers = st.floats(0.1, 9) | st.floats(-9, -0.1)
BINARY = [operator.add, operator.sub, operator.mul, operator.truediv]


def differences(f, x: np.ndarray) -> np.ndarray:
    """Central differences of a function of several numbers by each of them."""
    steps = np.eye(len(x)) * STEP
    return np.array([(f(*(x + step)) - f(*(x - step))) / (2 * STEP) for step in steps])


@pytest.mark.parametrize("operation", BINARY)
@given(numbers, numbers)
def test_operators_of_two_jets_have_their_derivatives(operation, a: float, b: float) -> None:
    result = operation(*seed(np.array([a, b])))
    assert result.value == operation(a, b)
    np.testing.assert_allclose(result.slope, differences(operation, np.array([a, b])), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("operation", BINARY)
@given(numbers, numbers)
def test_operators_of_a_jet_and_a_number_have_their_derivatives(operation, a: float, b: float) -> None:
    for combined in (lambda x: operation(x, b), lambda x: operation(b, x)):
        result = combined(seed(np.array([a]))[0])
        assert result.value == pytest.approx(combined(a), rel=1e-15)
        np.testing.assert_allclose(result.slope, differences(combined, np.array([a])), rtol=1e-6, atol=1e-6)


@given(numbers)
def test_sign_absolute_value_and_powers_have_their_derivatives(a: float) -> None:
    for operation in (operator.neg, abs, lambda x: abs(x) ** 0.5, lambda x: x**2.0):
        result = operation(seed(np.array([a]))[0])
        assert result.value == operation(a)
        np.testing.assert_allclose(result.slope, differences(operation, np.array([a])), rtol=1e-6, atol=1e-6)


def test_the_root_of_zero_has_no_slope() -> None:
    root = DualNumber(0.0, np.ones(2)) ** 0.5
    assert root.value == 0
    np.testing.assert_array_equal(root.slope, [0, 0])


def test_exact_zeros_and_ones_cost_nothing() -> None:
    (x,) = seed(np.array([3.0]))
    assert x * 0.0 == 0
    assert all(type(product) is float for product in (x * 0.0, 0.0 * x, 0.0 / x))
    assert x * 1.0 is x
    assert 1.0 * x is x


@given(numbers, numbers)
def test_jets_compare_as_their_values(a: float, b: float) -> None:
    x, y = seed(np.array([a, b]))
    for compare in (operator.lt, operator.le, operator.gt, operator.ge, operator.eq):
        assert compare(x, y) == compare(a, b)
        assert compare(x, b) == compare(a, b)
        assert compare(a, y) == compare(a, b)
    assert float(x) == a


def check_slopes(program: AssemblyProgram, name: str = "") -> float:
    """Compare the derivatives of all cuboids by all parameters with central differences.

    Returns the share of the parameters that were left out, because two pieces meet where they are.
    """
    cage, slopes = differentiate(program)
    parameters, edges = program.parameters(), 0
    for j in range(len(parameters)):
        sides = []
        for step in (-STEP, STEP):
            moved = parameters.copy()
            moved[j] += step
            sides.append((execute(program.with_parameters(moved)).vectors() - cage.vectors()) / step)
        if np.abs(sides[0] - sides[1]).max() > 1e-2:
            edges += 1
        else:
            wanted, note = (sides[0] + sides[1]) / 2, f"{name}, parameter {j}"
            np.testing.assert_allclose(slopes[:, :, j], wanted, rtol=1e-4, atol=1e-4, err_msg=note)
    return edges / len(parameters)


def generic(program: AssemblyProgram) -> AssemblyProgram:
    """The program with its numbers moved a little, so that nothing is flush or tied."""
    numbers = program.parameters()
    return program.with_parameters(numbers * np.random.default_rng(0).uniform(0.99, 1.01, len(numbers)))


@pytest.mark.parametrize("program", [programs.CHAIR, programs.GROWN], ids=["chair", "grown"])
def test_cuboids_follow_each_parameter_as_differences_do(program: AssemblyProgram) -> None:
    """Of mirrored and translated blocks, squeezed, leaning and growing cuboids."""
    assert check_slopes(generic(program)) == 0


def test_mirrored_blocks_have_mirrored_derivatives() -> None:
    program = generic(programs.CHAIR)
    cage, slopes = differentiate(program)
    side, copy = (cage.part_ids.index(f"Base/{name}/leg") for name in ("Side", "cube1"))
    outer = 3 + 4 * 3 + 6 * 6  # parameters of the root, which move both alike
    np.testing.assert_allclose(slopes[copy, 0, outer:], -slopes[side, 0, outer:], atol=1e-9)
    np.testing.assert_allclose(slopes[copy, 1:3], slopes[side, 1:3], atol=1e-9)
    assert np.abs(slopes[side, 0, outer:]).max() > 0.1


@settings(deadline=None, max_examples=6, derandomize=True)
@given(programs.program_texts(moves=3, depth=2))
def test_random_programs_follow_their_parameters(text: str) -> None:
    check_slopes(parse(text))


@pytest.mark.parametrize("category", ["chair", "table", "storage"])
def test_real_programs_follow_their_parameters(category: str) -> None:
    for name, text, _ in programs.real_programs(category, 2):
        assert check_slopes(parse(text), name) < 0.2
