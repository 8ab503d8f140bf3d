"""What ShapeAssembly's statements do, by hand and by law, and what the published programs give."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.errors import ProgramError
from cagesdf.structure.executor import (
    TICKS,
    TIE,
    UPRIGHT,
    Body,
    _nearest_lattice_places,
    differentiate,
    execute,
    execute_nodes,
)
from cagesdf.structure.parsing import parse
from cagesdf.structure.program import AssemblyProgram, Squeeze
from tests.support import programs

ROOT = Path(__file__).parents[2]
HEAD = "Assembly P {\nbbox = Cuboid(2, 2, 2, True)"
EYE = np.eye(3)
MIRROR = np.array([-1.0, 1.0, 1.0])


def run(*lines: str, size: str = "2, 2, 2") -> Cage:
    """The cuboids of a block of these statements."""
    return execute(parse("\n".join(["Assembly P {", f"bbox = Cuboid({size}, True)", *lines, "}"])))


def assert_is(cuboid: Cuboid, centre: ArrayLike, size: ArrayLike, axes: ArrayLike = EYE) -> None:
    for found, wanted in ((cuboid.centre, centre), (cuboid.size, size), (cuboid.axes, axes)):
        np.testing.assert_allclose(found, np.asarray(wanted), atol=1e-6)


def point(cuboid: Cuboid, place: object) -> np.ndarray:
    """Where a place of a cuboid is."""
    return cuboid.centre + ((np.array(place) - 0.5) * cuboid.size) @ cuboid.axes


def corner_set(cage: Cage) -> np.ndarray:
    """Each cuboid's corners, in an order that doesn't depend on its axes."""
    corners = np.round(cage.corners(), 7) + 0.0
    return np.array([sorted(map(tuple, eight)) for eight in corners])


# Attachments.


def test_a_cuboid_that_is_not_attached_stays_at_the_centre() -> None:
    assert_is(run("a = Cuboid(0.2, 0.4, 0.6, False)")["a"], [0, 0, 0], [0.2, 0.4, 0.6])


def test_the_first_attachment_moves() -> None:
    cage = run("a = Cuboid(0.2, 0.4, 0.6, True)", "attach(a, bbox, 0.5, 0.0, 1.0, 0.75, 0.0, 0.5)")
    assert_is(cage["a"], [0.5, -0.8, -0.3], [0.2, 0.4, 0.6])


POLE = ["a = Cuboid(0.1, 1, 0.2, False)", "attach(a, bbox, 0.5, 0, 0.5, 0.5, 0, 0.5)"]
LEANING = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])  # in the direction (0.6, 0.8, 0), by the least rotation


def test_the_second_attachment_turns_and_keeps_the_length_that_fits() -> None:
    cage = run(*POLE, "attach(a, bbox, 0.5, 1, 0.5, 0.8, 0.4, 0.5)")
    assert_is(cage["a"], [0.3, -0.6, 0], [0.1, 1, 0.2], LEANING)


def test_the_second_attachment_stretches_the_axis_that_reaches() -> None:
    cage = run(*POLE, "attach(a, bbox, 0.5, 1, 0.5, 0.95, 0.6, 0.5)")
    assert_is(cage["a"], [0.45, -0.4, 0], [0.1, 1.5, 0.2], LEANING)
    shorter = run(*POLE, "attach(a, bbox, 0.5, 1, 0.5, 0.65, 0.2, 0.5)")
    assert_is(shorter["a"], [0.15, -0.8, 0], [0.1, 0.5, 0.2], LEANING)


def test_where_no_single_length_fits_all_three_change() -> None:
    """The corner (1, 1, 1) is √3 from the held one, and one length can't bring it closer than √2."""
    cage = run(
        "a = Cuboid(1, 1, 1, False)",
        "attach(a, bbox, 0, 0, 0, 0.5, 0.5, 0.5)",
        f"attach(a, bbox, 1, 1, 1, {', '.join([repr(0.5 + 0.25 / 3**0.5)] * 3)})",
    )
    assert_is(cage["a"], [0.25 / 3**0.5] * 3, [0.5 / 3**0.5] * 3)


def test_opposite_directions_spin_an_upright_cuboid_in_place() -> None:
    """As in the official executor: the half turn is about the cuboid's own axis, so the goal isn't met."""
    cage = run(
        "a = Cuboid(0.1, 1, 0.2, False)",
        "attach(a, bbox, 0.5, 0, 0.5, 0.5, 0.5, 0.5)",
        "attach(a, bbox, 0.5, 1, 0.5, 0.5, 0, 0.5)",
    )
    assert_is(cage["a"], [0, 0.5, 0], [0.1, 1, 0.2], np.diag([-1, 1, -1]))


def test_two_places_that_are_to_meet_in_one_point_leave_the_cuboid_as_it_is() -> None:
    cage = run(*POLE, "attach(a, bbox, 0.5, 0.9, 0.5, 0.5, 0, 0.5)")
    assert_is(cage["a"], [0, -0.5, 0], [0.1, 1, 0.2])
    nearly = run(*POLE, "attach(a, bbox, 0.5, 0.9, 0.5, 0.5, 1e-10, 0.5)")
    assert_is(nearly["a"], [0, -0.5, 0], [0.1, 1, 0.2])


def test_the_third_attachment_turns_about_the_line_of_two_and_stretches() -> None:
    """A board between floor and ceiling, its right side put to a point 0.7 before the axis."""
    board = ["a = Cuboid(1, 2, 0.2, False)", "attach(a, bbox, 0.5, 0, 0.5, 0.5, 0, 0.5)"]
    board += ["attach(a, bbox, 0.5, 1, 0.5, 0.5, 1, 0.5)"]
    assert_is(run(*board)["a"], [0, 0, 0], [1, 2, 0.2])
    cage = run(*board, "attach(a, bbox, 1, 0.5, 0.5, 0.5, 0.5, 0.85)")
    assert_is(cage["a"], [0, 0, 0], [1.4, 2, 0.2], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    # A fourth one, off the line of all others, can't turn it, and finds no axis that is free.
    held = run(*board, "attach(a, bbox, 1, 0.5, 0.5, 0.5, 0.5, 0.85)", "attach(a, bbox, 1, 1, 0.5, 0.9, 0.9, 0.9)")
    assert_is(held["a"], cage["a"].centre, cage["a"].size, cage["a"].axes)


GROWING = ["low = Cuboid(0.4, 0.2, 0.4, True)", "high = Cuboid(0.4, 0.2, 0.4, True)", "a = Cuboid(0.4, {}, 0.4, True)"]
GROWING += ["attach(low, bbox, 0.5, 0, 0.5, 0.5, 0, 0.5)", "attach(high, bbox, 0.5, 1, 0.5, 0.5, 1, 0.5)"]
GROWING += ["attach(a, low, 0.5, 0, 0.5, 0.5, 1, 0.5)", "attach(a, high, 0.5, 1, 0.5, 0.5, 0, 0.5)"]


@pytest.mark.parametrize(
    ("height", "grown"),
    [(0.5, 1.6), (1.5, 1.6), (1.53, 1.53), (1.6, 1.6), (1.7, 1.7)],
    ids=["short", "gap of 0.1", "gap below 5 %", "flush", "overlapping"],
)
def test_an_aligned_cuboid_grows_to_its_second_partner_and_never_shrinks(height: float, grown: float) -> None:
    cage = run(*(line.format(height) for line in GROWING))
    assert_is(cage["a"], [0, -0.8 + grown / 2, 0], [0.4, grown, 0.4])


def test_an_aligned_cuboid_keeps_its_axes_and_an_equal_free_one_turns() -> None:
    lines = ["a = Cuboid(0.1, 1, 0.2, {})", "attach(a, bbox, 0.5, 0, 0.5, 0.5, 0, 0.5)"]
    lines += ["attach(a, bbox, 0.5, 1, 0.5, 0.8, 0.4, 0.5)"]
    for aligned, axes in ((True, EYE), (False, LEANING)):
        np.testing.assert_allclose(run(lines[0].format(aligned), *lines[1:])["a"].axes, axes, atol=1e-6)


places = st.tuples(*[st.floats(0, 1)] * 3)


@given(st.tuples(*[st.floats(0.1, 1.0)] * 3), places, places, places, st.tuples(*[st.floats(-1, 1)] * 3))
def test_two_attachments_are_both_met_where_the_goal_is_out_of_reach(
    size: tuple, first: tuple, second: tuple, at: tuple, way: tuple
) -> None:
    """A goal further than the two places are apart can always be reached by stretching."""
    length, apart = np.linalg.norm(way), np.linalg.norm((np.subtract(second, first)) * size)
    if length < 0.1 or apart < 0.05:
        return
    goal = np.array(at) + np.array(way) / length * (apart + 0.1) / 2  # in a bbox of 2
    numbers = [", ".join(map(repr, map(float, triple))) for triple in (size, first, at, second, goal)]
    cage = run(
        f"a = Cuboid({numbers[0]}, False)",
        f"attach(a, bbox, {numbers[1]}, {numbers[2]})",
        f"attach(a, bbox, {numbers[3]}, {numbers[4]})",
    )
    np.testing.assert_allclose(point(cage["a"], first), (np.array(at) - 0.5) * 2, atol=1e-9)
    np.testing.assert_allclose(cage["a"].axes @ cage["a"].axes.T, EYE, atol=1e-9)
    np.testing.assert_allclose(point(cage["a"], second), (goal - 0.5) * 2, atol=1e-4)


# Squeeze, reflect, translate.


def test_a_squeeze_puts_opposite_faces_to_the_faces_that_look_at_them() -> None:
    assert [str(attach) for attach in Squeeze("a", "b", "bbox", "left", (0.2, 0.3)).attaches()] == [
        "attach(a, b, 0.0, 0.5, 0.5, 1.0, 0.2, 0.3)",
        "attach(a, bbox, 1.0, 0.5, 0.5, 1.0, 0.2, 0.3)",
    ]
    assert [str(attach) for attach in Squeeze("a", "bbox", "c", "top", (0.2, 0.3)).attaches()] == [
        "attach(a, bbox, 0.5, 1.0, 0.5, 0.2, 1.0, 0.3)",
        "attach(a, c, 0.5, 0.0, 0.5, 0.2, 1.0, 0.3)",
    ]


def test_a_squeezed_shelf_spans_the_gap_between_two_walls() -> None:
    walls = ["l = Cuboid(0.1, 1, 1, True)", "r = Cuboid(0.1, 1, 1, True)", "a = Cuboid(0.3, 0.1, 0.4, False)"]
    walls += ["attach(l, bbox, 0, 0.5, 0.5, 0, 0.5, 0.5)", "attach(r, bbox, 1, 0.5, 0.5, 1, 0.5, 0.5)"]
    cage = run(*walls, "squeeze(a, l, r, left, 0.7, 0.4)")
    assert_is(cage["a"], [0, 0.2, -0.1], [1.8, 0.1, 0.4])


def test_reflections_are_mirrored_and_translations_evenly_spaced() -> None:
    leg = ["a = Cuboid(0.1, 1, 0.2, False)", "attach(a, bbox, 0.5, 0, 0.5, 0.1, 0, 0.2)"]
    cage = run(*leg, "reflect(a, X)", "translate(a, Z, 3, 0.6)")
    assert cage.part_ids == ("a", "cube1", "cube2", "cube3", "cube4")
    assert_is(cage["cube1"], [0.8, -0.5, -0.6], [0.1, 1, 0.2])
    for i in (1, 2, 3):
        assert_is(cage[f"cube{i + 1}"], [-0.8, -0.5, -0.6 + 0.4 * i], [0.1, 1, 0.2])
    leaning = run(*leg, "attach(a, bbox, 0.5, 1, 0.5, 0.3, 0.6, 0.5)", "reflect(a, X)", "reflect(a, Z)")
    a, x, z = corner_set(leaning)
    np.testing.assert_allclose(sorted((a * [-1, 1, 1]).tolist()), x.tolist(), atol=1e-6)
    np.testing.assert_allclose(sorted((a * [1, 1, -1]).tolist()), z.tolist(), atol=1e-6)


def test_copies_that_would_leave_their_partner_stop_at_its_face() -> None:
    lines = ["seat = Cuboid(1, 0.1, 1, True)", "a = Cuboid(0.1, 0.5, 0.1, True)"]
    lines += ["attach(a, seat, 0.5, 1, 0.5, 0.8, 0, 0.5)", "translate(a, X, 1, 0.9)"]
    assert_is(run(*lines)["cube2"], [0.5, -0.3, 0], [0.1, 0.5, 0.1])


# Blocks in blocks.

INSIDE = """
Assembly Q {
    bbox = Cuboid(0.5, 0.5, 0.5, True)
    leg = Cuboid(0.1, 0.5, 0.2, False)
    attach(leg, bbox, 0.5, 0.0, 0.5, 0.2, 0.0, 0.3)
}
"""


def with_inside(*lines: str, size: str = "0.5, 0.5, 0.5") -> AssemblyProgram:
    head = ["Assembly P {", "bbox = Cuboid(2, 2, 2, True)", f"Q = Cuboid({size}, False)"]
    return parse("\n".join([*head, *lines, "}"]) + INSIDE)


def test_lengths_of_a_block_scale_with_the_cuboid_that_it_fills_and_offsets_do_not() -> None:
    cage = execute(with_inside("attach(Q, bbox, 0.5, 0.5, 0.5, 0.75, 0.5, 0.5)", size="1.0, 0.5, 0.25"))
    assert cage.part_ids == ("Q/leg",)
    assert_is(cage["Q/leg"], [0.5 - 0.15, 0, -0.1], [0.2, 0.5, 0.1])


def test_a_block_turns_with_the_cuboid_that_it_fills() -> None:
    """Held at the middle of its bottom, its top put to the left of that: a quarter turn about z."""
    quarter = ["attach(Q, bbox, 0.5, 0, 0.5, 0.5, 0.5, 0.5)", "attach(Q, bbox, 0.5, 1, 0.5, 0.25, 0.5, 0.5)"]
    nodes = execute_nodes(with_inside(*quarter))
    turn = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])  # rows: where x, y and z point
    assert_is(nodes["Q"], [-0.25, 0, 0], [0.5, 0.5, 0.5], turn)
    assert_is(nodes["Q/leg"], np.array([-0.25, 0, 0]) + np.array([-0.15, 0, -0.1]) @ turn, [0.1, 0.5, 0.2], turn)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_reflected_block_has_mirrored_contents(axis: int) -> None:
    placed = ["attach(Q, bbox, 0.5, 0, 0.5, 0.6, 0.55, 0.65)", "attach(Q, bbox, 0.5, 1, 0.5, 0.75, 0.7, 0.8)"]
    cage = execute(with_inside(*placed, f"reflect(Q, {'XYZ'[axis]})"))
    assert cage.part_ids == ("Q/leg", "cube1/leg")
    signs = np.ones(3)
    signs[axis] = -1
    leg, copy = corner_set(cage)
    np.testing.assert_allclose(sorted((leg * signs).tolist()), copy, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(cage.axes), 1)


def test_a_translated_block_has_the_same_contents() -> None:
    cage = execute(with_inside("attach(Q, bbox, 0.5, 0, 0.5, 0.2, 0.5, 0.5)", "translate(Q, X, 2, 0.5)"))
    for i, name in enumerate(("Q/leg", "cube1/leg", "cube2/leg")):
        assert_is(cage[name], cage["Q/leg"].centre + np.array([0.5 * i, 0, 0]), cage["Q/leg"].size)


def test_leaves_come_block_by_block_and_declared_cuboids_before_copies() -> None:
    assert execute(programs.CHAIR).part_ids == (
        *("seat", "back", "arm", "cube4"),
        *("Base/Side/leg", "Base/Side/bar", "Base/Side/cube2", "Base/Side/cube3"),
        *("Base/cube1/leg", "Base/cube1/bar", "Base/cube1/cube2", "Base/cube1/cube3"),
    )
    assert execute_nodes(programs.CHAIR).part_ids[:2] == ("Base", "seat")


# The nearest lattice points.


def slow_nearest(a: Body, b: Body) -> tuple:
    """Of all pairs of lattice points one of the nearest: the first in a's order, then in b's."""
    places = np.array([(x, y, z) for z in TICKS for y in TICKS for x in TICKS])
    clouds = [((places - 0.5) * body.size) @ np.array(body.axes) + body.centre for body in (a, b)]
    apart = np.linalg.norm(clouds[0][:, None] - clouds[1][None], axis=2)
    i = int(np.argmax(apart.min(axis=1) <= apart.min() + TIE))
    return tuple(places[i]), tuple(places[int(np.argmax(apart[i] <= apart[i].min() + TIE))])


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.booleans(), st.booleans())
def test_the_nearest_lattice_points_are_those_of_an_exhaustive_search(seed: int, turned: bool, tied: bool) -> None:
    rng = np.random.default_rng(seed)
    a, b = (Body(name, tuple(rng.uniform(0.1, 1, 3).tolist()), True) for name in "ab")
    a.axes = UPRIGHT
    if turned:
        x, y, z = (tuple(axis) for axis in Rotation.random(random_state=seed).as_matrix().tolist())
        b.axes = x, y, z
    else:
        b.axes = UPRIGHT
    a.centre = (0.0, 0.0, 0.0) if tied else tuple(rng.uniform(-1, 1, 3).tolist())
    assert _nearest_lattice_places(a, b) == slow_nearest(a, b)


# Laws of whole programs.


@settings(deadline=None)
@given(programs.program_texts(moves=4))
def test_random_programs_execute_to_finite_cuboids_with_proper_axes(text: str) -> None:
    cage = execute(parse(text))
    assert np.isfinite(cage.vectors()).all()
    gram = cage.axes @ cage.axes.transpose(0, 2, 1)
    np.testing.assert_allclose(gram, np.broadcast_to(EYE, gram.shape), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(cage.axes), 1, atol=1e-6)


@settings(deadline=None, derandomize=True)
@given(programs.program_texts(moves=3))
def test_a_mirrored_program_executes_to_mirrored_cuboids(text: str) -> None:
    """Exactly so but for rounding: with generic numbers no lattice points are tied."""
    program = parse(text)
    cage, image = execute(program), execute(programs.mirrored(program))
    np.testing.assert_allclose(image.centre, cage.centre * MIRROR, atol=1e-7)
    np.testing.assert_allclose(image.size, cage.size, atol=1e-7)
    np.testing.assert_allclose(image.axes, MIRROR[:, None] * cage.axes * MIRROR, atol=1e-7)


@settings(deadline=None, derandomize=True)
@given(programs.program_texts(moves=2), st.sampled_from([0.5, 2.0, 3.7]))
def test_scaling_all_lengths_scales_the_cuboids(text: str, factor: float) -> None:
    """With at most two attachments the absolute thresholds only ask whether points have met, within 1e-4.

    Third ones compare lengths with 0.01, and so do depend on the unit.
    """
    program = parse(text)
    cage, larger = execute(program), execute(programs.scaled(program, factor))
    np.testing.assert_allclose(larger.centre, cage.centre * factor, atol=1e-6)
    np.testing.assert_allclose(larger.size, cage.size * factor, atol=1e-6)
    np.testing.assert_allclose(larger.axes, cage.axes, atol=1e-6)


@settings(deadline=None, max_examples=30)
@given(programs.program_texts(moves=3))
def test_differentiation_gives_the_cuboids_of_execution(text: str) -> None:
    program = parse(text)
    cage, slopes = differentiate(program)
    np.testing.assert_allclose(cage.vectors(), execute(program).vectors(), atol=1e-9)
    assert slopes.shape == (len(cage), 15, len(program.parameters()))


def test_numbers_that_lead_to_infinite_cuboids_are_refused() -> None:
    far = ["a = Cuboid(9, 1, 1, {0})", "b = Cuboid(9, 1, 1, {0})", "attach(b, a, 0, 0, 0, 1e308, 1, 1)"]
    for aligned in (True, False):
        lines = [line.format(aligned) for line in [*far, "attach(b, a, 0, 0, 0, 0, 1e308, 1)"]]
        program = parse("\n".join([HEAD, *lines, "}"]))
        for execution in (execute, differentiate):
            with pytest.raises(ProgramError, match="infinite"):
                execution(program)


# Published programs.


@pytest.mark.parametrize("category", ["chair", "table", "storage"])
def test_real_programs_give_the_published_cuboids_in_order(category: str) -> None:
    known = {"38955", "21506", "26846"}  # docs/programs.md
    for name, text, wanted in programs.real_programs(category, 60):
        if name not in known:
            np.testing.assert_allclose(execute(parse(text)).vectors(), wanted, atol=1e-4, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize(("category", "others"), [("chair", ["38955"]), ("table", ["21506", "26846"]), ("storage", [])])
def test_all_real_programs_but_the_listed_ones_give_the_published_cuboids(category: str, others: list[str]) -> None:
    """By the benchmark, in a process of its own: without type checks it takes seconds."""
    if not programs.SHARED.is_dir():
        pytest.skip("needs the published programs")
    command = [sys.executable, "benchmarks/programs.py", "--programs", str(programs.SHARED / category)]
    command += ["--cuboids", str(programs.SHARED / f"{category}_cuboids.jsonl.gz")]
    out = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    _, table, *listed = out.split("\n\n")  # the processor stands first
    assert [line.split(":")[0] for line in listed] == others
    assert float(table.rsplit("| ", 2)[1].split("%")[0]) >= 99.9
