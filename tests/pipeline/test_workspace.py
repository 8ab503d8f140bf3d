"""Work folders: other parameters or data beside the default run, and nothing of the user's lost."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from dvc.repo import Repo

from pipeline import lanes, workspace
from pipeline.params import ParamsError, check, read_yaml


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with the real parameters and graph, whose work folder is ours to fill."""
    for name in ("params.yaml", "dvc.yaml"):
        (tmp_path / name).write_bytes((workspace.ROOT / name).read_bytes())
    shutil.copytree(workspace.ROOT / ".dvc" / "plots", tmp_path / ".dvc" / "plots")
    (tmp_path / "profiles").mkdir()
    for path in (workspace.ROOT / "profiles").glob("*.yaml"):
        (tmp_path / "profiles" / path.name).write_bytes(path.read_bytes())
    monkeypatch.setattr(workspace, "ROOT", tmp_path)
    return tmp_path


@pytest.fixture
def root(project: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same without DVC's own files in its work folders, which take seconds."""
    monkeypatch.setattr(workspace, "subprocess", SimpleNamespace(run=lambda *arguments, **options: None))
    return project


def read(path: Path) -> dict:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def test_a_profile_is_the_default_parameters_with_its_differences(root: Path) -> None:
    folder = workspace.main(["profile", "tiny"])
    assert folder == root / "work" / "tiny"
    check(folder / "params.yaml")
    params, defaults = read(folder / "params.yaml"), read(root / "params.yaml")
    assert params["train"]["steps"] == read(root / "profiles" / "tiny.yaml")["train"]["steps"]
    assert params["match_targets"] == defaults["match_targets"]
    assert read(folder / "dvc.yaml") == read(root / "dvc.yaml")
    assert (folder / ".dvc" / "plots" / "arms.json").is_file()


def test_settings_that_were_edited_survive_and_win(root: Path) -> None:
    folder = workspace.main(["profile", "tiny"])
    (folder / "settings.yaml").write_text("train: {steps: 7}\n", encoding="utf-8")
    workspace.main(["profile", "tiny"])
    params = read(folder / "params.yaml")
    assert params["train"]["steps"] == 7
    assert params["train"]["width"] == read(root / "profiles" / "tiny.yaml")["train"]["width"]


def test_own_data_takes_the_place_of_synthesis(root: Path) -> None:
    data = root / "my shapes"
    data.mkdir()
    folder = workspace.main(["own", "--data", str(data), "--name", "stool", "--include", "A*", "--up", "z"])
    assert folder.name == "own-stool"
    params, content = read(folder / "params.yaml"), read(folder / "dvc.yaml")
    graph = content["stages"]
    assert content["metrics"] == read(root / "dvc.yaml")["metrics"], "dvc metrics show works there, too"
    assert params["run"]["categories"] == ["stool"]
    assert (params["import_shapes"]["include"], params["import_shapes"]["up"]) == ("A*", "z")
    assert "synthesize" not in graph
    assert (folder / "data" / "raw" / "stool").resolve() == data
    assert graph["import_shapes"]["cmd"].split()[3] == "data/raw/${item.category}"


def test_what_is_missing_or_misspelt_is_one_line_that_tells_what_there_is(root: Path) -> None:
    with pytest.raises(ParamsError, match="no profile 'tiney'; profiles/ has ablations, demo, keep, own, paper, tiny"):
        workspace.main(["profile", "tiney"])
    with pytest.raises(ParamsError, match="no such folder"):
        workspace.main(["own", "--data", str(root / "nowhere"), "--name", "chair"])
    with pytest.raises(ParamsError, match=r"'\.\./x'"):
        workspace.main(["own", "--data", str(root), "--name", "../x"])


def test_dvc_accepts_the_folder(project: Path) -> None:
    folder = workspace.main(["profile", "tiny"])
    listed = subprocess.run(
        [sys.executable, "-m", "dvc", "stage", "list", "--name-only"],
        cwd=folder, capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    assert "train@chair-cagesdf" in listed
    assert "train@table-cagesdf" not in listed


def test_merging_replaces_values_and_lists_whole_and_changes_neither_side() -> None:
    base, changes = {"a": {"b": 1, "c": [1, 2]}, "d": 3}, {"a": {"c": [9]}, "e": 4}
    assert workspace.merged(base, changes) == {"a": {"b": 1, "c": [9]}, "d": 3, "e": 4}
    assert base == {"a": {"b": 1, "c": [1, 2]}, "d": 3}


# Names and links


HOSTILE = [
    "my `touch pwned` chairs", "$(touch pwned)", "$$HOME ${HOME} ${item.category} $x", "a; touch pwned", "a\nb\n c",
    "'\"", "-n", "--help", "a&b|c>d", "~", "*", "[a]", "#", "%s\\n", "Stühle 椅子", "a=b", "$(shell touch pwned)",
    "${shell touch pwned}", "a:b", "a\\",
]  # fmt: skip


def own(root: Path, data: Path, *more: str) -> Path:
    return workspace.main(["own", f"--data={data}", "--name", "chair", *more])


def test_the_name_of_a_data_folder_stands_in_a_link_and_nowhere_else(root: Path) -> None:
    texts = []
    for name in HOSTILE:
        data = root / "data of mine" / name
        (data / "a").mkdir(parents=True)
        folder = own(root, data)
        assert (folder / "data" / "raw" / "chair").resolve() == data.resolve()
        texts.append([(folder / file).read_bytes() for file in ("dvc.yaml", "params.yaml", "settings.yaml")])
    assert all(text == texts[0] for text in texts)
    graph, default = read(folder / "dvc.yaml")["stages"], read(root / "dvc.yaml")["stages"]
    assert graph == {stage: entry for stage, entry in default.items() if stage != "synthesize"}


@pytest.mark.parametrize("origin", ["command line", "environment"])
def test_make_gives_names_to_commands_as_they_were_typed(tmp_path: Path, origin: str) -> None:
    for number, name in enumerate(HOSTILE):
        call_make(tmp_path / str(number), name, origin)
    assert not [*tmp_path.rglob("pwned")]


STAND_IN = """#!/bin/sh
printf '%s\\0' "$@" '' >>"$CALLS"
[ "$2" = pipeline.workspace ] && pwd
exit 0
"""


def call_make(folder: Path, name: str, origin: str) -> None:
    """All values have this name, and the project lies in such a folder; a stand-in for Python notes its arguments."""
    project = folder / name.replace(":", "").replace("\\", "") / "x"  # neither fits into PATH of all systems
    (project / ".venv" / "bin").mkdir(parents=True)
    (project / "Makefile").write_bytes((workspace.ROOT / "Makefile").read_bytes())
    python = project / ".venv" / "bin" / "python"
    python.write_text(STAND_IN)
    python.chmod(0o755)
    for file in ("pyproject.toml", "constraints.txt", ".venv/installed"):
        (project / file).touch()
    values = {"DATA": name, "NAME": "chair", "INCLUDE": name, "UP": name, "PROFILE": name}
    clean = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MAKELEVEL")}
    environment = {**clean, "CALLS": str(folder / "calls"), **(values if origin == "environment" else {})}
    typed = [f"{key}={value}" for key, value in values.items()] if origin == "command line" else []
    for target in ("own", "repro"):
        subprocess.run(["make", target, *typed], cwd=project, env=environment, check=True, capture_output=True)
    calls = [call.split("\0") for call in (folder / "calls").read_text().split("\0\0")]
    lanes = ["-m", "pipeline.lanes"]
    assert calls == [
        ["-m", "pipeline.workspace", "own", f"--data={name}", "--name=chair", f"--include={name}", f"--up={name}"],
        lanes,
        ["-m", "pipeline.workspace", "profile", "--", name],
        lanes,
        [""],
    ]


def test_names_that_are_no_words_stop_a_run_before_dvc_reads_them(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    params = read(root / "params.yaml")
    monkeypatch.chdir(root)
    for name in ("a; touch pwned", "$(touch pwned)", "-x", "../x", "a b", ""):
        changed = workspace.merged(params, {"run": {"categories": [name]}})
        (root / "params.yaml").write_text(yaml.safe_dump(changed), encoding="utf-8")
        with pytest.raises(ParamsError, match=r"run\.categories\.0: "):
            lanes.main()


def test_make_own_without_data_says_what_it_wants(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And doesn't take the folder it runs in."""
    with pytest.raises(SystemExit):
        workspace.main(["own", "--name", "chair"])
    assert "required: --data" in capsys.readouterr().err
    with pytest.raises(ParamsError, match="empty name"):
        workspace.main(["own", "--data=", "--name", "chair"])


def test_a_folder_that_holds_the_project_is_refused(root: Path) -> None:
    for data in (root, root.parent):
        with pytest.raises(ParamsError, match="holds the project itself"):
            own(root, data)
    (root / "shapes").mkdir()
    (root / "shapes" / "loop").symlink_to(root)
    with pytest.raises(ParamsError, match="holds the project itself"):
        own(root, root / "shapes")


def test_links_lead_to_the_folder_that_was_named_last(root: Path) -> None:
    for name in ("one", "two"):
        (root / name).mkdir()
        folder = own(root, root / name)
        assert (folder / "data" / "raw" / "chair").resolve() == root / name
    own(root, folder / "data" / "raw" / "chair")
    assert (folder / "data" / "raw" / "chair").resolve() == root / "two", "the link itself was named"
    (folder / "data" / "raw" / "chair").unlink()
    (folder / "data" / "raw" / "chair").mkdir()
    with pytest.raises(ParamsError, match="is no link; move it away"):
        own(root, root / "one")


def test_folders_behind_links_are_found_through_links_and_loops(tmp_path: Path) -> None:
    for name in ("data/a/b", "out/c/d", "far", "unlinked"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "data" / "a" / "c").symlink_to(tmp_path / "out" / "c")
    (tmp_path / "data" / "a" / "again").symlink_to(tmp_path / "out" / "c")
    (tmp_path / "data" / "inside").symlink_to(tmp_path / "data" / "a")
    (tmp_path / "data" / "nowhere").symlink_to(tmp_path / "none")
    (tmp_path / "out" / "c" / "d" / "far").symlink_to(tmp_path / "far")
    (tmp_path / "far" / "back").symlink_to(tmp_path / "out" / "c")
    assert workspace.linked_folders(tmp_path / "data") == [tmp_path / "far", tmp_path / "out" / "c"]


def test_a_change_behind_a_link_reruns_what_reads_the_shapes(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("shapes/a/seat.obj", "elsewhere/b/seat.obj"):
        (root / name).parent.mkdir(parents=True)
        (root / name).write_text("v 0 0 0\n")
    (root / "shapes" / "b").symlink_to(root / "elsewhere" / "b")
    folder = own(root, root / "shapes")
    assert (folder / "data" / "linked" / "0000").resolve() == root / "elsewhere" / "b"
    graph = read(folder / "dvc.yaml")["stages"]
    reading = [name for name, stage in graph.items() if "data/raw/${item.category}" in stage.get("deps", ())]
    assert reading == ["import_shapes", "make_clouds", "make_trials"]
    assert all("data/linked/0000" in graph[name]["deps"] for name in reading)
    # The same dependencies with a command of the test's own.
    stage = graph["import_shapes"] | {"cmd": "echo run >> runs", "outs": [], "params": []}
    stage["deps"] = [dep for dep in stage["deps"] if "library" not in dep]
    (folder / "dvc.yaml").write_text(yaml.safe_dump({"stages": {"import_shapes": stage}}), encoding="utf-8")
    monkeypatch.chdir(folder)
    Repo.init(no_scm=True, force=True).close()

    def runs() -> int:
        with Repo() as repo:
            repo.reproduce()
        return len((folder / "runs").read_text().splitlines())

    assert runs() == 1
    (root / "elsewhere" / "b" / "seat.obj").write_text("v 10 0 0\n")
    assert [runs(), runs()] == [2, 2]
    (root / "shapes" / "a" / "seat.obj").write_text("v 20 0 0\n")
    assert runs() == 3


# settings.yaml


COMMENTED = """\
# mine
train:   # long
  steps: 7    # enough
  learning_rate: 1.0e-3

import_shapes: {up: 'y'}  # as exported
run:
  # one arm only
  arms: [cagesdf]
  generators:
    - cagesdf
"""


def test_settings_stay_byte_for_byte_where_nothing_is_changed(root: Path) -> None:
    (root / "shapes").mkdir()
    folder = own(root, root / "shapes")
    text = COMMENTED + "  categories: [chair]\n"
    (folder / "settings.yaml").write_text(text, encoding="utf-8", newline="\n")
    own(root, root / "shapes")
    own(root, root / "shapes", "--up", "y")
    assert (folder / "settings.yaml").read_bytes() == text.encode()
    assert read(folder / "params.yaml")["train"]["steps"] == 7


def test_what_the_command_line_says_is_put_into_the_settings_beside_their_comments(root: Path) -> None:
    (root / "shapes").mkdir()
    folder = own(root, root / "shapes")
    (folder / "settings.yaml").write_text(COMMENTED, encoding="utf-8", newline="\n")
    own(root, root / "shapes", "--up", "z", "--include", "${run.x}*")
    text = (folder / "settings.yaml").read_text(encoding="utf-8")
    assert [comment for comment in ("# mine", "# long", "# enough", "# as exported", "# one arm only")
            if comment not in text] == []  # fmt: skip
    assert "learning_rate: 1.0e-3" in text
    changed = {"run": {"categories": ["chair"]}, "import_shapes": {"up": "z", "include": "${run.x}*"}}
    assert read(folder / "settings.yaml") == workspace.merged(yaml.safe_load(COMMENTED), changed)
    own(root, root / "shapes")
    assert read(folder / "params.yaml")["import_shapes"]["up"] == "z", "said once, it stays"
    assert (folder / "settings.yaml").read_text(encoding="utf-8") == text


@pytest.mark.parametrize("text", ["", "# only this\n", "---\n# only this\n"])
def test_settings_without_any_are_filled(root: Path, text: str) -> None:
    (root / "shapes").mkdir()
    folder = own(root, root / "shapes")
    (folder / "settings.yaml").write_text(text, encoding="utf-8")
    own(root, root / "shapes", "--up", "z")
    assert read(folder / "settings.yaml") == {"run": {"categories": ["chair"]}, "import_shapes": {"up": "z"}}
    assert (folder / "settings.yaml").read_text(encoding="utf-8").startswith(text)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_settings_are_read_with_a_byte_order_mark(root: Path, encoding: str) -> None:
    folder = workspace.main(["profile", "tiny"])
    (folder / "settings.yaml").write_text("train: {steps: 7}  # ü\n", encoding=encoding)
    workspace.main(["profile", "tiny"])
    assert read(folder / "params.yaml")["train"]["steps"] == 7


def test_broken_yaml_is_one_line_that_says_where(root: Path) -> None:
    broken = [
        (b"train: {steps: 7\nrun: [", r"settings.yaml, line 2, column 4: is not YAML \("),
        (b"train:\n\tsteps: 7\n", r"settings.yaml, line 2, column 1: is not YAML \("),
        (b"train: 1\n  steps: 7\n", r"settings.yaml, line 2, column 8: is not YAML \("),
        (b"a: \xff\n", r"settings.yaml, line 1, column 4: is not YAML \("),
        (b"a: 1\nb: \x07\n", r"settings.yaml, line 2, column 4: is not YAML \("),
        (b"a: !!python/object/apply:os.system [ls]\n", r"settings.yaml, line 1, column 4: is not YAML \("),
        (b"a: 2024-13-45\n", "settings.yaml: is not YAML"),
        (b"a: !!int ''\n", "settings.yaml: is not YAML"),
        (b"[" * 5000, "settings.yaml: is not YAML"),
        (b"- train\n", "settings.yaml: wanted a mapping of sections, got list"),
        (b"train\n", "settings.yaml: wanted a mapping of sections, got str"),
    ]
    for content, said in broken:
        with pytest.raises(ParamsError, match=said) as caught:
            read_yaml(content, "settings.yaml")
        assert "\n" not in str(caught.value)
    folder = workspace.main(["profile", "tiny"])
    (folder / "settings.yaml").write_bytes(content)
    with pytest.raises(ParamsError, match=said):
        workspace.main(["profile", "tiny"])
    assert (folder / "settings.yaml").read_bytes() == content


def test_settings_of_the_wrong_kind_are_one_line_that_says_where(root: Path) -> None:
    folder = workspace.main(["profile", "tiny"])
    wrong = [
        (b"train: 7\n", "params.yaml: train: "),
        (b"arms: {cagesdf: 7}\n", "params.yaml: arms.cagesdf: wanted a mapping"),
        (b"arms: [cagesdf]\n", "params.yaml: arms: wanted a mapping"),
        (b"arms:\n", "params.yaml: arms: wanted a mapping"),
        (b"run:\n", "params.yaml: run.categories: field required"),
        (b"7: 8\n", "params.yaml: 7: unknown section"),
        (b"run: {categories: ['a; touch pwned']}\n", r"params.yaml: run.categories.0: "),
        (b"run: {arms: ['$(touch pwned)']}\n", r"params.yaml: run.arms.0: "),
    ]
    for content, said in wrong:
        (folder / "settings.yaml").write_bytes(content)
        with pytest.raises(ParamsError, match=said) as caught:
            workspace.main(["profile", "tiny"])
        assert "\n" not in str(caught.value)


def test_a_key_that_is_there_twice_is_not_edited(root: Path) -> None:
    (root / "shapes").mkdir()
    folder = own(root, root / "shapes")
    (folder / "settings.yaml").write_text("train: {steps: 7}\ntrain: {steps: 8}\n", encoding="utf-8")
    with pytest.raises(ParamsError, match=r"settings.yaml, line 2, column 1: found duplicate key"):
        own(root, root / "shapes", "--up", "z")
