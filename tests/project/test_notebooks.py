"""The notebooks of examples/ run as they are written, each in a folder and a Python of its own."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
NOTEBOOKS = sorted(path.name for path in EXAMPLES.glob("*.ipynb"))


def read(notebook: str) -> dict[str, Any]:
    return json.loads((EXAMPLES / notebook).read_text(encoding="utf-8"))


def code(notebook: str) -> str:
    """The code of all cells; what ends with a name prints what a notebook would show of it."""
    cells = ["".join(cell["source"]) for cell in read(notebook)["cells"] if cell["cell_type"] == "code"]
    shown = [re.sub(r"^(\w+)\Z", r"print(\1._repr_html_()[:200])", cell, flags=re.MULTILINE) for cell in cells]
    # VTK would start for each picture; matplotlib draws as well.
    return "\n".join(["from cagesdf import rendering", "rendering.WINDOWS = ()", *shown])


@pytest.mark.parametrize("notebook", NOTEBOOKS)
def test_a_notebook_runs_from_its_first_cell_to_its_last_and_shows_shapes(notebook: str, tmp_path: Path) -> None:
    script = tmp_path / "notebook.py"
    script.write_text(code(notebook), encoding="utf-8")
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("<p><b>") >= 2
    assert list(tmp_path.glob("*.glb"))


@pytest.mark.parametrize("notebook", NOTEBOOKS)
def test_a_notebook_is_of_the_format_that_all_programs_read_and_kept_without_outputs(notebook: str) -> None:
    content = read(notebook)
    assert (content["nbformat"], content["nbformat_minor"]) == (4, 5)
    ids = [cell["id"] for cell in content["cells"]]
    assert len(set(ids)) == len(ids) > 0
    assert not [cell for cell in content["cells"] if cell.get("outputs") or cell.get("execution_count")]


def test_both_notebooks_are_there() -> None:
    assert NOTEBOOKS == ["edit_a_chair.ipynb", "your_own_shapes.ipynb"]
