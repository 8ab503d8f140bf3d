"""Procedural programs: nearly the drawing's cuboids, one program a family up to its numbers."""

import re
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cagesdf.cuboid import Cuboid
from cagesdf.structure.canonical import exact_signature
from cagesdf.structure.executor import execute
from cagesdf.structure.parsing import parse
from cagesdf.structure.program import Attach, Declare, Reflect, Squeeze, Statement, Translate
from cagesdf.synthesis.dataset import CATEGORIES, assemble, draw, draw_recipes
from cagesdf.synthesis.fixings import beyond, lowest, meeting_point, place_in, point_in
from cagesdf.synthesis.programs import Assembled
from cagesdf.synthesis.recipe import Recipe
from cagesdf.synthesis.writing import write_shape

WITH_PROGRAMS = [name for name, category in CATEGORIES.items() if category.assemble]
CENTRES, SIZES = 0.04, 0.06  # how far published programs' leaves are off their parts


def recipes(category: str, count: int) -> list[Recipe]:
    return draw_recipes(category, count, 0, np.random.default_rng(4))


@cache
def hundred(category: str) -> list[tuple[Recipe, Assembled, dict[str, Cuboid]]]:
    """Recipes with their programs and true cuboids, made once for all tests."""
    return [(recipe, assembled(recipe), draw(recipe).structure.cuboids()) for recipe in recipes(category, 100)]


def assembled(recipe: Recipe) -> Assembled:
    found = assemble(recipe)
    assert found is not None
    return found


def program_text(recipe: Recipe) -> str:
    return str(assembled(recipe).program)


def errors(found: Assembled, true: dict[str, Cuboid]) -> np.ndarray:
    """Of each leaf: how far its centre, and its most different length, are off the drawing's cuboid."""
    cage = execute(found.program).transformed(found.placement)
    rows = []
    for part_id, leaf in zip(found.part_ids, cage.cuboids().values()):
        cuboid = true[part_id].nearest_to(leaf.axes)
        rows.append((np.linalg.norm(leaf.centre - cuboid.centre), np.abs(leaf.size - cuboid.size).max()))
    return np.array(rows)


def test_chairs_and_tables_have_programs_and_vases_have_none() -> None:
    assert WITH_PROGRAMS == ["chair", "table"]
    assert assemble(recipes("vase", 1)[0]) is None


@pytest.mark.parametrize("category", WITH_PROGRAMS)
def test_leaves_are_the_drawings_parts_and_nearly_where_they_are(category: str) -> None:
    """As far off as those of published programs at most, and typically by a centimetre: fitting has work."""
    found = []
    for _, result, true in hundred(category):
        assert sorted(result.part_ids) == sorted(true)
        assert len(result.part_ids) == len(execute(result.program))
        found.append(errors(result, true))
    centres, sizes = np.concatenate(found).T
    assert centres.max() < CENTRES
    assert sizes.max() < SIZES
    assert 0.002 < np.median(centres) < 0.02
    assert 0.005 < np.median(sizes) < 0.03


@pytest.mark.parametrize("category", WITH_PROGRAMS)
def test_a_family_has_one_program_up_to_continuous_parameters_and_families_have_different_ones(category: str) -> None:
    signatures: dict[str, set[str]] = {}
    for recipe, result, _ in hundred(category):
        signatures.setdefault(recipe.family, set()).add(exact_signature(result.program))
    assert signatures.keys() == CATEGORIES[category].families.keys()
    assert all(len(found) == 1 for found in signatures.values())
    assert len(set.union(*signatures.values())) == len(signatures)


@pytest.mark.parametrize("category", WITH_PROGRAMS)
def test_a_family_has_one_program_at_the_ends_of_its_ranges_too(category: str) -> None:
    """Whatever touches or doesn't at extreme proportions."""
    rng = np.random.default_rng(0)
    for recipe, result, _ in hundred(category)[: len(CATEGORIES[category].families)]:
        family = CATEGORIES[category].families[recipe.family]
        signatures = {exact_signature(result.program)}
        for _ in range(4):
            ends = {name: float(rng.choice(pair)) for name, pair in family.ranges.items()}
            extreme = Recipe.from_json(recipe.to_json(proportions=ends))
            found = assembled(extreme)
            signatures.add(exact_signature(found.program))
            assert errors(found, draw(extreme).structure.cuboids())[:, 0].max() < CENTRES, recipe.family
        assert len(signatures) == 1, recipe.family


@pytest.mark.parametrize("category", WITH_PROGRAMS)
def test_the_text_reads_back_and_is_of_the_published_form(category: str) -> None:
    """Statements come as cuboids, attachments, symmetries; names say the index; numbers are short."""
    for _, result, _ in hundred(category)[:20]:
        program = result.program
        assert parse(str(program)) == program
        assert re.search(r"\d\.\d{4}", str(program)) is None
        for number, block in enumerate(program.blocks):
            assert block.name == f"Program_{number}"
            kinds = [rank(statement) for statement in block.statements]
            assert kinds == sorted(kinds)
            names = [statement.name for statement in block.statements if isinstance(statement, Declare)]
            assert all(name == f"cube{i}" or name.startswith("Program_") for i, name in enumerate(names))
            assert all(count_fixings(block.statements, name) == (1 if aligned else 2) for name, aligned in flags(block))


def rank(statement: Statement) -> int:
    return {Declare: 0, Attach: 1, Squeeze: 1, Reflect: 2, Translate: 2}[type(statement)]


def flags(block) -> list[tuple[str, bool]]:
    return [(item.name, item.aligned) for item in block.statements if isinstance(item, Declare)]


def count_fixings(statements: tuple[Statement, ...], name: str) -> int:
    return sum(isinstance(item, Attach | Squeeze) and item.a == name for item in statements)


def test_macros_make_what_stands_in_pairs_fours_and_rows() -> None:
    """Four legs are two and their mirror images; slats of a leaning back are no row along an axis."""
    panel, ladder, wire = (next(r for r in recipes("chair", 8) if r.family == f) for f in ("panel", "ladder", "wire"))
    base = assembled(panel).program.blocks[1]
    assert [str(item) for item in base.statements[-2:]] == ["reflect(cube0, X)", "reflect(cube1, X)"]
    assert sum(isinstance(item, Declare) for item in base.statements) == 2
    slats = assembled(ladder).program.blocks[2]
    assert sum(isinstance(item, Declare) for item in slats.statements) == 4
    spindles = assembled(wire).program.blocks[2].statements[-1]
    assert isinstance(spindles, Translate)
    assert (spindles.axis, spindles.count) == ("X", 4)


def test_editing_one_number_moves_what_is_attached() -> None:
    """A higher base takes seat and back up with it; a post that leans more takes the panel along."""
    program = assembled(next(r for r in recipes("chair", 8) if r.family == "panel")).program
    text = str(program)
    height = re.search(r"\tProgram_1 = Cuboid\([\d.]+, ([\d.]+)", text)
    assert height is not None
    raised = text[: height.start(1)] + str(float(height[1]) + 0.1) + text[height.end(1) :]
    before, after = execute(program), execute(parse(raised))
    moved = {name: (after[name].centre - before[name].centre)[1] for name in ("cube1", "Program_2/cube1")}
    assert all(way == pytest.approx(0.1 * 0.9, abs=0.02) for way in moved.values())


def test_a_shape_is_the_same_whatever_other_shapes_there_are() -> None:
    first, again = recipes("table", 9)[4], recipes("table", 18)[4]
    assert program_text(first) == program_text(again)


def test_programs_are_written_beside_the_shapes(tmp_path: Path) -> None:
    for category in CATEGORIES:
        recipe = recipes(category, 1)[0]
        write_shape(tmp_path, recipe, 0.0, np.random.default_rng(0))
        path = tmp_path / f"{category}_programs" / f"{recipe.shape_id}.txt"
        assert path.exists() == (category in WITH_PROGRAMS)
        if path.exists():
            assert path.read_bytes() == program_text(recipe).encode()


numbers = st.floats(-0.4, 0.4)


@given(st.tuples(numbers, numbers, numbers), st.integers(0, 99))
def test_a_meeting_point_lies_in_both_cuboids(offset: tuple[float, float, float], seed: int) -> None:
    """Of a turned cuboid and one whose centre it contains."""
    axes = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    a = Cuboid(np.zeros(3), axes * np.sign(np.linalg.det(axes)), np.array([1.0, 1.2, 1.4]))
    b = Cuboid(np.array(offset), np.eye(3), np.array([0.5, 0.1, 2.0]))
    found = meeting_point(a, b)
    assert beyond(a, found) < 1e-3
    assert beyond(b, found) < 1e-3
    np.testing.assert_allclose(point_in(b, place_in(b, found)), np.clip(found, *bounds(b)), atol=1e-12)


def bounds(cuboid: Cuboid) -> tuple[np.ndarray, np.ndarray]:
    corners = [cuboid.centre + np.array(signs) * cuboid.size / 2 for signs in product((-1, 1), repeat=3)]
    assert np.allclose(np.min(corners, axis=0), lowest(cuboid))
    return np.min(corners, axis=0), np.max(corners, axis=0)
