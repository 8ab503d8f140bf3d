"""The wheel, far from the repository: what is in it, and that its commands work with it alone."""

import json
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
import trimesh

from cagesdf import cli
from tests.support import toy

ROOT = Path(__file__).parents[2]
PACKAGES = str(Path(np.__file__).parent.parent)  # where the others are installed


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What of the repository a wheel may be made of."""
    folder = tmp_path_factory.mktemp("source")
    for name in ("cagesdf", "pipeline", "stages"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder / name)
    return folder


@pytest.fixture(scope="module")
def site(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what pip would install of the wheel."""
    built = tmp_path_factory.mktemp("built")
    return build("build_wheel", source, built)


def build(hook: str, source: Path, built: Path) -> Path:
    """What pip would install after one of setuptools' hooks, unpacked; they write into the source, so it is a copy."""
    code = f"from setuptools import build_meta; build_meta.{hook}({str(built)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=source, check=True, capture_output=True)
    (wheel,) = built.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(built / "site")
    return built / "site"


def command(site: Path, code: str, hidden: str = "") -> list[str]:
    """A Python that has the wheel and other packages, without their .pth files, which may lead to the repository."""
    block = f"sys.modules.update(dict.fromkeys({hidden.split()!r}))"
    return [sys.executable, "-S", "-c", f"import sys; sys.path[:0] = [{str(site)!r}, {PACKAGES!r}]; {block}; {code}"]


def output(site: Path, folder: Path, *arguments: object, hidden: str = "") -> subprocess.CompletedProcess[str]:
    """One command, in another folder."""
    words = ["cagesdf", *map(str, arguments)]
    code = f"sys.argv = {words!r}; from cagesdf.cli import run; run()"
    return subprocess.run(command(site, code, hidden), cwd=folder, capture_output=True, text=True)


def test_it_holds_the_library_with_its_data_and_nothing_else(site: Path) -> None:
    (metadata,) = site.glob("cagesdf-*.dist-info")
    assert sorted(path.name for path in site.iterdir()) == sorted(["cagesdf", metadata.name])
    inside = {path.relative_to(site).as_posix() for path in (site / "cagesdf").rglob("*") if path.is_file()}
    here = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "cagesdf").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert inside == here


def test_an_editable_install_leads_to_the_whole_repository_from_any_folder(source: Path, tmp_path: Path) -> None:
    """Stages run in work folders: `python -m stages.train` finds them there."""
    (path,) = build("build_editable", source, tmp_path).glob("*.pth")
    assert Path(path.read_text(encoding="utf-8").strip()).resolve() == source.resolve()


def test_shapes_are_edited_checked_and_measured_elsewhere(site: Path, tmp_path: Path) -> None:
    toy.write_obj(tmp_path / "shapes/box" / "seat.obj", toy.box([0, 0, 0], [2, 2, 2]))
    toy.write_obj(tmp_path / "shapes/box" / "leg.obj", toy.box([0, -2, 0], [1, 4, 1]))
    np.save(tmp_path / "points.npy", np.array([[0.0, 0.0, 0.0], [0.0, 1.5, 0.0]]))
    (tmp_path / "script.json").write_text('[{"op": "resize", "part": "leg_*", "axis": "y", "factor": 1.2}]')
    edit = output(
        site, tmp_path, "edit", site / "cagesdf/demo/run", "chair_0000", "script.json", "a.ply", "--resolution", 32
    )
    assert json.loads(edit.stdout)["closed"], edit.stderr
    assert trimesh.load_mesh(tmp_path / "a.ply").is_watertight
    [shape] = json.loads(output(site, tmp_path, "check", "shapes").stdout)["shapes"]
    assert shape == {"id": "box", "usable": True, "verdict": "passed"}
    assert output(site, tmp_path, "sdf", "shapes/box", "points.npy", "distances.npy").returncode == 0
    np.testing.assert_allclose(np.load(tmp_path / "distances.npy")[1], 0.5, atol=1e-6)


def test_what_is_not_in_it_is_named(site: Path, tmp_path: Path) -> None:
    plan = output(site, tmp_path, "plan")
    assert plan.returncode == 1
    assert plan.stderr.startswith("cagesdf: plan runs the stages, which are in the repository")
    assert "\n" not in plan.stderr.strip()
    view = output(site, tmp_path, "view", "--demo", hidden="viser")
    assert view.stderr == "cagesdf: this needs viser, which isn't installed; pip install 'cagesdf[editor]'\n"


@pytest.fixture
def editor(site: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """`cagesdf view --demo` on any free port of this machine."""
    code = "sys.argv = ['cagesdf', 'view', '--demo', '--port', '0']; from cagesdf.cli import run; run()"
    process = subprocess.Popen(
        command(site, code),
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
    )
    yield process
    process.terminate()
    process.wait()


def test_the_editor_opens_the_demo(editor: subprocess.Popen[str]) -> None:
    assert editor.stdout is not None
    said = (line for line in editor.stdout if line.startswith("The editor: "))
    with urlopen(next(said).split()[2]) as page:
        assert page.status == 200


def test_a_module_that_no_extra_has_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    metadata = [
        'viser<1.2,>=1.1; extra == "editor"',
        "torch>=2",
        "jinja2>=3; extra == 'report'",
        'pyyaml>=6; extra == "pipeline"',
    ]
    monkeypatch.setattr(cli, "requires", lambda name: metadata)
    assert [cli._extra(name) for name in ("viser", "viser.infra", "jinja2", "yaml", "torch", "nothing", None)] == [
        "editor", "editor", "report", "pipeline", None, None, None,
    ]  # fmt: skip
