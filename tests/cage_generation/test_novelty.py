"""What counts as new."""

from dataclasses import replace

import numpy as np
import pytest

from cagesdf.cage_generation.checks import rebuilding_figures, sample_figures
from cagesdf.cage_generation.generator import Generated, Samples
from cagesdf.cage_generation.novelty import TOLERANCE, Known, reach_of, standing
from cagesdf.cage_generation.tokens import program_of, tokens_of
from cagesdf.cuboid import Cage
from cagesdf.frames import Similarity
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.program import AssemblyProgram
from tests.support import programs

HERE = Similarity(1.0, np.eye(3), np.zeros(3))


def generated(program: AssemblyProgram, placement: Similarity = HERE) -> Generated:
    assembly = Assembly(program, placement)
    return Generated(assembly, assembly.cage())


def known(**by_name: AssemblyProgram) -> Known:
    items = {name: generated(program) for name, program in by_name.items()}
    return Known({n: item.structure for n, item in items.items()}, {n: item.cage for n, item in items.items()})


def changed(program: AssemblyProgram, by: float) -> AssemblyProgram:
    """Another length of the first block's second cuboid."""
    numbers = program.parameters()
    numbers[6 + 3] += by
    return program.with_parameters(numbers)


def nearest(item: Generated, among: Known) -> tuple[str, float]:
    return among.nearest(item.structure, item.cage)


def test_a_shape_is_its_own_copy_wherever_it_stands_and_whatever_its_names() -> None:
    among = known(chair=programs.CHAIR, grown=programs.GROWN)
    elsewhere = Similarity(2.5, np.eye(3), np.array([1.0, -2.0, 3.0]))
    other_names = program_of(tokens_of(programs.CHAIR))
    for item in (generated(programs.CHAIR, elsewhere), generated(other_names)):
        name, difference = nearest(item, among)
        assert name == "chair"
        assert difference < 1e-9


def test_a_larger_change_is_a_larger_difference() -> None:
    among = known(chair=programs.CHAIR)
    differences = [nearest(generated(changed(programs.CHAIR, by)), among)[1] for by in (0.0, 0.001, 0.02, 0.1)]
    assert differences == sorted(differences)
    assert differences[1] <= TOLERANCE < differences[3]


def test_another_structure_is_infinitely_different() -> None:
    name, difference = nearest(generated(programs.GROWN), known(chair=programs.CHAIR))
    assert (name, difference) == ("", np.inf)


def test_the_nearest_is_found_and_can_be_left_out() -> None:
    among = known(near=changed(programs.CHAIR, 0.02), far=changed(programs.CHAIR, 0.2))
    item = generated(programs.CHAIR)
    assert nearest(item, among)[0] == "near"
    assert among.nearest(item.structure, item.cage, without="near")[0] == "far"


def test_names_of_axes_do_not_matter() -> None:
    item = generated(programs.CHAIR)
    turned = Cage.of({name: cuboid.permuted(np.eye(3)[[1, 2, 0]]) for name, cuboid in item.cage.cuboids().items()})
    assert nearest(replace(item, cage=turned), known(chair=programs.CHAIR))[1] < 1e-9


def test_a_standing_cage_is_centred_and_as_wide_as_asked() -> None:
    cage = generated(programs.CHAIR).cage
    placed = cage.transformed(standing(cage, 1.3))
    corners = placed.corners().reshape(-1, 3)
    assert np.allclose(corners.min(axis=0), -corners.max(axis=0))
    assert reach_of([placed]) == pytest.approx(1.3)
    assert reach_of([placed, cage.transformed(standing(cage, 9.0)), placed]) == pytest.approx(1.3)


def test_figures_add_up() -> None:
    items = [generated(changed(programs.CHAIR, by)) for by in (0.0, 0.1)] + [generated(programs.GROWN)]
    items[1:] = [replace(item, floating=number) for number, item in enumerate(items[1:], start=1)]
    figures = sample_figures(Samples(tuple(items), (0, 1, 3), {"degenerate numbers": 2}), known(chair=programs.CHAIR))
    assert figures["drawn"] == 5
    assert (figures["valid"], figures["floating"]) == (3, 3)
    assert (figures["copies"], figures["new_cages"], figures["new_structures"]) == (1, 1, 1)
    assert figures["structures"] == 2
    rebuilt: dict[str, Generated | str] = {"chair": items[1], "other": items[2], "third": "degenerate numbers"}
    among = known(chair=programs.CHAIR, other=programs.CHAIR, third=programs.CHAIR)
    again = rebuilding_figures(rebuilt, among)
    assert (again["rebuilt"], again["same_structure"]) == (3, 1)
    assert again["rebuilding_difference"] == nearest(items[1], among)[1]
