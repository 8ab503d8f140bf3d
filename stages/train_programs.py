"""Train a generator of structures and cages: on programs, or on cages where there are none (§4.4).

python -m stages.train_programs data/shapes/chair data/cuboids/chair data/programs/chair
"""

from collections.abc import Mapping
from pathlib import Path

import torch

from cagesdf.cage_generation.checks import Figures, rebuilding_figures, sample_figures
from cagesdf.cage_generation.novelty import reach_of
from cagesdf.cage_generation.programs import ProgramGenerator
from cagesdf.cage_generation.proportions import ProportionGenerator, families
from cagesdf.cage_generation.tokens import ProgramTokens, tokens_of
from cagesdf.cage_generation.trained import TrainedGenerator
from cagesdf.cage_generation.training import Settings, train_programs
from cagesdf.cuboid import Cage
from cagesdf.errors import InputError, ProgramError, ShapeRejected
from cagesdf.io.cage_generators import KIND, write_generator
from cagesdf.io.cuboids import read_assemblies, read_cages
from cagesdf.io.rejected import write_rejected
from cagesdf.io.shapes import read_shapes
from cagesdf.seeds import item_rng
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.base import Structure
from pipeline import TrainProgramsParams, artefact, counter, run_stage
from pipeline.cost import Cost

SETTINGS = {"width", "code", "steps", "batch", "learning_rate", "divergence", "hidden", "seed"}
Log = list[dict[str, int | float]]

COST = Cost("steps", lambda sections, arm: sections["train_programs"].steps, {"steps": 200, "samples": 10}, grows=False)


def main(shapes: Path, cuboids: Path, out: Path, params: TrainProgramsParams) -> None:
    """Read `shapes/` and `cuboids/`, write `programs/`, from training shapes only; print how good it is."""
    with artefact.write(KIND, out, inputs={"shapes": shapes, "cuboids": cuboids}, params=params) as folder:
        torch.set_num_threads(1)  # with several, sums would be taken in another order on another machine
        source, cages = read_shapes(shapes), read_cages(cuboids)
        cages = {name: cages[name] for name in source.ids_of("train") if name in cages}
        programs = {name: assembly for name, assembly in read_assemblies(cuboids).items() if name in cages}
        if programs:
            missing = [
                ShapeRejected(name, "train_programs", "has no program") for name in cages if name not in programs
            ]
            trained, rejected, log, figures = on_programs(programs, out.name, params)
            rejected += missing
        else:
            trained, rejected, log, figures = on_cages({name: source.structure(name) for name in cages}, cages)
        samples = trained.generator.sample(item_rng(params.seed, "sample"), params.samples, params.temperature)
        figures |= sample_figures(samples, trained.known())
        write_generator(folder, trained, log, figures)
        write_rejected(folder, rejected, len(cages), params.max_rejected)
        print(f"{out.name}: {summary(figures)}{reasons(samples.failures)}")


def on_programs(
    programs: Mapping[str, Assembly], label: str, params: TrainProgramsParams
) -> tuple[TrainedGenerator, list[ShapeRejected], Log, Figures]:
    """The programs' autoencoder, the programs that it can't represent, its losses, and its quality on the others."""
    tokens: dict[str, ProgramTokens] = {}
    rejected: list[ShapeRejected] = []
    for shape_id, assembly in sorted(programs.items()):
        try:
            tokens[shape_id] = tokens_of(assembly.program)
        except ProgramError as error:
            rejected.append(ShapeRejected(shape_id, "train_programs", str(error)))
    settings = Settings(**params.model_dump(include=SETTINGS))
    with counter(settings.steps, "steps", f"train_programs {label}") as bar:
        model, log = train_programs(list(tokens.values()), settings, lambda step, loss: bar(step, loss=f"{loss:.1f}"))
    cages = {shape_id: programs[shape_id].cage() for shape_id in tokens}
    generator = ProgramGenerator(model, reach_of(cages.values()))
    trained = TrainedGenerator(generator, {shape_id: programs[shape_id] for shape_id in tokens}, cages)
    rebuilt = generator.rebuilt({shape_id: programs[shape_id].program for shape_id in tokens})
    return trained, rejected, log, rebuilding_figures(rebuilt, trained.known())


def on_cages(
    structures: Mapping[str, Structure], cages: Mapping[str, Cage]
) -> tuple[TrainedGenerator, list[ShapeRejected], Log, Figures]:
    """A generator of new proportions for the training structures: nothing is rejected, and nothing optimised."""
    generator = ProportionGenerator(families(structures, cages), reach_of(cages.values()))
    return TrainedGenerator(generator, structures, cages), [], [], {}


def summary(figures: Figures) -> str:
    """One line."""
    rebuilt = (
        f"{figures['same_structure']:.0f} of {figures['rebuilt']:.0f} rebuilt with their structure, "
        f"{figures['rebuilding_difference']:.3f} apart; "
        if "rebuilt" in figures
        else ""
    )
    return (
        f"{rebuilt}of {figures['drawn']:.0f} samples {figures['valid']:.0f} valid, {figures['copies']:.0f} copies, "
        f"{figures['new_cages']:.0f} new cages {figures['difference']:.3f} from the nearest, "
        f"{figures['new_structures']:.0f} of new structure; {figures['structures']:.0f} structures; "
        f"{figures['floating']:.0f} cuboids in mid-air left out"
    )


def reasons(failures: Mapping[str, int]) -> str:
    """Numbers and reasons of discarded draws, as text."""
    return "".join(f"; {count} discarded: {reason}" for reason, count in failures.items())


if __name__ == "__main__":
    run_stage(main, InputError)
