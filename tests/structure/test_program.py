"""The ShapeAssembly language: what is read, what is printed, what is refused, and how."""

import re
import time
from collections import Counter
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.errors import ProgramError
from cagesdf.structure.canonical import canonical_signature
from cagesdf.structure.executor import execute
from cagesdf.structure.parsing import parse, read_program
from cagesdf.structure.program import (
    MAX_CHARACTERS,
    MAX_COPIES,
    MAX_CUBOIDS,
    MAX_DEPTH,
    MAX_LEAVES,
    MAX_MOVES,
    MAX_STATEMENTS,
    AssemblyProgram,
    Attach,
    Block,
    Declare,
    Reflect,
    Squeeze,
    Translate,
)
from tests.support import programs

EVERYTHING = """Assembly Table {
    bbox = Cuboid(1.0, 0.7, 2.0, True)
    Top = Cuboid(1.0, 0.1, 2.0, True)
    leg = Cuboid(0.1, .6, 1e-1, False)
    rod = Cuboid(0.1, 0.1, 0.1)
    attach(Top, bbox, 0.5, 1.0, 0.5, 0.5, 1, 0.5)
    squeeze(leg, bbox, Top, bot, 0.1, 0.2)
    attach(rod, leg, 0.5, 0.5, 0.5, +0.5, -0.5, 2.)
    reflect(leg, X)
    translate(leg, Z, 2, 0.6)
}
Assembly Top {
    bbox = Cuboid(1.0, 0.1, 2.0, True)
    board = Cuboid(0.4, 0.1, 2.0, True)
    attach(board, bbox, 0.5, 0.5, 0.5, 0.2, 0.5, 0.5)
}
"""

# Statements after `bbox`, `a` and `b` on the lines 2 to 4, and what the complaint about line 5 says.
MALFORMED = [
    ("c = Cuboid(1, 2, True)", "name = Cuboid(l, h, w, True or False)"),
    ("c = Cuboid(1, 2, 3, true)", "name = Cuboid(l, h, w, True or False)"),
    ("c = Cuboid(1, 2, nan, True)", "name = Cuboid(l, h, w, True or False)"),
    ("c = Box(1, 2, 3, True)", "name = Cuboid(l, h, w, True or False)"),
    ("c d = Cuboid(1, 2, 3, True)", "name = Cuboid(l, h, w, True or False)"),
    ("c = Cuboid(1, 0, 3, True)", "positive numbers"),
    ("c = Cuboid(1, -2, 3, True)", "positive numbers"),
    ("c = Cuboid(1, 1e999, 3, True)", "positive numbers"),
    ("a = Cuboid(1, 2, 3, True)", "a is there already"),
    ("bbox = Cuboid(1, 2, 3, True)", "bbox is there already"),
    ("attach(a, b, 0, 0, 0, 1, 1)", "attach(a, b, x1, y1, z1, x2, y2, z2)"),
    ("attach(a, b, 0, 0, 0, 1, 1, 1, 1)", "attach(a, b, x1, y1, z1, x2, y2, z2)"),
    ("attach(a, b, 0, 0, 0, 1, 1, 1) attach(a, b, 0, 0, 0, 1, 1, 1)", "attach(a, b, x1, y1, z1, x2, y2, z2)"),
    ("attach(a, b, 0, 0, 0, 1, 1, 1e999)", "inf is not finite"),
    ("attach(a, c, 0, 0, 0, 1, 1, 1)", "c is not there yet; wanted one of bbox, a, b"),
    ("attach(c, a, 0, 0, 0, 1, 1, 1)", "c is not there yet"),
    ("attach(bbox, a, 0, 0, 0, 1, 1, 1)", "the bbox is fixed"),
    ("attach(a, a, 0, 0, 0, 1, 1, 1)", "can't be attached to itself"),
    ("squeeze(a, b, bbox, side, 0, 0)", "right or left or top or bot or front or back"),
    ("squeeze(a, b, bbox, top, 0)", "squeeze(a, b, c,"),
    ("squeeze(bbox, a, b, top, 0, 0)", "the bbox is fixed"),
    ("squeeze(a, bbox, a, top, 0, 0)", "can't be attached to itself"),
    ("squeeze(a, b, c, top, 0, 0)", "c is not there yet"),
    ("squeeze(a, b, bbox, top, 0, -1e999)", "-inf is not finite"),
    ("reflect(a, x)", "reflect(a, X or Y or Z)"),
    ("reflect(bbox, X)", "the bbox is fixed"),
    ("reflect(c, X)", "c is not there yet"),
    ("translate(a, X, 2.5, 0.5)", "translate(a, X or Y or Z, count, span)"),
    ("translate(a, X, 0, 0.5)", f"wanted 1 to {MAX_COPIES}"),
    (f"translate(a, X, {MAX_COPIES + 1}, 0.5)", f"wanted 1 to {MAX_COPIES}"),
    ("translate(a, X, 99999999999, 0.5)", "translate(a, X or Y or Z, count, span)"),
    ("translate(a, X, 1, 1e999)", "inf is not finite"),
    ("rotate(a, X, 0.5)", "wanted one of name = Cuboid"),
    ("hello", "wanted one of name = Cuboid"),
    ("Assembly Q {", "wanted one of name = Cuboid"),
    ("}}", "wanted one of name = Cuboid"),
    ("P = Cuboid(1, 2, 3, True)", "block P is used already"),
]
HEAD = "Assembly P {\nbbox = Cuboid(1, 1, 1, True)\na = Cuboid(1, 1, 1, True)\nb = Cuboid(1, 1, 1, True)\n"


def complaint(text: str) -> ProgramError:
    with pytest.raises(ProgramError) as error:
        parse(text, "chair.txt")
    return error.value


def nested(depth: int) -> str:
    """Blocks within each other, each with one cuboid."""
    lines = []
    for i in range(depth):
        name = f"B{i + 1}" if i + 1 < depth else "leaf"
        lines += [f"Assembly B{i} {{", "bbox = Cuboid(1, 1, 1, True)", f"{name} = Cuboid(1, 1, 1, True)", "}"]
    return "\n".join(lines)


def test_every_statement_is_read_as_it_is_written() -> None:
    table, top = parse(EVERYTHING).blocks
    assert table.size == (1.0, 0.7, 2.0)
    assert table.statements == (
        Declare("Top", (1.0, 0.1, 2.0), True),
        Declare("leg", (0.1, 0.6, 0.1), False),
        Declare("rod", (0.1, 0.1, 0.1), False),
        Attach("Top", "bbox", (0.5, 1.0, 0.5), (0.5, 1.0, 0.5)),
        Squeeze("leg", "bbox", "Top", "bot", (0.1, 0.2)),
        Attach("rod", "leg", (0.5, 0.5, 0.5), (0.5, -0.5, 2.0)),
        Reflect("leg", "X"),
        Translate("leg", "Z", 2, 0.6),
    )
    assert top.name == "Top"
    names = [(member.name, member.original, member.number) for member in table.members()]
    assert names[3:] == [("cube3", "leg", 1), ("cube4", "leg", 1), ("cube5", "leg", 2)]


def test_a_printed_program_is_read_back_the_same() -> None:
    for program in (parse(EVERYTHING), programs.CHAIR, programs.GROWN):
        assert parse(str(program)) == program


@given(programs.program_texts())
def test_any_program_is_read_back_as_it_was_printed(text: str) -> None:
    program = parse(text)
    assert parse(str(program)) == program
    assert program.with_parameters(program.parameters()) == program


@pytest.mark.parametrize("category", ["chair", "table", "storage"])
def test_real_programs_are_read_back_as_they_were_printed(category: str) -> None:
    for _, text, _ in programs.real_programs(category, 100):
        program = parse(text)
        assert parse(str(program)) == program
        assert str(program).split() == text.split()


def test_comments_blank_lines_and_spaces_change_nothing(tmp_path: Path) -> None:
    roomy = "\n# a table\n\n" + EVERYTHING.replace("\n", "  # what for\r\n \t\r\n").replace(",", " ,\t")
    assert parse(roomy) == parse(EVERYTHING)
    assert parse(EVERYTHING.replace(" = ", "=").replace(", ", ",")) == parse(EVERYTHING)
    (tmp_path / "a.txt").write_text(roomy, encoding="utf-8-sig")
    assert read_program(tmp_path / "a.txt") == parse(EVERYTHING)


@pytest.mark.parametrize(("line", "wanted"), MALFORMED)
def test_a_malformed_line_is_quoted_with_file_number_and_what_was_wanted(line: str, wanted: str) -> None:
    error = complaint(f"{HEAD}{line}\n}}\n")
    assert (error.source, error.line, error.text) == ("chair.txt", 5, line)
    assert wanted in error.wanted
    assert str(error).startswith(f"chair.txt, line 5: {line}: ")


def test_what_is_wrong_with_blocks_is_said_at_their_first_line() -> None:
    leaf = "bbox = Cuboid(1, 1, 1, True)\na = Cuboid(1, 1, 1, True)\n"
    for text, line, wanted in [
        ("", 0, "at least one block"),
        ("# nothing\n", 0, "at least one block"),
        ("a = Cuboid(1, 1, 1, True)", 1, "wanted Assembly NAME {"),
        ("Assembly P\n{", 1, "wanted Assembly NAME {"),
        ("}", 1, "wanted Assembly NAME {"),
        ("Assembly P {\n}", 2, "bbox = Cuboid(l, h, w, True) first"),
        ("Assembly P {\n\na = Cuboid(1, 1, 1, True)\n}", 3, "bbox = Cuboid(l, h, w, True) first"),
        ("Assembly P {\nbbox = Cuboid(1, 1, 1, True)\n}", 1, "no cuboid but its bbox"),
        (f"Assembly P {{\n{leaf}", 3, "wanted } at the end of block P"),
        (f"Assembly P {{\n{leaf}}}\nAssembly P {{\n{leaf}}}", 5, "block P is there already"),
        (f"Assembly P {{\n{leaf}}}\nAssembly Q {{\n{leaf}}}", 5, "no cuboid is called Q"),
        (f"Assembly P {{\n{leaf}}}\nAssembly Q {{\n{leaf}Q = Cuboid(1, 1, 1, True)\n}}", 5, "no cuboid is called Q"),
        (f"Assembly P {{\nbbox = Cuboid(1, -1, 1, True)\n{leaf[29:]}}}", 1, "bbox has lengths 1.0, -1.0, 1.0"),
    ]:
        error = complaint(text)
        assert (error.line, wanted in error.wanted) == (line, True), (text, str(error))


def test_a_block_fills_one_cuboid_and_never_itself() -> None:
    inside = "bbox = Cuboid(1, 1, 1, True)\nQ = Cuboid(1, 1, 1, True)\n"
    twice = f"Assembly P {{\n{inside}R = Cuboid(1, 1, 1, True)\n}}\nAssembly Q {{\nbbox = Cuboid(1, 1, 1, True)\n"
    error = complaint(f"{twice}a = Cuboid(1, 1, 1, True)\n}}\nAssembly R {{\n{inside}}}")
    assert (error.line, "block Q is used already" in error.wanted) == (12, True)
    recursive = f"Assembly P {{\n{inside}}}\nAssembly Q {{\nbbox = Cuboid(1, 1, 1, True)\nP = Cuboid(1, 1, 1, True)\n}}"
    error = complaint(recursive)
    assert (error.line, "block P is used already" in error.wanted) == (7, True)


def test_a_copy_is_neither_copied_nor_called_like_another_cuboid() -> None:
    error = complaint(f"{HEAD}reflect(a, X)\nreflect(cube2, Y)\n}}")
    assert (error.line, "cube2 is a copy" in error.wanted) == (6, True)
    error = complaint(f"{HEAD}cube3 = Cuboid(1, 1, 1, True)\nreflect(a, X)\n}}")
    assert (error.line, "copy would be called cube3" in error.wanted) == (6, True)
    error = complaint(f"{HEAD}reflect(a, X)\ncube2 = Cuboid(1, 1, 1, True)\n}}")
    assert (error.line, "cube2 is there already" in error.wanted) == (6, True)
    assert len(execute(parse(f"{HEAD}reflect(a, X)\nattach(b, cube2, 0, 0, 0, 1, 1, 1)\n}}"))) == 3


def test_limits_end_in_errors_that_name_them() -> None:
    assert f"{MAX_CHARACTERS:,} characters" in complaint("#" * (MAX_CHARACTERS + 1)).wanted
    assert f"{MAX_STATEMENTS:,} statements" in complaint(HEAD + "reflect(a, X)\n" * MAX_STATEMENTS + "}").wanted
    many = complaint(HEAD + f"translate(a, X, {MAX_COPIES}, 1)\n" * 2 + "}")
    assert (many.line, f"{MAX_CUBOIDS} cuboids in a block" in many.wanted) == (6, True)
    declared = "".join(f"c{i} = Cuboid(1, 1, 1, True)\n" for i in range(MAX_CUBOIDS - 2))
    assert len(execute(parse(f"{HEAD}{declared}}}"))) == MAX_CUBOIDS
    more = complaint(f"{HEAD}{declared}another = Cuboid(1, 1, 1, True)\n}}")
    assert (more.line, f"{MAX_CUBOIDS} cuboids in a block" in more.wanted) == (MAX_CUBOIDS + 3, True)
    moved = complaint(HEAD + "attach(a, b, 0, 0, 0, 1, 1, 1)\n" * (MAX_MOVES + 1) + "}")
    assert (moved.line, f"{MAX_MOVES} attachments" in moved.wanted) == (5 + MAX_MOVES, True)
    assert len(execute(parse(nested(MAX_DEPTH)))) == 1
    assert f"{MAX_DEPTH} blocks within" in complaint(nested(MAX_DEPTH + 1)).wanted


def test_copies_of_copies_through_blocks_are_counted() -> None:
    blocks = []
    for i in range(3):
        name = f"B{i + 1}" if i < 2 else "leaf"
        statements = (Declare(name, (1.0, 1.0, 1.0), True), Translate(name, "X", 40, 1.0))
        blocks.append(Block(f"B{i}", (1.0, 1.0, 1.0), statements))
    with pytest.raises(ProgramError, match=f"{MAX_LEAVES:,} cuboids"):
        AssemblyProgram(tuple(blocks))
    assert len(execute(AssemblyProgram(tuple(blocks[1:])))) == 41**2


def test_files_that_hold_no_text_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "b.txt").write_bytes(b"#" * (4 * MAX_CHARACTERS + 1))
    for name in ("a.txt", "b.txt", "c.txt", "."):
        with pytest.raises(ProgramError) as error:
            read_program(tmp_path / name)
        assert error.value.source == str(tmp_path / name)


def test_parameters_stand_in_the_order_of_the_text() -> None:
    program = parse(EVERYTHING)
    numbers = program.parameters()
    assert len(numbers) == 4 * 3 + 2 * 6 + 2 + 1 + 2 * 3 + 6
    np.testing.assert_array_equal(numbers[:6], [1.0, 0.7, 2.0, 1.0, 0.1, 2.0])
    np.testing.assert_array_equal(numbers[-6:], [0.5, 0.5, 0.5, 0.2, 0.5, 0.5])
    longer = program.with_parameters(numbers + 0.25)
    np.testing.assert_array_equal(longer.parameters(), numbers + 0.25)
    assert isinstance(longer.blocks[0].statements[7], Translate)
    assert longer.blocks[0].statements[7].span == 0.85
    for wrong, say in ((numbers[:-1], "few"), (np.append(numbers, 1.0), "many")):
        with pytest.raises(ValueError, match=say):
            program.with_parameters(wrong)
    with pytest.raises(ProgramError, match="positive"):
        program.with_parameters(-numbers)


def survives(text: str) -> None:
    """Parsing and executing end, and in nothing worse than a ProgramError of one short line."""
    said = ""
    try:
        execute(parse(text))
    except ProgramError as error:
        said = str(error)
    assert "\n" not in said
    assert len(said) < 800


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    survives(text)
    survives(f"{HEAD}{text}\n}}\n")


WORDS = ["}", "{", "(", ")", ",", "=", "#", "\n", "bbox", "cube0", "cube3", "Program_1", "leg", "P", "X", "top", "True"]
WORDS += ["Assembly Q {", "reflect(leg, X)", "translate(leg, Z, 256, 1)", "attach(", "Cuboid(1, 1, 1, True)"]
WORDS += ["0", "-1", "1e308", "1e-308", "1e999", "nan", ".", "é", "\x00", "\u2028"]


@settings(deadline=None, max_examples=150)
@given(
    st.sampled_from([EVERYTHING, str(programs.CHAIR), str(programs.GROWN)]),
    st.lists(st.tuples(st.floats(0, 1), st.integers(0, 30), st.sampled_from(WORDS)), min_size=1, max_size=4),
)
def test_a_program_with_anything_changed_is_read_or_refused(text: str, edits: list[tuple[float, int, str]]) -> None:
    for where, cut, word in edits:
        at = int(where * len(text))
        text = text[:at] + word + text[at + cut :]
    survives(text)


@settings(deadline=None, max_examples=150)
@given(
    st.sampled_from([programs.CHAIR, programs.GROWN]),
    st.dictionaries(
        st.integers(0, 40),
        st.sampled_from([0.0, 0.5, 1.0, -3.0, 1e-300, 1e300, 1.7e308, 1e-5, 7.0]),
        min_size=1,
        max_size=6,
    ),
)
def test_a_program_with_any_numbers_is_executed_or_refused(program: AssemblyProgram, changes: dict[int, float]) -> None:
    numbers = program.parameters()
    for i, number in changes.items():
        numbers[i % len(numbers)] = number
    try:
        changed = program.with_parameters(numbers)
    except ProgramError:
        return
    survives(str(changed))


@pytest.mark.parametrize("digits", ["1" * 200_000, "1" * 200_000 + "x", "1." * 100_000, " " * 200_000 + "x"])
def test_long_numbers_are_read_in_linear_time(digits: str) -> None:
    """A pattern that backtracks would need minutes: its time grows with the square."""
    start = time.process_time()
    complaint(f"{HEAD}attach(a, b, {digits}, {digits}, 0, 0, 0, {digits})\n}}")
    assert time.process_time() - start < 2


def mutated(text: str, rng: Random) -> bytes:
    """A program's text with a few lines, words or bytes changed, in some encoding."""
    lines = text.splitlines()
    for _ in range(rng.choice((1, 1, 2, 4))):
        i, j = (rng.randrange(len(lines)) for _ in range(2))
        words = re.split(r"([\w.+-]+)", lines[i])
        words[rng.randrange(len(words))] = rng.choice(FRAGMENTS)
        lines[i : i + 1] = rng.choice(
            ([], ["".join(words)], [lines[j]], [lines[i]] * rng.choice((2, 500)), [lines[i][: rng.randrange(40)]])
        ) or [""]
    content = "\n".join(lines).encode(rng.choice(ENCODINGS), errors="replace")
    flipped = bytearray(content)
    for _ in range(rng.choice((0, 0, 1, 5))):
        flipped[rng.randrange(len(flipped))] = rng.randrange(256)
    return bytes(flipped)


FRAGMENTS = (
    "1e308", "-1e309", "nan", "1e-320", "9" * 5000, "256", "257", "bbox", "Program_0", "cube0", "X", "True", "attach",
    "squeeze", "reflect", "translate", "Cuboid", "Assembly", "{", "}", "(", ",", "#", "\u0660", "\ufeff",
    "\u2028", "\x00",
)  # fmt: skip
ENCODINGS = ("utf-8", "utf-8", "utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-32", "latin-1")


def test_any_mutated_file_is_a_program_that_executes_and_is_signed_or_a_program_error(tmp_path: Path) -> None:
    rng, path = Random(14), tmp_path / "p.txt"
    outcomes: Counter[str] = Counter()
    for _ in range(250):
        path.write_bytes(mutated(str(rng.choice((programs.CHAIR, programs.GROWN))), rng))
        try:
            program = read_program(path)
            assert len(execute(program)) >= 1
            canonical_signature(program)
            outcomes["read"] += 1
        except ProgramError:
            outcomes["refused"] += 1
    assert min(outcomes["read"], outcomes["refused"]) > 10, outcomes
