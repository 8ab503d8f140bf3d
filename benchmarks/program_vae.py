"""The programs' autoencoder: its speed of training, and its results on published programs (docs/generation.md).

    python -m benchmarks.program_vae speed FOLDER
    python -m benchmarks.program_vae train FOLDER TRAIN_IDS VAL_IDS [steps] [width] [code] [divergence]

FOLDER has programs as text, the other two files an id a line. `speed` has one thread, official width and losses, and
takes turns with the line-by-line version that the tests compare with. `train` prints a Markdown table: how programs
are rebuilt, how many samples are valid, new, rooted and stable.
"""

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

import numpy as np
import torch

from cagesdf.cage_generation.batching import Batch
from cagesdf.cage_generation.checks import rebuilding_figures, sample_figures
from cagesdf.cage_generation.novelty import Known, reach_of
from cagesdf.cage_generation.program_vae import TERMS, WEIGHTS, ProgramVAE
from cagesdf.cage_generation.programs import ProgramGenerator
from cagesdf.cage_generation.tokens import ProgramTokens, tokens_of
from cagesdf.cage_generation.training import Settings, train_programs
from cagesdf.cuboid import Cage
from cagesdf.errors import ProgramError
from cagesdf.frames import Similarity
from cagesdf.shape_generation.static_stability import rooted, stable
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.parsing import read_program
from cagesdf.structure.program import AssemblyProgram
from cagesdf.training.precision import processor
from tests.support import one_program

OFFICIAL = 25  # programs a second on one core, forward, backward and Adam
BATCH = 64
TURNS = 15
SAMPLES = 500


def speed(folder: Path) -> None:
    """Programs a second: batched, and line by line."""
    tokens = [tokens_of(read_program(path)) for path in sorted(folder.glob("*.txt"))[: BATCH * TURNS]]
    weights = torch.tensor([{**WEIGHTS, "divergence": 0.1}[term] for term in TERMS])
    models = [ProgramVAE.drawn(256, 256, seed=0) for _ in range(2)]
    adams = [torch.optim.Adam(model.parameters(), 1e-4, eps=1e-6, fused=True) for model in models]

    def at_once(batch: Sequence[ProgramTokens]) -> torch.Tensor:
        packed = Batch.of(batch)
        return models[0](packed, torch.randn(len(batch), 256), torch.ones(len(packed.targets)))

    def one_by_one(batch: Sequence[ProgramTokens]) -> torch.Tensor:
        return torch.stack([one_program.losses(models[1], program, torch.randn(256)) for program in batch])

    def seconds(
        losses: Callable[[Sequence[ProgramTokens]], torch.Tensor], batch: Sequence, adam: torch.optim.Adam
    ) -> float:
        start = time.process_time()
        adam.zero_grad()
        (losses(batch) @ weights).mean().backward()
        adam.step()
        return (time.process_time() - start) / len(batch)

    times: list[list[float]] = [[], []]
    for turn in range(TURNS):
        batch = tokens[BATCH * turn : BATCH * (turn + 1)]
        times[0].append(seconds(at_once, batch, adams[0]))
        times[1].append(seconds(one_by_one, batch[:4], adams[1]))
    ours, theirs = (1 / median(values) for values in times)
    lines = np.mean([sum(len(block.lines) + 1 for block in program) for program in tokens])
    print(f"On {processor()}.\n")
    print(f"{sum(p.numel() for p in models[0].parameters()):,} weights; {lines:.1f} lines a program")
    print("| | programs/s | of the official |\n|---|---|---|")
    print(f"| batches of {BATCH} | {ours:.0f} | {ours / OFFICIAL:.1f} |")
    print(f"| line by line | {theirs:.1f} | {theirs / OFFICIAL:.2f} |")


def read(folder: Path, ids: Path) -> dict[str, AssemblyProgram]:
    """Programs by id, of those that are there and that rows can hold."""
    programs: dict[str, AssemblyProgram] = {}
    for name in ids.read_text(encoding="utf-8").split():
        path = folder / f"{name.removesuffix('.txt')}.txt"
        if path.is_file():
            program = read_program(path)
            try:
                tokens_of(program)
            except ProgramError as error:
                print(f"{name}: {error}", file=sys.stderr)
                continue
            programs[path.stem] = program
    return programs


def placed(programs: dict[str, AssemblyProgram]) -> tuple[dict[str, Assembly], dict[str, Cage]]:
    """Structures and cages by id, in the programs' own frame."""
    identity = Similarity(1.0, np.eye(3), np.zeros(3))
    structures = {name: Assembly(program, identity) for name, program in programs.items()}
    return structures, {name: structure.cage() for name, structure in structures.items()}


def train(folder: Path, train_ids: Path, val_ids: Path, steps: int, width: int, code: int, divergence: float) -> None:
    """Train on published programs; a table of what comes of it."""
    programs, others = read(folder, train_ids), read(folder, val_ids)
    settings = Settings(width, code, steps, 32, 2e-3, divergence, 0.1, seed=0)
    start = time.process_time()
    model, log = train_programs(
        [tokens_of(program) for program in programs.values()],
        settings,
        lambda step, loss: print(f"{step} of {steps} steps: {loss:.1f}", file=sys.stderr),
    )
    spent = time.process_time() - start
    structures, cages = placed(programs)
    generator, known = ProgramGenerator(model, reach_of(cages.values())), Known(structures, cages)
    print(f"{len(programs)} programs, {settings}; {spent:.0f} s, {steps * settings.batch / spent:.0f} programs/s")
    print("losses: " + ", ".join(f"{term} {log[-1][term]:.2f}" for term in TERMS))
    for label, those in (("training", dict(list(programs.items())[:200])), ("validation", others)):
        rebuilt = generator.rebuilt(those)
        figures = rebuilding_figures(rebuilt, Known(*placed(those)))
        failed = sum(isinstance(item, str) for item in rebuilt.values())
        print(
            f"| {label} programs rebuilt | {figures['rebuilt']}, {failed} discarded, {figures['same_structure']} of "
            f"the same structure, these {figures['rebuilding_difference']:.3f} apart |"
        )
    print(f"| published | rooted {share(map(rooted, cages.values()))}, stable {share(map(stable, cages.values()))} |")
    for temperature in (1.0, 0.7):
        samples = generator.sample(np.random.default_rng(0), SAMPLES, temperature)
        figures = sample_figures(samples, known)
        made = [item.cage for item in samples.kept]
        print(
            f"| samples, temperature {temperature} | {figures['valid'] / figures['drawn']:.1%} valid, "
            f"{figures['copies']} copies, {figures['new_cages']} new cages, {figures['new_structures']} new "
            f"structures, {figures['structures']} structures; rooted {share(map(rooted, made))}, "
            f"stable {share(map(stable, made))}; {dict(samples.failures)} |"
        )


def share(flags: "map[bool]") -> str:
    """Share of true flags, in per cent."""
    return f"{np.mean(list(flags)):.1%}"


if __name__ == "__main__":
    torch.set_num_threads(1)
    torch.manual_seed(0)
    match sys.argv[1:]:
        case ["speed", folder]:
            speed(Path(folder))
        case ["train", folder, train_ids, val_ids, *rest]:
            steps, width, code, divergence = (*rest, *("6000", "192", "32", "0.1")[len(rest) :])
            train(Path(folder), Path(train_ids), Path(val_ids), int(steps), int(width), int(code), float(divergence))
        case _:
            sys.exit(__doc__)
