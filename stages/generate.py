"""Make new shapes with a trained arm: new cages, codes by each of its methods, surfaces, checks (§4.4).

python -m stages.generate data/runs/chair/cagesdf data/programs/chair data/generated/chair/cagesdf
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import torch

from cagesdf.cage_generation.generator import Generated, Samples
from cagesdf.errors import InputError
from cagesdf.extraction import LOOSE
from cagesdf.io.cage_generators import read_generator
from cagesdf.io.generated_shapes import KIND, write_generated
from cagesdf.io.runs import read_run
from cagesdf.models.arms import decoder_class
from cagesdf.run import Run
from cagesdf.seeds import item_rng
from cagesdf.shape_generation.cages import draw_cages
from cagesdf.shape_generation.generated import GeneratedShape
from cagesdf.shape_generation.surfaces import (
    STABILITIES,
    Extracting,
    Order,
    code_source,
    counts,
    has_cuboids,
    in_order,
    make_shape,
    methods_of,
    orders,
)
from pipeline import GenerateParams, artefact, progress, run_stage
from pipeline.cost import Cost, Sections
from pipeline.executor import workers


def new_shapes(sections: Sections, arm: str) -> int:
    """Shapes by each of the arm's methods."""
    knows_cuboids = decoder_class(sections[f"arms.{arm}"].decoder).trains_on != "cube"
    return sections["generate"].shapes * (2 if knows_cuboids else 1)


COST = Cost("new shapes", new_shapes, {"shapes": 2})


def main(run: Path, programs: Path, out: Path, params: GenerateParams) -> None:
    """Read `run` and `programs/`, write `generated/`: the methods of an arm, and all arms, have the same cages."""
    with artefact.write(KIND, out, inputs={"run": run, "programs": programs}, params=params) as folder:
        # A thread a surface: torch's own would wait for each other on a busy machine, and give other last bits.
        torch.set_num_threads(1)
        trained = read_run(run)
        samples, drawn = cages(trained, programs, params)
        tau = None if params.tau == "likelihood" else params.tau
        sources = {method: code_source(trained, method, tau) for method in methods_of(trained)}
        rng_of = partial(item_rng, params.seed, "code")
        todo = [
            order
            for method, source in sources.items()
            for order in orders(drawn, method, source, params.seed, rng_of, params.temperature)
        ]
        how = Extracting(params.resolution, LOOSE[params.loose], params.points, STABILITIES[params.stability])

        def make(order: Order) -> GeneratedShape:
            return make_shape(trained, how, item_rng(params.seed, "points", order.method, order.shape_id), order)

        about = {
            "drawn": len(samples.kept) + sum(samples.failures.values()),
            "failures": dict(samples.failures),
            "methods": {name: source.about() for name, source in sources.items()},
        }
        with ThreadPoolExecutor(workers()) as pool:
            made = iter(progress(in_order(pool, make, todo, 2 * workers()), len(todo), "generate"))
            rows = write_generated(folder, made, about)
        for name in sources:
            print(f"{out.name}, {name}: {summary([row for row in rows if row['method'] == name], about, name)}")


def cages(run: Run, programs: Path, params: GenerateParams) -> tuple[Samples, list[tuple[int, Generated | None]]]:
    """New cages, with the numbers of their draws; for an arm without cuboids None for each number."""
    if not has_cuboids(run):
        return Samples((), (), {}), [(number, None) for number in range(params.shapes)]
    rng = item_rng(params.seed, "cages")
    samples = draw_cages(read_generator(programs), rng, params.shapes, params.temperature)
    return samples, list(zip(samples.numbers, samples.kept))


def summary(rows: Sequence[Mapping[str, Any]], about: Mapping[str, Any], method: str) -> str:
    """One line."""
    numbers = counts(rows)
    text = f"{numbers['shapes']} shapes, {numbers['ok']} with a surface, {numbers['one_piece']} in one piece"
    text += f", {numbers['empty']} empty, {numbers['broken']} broken"
    if "rooted" in numbers:
        text += f"; {numbers['rooted']} rooted, {numbers['stable']} stable"
        text += f"; {numbers['floating']} cuboids in mid-air left out"
    if about["drawn"]:
        text += f"; {about['drawn'] - numbers['shapes']} of {about['drawn']} draws discarded"
    known = about["methods"][method]
    if "tau" in known:
        effective = sorted(row["effective"] for row in rows)
        middle = effective[len(effective) // 2] if effective else 0.0
        text += (
            f"; tau {known['tau']:.3g}: {middle:.1f} of {known['kernels']} codes in effect "
            f"(tau 1: {known['effective_at_1']:.1f})"
        )
    return text


if __name__ == "__main__":
    run_stage(main, InputError)
