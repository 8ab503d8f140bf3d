"""What is said of a surface: whether it is closed, hangs together, and is thick enough for its cells."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.editing.health import FINEST, HELD, STEP, Health
from cagesdf.editing.state import State
from cagesdf.extraction import USUAL, Extraction
from cagesdf.extraction.lattice import Lattice
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.geometry.solid import cage_surface, thickness, union
from tests.support.attached import box, state_of

EVEN = replace(USUAL, finer=1.0)  # cells that are the same whatever they hold


def found(parts: dict[str, Mesh]) -> Extraction:
    meshes = [mesh for mesh in parts.values() if len(mesh.faces)]
    whole = union(meshes)
    components = len({tuple(mesh.vertices[0]) for mesh in meshes})  # none of them touch
    return Extraction(whole, parts, 0, 0.0, components, 0, 0.0)


def solid(*cuboids: Cuboid) -> Mesh:
    return join([cage_surface(Cage.of({"": cuboid})) for cuboid in cuboids])


def board(thickness: float) -> tuple[State, Extraction]:
    """A board in the middle of its cuboid, which is 0.5 high."""
    state = state_of({"board": box((0, 0, 0), (0.6, 0.5, 0.6))})
    return state, found({"board": solid(box((0, 0, 0), (0.6, thickness, 0.6)))})


@settings(max_examples=25, deadline=None)
@given(st.floats(0.004, 0.05), st.integers(32, 256))
def test_a_board_is_as_thick_as_it_is_and_holds_with_the_resolution_that_is_recommended(
    thickness: float, resolution: int
) -> None:
    state, surface = board(thickness)
    health = Health.of(surface, state, resolution, EVEN)
    assert health.thinnest == "board"
    assert health.thickness == pytest.approx(thickness / (1 + 2 * thickness / 0.6))  # the rims are area, too
    # In steps of a lattice, which has whole cells and at least 16 along each axis; the rims are area there, too.
    wide, deep = (max(16, length * resolution / (2 * HALF_EXTENT)) for length in (0.6, 0.5))
    steps = thickness / 0.5 * deep
    assert health.cells == pytest.approx(steps / (1 + 2 * steps / wide), rel=0.07)
    if health.resolution:
        assert Health.of(surface, state, health.resolution, EVEN).cells >= HELD
        assert Health.of(surface, state, health.resolution - STEP, EVEN).cells < HELD
    else:
        assert Health.of(surface, state, FINEST, EVEN).cells < HELD
    assert bool(health.warnings()) == (health.cells < HELD)
    if health.warnings():
        assert (str(health.resolution) if health.resolution else "thicker") in health.warnings()[0]


@settings(max_examples=25, deadline=None)
@given(st.floats(0.001, 0.05), st.integers(32, 256))
def test_a_board_that_is_too_thin_is_said_to_be_so_only_where_no_cells_hold_it(
    thickness: float, resolution: int
) -> None:
    state, surface = board(thickness)
    even, held = (Health.of(surface, state, resolution, fineness) for fineness in (EVEN, USUAL))
    assert held.cells >= even.cells
    if even.cells >= HELD:
        assert (held.cells, held.warnings()) == (even.cells, ())
    elif thickness > 1.2 * HELD * max(USUAL.finer * 2 * HALF_EXTENT, np.cbrt(0.6 * 0.5 * 0.6)) / resolution:
        assert HELD <= held.cells < 1.2 * HELD
        assert held.warnings() == ()
    else:
        assert held.cells < 1.2 * HELD


def test_a_solid_that_fills_its_cuboid_is_never_too_thin() -> None:
    thin = box((0, 0, 0), (0.6, 0.002, 0.002))
    assert Health.of(found({"a": solid(thin)}), state_of({"a": thin}), 32).warnings() == ()


def test_parts_in_pieces_and_without_a_surface_are_named() -> None:
    cuboids = {"a": box((0, 0, 0), (0.6, 0.1, 0.1)), "b": box((0, 0.5, 0), (0.6, 0.1, 0.1))}
    cuboids["c"] = box((0, -0.5, 0), (0.6, 0.1, 0.1))
    pieces = solid(box((-0.2, 0, 0), (0.1, 0.1, 0.1)), box((0.2, 0, 0), (0.1, 0.1, 0.1)))
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    health = Health.of(found({"a": pieces, "b": nothing, "c": solid(cuboids["c"])}), state_of(cuboids), 128)
    assert health.torn == ("a", "b")
    assert "a, b" in health.warnings()[0]


@pytest.mark.parametrize(("gap", "apart"), [(0.1, ()), (0.5, ("c",))])
def test_parts_that_hang_together_with_less_than_the_most_are_named(gap: float, apart: tuple[str, ...]) -> None:
    places = {"a": 0.0, "c": -gap, "b": 0.1}
    cuboids = {name: box((0, y, 0), (0.6, 0.1, 0.1)) for name, y in places.items()}
    health = Health.of(found({name: solid(each) for name, each in cuboids.items()}), state_of(cuboids), 128)
    assert (health.apart, health.expected) == (apart, 1 + len(apart))
    assert [text for text in health.warnings() if "attached" in text] == [
        f"{c}: not attached to the rest" for c in apart
    ]


def test_of_many_parts_a_warning_names_some() -> None:
    cuboids = {f"part{i}": box((0.2 * i, 0, 0), (0.1, 0.1, 0.1)) for i in range(8)}
    health = Health.of(found({name: solid(each) for name, each in cuboids.items()}), state_of(cuboids), 128)
    assert health.warnings() == ("part1, part2, part3, part4 and 3 more: not attached to the rest",)


def test_more_components_than_groups_of_cuboids_are_warned_of() -> None:
    cuboids = {"a": box((0, 0, 0), (0.6, 0.1, 0.1)), "b": box((0, 0.1, 0), (0.6, 0.1, 0.1))}
    surface = found({"a": solid(box((0, 0, 0), (0.5, 0.05, 0.05))), "b": solid(box((0, 0.1, 0), (0.5, 0.05, 0.05)))})
    health = Health.of(surface, state_of(cuboids), 128)
    assert (health.components, health.expected, health.closed) == (2, 1, True)
    assert "2 pieces" in health.warnings()[0]
    assert str(health).startswith("closed, 2 components, thinnest")


@settings(max_examples=10, deadline=None)
@given(st.floats(0.01, 0.3), st.floats(0, 90), st.integers(16, 512))
def test_cells_through_a_part_are_its_thickness_once_the_lattice_s_steps_are_units(
    thick: float, degrees: float, resolution: int
) -> None:
    axes = Rotation.from_rotvec([0.0, np.deg2rad(degrees), 0.0]).as_matrix()
    cuboid = Cuboid(np.array([0.1, 0.2, 0.0]), axes, np.array([0.6, 0.5, 0.3]))
    mesh = solid(Cuboid(cuboid.centre, axes, np.array([0.5, 0.4 * thick, 0.2])))
    steps = Lattice.of(cuboid, 2 * HALF_EXTENT / resolution, USUAL.least).steps
    expected = thickness(mesh.with_vertices((mesh.vertices - cuboid.centre) @ axes.T / steps))
    state = state_of({"part": cuboid})
    assert Health.of(found({"part": mesh}), state, resolution, EVEN).cells == pytest.approx(expected)
