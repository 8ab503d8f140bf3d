"""The `cagesdf` command as a user meets it."""

import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pytest

from cagesdf import cli
from cagesdf.formats.obj import read_obj_groups
from cagesdf.geometry.meshes import Mesh, is_closed, signed_volume
from cagesdf.io.meshes import write_ply
from cagesdf.io.points import CHUNK, PointChunks, PointsOf, shard_path, write_shard
from pipeline import artefact
from tests.support import toy
from tests.support.commands import Command
from tests.support.constant_runs import PARAMS, write_program

ROOT = Path(__file__).parents[2]


def write_points(folder: Path, kinds: tuple[PointsOf, ...] = ("shape",)) -> Path:
    """Of each kind two shards of two chunks; a quarter of the points is inside, half near."""
    rng = np.random.default_rng(0)
    with artefact.write("points", folder, inputs={}, params=PARAMS) as out:
        for k in range(2):
            sdf = np.tile(np.where(np.arange(CHUNK) % 4 == 0, -0.05, 0.05), (2, 1)).astype(np.float32)
            near = np.tile(np.arange(CHUNK) % 2 == 0, (2, 1))
            whose = np.array([0, 0], np.int32), np.array([0, k], np.int32), np.array([0, k], np.int32)
            xyz = rng.uniform(-1, 1, (2, CHUNK, 3)).astype(np.float32)
            chunks = PointChunks(*whose, xyz, sdf, near, (f"c{k}",), ("a", "b"))
            for of in kinds:
                write_shard(shard_path(out, of, k), [chunks], rng, of=of)
    return folder


def test_the_version_is_the_packages(command: Command) -> None:
    try:
        installed = version("cagesdf")
    except PackageNotFoundError:
        pytest.skip("not installed: pip install -e .")
    assert command("--version").strip() == installed
    assert installed == tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]


def test_help_waits_for_no_library_that_computes() -> None:
    """Not timed: these are what takes seconds to import."""
    heavy = {"torch", "numpy", "scipy", "pyarrow", "viser", "trimesh", "manifold3d", "PIL", "pydantic", "beartype"}
    code = (
        "import sys, atexit; from cagesdf.cli import run; sys.argv = ['cagesdf', '--help'];"
        "atexit.register(lambda: print([name for name in sys.modules if '.' not in name])); run()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert "extract" in done.stdout
    assert not heavy & set(re.findall(r"'(\w+)'", done.stdout.splitlines()[-1]))


def test_mistyped_words_are_met_with_a_suggestion(command: Command) -> None:
    assert 'Did you mean "inspect"?' in command.complaint("inspct", "x")
    assert "Did you mean --resolution?" in command.complaint("extract", "a", "b", "c.ply", "--resolutin", "64")


def test_what_is_missing_or_no_number_is_said(command: Command) -> None:
    assert "--help" in command.complaint("inspect")
    assert '"many"' in command.complaint("extract", "a", "b", "c.ply", "--resolution", "many")


def test_points_are_described_with_the_share_inside_and_counts_by_cuboid(command: Command, tmp_path: Path) -> None:
    text = command("inspect", write_points(tmp_path / "points" / "chair"))
    assert "points, format 1" in text
    assert "points, 256 rows in 2 files" in text
    assert "sign negative inside" in text
    assert "25.0% of the points" in text
    assert "50.0% near the surface, 50.0% uniform" in text
    assert "a shape    points: c0: 128, c1: 128" in text
    assert "a step     points: 0: 192, 1: 64" in text
    assert "a cuboid   points: c0 0 a: 128, c1 0 a: 64, c1 1 b: 64" in text
    assert "-0.05 to 0.05" in text
    shard = command("inspect", tmp_path / "points" / "chair" / "shape-0001.parquet")
    assert "shape-0001.parquet: points, 128 rows" in shard
    assert "c1 0 a: 64, c1 1 b: 64" in shard


def test_points_of_shapes_and_of_parts_are_described_apart(command: Command, tmp_path: Path) -> None:
    text = command("inspect", write_points(tmp_path / "points" / "chair", ("shape", "part")))
    for of in ("shape", "part"):
        assert f"{of}-0000.parquet … {of}-0001.parquet: points, 256 rows in 2 files" in text
        assert f"of {of}" in text


def test_points_are_drawn_as_a_slice(command: Command, tmp_path: Path) -> None:
    points = write_points(tmp_path / "points" / "chair")
    command("inspect", points, "--picture", tmp_path / "slice.png")
    assert (tmp_path / "slice.png").read_bytes().startswith(b"\x89PNG")
    assert "ends in .png" in command.complaint("inspect", points, "--picture", tmp_path / "slice.gif")
    command("inspect", points / "shape-0001.parquet", "--picture", tmp_path / "shard.png")
    assert (tmp_path / "shard.png").is_file()


def test_shapes_are_described_column_by_column_with_their_meanings(command: Command, tmp_path: Path) -> None:
    shapes = [toy.stool("stool_1"), toy.stool("stool_2", split="val", legs=3)]
    text = command("inspect", toy.write_shapes_artefact(tmp_path / "shapes", shapes))
    assert "shapes, 2 rows" in text
    assert "parts, 9 rows" in text
    assert "4 to 5" in text
    assert "raw → canonical: scale, rotation by rows, translation" in text
    assert "stool_1" in text


def test_a_run_is_described_with_its_files(command: Command, trained: Path) -> None:
    text = command("inspect", trained)
    assert "run, format 1" in text
    assert "weights.safetensors" in text
    assert "latents, 2 rows" in text


def test_a_mesh_is_described_with_its_counts_and_whether_it_is_closed(command: Command, tmp_path: Path) -> None:
    mesh = toy.box([0, 0, 1], [1, 2, 3])
    write_ply(tmp_path / "a.ply", mesh)
    text = command("inspect", tmp_path / "a.ply")
    assert "yes: no hole" in text
    assert "-0.5 to 2.5" in text
    assert text.split("volume")[1].split()[0] == "6"
    write_ply(tmp_path / "b.ply", Mesh(mesh.vertices, mesh.faces[1:]))
    assert "closed    no" in command("inspect", tmp_path / "b.ply")


def test_what_can_not_be_inspected_is_refused_with_what_was_wanted(command: Command, tmp_path: Path) -> None:
    assert "no such file or folder" in command.complaint("inspect", tmp_path / "nowhere")
    assert "manifest.json" in command.complaint("inspect", tmp_path)
    (tmp_path / "a.txt").write_text("x", encoding="utf-8")
    assert "wanted an artefact's folder" in command.complaint("inspect", tmp_path / "a.txt")
    (tmp_path / "a.parquet").write_text("x", encoding="utf-8")
    assert "not a readable Parquet file" in command.complaint("inspect", tmp_path / "a.parquet")
    (tmp_path / "a.ply").write_text("ply\n", encoding="utf-8")
    assert "a.ply" in command.complaint("inspect", tmp_path / "a.ply")
    write_points(tmp_path / "points" / "chair")
    assert "holds the artefacts chair" in command.complaint("inspect", tmp_path / "points")


UPRIGHT = [1, 0, 0, 0, 1, 0, 0, 0, 1]
MIRRORED = [[0, -0.25, 0, *UPRIGHT, 0.5, 0.5, 0.5], [0, 0.25, 0, *UPRIGHT, 0.5, 0.5, 0.5]]


def test_programs_are_executed_in_the_order_of_the_paths_and_folders_sorted(command: Command, tmp_path: Path) -> None:
    for name in ("b/2", "b/1", "b/c/3"):
        write_program(tmp_path / f"{name}.txt")
    first = write_program(tmp_path / "z.prog")
    lines = list(map(json.loads, command("execute", first, tmp_path / "b").splitlines()))
    assert [line["id"] for line in lines] == ["z", "1", "2", "3"]
    assert all(line == {"id": line["id"], "cuboids": MIRRORED} for line in lines)


def test_a_program_that_fails_has_its_line_and_the_others_go_on(
    command: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_program(tmp_path / "1.txt")
    write_program(tmp_path / "2.txt", height=-1)
    write_program(tmp_path / "3.txt")
    for name in ("execute", "signature"):
        complaint = command.complaint(name, tmp_path)
        assert "1 of 3 programs failed" in complaint
        lines = list(map(json.loads, capsys.readouterr().out.splitlines()))
        assert [line["id"] for line in lines] == ["1", "2", "3"]
        assert "2.txt, line 3: seat = Cuboid(0.5, -1, 0.5, True): " in lines[1]["error"]
        assert lines[1].keys() == {"id", "error"}
        assert "error" not in lines[0]


def test_lists_of_ids_among_programs_are_left_out(command: Command, tmp_path: Path) -> None:
    write_program(tmp_path / "chair" / "172.txt")
    (tmp_path / "chair_train.txt").write_text("172\n38955\n", encoding="utf-8")
    (tmp_path / "chair" / "val.txt").write_text("172", encoding="utf-8")
    assert len(command("execute", tmp_path).splitlines()) == 1
    (tmp_path / "chair" / "cut.txt").write_text("", encoding="utf-8")
    assert "at least one block" in command.complaint("execute", tmp_path)


def test_execute_and_signature_refuse_paths_without_programs(command: Command, tmp_path: Path) -> None:
    for name in ("execute", "signature"):
        assert "wanted files or folders" in command.complaint(name)
        assert "no such file or folder" in command.complaint(name, tmp_path / "nowhere")
        assert "no programs in it" in command.complaint(name, tmp_path)
        assert '"rough"' in command.complaint("signature", tmp_path, "--kind", "rough")


def test_executed_cuboids_are_written_to_a_file_whole(
    command: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    programs, out = tmp_path / "programs", tmp_path / "out.jsonl"
    write_program(programs / "1.txt")
    printed = command("execute", programs)
    assert "1 of 1 programs" in command("execute", programs, "--out", out)
    assert out.read_text(encoding="utf-8") == printed
    write_program(programs / "2.txt", height=0)
    assert "1 of 2 programs failed" in command.complaint("execute", programs, "--out", out)
    assert "error" in json.loads(out.read_text(encoding="utf-8").splitlines()[1])
    assert "make it first" in command.complaint("execute", programs, "--out", tmp_path / "no" / "a.jsonl")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.jsonl", "programs"]


def test_the_mesh_of_a_program_has_a_closed_object_for_each_cuboid(command: Command, tmp_path: Path) -> None:
    program, out = write_program(tmp_path / "stool.txt"), tmp_path / "stool.obj"
    command("execute", program, "--mesh", out)
    groups = read_obj_groups(out)
    assert [name for name, _ in groups] == ["stool/seat", "stool/cube1"]
    for (_, mesh), vector in zip(groups, MIRRORED):
        assert is_closed(mesh)
        assert signed_volume(mesh) == pytest.approx(0.125)
        np.testing.assert_allclose(mesh.vertices.mean(axis=0), vector[:3], atol=1e-12)
    write_program(tmp_path / "more" / "a.txt")
    assert "wanted one program" in command.complaint("execute", program, tmp_path / "more", "--mesh", out)
    assert "ends in .obj" in command.complaint("execute", program, "--mesh", tmp_path / "stool.ply")


def test_signatures_say_which_programs_are_equal_and_the_summary_counts_them(command: Command, tmp_path: Path) -> None:
    for i, name in enumerate(("seat", "seat", "board")):
        write_program(tmp_path / f"{i}.txt", name, height=0.1 * (i + 1))
    for kind, classes in (("exact", 2), ("canonical", 1)):
        lines = list(map(json.loads, command("signature", tmp_path, "--kind", kind).splitlines()))
        assert [line["id"] for line in lines] == ["0", "1", "2"]
        assert len({line["signature"] for line in lines}) == classes
    summary = command("signature", tmp_path, "--kind", "exact", "--summary").split("\n")
    assert [line.split()[-1] for line in summary[:3]] == ["3", "2", "2"]
    assert summary[3].endswith("2 (66.7%)")


def test_a_defect_is_no_line_but_an_exception(monkeypatch: pytest.MonkeyPatch) -> None:
    def defect(*arguments: object, **options: object) -> None:
        raise ValueError("an index nobody thought of")

    monkeypatch.setattr(cli, "app", defect)
    with pytest.raises(ValueError, match="nobody thought of"):
        cli.run()


def test_a_reader_that_stops_early_gets_no_traceback(tmp_path: Path) -> None:
    for i in range(300):
        write_program(tmp_path / f"{i}.txt")
    code = "from cagesdf.cli import run; run()"
    with subprocess.Popen(
        [sys.executable, "-c", code, "execute", tmp_path], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert json.loads(process.stdout.readline())["id"] == "0"
        process.stdout.close()
        assert process.stderr.read() == b""
