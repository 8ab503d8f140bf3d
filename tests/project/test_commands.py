"""The commands of the pages: each is one that there is, with arguments that it takes; README's run."""

import importlib.util
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cagesdf import cli
from cagesdf.demo import DEMO
from tests.support import toy
from tests.support.commands import Command
from tests.support.constant_runs import write_program

ROOT = Path(__file__).parents[2]
PAGES = ["README.md", "CONTRIBUTING.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]
PAGES.remove("docs/log.md")  # of what was, too
# A line of a block, or words in backticks; a comment ends it.
COMMAND = re.compile(r"(?:^(?: {4}|\$ )?(?:\.venv/bin/)?|`)((?:cagesdf|make|python -m) [^`\n#]*[^`\n# ])", re.MULTILINE)
# What README's placeholders stand for in a run, and how little is enough.
STAND_INS = {
    "RUN": "data/runs/chair/cagesdf", "SHAPE": "chair_0000", "CUBOIDS_OF": "chair_0000", "STYLE_OF": "chair_0001",
    "leg=chair_0007": "leg=chair_0001", "256": "32", "24": "1",
}  # fmt: skip
LONG = {"view", "plan", "fit", "check"}  # a server, minutes, and shapes of the user's
SMALL = {"edit", "swap", "mix", "generate"}


def commands(page: str, program: str) -> Iterator[list[str]]:
    """The words of a page's commands of one program; alternatives in brackets are left out."""
    for text in COMMAND.findall((ROOT / page).read_text(encoding="utf-8")):
        line = re.sub(r"\[[^\]]*\]|…|\.\.\.$", "", text)
        if line.startswith(program + " "):
            yield shlex.split(line.replace("{chair,table}", "chair"))


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_a_page_exists_and_takes_the_options_that_stand_there(page: str) -> None:
    names = {name for name in cli.app if not name.startswith("-")}
    for words in commands(page, "cagesdf"):
        if words[1].startswith("-"):
            continue
        assert words[1] in names, words
        options = {word.partition("=")[0] for word in words[2:] if word.startswith("--")}
        known = {name for argument in cli.app[words[1]].assemble_argument_collection() for name in argument.names}
        assert options <= known, words


@pytest.mark.parametrize("page", [page for page in PAGES if page != "docs/extending.md"])  # which adds a stage
def test_every_module_and_target_of_a_page_is_there(page: str) -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for words in commands(page, "make"):
        assert words[1] in targets or "=" in words[1], words
    for words in commands(page, "python -m"):
        if words[2].split(".")[0] in ("benchmarks", "cagesdf", "pipeline", "stages"):
            assert importlib.util.find_spec(words[2]), words


def test_a_command_that_is_not_there_would_be_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "page.md").write_text("Run `cagesdf extrude RUN`:\n\n    make repo\n", encoding="utf-8")
    monkeypatch.setattr("tests.project.test_commands.ROOT", tmp_path)
    assert [*commands("page.md", "cagesdf")] == [["cagesdf", "extrude", "RUN"]]
    assert [*commands("page.md", "make")] == [["make", "repo"]]


@pytest.mark.slow
def test_the_commands_of_the_readme_run(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    toy.write_obj(Path("chair.obj"), toy.box(np.zeros(3), np.ones(3)))
    np.save("points.npy", np.random.default_rng(0).uniform(-1, 1, (50, 3)))
    write_program(Path("programs/stool.txt"))
    shutil.copytree(DEMO / "run", STAND_INS["RUN"])
    shutil.copytree(DEMO / "programs", "data/programs/chair")
    [script] = re.findall(
        r"echo '(\[.*?\])' > script\.json", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL
    )
    Path("script.json").write_text(script.replace("chair_0007", "chair_0001"), encoding="utf-8")
    done = []
    for words in commands("README.md", "cagesdf"):
        if words[1] in LONG or words[2].startswith("data/"):
            continue
        arguments = [STAND_INS.get(word, word) for word in words[1:]]
        command(*arguments, *(["--resolution", "32"] if words[1] in SMALL else []))
        done.append(words[1])
    assert set(done) == {"edit", "swap", "mix", "generate", "parts", "extract", "sdf", "execute"}
    for name in ("out.glb", "new", "found", "distances.npy", "cuboids.jsonl"):
        assert Path(name).exists(), name
