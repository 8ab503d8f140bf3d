"""The results in the documentation are the committed figures: no number was typed."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from cagesdf.evaluation.metrics import METRICS, OF_KEY
from cagesdf.evaluation.reconstruction import VERSION
from cagesdf.io.scores import MEANINGS
from cagesdf.report.results import gains, readme_table, results_page, with_metrics, with_readme_table

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def tables() -> Any:
    """The committed figures: a run on this machine replaces the file, and no documentation."""
    shown = subprocess.run(
        ["git", "show", "HEAD:data/metrics/tables.json"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return json.loads(shown.stdout)


def rows(markdown: str) -> list[list[str]]:
    return [
        [cell.strip() for cell in line.strip("|").split("|")] for line in markdown.splitlines() if line.startswith("|")
    ]


def test_the_results_page_is_made_from_the_committed_figures(tables: Any) -> None:
    assert (ROOT / "docs/results.md").read_text(encoding="utf-8") == results_page(tables)


def test_the_readmes_table_is_made_from_the_committed_figures(tables: Any) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert with_readme_table(readme, tables) == readme
    assert readme.count("\n") <= 150


def test_each_row_of_the_readmes_table_has_as_many_cells_as_its_head(tables: Any) -> None:
    head, _, *body = rows(readme_table(tables))
    assert {len(row) for row in body} == {len(head)} == {1 + 2 * len(tables["table1"])}
    assert body[0][0] == "`cagesdf`"


def test_a_changed_figure_changes_its_cell_alone(tables: Any) -> None:
    changed = json.loads(json.dumps(tables))
    changed["table1"]["chair"]["deepsdf"]["surface_distance"] |= {"mean": 12.345, "std": 0.5}
    before, after = rows(readme_table(tables)), rows(readme_table(changed))
    cells = zip([cell for row in before for cell in row], [cell for row in after for cell in row], strict=True)
    assert [new for old, new in cells if old != new] == [f"{12.345:.2f} ± 0.50"]


def test_what_was_not_measured_is_a_dash(tables: Any) -> None:
    deepsdf = next(row for row in rows(readme_table(tables)) if row[0] == "`deepsdf`")
    assert deepsdf[1 + len(tables["table1"]) :] == ["–"] * len(tables["table1"])


def test_gains_of_mixes_stand_in_the_page_where_there_are_any(tables: Any) -> None:
    """A column for each kind, `–` for an arm without it."""
    edits = {"cagesdf": {kind: {"gain": {"median": gain}} for kind, gain in (("mix", -0.5), ("mix_keep", 0.25))}}
    some = {**tables, "edits": {"categories": {"chair": {**edits, "cagesdf_global": {"swap": {}}}}}}
    some["table1"] = {"chair": tables["table1"]["chair"]}
    kinds = {"mix_warp": "warp", "mix": "recipe", "mix_keep": "details kept"}
    head, _, row = gains(some, kinds).strip().splitlines()
    assert [cell.strip() for cell in head.split("|")[2:-1]] == ["chair: warp", "recipe", "details kept"]
    assert [cell.strip() for cell in row.split("|")[1:-1]] == ["`cagesdf`", "–", "−0.50", "0.25"]
    assert gains(some, {"bent": "bent"}) == ""


def test_a_readme_without_a_place_for_the_table_is_refused(tables: Any) -> None:
    with pytest.raises(ValueError, match="one pair of comments"):
        with_readme_table("# cagesdf\n", tables)


def test_the_page_of_metrics_has_each_of_them_as_it_is_calculated() -> None:
    page = (ROOT / "docs/metrics.md").read_text(encoding="utf-8")
    assert with_metrics(page) == page
    assert f"Version {VERSION} of the definitions" in page
    with pytest.raises(ValueError, match="one pair of comments"):
        with_metrics(page + page)


def test_the_committed_tables_have_the_registrys_metrics(tables: Any) -> None:
    for table in ("table1", "table2"):
        for arms in tables[table].values():
            assert {tuple(sorted(figures)) for figures in arms.values()} == {tuple(sorted(OF_KEY))}
    assert tables["about"]["version"] == VERSION


def test_a_metrics_key_title_and_meaning_are_its_own() -> None:
    for field in ("key", "title", "meaning"):
        assert len({getattr(metric, field) for metric in METRICS}) == len(METRICS)
    assert list(OF_KEY) == list(MEANINGS)
    assert len(OF_KEY) == sum(len(metric.variants) for metric in METRICS)
