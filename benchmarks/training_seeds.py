"""Dependence of the default run's figures on the training seed.

    python -m benchmarks.training_seeds chair 4 5 6

trains, extracts and measures every arm of `params.yaml` with each seed, on the data of `make repro`, and prints a
Markdown table: surface_distance (% of the longest side), mean, standard deviation and each figure over the
seeds.
"""

import sys
import tempfile
from pathlib import Path
from statistics import mean, stdev

from cagesdf.evaluation.tables import gather_tables
from cagesdf.io.scores import read_scores
from pipeline import load
from stages import evaluate, extract_meshes, train

ARMS = ("cagesdf", "cagesdf_global", "cagesdf_noaug", "cagesdf_global_noaug", "deepsdf", "deepsdf_sine")
METRICS = ("surface_distance", "surface_distance_detail")


def measured(category: str, arm: str, seed: int, work: Path) -> dict:
    """Tables 1 and 2 of one arm, trained with one seed."""
    names = ("points", "shapes", "cuboids", "sequences")
    points, shapes, cuboids, sequences = (Path("data") / name / category for name in names)
    run, meshes, scores = (work / kind / f"{arm}-{seed}" / arm for kind in ("runs", "meshes", "scores"))
    train.main(points, shapes, cuboids, sequences, run, load(f"arms.{arm}").model_copy(update={"seed": seed}))
    extract_meshes.main(run, meshes, load("extract_meshes"))
    evaluate.main(meshes.parent, shapes, sequences, scores, load("evaluate"))
    return gather_tables({category: read_scores(scores)})


def main(category: str, seeds: list[int]) -> None:
    lines = ["| arm | source | source, detail | held-out | held-out, detail |", "|---|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as work:
        for arm in ARMS:
            results = [measured(category, arm, seed, Path(work)) for seed in seeds]
            cells = []
            for table in ("table1", "table2"):
                for metric in METRICS:
                    figures = [result[table].get(category, {}).get(arm, {}).get(metric) for result in results]
                    values = [figure["mean"] for figure in figures if figure]
                    each = ", ".join(f"{value:.3f}" for value in values)
                    cells.append(f"{mean(values):.3f} ± {stdev(values):.3f} ({each})" if len(values) > 1 else "–")
            lines.append(f"| `{arm}` | {' | '.join(cells)} |")
            print("\n".join(lines), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], [int(seed) for seed in sys.argv[2:]])
