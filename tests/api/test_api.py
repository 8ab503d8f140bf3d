"""The Python API: the same bytes as the command, shapes that stay as they were where something is wrong."""

import inspect
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

import cagesdf
from cagesdf import rendering
from cagesdf.api import display
from cagesdf.api.shapes import EditableShape
from cagesdf.editing.script import KINDS
from cagesdf.exported import Place
from cagesdf.geometry.meshes import Mesh
from tests.support import balls, constant_runs, stools, toy
from tests.support.commands import Command

ROOT = Path(__file__).parents[2]
EDITS: list[tuple[str, dict[str, Any]]] = [
    ("move", {"part": "arm_1", "by": (0.05, 0.02, 0.0), "attach": True}),
    ("resize", {"part": "leg_*", "axis": "z", "factor": 0.9, "keep": "high"}),
    ("rotate", {"part": "back", "axis": "x", "angle": 5.0}),
    ("scale", {"factors": (1.1, 1.0, 0.9)}),
    ("set", {"parameter": "Chair.seat.y", "value": 0.08}),
    ("swap", {"style_of": "b"}),
    ("blend", {"style_of": "a", "weight": 0.3}),
    ("mix", {"part": "leg_*|back", "style_of": "b", "weight": 0.7}),
    ("style", {"code": (0.5, -0.25, 0.125, 1.0)}),
    ("style", {"code": (0.5, 0.25, 0.125, 1.0), "residuals": {"leg_*": (0.1, 0.0, -0.1, 0.0, 0.2, 0.0)}}),
    ("harmonise", {}),
    ("add", {"name": "shelf", "centre": (0.1, 0.2, 0.5), "lengths": (0.4, 0.4, 0.05)}),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two chairs in one cage, and a network that was never trained."""
    return constant_runs.write_parts_run(tmp_path_factory.mktemp("runs") / "parts")


@pytest.fixture(scope="module")
def run(folder: Path) -> cagesdf.TrainedRun:
    return cagesdf.load_run(folder)


@pytest.fixture
def without_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    """Matplotlib draws in this process: VTK would start one a picture."""
    monkeypatch.setattr(rendering, "WINDOWS", ())


def edited(run: cagesdf.TrainedRun) -> EditableShape:
    shape = run.open("a")
    for name, fields in EDITS:
        assert getattr(shape, name)(**fields) is shape
    return shape


def test_every_operation_of_scripts_is_a_method_with_the_same_fields_and_defaults() -> None:
    for name, kind in KINDS.items():
        fields = {key: field.default for key, field in kind.model_fields.items() if key != "op"}
        given = dict(inspect.signature(getattr(EditableShape, name)).parameters)
        given.pop("self")
        assert [*given] == [*fields] or sorted(given) == sorted(fields), name
        for key, parameter in given.items():
            required = kind.model_fields[key].is_required()
            assert required == (parameter.default is inspect.Parameter.empty), (name, key)
            assert required or parameter.default == fields[key], (name, key)


def test_methods_the_script_and_the_command_write_the_same_bytes(
    run: cagesdf.TrainedRun, folder: Path, command: Command, tmp_path: Path
) -> None:
    shape = edited(run)
    shape.save(tmp_path / "methods.glb", resolution=24)
    (tmp_path / "script.json").write_text(shape.script, encoding="utf-8")
    run.open("a").edit(shape.script).save(tmp_path / "script.glb", resolution=24)
    command("edit", folder, "a", tmp_path / "script.json", tmp_path / "command.glb", "--resolution", 24)
    whole = (tmp_path / "methods.glb").read_bytes()
    assert (tmp_path / "script.glb").read_bytes() == whole
    assert (tmp_path / "command.glb").read_bytes() == whole
    command("extract", folder, "a", tmp_path / "rest.glb", "--resolution", 24)
    assert (tmp_path / "rest.glb").read_bytes() != whole
    assert not list(tmp_path.glob(".*")), "nothing is left beside"


def test_undo_restores_the_bytes_and_redo_those_after(run: cagesdf.TrainedRun, tmp_path: Path) -> None:
    shape = run.open("a")
    shape.save(tmp_path / "before.ply", 24)
    shape.resize("leg_*", axis="z", factor=1.3).save(tmp_path / "after.ply", 24)
    shape.undo().save(tmp_path / "undone.ply", 24)
    shape.redo().save(tmp_path / "redone.ply", 24)
    before, after, undone, redone = (
        (tmp_path / f"{name}.ply").read_bytes() for name in ("before", "after", "undone", "redone")
    )
    assert before == undone != after == redone


def test_parts_are_evaluated_once_whatever_evaluates_them(run: cagesdf.TrainedRun) -> None:
    shape = run.open(run.shapes[0])
    first, again = (shape.extract(24, each=lambda part_of, cuboids: [*map(part_of, cuboids)]) for _ in range(2))
    assert first.evaluations > 0
    assert again.evaluations == 0
    assert again.mesh.vertices.tobytes() == first.mesh.vertices.tobytes()


def test_the_mesh_and_every_part_are_closed_and_lie_where_the_file_has_them(
    run: cagesdf.TrainedRun, tmp_path: Path
) -> None:
    shape = edited(run)
    mesh, parts = shape.mesh(24), shape.parts(24)
    assert mesh.is_volume
    assert parts
    assert all(part.is_volume for part in parts.values())
    assert parts.keys() <= shape.cuboids.keys()
    shape.save(tmp_path / "a.ply", 24)
    np.testing.assert_array_equal(trimesh.load_mesh(tmp_path / "a.ply", process=False).vertices, mesh.vertices)
    given = Mesh(np.array(mesh.vertices), np.array(mesh.faces, np.int32))
    place = Place.of(given)
    stored, origin = place.stored(given), place.origin
    assert not origin.any()
    assert len(stored.faces) == len(mesh.faces)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_resized_cuboid_is_longer_along_the_axis_that_was_named_alone(run: cagesdf.TrainedRun, axis: str) -> None:
    """The run's shapes stand on z in their files, and on y in the canonical frame."""
    shape = run.open("a")
    before = shape.cuboids
    after = shape.resize("seat", axis=axis, factor=1.5, mirror=False).cuboids  # type: ignore[arg-type]
    factors = np.where(np.array(["x", "y", "z"]) == axis, 1.5, 1.0)
    np.testing.assert_allclose(after["seat"].size, before["seat"].size * factors)
    for name in before.keys() - {"seat"}:
        np.testing.assert_array_equal(after[name].size, before[name].size)


def test_cuboids_move_by_what_the_files_frame_says(run: cagesdf.TrainedRun) -> None:
    shape = run.open("a")
    before = shape.cuboids["seat"].centre
    shape.move("seat", by=np.array([0.25, -0.125, 0.5]).tolist(), mirror=False)
    np.testing.assert_allclose(shape.cuboids["seat"].centre - before, [0.25, -0.125, 0.5])


def test_what_is_wrong_is_named_and_leaves_the_shape_as_it_was(run: cagesdf.TrainedRun, tmp_path: Path) -> None:
    shape = run.open("a").move("seat", by=(0.1, 0.0, 0.0))
    before = shape.script
    for wrong, words in (
        (lambda: shape.move("wing", by=(0.0, 0.0, 1.0)), "no part is called so; wanted one of"),
        (lambda: shape.resize("seat", axis="x", factor=0.0), "factor is 0.0; wanted a number from 0.01 to 100"),
        (lambda: shape.swap("c"), "did you mean"),
        (lambda: shape.edit('[{"op": "undo"}, {"op": "undo"}]'), "operation 1: undo: there is nothing to take back"),
        (lambda: shape.mesh(4), "resolution 4: wanted 8 to 1,024 cells"),
        (lambda: shape.save(tmp_path / "a.step"), "ends in .ply"),
        (lambda: shape.save(tmp_path / "no" / "a.ply"), "make it first"),
        (lambda: run.open("aa"), "did you mean a"),
        (lambda: run.generate(0), "count 0: wanted 1 to"),
        (lambda: run.generate(1, seed=-1), "seed -1"),
        (lambda: run.generate(1), "are looked for in"),
        (lambda: run.fit(tmp_path), "holds no mesh"),
        (lambda: cagesdf.load_run(tmp_path), "isn't a run"),
        (lambda: cagesdf.load_run(tmp_path / "nowhere"), "nowhere: no such folder; wanted a run"),
    ):
        with pytest.raises(cagesdf.InputError) as failure:
            wrong()
        assert words in str(failure.value)
    assert shape.script == before
    assert not list(tmp_path.iterdir())


def test_a_run_without_cuboids_gives_surfaces_and_no_edits(tmp_path: Path) -> None:
    run = cagesdf.load_run(stools.write_arm(tmp_path / "run", -0.05, trains_on="cube"))
    shape = run.open(run.shapes[0])
    for wrong in (lambda: shape.swap(run.shapes[1]), lambda: run.generate(1)):
        with pytest.raises(cagesdf.InputError, match="without cuboids"):
            wrong()


def test_one_number_in_place_of_three_is_refused_in_the_words_of_scripts(run: cagesdf.TrainedRun) -> None:
    shape = run.open("a")
    move, scale = inspect.unwrap(EditableShape.move), inspect.unwrap(EditableShape.scale)  # without checks of types
    with pytest.raises(cagesdf.InputError, match=r"^move: by is 0\.1; wanted three numbers \[x, y, z\]"):
        move(shape, "seat", by=0.1)
    with pytest.raises(cagesdf.InputError, match=r"^scale: factors is 1\.2; wanted three numbers \[x, y, z\]"):
        scale(shape, 1.2)
    assert shape.script == "[]\n"


def test_new_shapes_have_the_bytes_of_those_that_the_command_makes(command: Command, tmp_path: Path) -> None:
    stools.write_programs(tmp_path / "data" / "programs" / "stool")
    folder = stools.write_arm(tmp_path / "data" / "runs" / "stool" / "full", -0.05)
    words = "--count", 3, "--seed", 5, "--resolution", 16, "--ending", "ply"
    command("generate", folder, *words, "--out", tmp_path / "new")
    shapes = cagesdf.load_run(folder).generate(3, seed=5)
    entries = [json.loads(line) for line in (tmp_path / "new" / "index.jsonl").read_text().splitlines()]
    assert len(shapes) == len(entries) == 3
    for shape, entry in zip(shapes, entries):
        shape.save(tmp_path / entry["mesh"], 16)
        assert (tmp_path / entry["mesh"]).read_bytes() == (tmp_path / "new" / entry["mesh"]).read_bytes()
        np.testing.assert_array_equal(shape.cage.vectors(), entry["cuboids"])
        assert cagesdf.load_run(folder).open(shape.shape_id).edit(shape.script).script == shape.script


def test_warnings_are_those_of_the_command(
    run: cagesdf.TrainedRun, command: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shape = run.open("a").resize("seat", axis="y", factor=0.05)
    (tmp_path / "script.json").write_text(shape.script)
    warned: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cagesdf.cli.surfaces.warn", warned.extend)
        command("edit", run.folder, "a", tmp_path / "script.json", tmp_path / "out.ply", "--resolution", 24)
    assert warned
    assert shape.warnings(24) == tuple(warned)


@pytest.mark.parametrize("resolution", [7, 1025, 100_000])
def test_no_more_cells_are_made_than_memory_has(run: cagesdf.TrainedRun, resolution: int) -> None:
    with pytest.raises(cagesdf.InputError, match=f"resolution {resolution:,}: wanted 8 to 1,024 cells"):
        run.open("a").mesh(resolution)


def test_the_demo_is_called_so_in_commands_too(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command("extract", "demo", "chair_0000", tmp_path / "chair.ply", "--resolution", 16)
    assert (tmp_path / "chair.ply").is_file()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo").mkdir()
    with pytest.raises(cagesdf.InputError, match="demo"):
        cagesdf.load_run("demo")


def test_shapes_and_runs_are_printed_as_lines(run: cagesdf.TrainedRun) -> None:
    shape = run.open("a").move("seat", by=(0.0, 0.1, 0.0))
    assert repr(shape) == f"<EditableShape: a, 1 operations; {len(shape.cage)} cuboids>"
    assert repr(run) == f"<TrainedRun: {run.folder}; 2 shapes>"


def test_a_notebook_shows_pictures_and_names_of_any_spelling(run: cagesdf.TrainedRun, without_opengl: None) -> None:
    html = run.open("a")._repr_html_()
    assert html.count("data:image/png;base64,") == 1
    assert "<td>seat</td>" in html
    assert "<td>b</td>" in run._repr_html_()
    surface = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    html = display.shape_html("<b>&", run.open("a").cage, {"<script>": run.open("a").cuboids["seat"]}, surface)
    assert "<script>" not in html
    assert "&lt;b&gt;&amp;" in html


def test_a_picture_is_of_its_size_and_wrong_ones_are_refused(
    run: cagesdf.TrainedRun, tmp_path: Path, without_opengl: None
) -> None:
    shape = run.open("a")
    shape.picture(tmp_path / "a.png", size=64, resolution=16)
    picture = np.asarray(Image.open(tmp_path / "a.png"))
    assert picture.shape == (64, 64, 3)
    assert picture.min() < 200 < picture.max()
    for name, size, message in (
        ("a.gif", 64, r"ends in \.png or \.jpg"),
        ("a.png", 9, "16 to 4096"),
        ("no/a.png", 64, "no folder"),
    ):
        with pytest.raises(cagesdf.InputError, match=message):
            shape.picture(tmp_path / name, size=size, resolution=16)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_distances_to_meshes_are_those_to_their_union_and_those_of_the_command(
    command: Command, tmp_path: Path
) -> None:
    """Two boxes, one of which reaches into the other."""
    boxes = {"a": toy.box([0, 0, 0], [2, 2, 2]), "b": toy.box([1, 0, 0], [2, 1, 1])}
    points = np.array([[0, 0, 0], [0, 1.5, 0], [0.75, 0, 0], [3, 0, 0], [0, 0, -11]], np.float64)
    meshes = {name: trimesh.Trimesh(mesh.vertices, mesh.faces, process=False) for name, mesh in boxes.items()}
    distances = cagesdf.signed_distance(meshes, points)
    np.testing.assert_allclose(distances, [-1, 0.5, -np.hypot(0.25, 0.5), 1, 10], atol=2e-6)
    np.testing.assert_allclose(cagesdf.signed_distance(meshes["a"], points[:2]), [-1, 0.5], atol=2e-6)
    for name, mesh in boxes.items():
        toy.write_obj(tmp_path / "shape" / f"{name}.obj", mesh)
    np.testing.assert_array_equal(cagesdf.signed_distance(tmp_path / "shape", points), distances)
    np.save(tmp_path / "points.npy", points)
    command("sdf", tmp_path / "shape", tmp_path / "points.npy", tmp_path / "out.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "out.npy"), distances.astype(np.float32))
    with pytest.raises(cagesdf.InputError, match=r"shape \(5, 2\)"):
        cagesdf.signed_distance(meshes, points[:, :2])
    with pytest.raises(cagesdf.InputError, match=r"rejected: .* no faces"):
        cagesdf.signed_distance({"empty": trimesh.Trimesh()}, points)


def test_check_says_of_each_shape_what_the_command_prints(command: Command, tmp_path: Path) -> None:
    box = toy.box([0, 0, 0], [2, 2, 2])
    toy.write_obj(tmp_path / "sound" / "seat.obj", box)
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "seat.obj").write_text("v 0 0 0\nf 1 2 3\n")
    checks = cagesdf.check(tmp_path)
    assert [(item.shape_id, item.usable) for item in checks] == [("bad", False), ("sound", True)]
    command.on_terminal()
    command.complaint("check", tmp_path)
    assert command.capsys.readouterr().out.splitlines()[:-1] == [str(item) for item in checks]


def test_a_fitted_shape_has_the_bytes_of_the_one_that_the_command_writes(
    command: Command, run_folder: Path, tmp_path: Path
) -> None:
    source = balls.write_pair(tmp_path / "new")
    command("fit", run_folder, source, tmp_path / "out", "--resolution", 24, "--seed", 3)
    shape = cagesdf.load_run(run_folder).fit(source, seed=3)
    shape.save(tmp_path / "api.ply", 24)
    assert (tmp_path / "api.ply").read_bytes() == (tmp_path / "out" / "surface.ply").read_bytes()
    assert shape.editable().extract(24).mesh.vertices.tobytes() == shape.extract(24).mesh.vertices.tobytes()
    edited = shape.editable().move("a", by=(0.1, 0.0, 0.0), mirror=False)
    assert edited.cuboids["a"].centre[0] == pytest.approx(shape.cuboids["a"].centre[0] + 0.1)


@pytest.mark.parametrize("page", ["README.md", "docs/api.md"])
def test_the_examples_of_a_page_run(page: str, tmp_path: Path) -> None:
    """In a Python of their own: a user has no checks of types."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    code = "\n".join([*blocks, "assert mesh.is_volume"])
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    written = [path for path in tmp_path.iterdir() if path.suffix in (".glb", ".ply")]
    assert written
    assert all(trimesh.load_scene(path).geometry for path in written)


def loaded(code: str) -> set[str]:
    """The modules that a fresh Python has after some code."""
    text = f"import sys; {code}; print(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", text], cwd=ROOT, capture_output=True, text=True).stdout.split())


def test_the_package_and_its_help_start_without_what_they_may_need_later() -> None:
    heavy = {"torch", "scipy", "trimesh", "pyarrow", "viser", "pyvista", "matplotlib", "pipeline"}
    assert not heavy & loaded("import cagesdf; dir(cagesdf)")
    assert not heavy & loaded("import cagesdf.cli; cagesdf.cli.app(['--help'], result_action='return_value')")
    assert "torch" in loaded("from cagesdf import load_run")
    assert "torch" not in loaded("from cagesdf import check, signed_distance")


def test_all_names_are_there_and_the_types_of_exactly_these_are_declared() -> None:
    stub = (ROOT / "cagesdf" / "__init__.pyi").read_text(encoding="utf-8").splitlines()
    assert sorted(line.split(" as ")[1] for line in stub) == sorted(vars(cagesdf)["__all__"])
    for name in vars(cagesdf)["__all__"]:
        assert getattr(cagesdf, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        cagesdf.nothing  # type: ignore[attr-defined]  # noqa: B018
