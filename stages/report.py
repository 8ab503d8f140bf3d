"""Gather figures, pictures and loss curves of all categories and arms into tables and one page (§4).

python -m stages.report data/scores data/meshes data/runs data/shapes data/cuboids data/sequences \\
    data/trials data/edits data/progress data/generated data/generation data/metrics data/report
"""

import json
from pathlib import Path

from cagesdf.errors import InputError
from cagesdf.evaluation.table3 import gather_generation
from cagesdf.evaluation.tables import gather_edits, gather_progress, gather_tables
from cagesdf.io.edits import read_edits
from cagesdf.io.generation import read_generation
from cagesdf.io.progress import read_progress
from cagesdf.io.scores import read_scores
from cagesdf.io.trials import read_trials
from cagesdf.report.gather import read_category
from cagesdf.report.page import write_page
from cagesdf.report.summary import progress_rows, summary
from pipeline import ReportParams, artefact, run_stage
from pipeline.executor import workers


def main(
    scores: Path,
    meshes: Path,
    runs: Path,
    shapes: Path,
    cuboids: Path,
    sequences: Path,
    trials: Path,
    edits: Path,
    progress: Path,
    generated: Path,
    generation: Path,
    metrics: Path,
    out: Path,
    params: ReportParams,
) -> None:
    """Read the folders of the categories and arms that are run, write `metrics/` and `report/index.html`.

    `metrics/` has all tables, and the few figures and curves that DVC shows. Both are published at the end, so that a
    failure leaves those of the last run.
    """
    names = sorted(params.categories)
    kinds = {
        "scores": scores,
        "shapes": shapes,
        "cuboids": cuboids,
        "sequences": sequences,
        "trials": trials,
        "edits": edits,
        "progress": progress,
        "generation": generation,
    }
    of_category = {kind: artefact.inside(folder, names, kind, params.format) for kind, folder in kinds.items()}
    by_arm = {"meshes": (meshes, params.arms), "run": (runs, params.arms), "generated": (generated, params.generators)}
    of_arm = {
        (kind, name): artefact.inside(folder / name, arms, kind, params.format)
        for kind, (folder, arms) in by_arm.items()
        for name in names
    }
    read = [path for paths in (*of_category.values(), *of_arm.values()) for path in paths.values()]
    inputs = {path.relative_to(scores.parent).as_posix(): path / artefact.MANIFEST for path in read}
    tables = gather_tables({name: read_scores(scores / name) for name in names})
    tables["edits"] = gather_edits(
        {name: [read_edits(file) for file in edited(edits / name, trials / name)] for name in names},
        {name: list(of_arm["run", name]) for name in names},
    )
    tables["progress"] = gather_progress({name: read_progress(progress / name) for name in names})
    tables["table3"] = gather_generation({name: read_generation(generation / name) for name in names})
    tables["trials"] = {name: read_trials(trials / name).counts() for name in names}
    categories = [
        read_category(
            shapes / name,
            cuboids / name,
            sequences / name,
            trials / name,
            of_arm["meshes", name],
            of_arm["run", name],
            edits / name,
            of_arm["generated", name],
            generation / name,
            params.shapes,
            params.generated,
        )
        for name in names
    ]
    tables["cuboids"] = {category.name: category.bounding for category in categories}
    with (
        artefact.write("metrics", metrics, inputs={}, foreign=inputs, params=params) as figures,
        artefact.write("report", out, inputs={}, foreign=inputs, params=params) as page,
    ):
        for name, content in (
            ("tables", tables), ("summary", summary(tables)), ("progress", progress_rows(tables))
        ):  # fmt: skip
            text = json.dumps(content, indent=1, sort_keys=True)
            (figures / f"{name}.json").write_text(text + "\n", encoding="utf-8", newline="\n")
        write_page(page / "index.html", tables, categories, params.image_size, workers())


def edited(edits: Path, trials: Path) -> tuple[Path, Path]:
    """Figures of edits: the arms', and the references'."""
    return edits / "edits.parquet", trials / "references.parquet"


if __name__ == "__main__":
    run_stage(main, InputError)
