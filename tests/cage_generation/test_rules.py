"""The rules allow what published programs say, and all that they allow executes."""

import numpy as np
import pytest

from cagesdf.cage_generation.rules import OVERHANG, BlockRules, Invalid
from cagesdf.cage_generation.tokens import (
    ATTACH,
    CUBOID,
    END,
    FACE_NAMES,
    OPERANDS,
    PHASE,
    REFLECT,
    SLOTS,
    SQUEEZE,
    TRANSLATE,
    command_of,
)
from cagesdf.structure.executor import execute
from cagesdf.structure.parsing import parse
from cagesdf.structure.program import (
    AXES,
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

COPIES = (REFLECT, TRANSLATE)


def check_allowed(block: Block) -> None:
    """Every statement of a block, and its end, is one that the rules allow where it stands."""
    rules = BlockRules(block.size)
    for statement in block.statements:
        command, names = command_of(statement)
        assert rules.commands()[command], statement
        known = {name: slot for slot, name in enumerate([*rules.names, *names[: command == CUBOID]])}
        chosen: tuple[int, ...] = ()
        for name in names:
            assert rules.operands(command, chosen)[known[name]], (str(statement), name)
            chosen += (known[name],)
        if isinstance(statement, Reflect | Translate):
            assert rules.axes(command, chosen[0])[AXES.index(statement.axis)], statement
        if isinstance(statement, Squeeze):
            assert rules.faces(chosen)[FACE_NAMES.index(statement.face)], statement
        rules.add(statement)
    assert rules.commands()[END]
    assert len(rules.attached()) == len(rules.names) - 1


@pytest.mark.parametrize("category", ["chair", "table", "storage"])
def test_every_published_program_keeps_to_the_rules(category: str) -> None:
    for _, text, _ in programs.real_programs(category, 300):
        for block in parse(text).blocks:
            check_allowed(block)


def random_statement(rules: BlockRules, rng: np.random.Generator) -> Statement | None:
    """One of those that the rules allow, with any numbers; None at the end."""
    command = int(rng.choice(np.flatnonzero(rules.commands())))
    chosen: tuple[int, ...] = ()
    for _ in range(OPERANDS.get(command, 0)):
        allowed = rules.operands(command, chosen)
        assert allowed.any(), "a command that is allowed has cuboids to speak of"
        chosen += (int(rng.choice(np.flatnonzero(allowed))),)
    names = [*rules.names, f"cube{len(rules.names) - 1}"]
    x, y, z, u, v, w = rng.uniform(0, 1, 6).round(2).tolist()
    if command == CUBOID:
        return Declare(names[chosen[0]], (x + 0.01, y + 0.01, z + 0.01), bool(rng.integers(2)))
    if command == ATTACH:
        return Attach(names[chosen[0]], names[chosen[1]], (x, y, z), (u, v, w))
    if command == SQUEEZE:
        face = FACE_NAMES[int(rng.choice(np.flatnonzero(rules.faces(chosen))))]
        return Squeeze(names[chosen[0]], names[chosen[1]], names[chosen[2]], face, (u, v))
    if command in COPIES:
        axis = AXES[int(rng.choice(np.flatnonzero(rules.axes(command, chosen[0]))))]
        return Reflect(names[chosen[0]], axis) if command == REFLECT else Translate(names[chosen[0]], axis, 2, x)
    return None


def test_any_walk_along_the_rules_is_a_program_that_executes() -> None:
    rng = np.random.default_rng(0)
    finished = 0
    for _ in range(300):
        rules = BlockRules((1.0, 1.2, 0.8))
        last = 0
        try:
            while (statement := random_statement(rules, rng)) is not None:
                phase = PHASE[command_of(statement)[0]]
                assert phase >= last
                last = phase
                rules.add(statement)
        except Invalid:
            continue
        finished += 1
        program = AssemblyProgram((Block("Root", (1.0, 1.2, 0.8), tuple(rules.statements)),))
        cage = execute(program)
        kept = [cage.part_ids.index(rules.names[slot]) for slot in rules.attached()]
        assert kept
        assert np.abs(cage.corners()[kept]).max() <= 0.6 + OVERHANG * 1.2 + 1e-9
    assert finished > 30


A, B = Declare("a", (0.2, 0.2, 0.2), True), Declare("b", (0.2, 0.2, 0.2), True)
MIDDLE = (0.5, 0.5, 0.5)


def begun(*statements: Statement) -> BlockRules:
    rules = BlockRules((1.0, 1.0, 1.0))
    for statement in statements:
        rules.add(statement)
    return rules


def test_a_block_begins_with_a_cuboid_and_ends_with_one_attached() -> None:
    assert np.flatnonzero(begun().commands()).tolist() == [CUBOID]
    assert not begun(A).commands()[END]
    assert begun(A, Attach("a", "bbox", MIDDLE, MIDDLE)).commands()[END]


def test_no_cuboid_is_declared_after_an_attachment_and_none_attached_after_a_copy() -> None:
    attached = begun(A, B, Attach("a", "bbox", MIDDLE, (0.2, 0.5, 0.5)))
    assert not attached.commands()[CUBOID]
    attached.add(Reflect("a", "X"))
    assert not attached.commands()[[CUBOID, ATTACH, SQUEEZE]].any()
    assert not attached.commands()[[REFLECT, TRANSLATE]].any(), "a is copied, b is nowhere"


def test_nothing_is_attached_to_what_has_no_place_or_to_itself() -> None:
    rules = begun(A, B)
    assert np.flatnonzero(rules.operands(ATTACH, (1,))).tolist() == [0]
    rules.add(Attach("a", "bbox", MIDDLE, MIDDLE))
    assert np.flatnonzero(rules.operands(ATTACH, (2,))).tolist() == [0, 1]
    assert np.flatnonzero(rules.operands(ATTACH, (1,))).tolist() == [0]


def test_a_cuboid_is_attached_twice_at_most_and_squeezed_only_before() -> None:
    rules = begun(A, B, Attach("a", "bbox", MIDDLE, MIDDLE), Squeeze("b", "bbox", "a", "top", (0.5, 0.5)))
    assert np.flatnonzero(rules.operands(ATTACH, ())).tolist() == [1]
    assert not rules.operands(SQUEEZE, ()).any()
    rules.add(Attach("a", "bbox", MIDDLE, MIDDLE))
    assert not rules.operands(ATTACH, ()).any()
    assert not rules.commands()[[ATTACH, SQUEEZE]].any()


def test_nothing_is_mirrored_in_a_plane_through_its_centre() -> None:
    rules = begun(A, Attach("a", "bbox", MIDDLE, (0.2, 0.5, 0.5)))
    assert rules.axes(REFLECT, 1).tolist() == [True, False, False]
    assert not begun(A, Attach("a", "bbox", MIDDLE, MIDDLE)).commands()[REFLECT]


def test_a_squeeze_that_holds_to_the_bbox_is_vertical() -> None:
    upright = BlockRules.faces((1, 0, 2))
    assert [name for name, allowed in zip(FACE_NAMES, upright) if allowed] == ["top", "bot"]
    assert BlockRules.faces((1, 2, 3)).all()


def test_at_most_ten_cuboids_are_declared() -> None:
    rules = begun(*[Declare(f"cube{i}", (0.1, 0.1, 0.1), True) for i in range(SLOTS - 1)])
    assert not rules.commands()[CUBOID]
    assert rules.commands()[ATTACH]


def test_a_part_far_from_its_block_is_invalid_with_its_reason() -> None:
    long = Declare("a", (3.0, 0.1, 0.1), True)
    with pytest.raises(Invalid, match="outside its block"):
        begun(long, Attach("a", "bbox", (0.0, 0.5, 0.5), MIDDLE))
