"""What is written from codes, trained or not, is a valid program or says why it is none."""

from collections import Counter

import numpy as np
import pytest
import torch

from cagesdf.cage_generation import decoding
from cagesdf.cage_generation.decoding import ASIDE, THINNEST, Written, decode
from cagesdf.cage_generation.program_vae import ProgramVAE
from cagesdf.cage_generation.programs import ProgramGenerator
from cagesdf.cage_generation.rules import BlockRules
from cagesdf.cage_generation.tokens import (
    CUBOID,
    END,
    FACE_NAMES,
    PHASE,
    command_of,
    program_of,
    tokens_of,
)
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.canonical import exact_signature
from cagesdf.structure.executor import execute
from cagesdf.structure.program import AXES, AssemblyProgram, Declare, Reflect, Squeeze, Translate, numbers_of

REASONS = {
    "degenerate numbers",
    "cuboid shrunk to nothing",
    "cuboid outside its block",
    "part outside the program's bbox",
    "too many blocks",
}


def linear(head: torch.nn.Sequential) -> torch.nn.Linear:
    """The last layer of a head."""
    last = head[-1]
    assert isinstance(last, torch.nn.Linear)
    return last


def untrained(seed: int) -> ProgramVAE:
    """One whose choices differ from code to code and line to line, and whose numbers are not absurd."""
    model = ProgramVAE.drawn(24, 6, seed)
    decoder = model.decoder
    with torch.no_grad():
        for head in (decoder.command, decoder.operands, decoder.aligned, decoder.leaf, decoder.copies, decoder.squeeze):
            linear(head).weight.mul_(8.0)
        for parameter in decoder.writer.parameters():
            parameter.mul_(4.0)
        for head, value in ((decoder.bbox, 1.0), (decoder.lengths, 0.3), (decoder.places, 0.5), (decoder.squeeze, 0.5)):
            linear(head).bias.fill_(value)
    return model


def codes(count: int, seed: int) -> torch.Tensor:
    return torch.randn(count, 6, generator=torch.Generator().manual_seed(seed))


def program_or_reason(item: Written | str) -> AssemblyProgram | str:
    return item.program if isinstance(item, Written) else item


@pytest.fixture(scope="module")
def written() -> list[AssemblyProgram | str]:
    return [program_or_reason(item) for seed in range(12) for item in decode(untrained(seed).decoder, codes(40, seed))]


def test_every_code_gives_a_program_that_executes_near_its_bbox_or_a_reason(
    written: list[AssemblyProgram | str],
) -> None:
    found = Counter(item if isinstance(item, str) else "valid" for item in written)
    assert set(found) <= REASONS | {"valid"}
    assert found["valid"] > 20, found
    for program in written:
        if isinstance(program, AssemblyProgram):
            size = np.array(program.blocks[0].size)
            corners = execute(program).corners().reshape(-1, 3)
            assert (np.abs(corners) - size / 2).max() <= ASIDE * size.max()


def test_no_program_breaks_a_rule(written: list[AssemblyProgram | str]) -> None:
    """Those of phases, operands, axes and faces, asked again of what remained."""
    seen: Counter[int] = Counter()
    for program in written:
        if isinstance(program, str):
            continue
        for block in program.blocks:
            rules, phase = BlockRules(block.size), 0
            for statement in block.statements:
                command, names = command_of(statement)
                seen[command] += 1
                assert PHASE[command] >= phase
                phase = PHASE[command]
                known = {name: slot for slot, name in enumerate([*rules.names, *names[: command == CUBOID]])}
                slots = tuple(known[name] for name in names)
                assert all(rules.operands(command, slots[:i])[slot] for i, slot in enumerate(slots))
                if isinstance(statement, Reflect | Translate):
                    assert rules.axes(command, slots[0])[AXES.index(statement.axis)]
                if isinstance(statement, Squeeze):
                    assert rules.faces(slots)[FACE_NAMES.index(statement.face)]
                if isinstance(statement, Declare):
                    assert min(numbers_of(statement)) >= np.float32(THINNEST)
                rules.add(statement)
            assert rules.commands()[END]
            assert len(rules.attached()) == len(rules.names) - 1, "nothing is left in mid-air"
    assert len(seen) == 5, "all statements are tried"


def test_a_programs_rows_say_the_same(written: list[AssemblyProgram | str]) -> None:
    for program in written:
        if isinstance(program, AssemblyProgram):
            assert program_of(tokens_of(program)) == program


def test_programs_beside_it_do_not_change_a_program() -> None:
    model, many = untrained(1), codes(30, 3)
    together = decode(model.decoder, many)
    alone = [decode(model.decoder, code[None])[0] for code in many]
    for a, b in zip(together, alone):
        assert type(a) is type(b)
        if isinstance(a, Written) and isinstance(b, Written):
            assert np.allclose(a.program.parameters(), b.program.parameters(), atol=1e-4)
            assert a.floating == b.floating


def test_the_seed_decides_what_is_drawn_and_a_temperature_of_0_draws_the_mean() -> None:
    models = (untrained(seed) for seed in range(100))
    model = next(model for model in models if isinstance(decode(model.decoder, torch.zeros(1, 6))[0], Written))
    generator = ProgramGenerator(model, 1.2)

    def draw(seed: int, temperature: float) -> list[str]:
        samples = generator.sample(np.random.default_rng(seed), 20, temperature)
        return [item.structure.to_json() for item in samples.kept]

    assert draw(0, 1.0) == draw(0, 1.0) != draw(1, 1.0)
    assert len(set(draw(0, 1.0))) > 1
    mean = program_or_reason(decode(model.decoder, torch.zeros(1, 6))[0])
    assert isinstance(mean, AssemblyProgram)
    assert draw(0, 0.0) == draw(1, 0.0)
    assert len(draw(0, 0.0)) == 20
    for text in draw(0, 0.0):  # alike but for last digits: rows of one product differ in them on some processors
        again = Assembly.from_json(text).program
        assert exact_signature(again) == exact_signature(mean)
        assert np.allclose(again.parameters(), mean.parameters(), atol=1e-5)


def test_every_draw_is_kept_or_counted_and_stands_where_shapes_do() -> None:
    samples = ProgramGenerator(untrained(2), 1.2).sample(np.random.default_rng(0), 50, 1.0)
    assert len(samples.kept) + sum(samples.failures.values()) == 50
    assert len(samples.numbers) == len(samples.kept)
    for item in samples.kept:
        corners = item.cage.corners().reshape(-1, 3)
        assert np.allclose(corners.min(axis=0) + corners.max(axis=0), 0, atol=1e-9)
        assert np.isclose(np.linalg.norm(corners, axis=1).max(), 1.2)
        assert item.structure.parts() == item.cage.part_ids


def test_no_codes_give_no_programs() -> None:
    assert decode(untrained(0).decoder, torch.zeros(0, 6)) == []


def test_cuboids_in_mid_air_are_left_out_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a program's blocks declared as they were written is in it, or counted."""
    declared: Counter[int] = Counter()  # by sample
    finished = decoding._finished

    def listening(draft: decoding._Draft, number: int) -> tuple:
        declared[draft.sample] += sum(isinstance(statement, Declare) for statement in draft.rules.statements)
        return finished(draft, number)

    monkeypatch.setattr(decoding, "_finished", listening)
    counted: Counter[bool] = Counter()
    for seed in range(4):
        declared.clear()
        for sample, item in enumerate(decode(untrained(seed).decoder, codes(30, seed))):
            if isinstance(item, Written):
                kept = sum(isinstance(s, Declare) for block in item.program.blocks for s in block.statements)
                assert item.floating == declared[sample] - kept
                counted[item.floating > 0] += 1
    assert min(counted[True], counted[False]) > 2, counted


def test_drawn_shapes_know_how_many_cuboids_were_left_out() -> None:
    samples = ProgramGenerator(untrained(1), 1.2).sample(np.random.default_rng(0), 20, 1.0)
    many = decode(untrained(1).decoder, torch.from_numpy(np.random.default_rng(0).standard_normal((20, 6))).float())
    assert [item.floating for item in samples.kept] == [item.floating for item in many if isinstance(item, Written)]
    assert any(item.floating for item in samples.kept)
