"""The programs' autoencoder line by line and program by program: slow, and obviously what it should be.

With the weights of a `ProgramVAE`, so that its losses and gradients can be compared with the batched ones.
"""

import torch
from torch import Tensor

from cagesdf.cage_generation.program_vae import DEPTHS, TERMS, ProgramVAE
from cagesdf.cage_generation.recurrent import PackedGRU
from cagesdf.cage_generation.tokens import (
    ALIGNED,
    ATTACH,
    AXIS,
    COMMAND,
    COUNT,
    CUBOID,
    END,
    FACE,
    OPERAND,
    OPERANDS,
    PLACE,
    PLACES,
    REFLECT,
    SIZE,
    SLOTS,
    SPAN,
    SQUEEZE,
    START,
    TRANSLATE,
    WIDTH,
    ProgramTokens,
)


def read_next(network: PackedGRU, line: Tensor, state: Tensor) -> Tensor:
    """A gated recurrent unit's next state [Cho et al. 2014]."""
    given, kept = network.given(line), network.kept(state)
    (reset, update, new), (kept_reset, kept_update, kept_new) = given.chunk(3), kept.chunk(3)
    r, z = torch.sigmoid(reset + kept_reset), torch.sigmoid(update + kept_update)
    return (1 - z) * torch.tanh(new + r * kept_new) + z * state


def marker(command: int) -> Tensor:
    return torch.eye(WIDTH)[command]


def rows_of(program: ProgramTokens, number: int) -> Tensor:
    return torch.tensor(program[number].lines, dtype=torch.float32)


def encoded(model: ProgramVAE, program: ProgramTokens) -> tuple[Tensor, Tensor]:
    """Mean and logarithm of the variance of a program's code."""
    encoder = model.encoder

    def block_code(number: int) -> Tensor:
        state = read_next(encoder.reader, encoder.line(marker(START)), encoder.start)
        for row, child in zip(rows_of(program, number), program[number].filling):
            line = encoder.line(row) if child < 0 else block_code(int(child))
            state = read_next(encoder.reader, line, state)
        return state

    narrow = encoder.narrow(block_code(0))
    return encoder.mean(narrow), encoder.log_variance(narrow)


def surprise(logits: Tensor, truth: Tensor) -> Tensor:
    """Cross entropy of one choice, the truth being marked by a 1."""
    return -torch.log_softmax(logits, 0)[int(truth.argmax())]


def doubt(logit: Tensor, truth: Tensor, weight: float) -> Tensor:
    chance = torch.sigmoid(logit[0])
    return -weight * torch.log(chance) if truth > 0.5 else -torch.log(1 - chance)


def losses(model: ProgramVAE, program: ProgramTokens, noise: Tensor) -> Tensor:
    """By TERMS."""
    decoder, total = model.decoder, {term: torch.zeros(()) for term in TERMS}
    mean, log_variance = encoded(model, program)
    total["divergence"] = -sum(1 + s - m**2 - torch.exp(s) for m, s in zip(mean, log_variance))

    def write(number: int, code: Tensor, depth: int) -> None:
        size = torch.tensor(program[number].size, dtype=torch.float32)
        total["bbox"] = total["bbox"] + (decoder.bbox(code) - size).abs().sum()
        filling = program[number].filling.tolist()
        cuboids = sum(row[CUBOID] for row in rows_of(program, number))
        level = torch.eye(DEPTHS)[min(depth, DEPTHS - 1)]
        state, given = code, marker(START)
        for row, child in zip([*rows_of(program, number), marker(END)], [*filling, -1]):
            state = read_next(decoder.writer, decoder.line(torch.cat([given, size, level])), state)
            say(row, state, size)
            if row[CUBOID]:
                both = torch.cat([state, code])
                leaf = torch.tensor(float(child < 0))
                total["leaf"] = total["leaf"] + doubt(decoder.leaf(both), leaf, 1.0) / cuboids
                if child >= 0:
                    write(int(child), decoder.inner(both), depth + 1)
            given = row

    def say(row: Tensor, state: Tensor, size: Tensor) -> None:
        command = int(row[COMMAND].argmax())
        add("command", surprise(decoder.command(state), row[COMMAND]))
        if command in (ATTACH, SQUEEZE, REFLECT, TRANSLATE):
            logits = decoder.operands(torch.cat([state, row[COMMAND]]))
            for i in range(OPERANDS[command]):
                add("operands", surprise(logits[i * SLOTS : (i + 1) * SLOTS], row[OPERAND[i]]))
        if command == CUBOID:
            sized = torch.cat([state, size])
            add("lengths", (decoder.lengths(sized) - row[SIZE]).abs().sum())
            add("aligned", doubt(decoder.aligned(sized), row[ALIGNED], 0.2))
        if command == ATTACH:
            places = decoder.places(torch.cat([state, row[OPERAND[0]], row[OPERAND[1]]]))
            add("places", (places - row[PLACES]).abs().sum())
        if command in (REFLECT, TRANSLATE):
            copies = decoder.copies(torch.cat([state, row[OPERAND[0]], size]))
            add("axis", surprise(copies[:3], row[AXIS]))
            if command == TRANSLATE:
                add("copies", (copies[3] - row[COUNT]).abs() + (copies[4] - row[SPAN]).abs())
        if command == SQUEEZE:
            held = decoder.squeeze(torch.cat([state, *[row[columns] for columns in OPERAND]]))
            add("face", surprise(held[:6], row[FACE]))
            add("places", (held[6:] - row[PLACE]).abs().sum())

    def add(term: str, loss: Tensor) -> None:
        total[term] = total[term] + loss

    write(0, decoder.root(mean + noise * torch.exp(log_variance / 2)), 0)
    return torch.stack([total[term] for term in TERMS])
