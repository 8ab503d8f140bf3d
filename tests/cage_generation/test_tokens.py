"""Rows of numbers and programs say the same."""

from dataclasses import replace

import numpy as np
import pytest

from cagesdf.cage_generation.tokens import (
    ATTACH,
    CUBOID,
    END,
    OPERAND,
    SIZES,
    SLOTS,
    WIDTH,
    BlockTokens,
    program_of,
    tokens_of,
)
from cagesdf.errors import ProgramError
from cagesdf.structure.canonical import canonical_signature
from cagesdf.structure.executor import execute
from cagesdf.structure.parsing import parse
from tests.support import programs


def in_one_block(*lines: str) -> str:
    return "\n".join(["Assembly Root {", "bbox = Cuboid(1, 1, 1, True)", *lines, "}"])


@pytest.mark.parametrize("category", ["chair", "table", "storage"])
def test_every_published_program_comes_back_from_its_rows_letter_by_letter(category: str) -> None:
    for name, text, _ in programs.real_programs(category, 400):
        program = parse(text, name)
        assert str(program_of(tokens_of(program))) == str(program)


@pytest.mark.parametrize("program", [programs.CHAIR, programs.GROWN])
def test_names_are_all_that_is_lost(program) -> None:
    again = program_of(tokens_of(program))
    assert again != program
    assert canonical_signature(again) == canonical_signature(program)
    assert np.array_equal(again.parameters(), program.parameters())
    assert np.array_equal(execute(again).vectors(), execute(program).vectors())
    assert program_of(tokens_of(again)) == again


def test_blocks_are_in_breadth_whatever_their_order_in_the_text() -> None:
    root, base, side = programs.CHAIR.blocks
    turned = replace(programs.CHAIR, blocks=(root, side, base))
    for ours, theirs in zip(tokens_of(turned), tokens_of(programs.CHAIR), strict=True):
        assert np.array_equal(ours.lines, theirs.lines)
        assert np.array_equal(ours.filling, theirs.filling)


def test_a_row_marks_its_command_and_each_of_its_cuboids_once() -> None:
    for block in tokens_of(programs.CHAIR):
        assert (block.lines[:, :7].sum(axis=1) == 1).all()
        assert (block.lines[:, OPERAND[0]].sum(axis=1) == 1).all()
        assert (block.lines[:, OPERAND[1]].sum(axis=1) >= block.lines[:, ATTACH]).all()


TOO_MANY = [f"c{i} = Cuboid(1, 1, 1, True)" for i in range(SLOTS)]


@pytest.mark.parametrize(
    ("lines", "wanted"),
    [
        (TOO_MANY, "wanted at most 10 cuboids"),
        (["a = Cuboid(1, 1, 11, True)"], r"wanted numbers from .* to 10.0"),
        (["a = Cuboid(1, 1, 1, True)", "attach(a, bbox, 0, 0, 0, 0, 0, 2.5)"], "wanted numbers from -1.0 to 2.0"),
        (["a = Cuboid(1, 1, 1, True)", "translate(a, X, 100, 1)"], "wanted at most 64 copies"),
        (
            ["a = Cuboid(1, 1, 1, True)", "reflect(a, X)", "attach(a, bbox, 0, 0, 0, 0, 0, 0)"],
            "wanted cuboids before attachments before copies",
        ),
        (
            ["a = Cuboid(1, 1, 1, True)", "reflect(a, X)", "attach(a, cube1, 0, 0, 0, 0, 0, 0)"],
            "cube1 is a copy; wanted declared cuboids",
        ),
        (["a = Cuboid(1, 1, 1, True)", *["attach(a, bbox, 0, 0, 0, 0, 0, 0)"] * 64], "wanted at most 64 statements"),
    ],
)  # fmt: skip
def test_what_rows_cannot_hold_is_refused_by_line(lines: list[str], wanted: str) -> None:
    with pytest.raises(ProgramError, match=wanted):
        tokens_of(parse(in_one_block(*lines)))


def test_blocks_within_each_other_are_limited() -> None:
    text = "".join(
        f"Assembly B{i} {{\nbbox = Cuboid(1, 1, 1, True)\nB{i + 1} = Cuboid(1, 1, 1, True)\n}}\n" for i in range(5)
    )
    with pytest.raises(ProgramError, match="4 within each other"):
        tokens_of(parse(text))


def test_rows_that_say_nothing_or_name_no_cuboid_are_refused() -> None:
    (root, *_) = tokens_of(programs.GROWN)
    for change in ("nothing", "end", "slot"):
        lines = root.lines.copy()
        row = lines[int(np.flatnonzero(lines[:, ATTACH])[0])]
        if change == "slot":
            row[OPERAND[1]] = np.eye(SLOTS)[SLOTS - 1]
        else:
            row[:] = np.eye(WIDTH)[END] if change == "end" else 0
        with pytest.raises(ProgramError, match="wanted a statement about some of bbox"):
            program_of((BlockTokens(root.size, lines, root.filling),))


def test_the_thinnest_length_is_within_the_bounds() -> None:
    text = in_one_block(f"a = Cuboid(1, {SIZES[0]}, 1, False)")
    assert tokens_of(parse(text))[0].lines[0, CUBOID] == 1
