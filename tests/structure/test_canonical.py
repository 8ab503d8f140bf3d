"""Which programs count as equal: names and order don't matter to the canonical signature, all else does."""

import time
from contextlib import suppress
from dataclasses import replace
from itertools import combinations, permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.errors import ProgramError
from cagesdf.structure import canonical
from cagesdf.structure.canonical import (
    canonical_signature,
    exact_signature,
    fact,
    node_signatures,
    without_flags,
)
from cagesdf.structure.parsing import parse
from cagesdf.structure.program import (
    BBOX,
    MAX_CUBOIDS,
    AssemblyProgram,
    Attach,
    Block,
    Declare,
    Reflect,
    Squeeze,
    Statement,
    Translate,
)
from tests.support import programs

CHAIR = str(programs.CHAIR)


@settings(deadline=None)
@given(programs.program_texts(), st.integers(0, 2**32 - 1))
def test_other_names_and_another_order_leave_the_canonical_signature_alone(text: str, seed: int) -> None:
    program = parse(text)
    other = programs.scrambled(program, np.random.default_rng(seed))
    assert canonical_signature(other) == canonical_signature(program)
    assert sorted(node_signatures(other, ".").values()) == sorted(node_signatures(program, ".").values())


@settings(deadline=None)
@given(programs.program_texts(), st.floats(0.9, 1.1))
def test_numbers_leave_both_signatures_alone(text: str, factor: float) -> None:
    program = parse(text)
    other = program.with_parameters(program.parameters() * factor)
    assert exact_signature(other) == exact_signature(program)
    assert canonical_signature(other) == canonical_signature(program)


@pytest.mark.parametrize("category", ["chair", "table", "storage"])
def test_real_programs_keep_their_canonical_signature_when_scrambled(category: str) -> None:
    rng = np.random.default_rng(0)
    for _, text, _ in programs.real_programs(category, 40):
        program = parse(text)
        assert canonical_signature(programs.scrambled(program, rng)) == canonical_signature(program)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("squeeze(leg, bbox, bbox, top", "squeeze(leg, bbox, bbox, bot"),
        ("squeeze(bar, leg, bbox, back", "squeeze(bar, bbox, leg, back"),
        ("reflect(arm, X)", "reflect(arm, Z)"),
        ("reflect(arm, X)", "reflect(back, X)"),
        ("reflect(arm, X)", "translate(arm, X, 1, 0.5)"),
        ("translate(leg, Z, 2", "translate(leg, Z, 3"),
        ("translate(leg, Z, 2", "translate(leg, Y, 2"),
        ("attach(back, seat, 0.5", "attach(back, Base, 0.5"),
        ("0.5, False)\n\tattach(Base", "0.5, True)\n\tattach(Base"),
        ("\treflect(Side, X)\n", ""),
        ("\treflect(Side, X)\n", "\treflect(Side, X)\n\treflect(Side, X)\n"),
    ],
)
def test_a_face_axis_count_operand_flag_or_statement_changes_both_signatures(old: str, new: str) -> None:
    assert CHAIR.count(old) == 1
    changed = parse(CHAIR.replace(old, new))
    assert canonical_signature(changed) != canonical_signature(programs.CHAIR)
    assert exact_signature(changed) != exact_signature(programs.CHAIR)


def test_the_exact_signature_depends_on_names_and_order() -> None:
    renamed = parse(CHAIR.replace("arm", "rest"))
    assert exact_signature(renamed) != exact_signature(programs.CHAIR)
    lines = CHAIR.splitlines(keepends=True)
    swapped = parse("".join([*lines[:2], lines[3], lines[2], *lines[4:]]))
    assert exact_signature(swapped) != exact_signature(programs.CHAIR)
    assert canonical_signature(swapped) == canonical_signature(renamed) == canonical_signature(programs.CHAIR)


def test_without_flags_programs_are_equal_that_differ_in_them_alone() -> None:
    other = parse(CHAIR.replace("False", "True"))
    assert canonical_signature(other) != canonical_signature(programs.CHAIR)
    assert canonical_signature(without_flags(other)) == canonical_signature(without_flags(programs.CHAIR))


def test_it_matters_of_which_cuboid_something_is_a_copy() -> None:
    """Two posts on each other, both mirrored: a cap on the one's image is not a cap on the other's."""
    head = "Assembly P {\nbbox = Cuboid(1, 1, 1, True)\n"
    head += "".join(f"{name} = Cuboid(1, 1, 1, True)\n" for name in "abc")
    places = "0, 0, 0, 1, 1, 1)\n"
    head += f"attach(a, bbox, {places}attach(b, a, {places}reflect(a, X)\nreflect(b, X)\n"
    low, high = (parse(f"{head}attach(c, {copy}, {places}}}") for copy in ("cube3", "cube4"))
    assert canonical_signature(low) != canonical_signature(high)


def test_siblings_share_a_node_signature_only_if_nothing_tells_them_apart() -> None:
    program = parse(
        "Assembly P {\nbbox = Cuboid(1, 1, 1, True)\n"
        + "".join(f"leg{i} = Cuboid(0.1, {i}, 0.1, True)\n" for i in (1, 2))
        + "top = Cuboid(1, 1, 1, True)\n"
        + "".join(f"squeeze(leg{i}, bbox, top, bot, 0.{i}, 0.1)\nreflect(leg{i}, X)\n" for i in (1, 2))
        + "}"
    )
    nodes = node_signatures(program, ".")
    assert nodes["."] == canonical_signature(program)
    assert nodes["leg1"] == nodes["leg2"]
    assert nodes["cube3"] == nodes["cube4"]
    assert len({nodes["leg1"], nodes["cube3"], nodes["top"]}) == 3


# Soundness: against a search through all ways to call one block's cuboids as another's.


def said(block: Block) -> list[tuple[str, tuple[str, ...]]]:
    """What a block's statements say, copies named with what they copy."""
    copies = iter([member.name for member in block.members() if member.copied_by is not None])
    found = []
    for statement in block.statements:
        kind, names = fact(statement)
        if isinstance(statement, Reflect | Translate):
            names += tuple(next(copies) for _ in range(getattr(statement, "count", 1)))
        found.append((kind, names))
    return found


def can_be_renamed(a: Block, b: Block) -> bool:
    """Whether some renaming of all cuboids makes the one block say what the other says."""
    ours, theirs = said(a), sorted(said(b))
    names, targets = ([member.name for member in block.members()] for block in (a, b))
    if len(names) != len(targets) or sorted(kind for kind, _ in ours) != [kind for kind, _ in theirs]:
        return False
    return any(
        sorted((kind, tuple(called[name] for name in operands)) for kind, operands in ours) == theirs
        for order in permutations(targets)
        for called in [{BBOX: BBOX, **dict(zip(names, order))}]
    )


def small_block(rng: np.random.Generator) -> Block:
    """Three cuboids and few words, so that many such blocks are equal."""
    origin, names = (0.0, 0.0, 0.0), ["a", "b", "c"]
    statements: list[Statement] = [Declare(name, (1.0, 1.0, 1.0), True) for name in names]
    for _ in range(int(rng.integers(1, 4))):
        copies = len(Block("P", (1.0, 1.0, 1.0), tuple(statements)).members()) - 3
        known = [*names, *(f"cube{3 + i}" for i in range(copies))]
        a = names[rng.integers(3)]
        b, c = rng.choice([BBOX, *(name for name in known if name != a)], 2).tolist()
        choices: list[Statement] = [Attach(a, b, origin, origin), Squeeze(a, b, c, "top", (0.0, 0.0))]
        if copies < 2:
            choices += [Reflect(a, "X"), Translate(a, "X", 1, 1.0)]
        statements.append(choices[rng.integers(len(choices))])
    return Block("P", (1.0, 1.0, 1.0), tuple(statements))


def test_signatures_are_equal_just_where_some_renaming_makes_the_programs_equal() -> None:
    rng = np.random.default_rng(0)
    blocks = [small_block(rng) for _ in range(120)]
    signatures = [canonical_signature(AssemblyProgram((block,))) for block in blocks]
    outcomes = []
    for (a, one), (b, other) in combinations(zip(blocks, signatures), 2):
        outcomes.append(can_be_renamed(a, b))
        assert (one == other) == outcomes[-1], f"{a}\n{b}"
    assert outcomes.count(True) > 20


def test_blocks_are_part_of_the_signature_wherever_they_stand() -> None:
    lines = CHAIR.replace("squeeze(bar, leg, bbox, back", "squeeze(bar, leg, bbox, front")
    assert canonical_signature(parse(lines)) != canonical_signature(programs.CHAIR)
    shuffled = AssemblyProgram((programs.CHAIR.blocks[0], *reversed(programs.CHAIR.blocks[1:])))
    assert canonical_signature(shuffled) == canonical_signature(programs.CHAIR)


def test_deep_and_wide_programs_are_signed_in_time() -> None:
    """Signing a block again for each use of its signature would double the work with each level."""
    blocks = []
    for i in range(16):
        inside = Declare(f"B{i + 1}", (1.0, 1.0, 1.0), True)
        blocks.append(Block(f"B{i}", (1.0, 1.0, 1.0), (inside, replace(inside, name="leaf"))))
    start = time.process_time()
    canonical_signature(AssemblyProgram(tuple(blocks)))
    slats = tuple(Declare(f"s{i}", (1.0, 1.0, 1.0), True) for i in range(60))
    canonical_signature(AssemblyProgram((Block("P", (1.0, 1.0, 1.0), slats),)))
    assert time.process_time() - start < 10


@settings(deadline=None, max_examples=40)
@given(programs.program_texts(), st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_cuboids_that_are_interchangeable_get_the_names_they_would_get_one_by_one(
    text: str, seed: int, times: int
) -> None:
    """Programs with some statements said several times over, of new cuboids."""
    rng, program = np.random.default_rng(seed), parse(text)
    blocks = []
    for block in program.blocks:
        leaves = [s for s in block.statements if isinstance(s, Declare) and program.block(s.name) is None]
        twins = [s for i, s in enumerate(leaves) if i in rng.integers(0, len(leaves), 2)] if leaves else []
        said: list[Statement] = []
        for statement in block.statements:
            said.append(statement)
            for twin in twins:
                if statement == twin:
                    said += [replace(twin, name=f"{twin.name}_twin{i}") for i in range(times)]
                elif isinstance(statement, Attach) and statement.a == twin.name:
                    said += [replace(statement, a=f"{twin.name}_twin{i}") for i in range(times)]
        copies = [s for s in said if isinstance(s, Reflect | Translate)]
        blocks.append(replace(block, statements=tuple(s for s in said if s not in copies)))
    with suppress(ProgramError):
        doubled = AssemblyProgram(tuple(blocks))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(canonical, "_interchangeable", lambda facts, names: False)
            one_by_one = canonical_signature(doubled)
        assert canonical_signature(doubled) == one_by_one


def test_a_block_full_of_cuboids_that_nothing_tells_apart_takes_a_few_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    rounds, refined = [0], canonical._refined

    def counted(*arguments: Any) -> dict[str, int]:
        rounds[0] += 1
        return refined(*arguments)

    monkeypatch.setattr(canonical, "_refined", counted)
    cuboids = [Declare(f"c{i}", (1.0, 1.0, 1.0), True) for i in range(MAX_CUBOIDS)]
    canonical_signature(AssemblyProgram((Block("A", (1.0, 1.0, 1.0), tuple(cuboids)),)))
    assert rounds[0] == 2
