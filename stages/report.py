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
    """Read the folders of all categories, write `metrics/tables.json` and `report/index.html`."""
    names = [folder.name for folder in inside(shapes)]
    inputs = {
        folder.relative_to(scores.parent).as_posix(): folder / artefact.MANIFEST
        for name in names
        for folder in [
            scores / name,
            *inside(meshes / name),
            *inside(runs / name),
            edits / name,
            trials / name,
            progress / name,
            *inside(generated / name),
            generation / name,
        ]
    }
    tables = gather_tables({name: read_scores(scores / name) for name in names})
    tables["edits"] = gather_edits(
        {name: [read_edits(file) for file in edited(edits / name, trials / name)] for name in names},
        {name: [folder.name for folder in inside(runs / name)] for name in names},
    )
    tables["progress"] = gather_progress({name: read_progress(progress / name) for name in names}, params.rates)
    tables["table3"] = gather_generation({name: read_generation(generation / name) for name in names})
    tables["trials"] = {name: read_trials(trials / name).counts() for name in names}
    categories = [
        read_category(
            shapes / name,
            cuboids / name,
            sequences / name,
            trials / name,
            {folder.name: folder for folder in inside(meshes / name)},
            {folder.name: folder for folder in inside(runs / name)},
            edits / name,
            {folder.name: folder for folder in inside(generated / name)},
            generation / name,
            params.shapes,
            params.generated,
        )
        for name in names
    ]
    tables["cuboids"] = {category.name: category.bounding for category in categories}
    with artefact.write("metrics", metrics, inputs={}, foreign=inputs, params=params) as folder:
        text = json.dumps(tables, indent=1, sort_keys=True)
        (folder / "tables.json").write_text(text + "\n", encoding="utf-8", newline="\n")
    with artefact.write("report", out, inputs={}, foreign=inputs, params=params) as folder:
        write_page(folder / "index.html", tables, categories, params.image_size, workers())


def edited(edits: Path, trials: Path) -> tuple[Path, Path]:
    """Figures of edits: the arms', and the references'."""
    return edits / "edits.parquet", trials / "references.parquet"


def inside(folder: Path) -> list[Path]:
    """The artefacts in a folder, sorted by name."""
    return sorted(item for item in folder.glob("*") if (item / artefact.MANIFEST).is_file())


if __name__ == "__main__":
    run_stage(main, InputError)
