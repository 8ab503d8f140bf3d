"""Gather figures, pictures and loss curves of all categories and arms into tables and one page (§4).

python -m stages.report data data/metrics data/report
"""

import json
from pathlib import Path

from cagesdf.errors import InputError
from cagesdf.evaluation.table3 import gather_generation
from cagesdf.evaluation.tables import gather_edits, gather_progress, gather_tables
from cagesdf.io.edits import read_edits
from cagesdf.io.generation_scores import read_generation
from cagesdf.io.progress import read_progress
from cagesdf.io.scores import read_scores
from cagesdf.io.trials import read_trials
from cagesdf.report.gather import read_category
from cagesdf.report.page import write_page
from cagesdf.report.summary import progress_rows, summary
from pipeline import ReportParams, artefact, run_stage
from pipeline.executor import workers

# Folders of data/: with an artefact of that kind a category; and with one an arm in a folder a category, and its kind.
OF_CATEGORY = ("scores", "shapes", "cuboids", "sequences", "trials", "edits", "progress", "generation")
OF_ARM = {"meshes": "meshes", "runs": "run", "generated": "generated"}


def main(data: Path, metrics: Path, out: Path, params: ReportParams) -> None:
    """Read the folders of the categories and arms that are run in `data/`, write `metrics/` and `report/index.html`.

    `metrics/` has all tables, and the few figures and curves that DVC shows. Both are published at the end, so that a
    failure leaves those of the last run.
    """
    names = sorted(params.categories)
    arms = {"meshes": params.arms, "runs": params.arms, "generated": params.generators}
    of_category = {folder: artefact.inside(data / folder, names, folder, params.format) for folder in OF_CATEGORY}
    of_arm = {
        (folder, name): artefact.inside(data / folder / name, arms[folder], kind, params.format)
        for folder, kind in OF_ARM.items()
        for name in names
    }
    read = [path for paths in (*of_category.values(), *of_arm.values()) for path in paths.values()]
    inputs = {path.relative_to(data).as_posix(): path / artefact.MANIFEST for path in read}
    tables = gather_tables({name: read_scores(path) for name, path in of_category["scores"].items()})
    edits, trials = of_category["edits"], of_category["trials"]
    tables["edits"] = gather_edits(
        {name: [read_edits(file) for file in edited(edits[name], trials[name])] for name in names},
        {name: list(of_arm["runs", name]) for name in names},
    )
    tables["progress"] = gather_progress({name: read_progress(path) for name, path in of_category["progress"].items()})
    tables["table3"] = gather_generation(
        {name: read_generation(path) for name, path in of_category["generation"].items()}
    )
    tables["trials"] = {name: read_trials(path).counts() for name, path in trials.items()}
    categories = [
        read_category(
            of_category["shapes"][name],
            of_category["cuboids"][name],
            of_category["sequences"][name],
            trials[name],
            of_arm["meshes", name],
            of_arm["runs", name],
            edits[name],
            of_arm["generated", name],
            of_category["generation"][name],
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
