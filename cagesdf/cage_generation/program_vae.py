"""ShapeAssembly's variational autoencoder for programs, for many programs at once [Jones et al. 2020].

The encoder reads a block line by line, a cuboid that another block fills being read as that block's
code; the root's code gives the mean and variance of the program's. The decoder writes the root from
a code: the bbox's lengths, then line by line a command, the cuboids it is about, its numbers; for
each cuboid whether a block fills it, and the code from which that one is written in turn.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy, one_hot

from cagesdf.cage_generation.batching import Batch, Level
from cagesdf.cage_generation.recurrent import PackedGRU
from cagesdf.cage_generation.tokens import (
    ALIGNED,
    ATTACH,
    AXIS,
    COMMAND,
    COMMANDS,
    COUNT,
    CUBOID,
    FACE,
    OPERAND,
    PLACE,
    PLACES,
    REFLECT,
    SIZE,
    SLOTS,
    SPAN,
    SQUEEZE,
    TRANSLATE,
    WIDTH,
    ProgramTokens,
)

SLOPE = 0.2  # of the rectifiers below 0
DEPTHS = 3  # that the network distinguishes; deeper blocks count as the last
LEVEL_FEATURES = 3 + DEPTHS  # of a step's input besides the line: the bbox's lengths, the depth
TERMS = (
    "command",
    "operands",
    "lengths",
    "aligned",
    "places",
    "axis",
    "copies",
    "face",
    "leaf",
    "bbox",
    "divergence",
)
# The official weights: continuous values count fifty times.
WEIGHTS = {**dict.fromkeys(TERMS, 1.0), **dict.fromkeys(("lengths", "places", "copies", "bbox"), 50.0)}
ALIGNED_WEIGHT = 0.2  # of aligned cuboids, which are the most


def layers(*widths: int) -> nn.Sequential:
    """Linear layers with leaky rectifiers between them."""
    parts: list[nn.Module] = []
    for before, after in pairwise(widths):
        parts += [nn.Linear(before, after), nn.LeakyReLU(SLOPE)]
    return nn.Sequential(*parts[:-1])


class Encoder(nn.Module):
    """The encoder: mean and variance of the codes of programs."""

    def __init__(self, width: int, code: int) -> None:
        super().__init__()
        self.line = layers(WIDTH, width, width, width)
        self.reader = PackedGRU(width)
        self.start = nn.Parameter(torch.zeros(width))
        self.narrow = nn.Sequential(nn.Linear(width, width), nn.ReLU())
        self.mean = nn.Linear(width, code)
        self.log_variance = nn.Linear(width, code)

    def forward(self, batch: Batch) -> tuple[Float[Tensor, "s d"], Float[Tensor, "s d"]]:
        """Mean and logarithm of the variance of each program's code."""
        codes: Tensor | None = None
        deeper: Level | None = None
        for level in reversed(batch.levels):
            lines = self.line(level.lines)
            if codes is not None and deeper is not None:
                lines = lines.index_put((deeper.outer_given,), codes)
            start = self.start.expand(len(level.shape), -1)
            codes, deeper = self.reader(lines, level.running, start)[level.last], level
        assert codes is not None
        narrow = self.narrow(codes[torch.argsort(batch.levels[0].shape)])
        return self.mean(narrow), self.log_variance(narrow)


class Decoder(nn.Module):
    """The decoder: programs from codes, a line at a time. `state` is the recurrent network's after the lines so far."""

    def __init__(self, width: int, code: int) -> None:
        super().__init__()
        self.root = nn.Linear(code, width)
        self.line = layers(WIDTH + LEVEL_FEATURES, width, width, width)
        self.writer = PackedGRU(width)
        self.bbox = layers(width, width, 3)
        self.command = layers(width, width, len(COMMANDS))
        self.operands = layers(width + len(COMMANDS), width, 3 * SLOTS)
        self.lengths = layers(width + 3, width, 3)
        self.aligned = layers(width + 3, width, 1)
        self.places = layers(width + 2 * SLOTS, width, 6)
        self.copies = layers(width + SLOTS + 3, width, 5)  # axis, count, span
        self.squeeze = layers(width + 3 * SLOTS, width, 8)  # face, place
        self.inner = layers(2 * width, width, width)
        self.leaf = layers(2 * width, width, 1)

    def steps(self, lines: Float[Tensor, "n 63"], size: Float[Tensor, "n 3"], depth: int) -> Float[Tensor, "n w"]:
        """Inputs of the recurrent network, one for each line."""
        level = one_hot(torch.tensor(min(depth, DEPTHS - 1)), DEPTHS).to(lines).expand(len(lines), -1)
        return self.line(torch.cat([lines, size, level], dim=1))

    def forward(self, batch: Batch, codes: Float[Tensor, "s d"], shown: Float[Tensor, " m"]) -> Float[Tensor, "s 10"]:
        """Losses of each program written from its code: TERMS but the divergence.

        Each line is written after the true ones before it, times `shown`: 1 shows a line, 0 hides it.
        """
        states: list[Tensor] = []
        begun: list[Tensor] = []
        bbox = codes.new_zeros(batch.count)
        codes = self.root(codes)[batch.levels[0].shape]
        shown_by_level = shown.split([len(level.lines) for level in batch.levels])
        for level, factors in zip(batch.levels, shown_by_level):
            if states:
                codes = self.inner(torch.cat([states[-1][level.outer], begun[-1][level.outer]], dim=1))
            wrong = (self.bbox(codes) - level.size).abs().sum(dim=1)
            bbox = bbox.index_add(0, level.shape, wrong)
            steps = self.steps(level.lines * factors[:, None], level.size[level.block], level.depth)
            states.append(self.writer(steps, level.running, codes))
            begun.append(codes[level.block])
        losses = self._line_losses(batch, torch.cat(states), torch.cat(begun))
        return torch.stack([*losses, bbox], dim=1)

    def _line_losses(self, batch: Batch, states: Float[Tensor, "m w"], begun: Float[Tensor, "m w"]) -> list[Tensor]:
        """Losses by program, in the order of TERMS, from "command" to "leaf".

        `begun` are the codes of the lines' blocks. Each head is asked about the lines only that need it.
        """
        targets = batch.targets
        every = torch.arange(len(targets))
        cuboid, attach, squeeze = batch.rows[CUBOID], batch.rows[ATTACH], batch.rows[SQUEEZE]
        reflect, translate = batch.rows[REFLECT], batch.rows[TRANSLATE]
        copy = torch.cat([reflect, translate])
        # Statements that choose three cuboids come first, then those that choose two, then one.
        about = torch.cat([squeeze, attach, copy])
        choosers = (about, about[: len(squeeze) + len(attach)], squeeze)

        def given(rows: Tensor, *columns: slice) -> Tensor:
            return torch.cat([states[rows], *[targets[rows, column] for column in columns]], dim=1)

        def choice(logits: Tensor, rows: Tensor, columns: slice) -> Tensor:
            return cross_entropy(logits, targets[rows, columns].argmax(dim=1), reduction="none")

        def apart(values: Tensor, rows: Tensor, columns: slice) -> Tensor:
            return (values - targets[rows, columns]).abs().sum(dim=1)

        def sums(*entries: tuple[Tensor, Tensor]) -> Tensor:
            """Sums of the values at rows, by program."""
            total = states.new_zeros(batch.count)
            for rows, values in entries:
                total = total.index_add(0, batch.shape[rows], values)
            return total

        operands = self.operands(given(about, COMMAND)).unflatten(1, (len(OPERAND), SLOTS))
        sized = torch.cat([states[cuboid], batch.size[cuboid]], dim=1)
        places = self.places(given(attach, *OPERAND[:2]))
        copies = self.copies(torch.cat([given(copy, OPERAND[0]), batch.size[copy]], dim=1))
        held = self.squeeze(given(squeeze, *OPERAND))
        aligned = self.aligned(sized)[:, 0]
        leaf = self.leaf(torch.cat([states[cuboid], begun[cuboid]], dim=1))[:, 0]
        return [
            sums((every, choice(self.command(states), every, COMMAND))),
            sums(*[(rows, choice(operands[: len(rows), i], rows, OPERAND[i])) for i, rows in enumerate(choosers)]),
            sums((cuboid, apart(self.lengths(sized), cuboid, SIZE))),
            sums((cuboid, weighted_entropy(aligned, targets[cuboid, ALIGNED], ALIGNED_WEIGHT))),
            sums((attach, apart(places, attach, PLACES)), (squeeze, apart(held[:, 6:], squeeze, PLACE))),
            sums((copy, choice(copies[:, :3], copy, AXIS))),
            sums((translate, apart(copies[len(reflect) :, 3:], translate, slice(COUNT, SPAN + 1)))),
            sums((squeeze, choice(held[:, :6], squeeze, FACE))),
            sums((cuboid, weighted_entropy(leaf, batch.leaf[cuboid], 1.0) / batch.declared[cuboid])),
        ]


def weighted_entropy(logits: Float[Tensor, " k"], targets: Float[Tensor, " k"], weight: float) -> Float[Tensor, " k"]:
    """Binary cross entropies; those of positive targets count `weight` times."""
    return binary_cross_entropy_with_logits(logits, targets, pos_weight=logits.new_tensor(weight), reduction="none")


class ProgramVAE(nn.Module):
    """Encoder and decoder."""

    def __init__(self, width: int, code: int) -> None:
        """Sizes of the recurrent networks' states, and of a program's code."""
        super().__init__()
        self.width, self.code = width, code
        self.encoder = Encoder(width, code)
        self.decoder = Decoder(width, code)

    @staticmethod
    def drawn(width: int, code: int, seed: int) -> "ProgramVAE":
        """An untrained autoencoder; `seed` decides its weights."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            return ProgramVAE(width, code)

    def forward(self, batch: Batch, noise: Float[Tensor, "s d"], shown: Float[Tensor, " m"]) -> Float[Tensor, "s 11"]:
        """Losses of each program, by TERMS, without weights.

        `noise` is standard normal; zeros take the mean code. `shown` is as in `Decoder`. The divergence
        is twice the usual one, as in the official model: -Σ (1 + log σ² - μ² - σ²).
        """
        mean, log_variance = self.encoder(batch)
        losses = self.decoder(batch, mean + noise * torch.exp(log_variance / 2), shown)
        divergence = -(1 + log_variance - mean**2 - log_variance.exp()).sum(dim=1)
        return torch.cat([losses, divergence[:, None]], dim=1)

    def codes(self, programs: Sequence[ProgramTokens]) -> Float[Tensor, "s d"]:
        """Mean codes of programs."""
        with torch.no_grad():
            return self.encoder(Batch.of(programs))[0]
