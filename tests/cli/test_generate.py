"""`cagesdf generate` as a user meets it."""

import json
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from cagesdf import rendering
from cagesdf.cli import generating
from cagesdf.geometry.meshes import Mesh, is_closed
from cagesdf.geometry.solid import CUBE_FACES, cage_surface
from cagesdf.io.meshes import read_ply
from cagesdf.io.runs import read_run
from cagesdf.run import Run
from cagesdf.shape_generation.cages import ROUNDS
from cagesdf.shape_generation.generated import GeneratedShape
from cagesdf.shape_generation.surfaces import Order
from cagesdf.structure.executor import execute
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.structure.parsing import read_program
from tests.support import constant_runs, stools
from tests.support.commands import Command
from tests.support.instant import Instant


@pytest.fixture(autouse=True)
def without_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    """Matplotlib draws in this process: VTK would start one a picture."""
    monkeypatch.setattr(rendering, "WINDOWS", ())


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """As the pipeline leaves it: data/runs/stool/full and data/programs/stool."""
    stools.write_programs(tmp_path / "data" / "programs" / "stool")
    return stools.write_arm(tmp_path / "data" / "runs" / "stool" / "full", -0.05)


def read_shape(run: Path) -> GeneratedShape:
    """One of a run's shapes, as the stage makes it."""
    trained = read_run(run)
    cage = trained.sequences["stool_0"].cages[0]
    mesh = cage_surface(cage)
    return GeneratedShape(
        "", "", 0, 0, trained.structures["stool_0"], cage, 0, np.zeros(2, np.float32), {}, 1.0, "ok", mesh, 1, 0.0, 1,
        rooted=True, stable=True, points=mesh.vertices.astype(np.float32),
        parts=dict(zip(cage.part_ids, (Mesh(corners, CUBE_FACES) for corners in cage.corners()))),
    )  # fmt: skip


def lines(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "index.jsonl").read_text(encoding="utf-8").splitlines()]


def test_shapes_their_structures_an_index_and_a_picture_are_written(
    command: Command, run: Path, tmp_path: Path
) -> None:
    out = tmp_path / "new"
    told = json.loads(command("generate", run, "--count", 3, "--out", out, "--resolution", 32, "--ending", "ply"))
    assert (told["shapes"], told["ok"], told["method"], told["asked"]) == (3, 3, "dependent", 3)
    assert told["tau"] > 0
    entries = lines(out)
    assert sorted(path.name for path in out.iterdir()) == sorted(
        ["index.jsonl", "sheet.png", *(f"{entry['id']}.{ending}" for entry in entries for ending in ("ply", "json"))]
    )
    for entry in entries:
        mesh = read_ply(out / entry["mesh"])
        assert is_closed(mesh)
        assert (entry["status"], entry["closed"], entry["components"]) == ("ok", True, 1)
        structure = PartHierarchy.from_json((out / entry["structure"]).read_text(encoding="utf-8"))
        boxes = np.array([[*structure.cuboids()[part].centre] for part in entry["part_ids"]])
        np.testing.assert_allclose(boxes, np.array(entry["cuboids"])[:, :3])
        assert len(entry["latent"]) == 2
        assert entry["health"].startswith("closed, 1 component, thinnest ")
    assert told["warned"] == sum(bool(entry["warnings"]) for entry in entries)
    assert Image.open(out / "sheet.png").size[0] > 0


def test_a_seed_gives_the_same_shapes_again_and_another_one_others(command: Command, run: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        command("generate", run, "--count", 2, "--out", tmp_path / name, "--resolution", 16, "--seed", seed)
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name
    assert lines(tmp_path / "a")[0]["cuboids"] != lines(tmp_path / "c")[0]["cuboids"]


def test_a_temperature_of_0_gives_the_mean_cuboids_and_styles_of_training_shapes(
    command: Command, run: Path, tmp_path: Path
) -> None:
    command("generate", run, "--count", 3, "--out", tmp_path / "new", "--resolution", 8, "--temperature", 0)
    entries = lines(tmp_path / "new")
    assert len({tuple(map(tuple, entry["cuboids"])) for entry in entries}) == 1
    known = {tuple(code) for code in read_run(run).latents.values.tolist()}
    assert {tuple(entry["latent"]) for entry in entries} <= known


def test_a_given_program_needs_no_generator_and_all_shapes_have_its_cuboids(command: Command, tmp_path: Path) -> None:
    run = stools.write_arm(tmp_path / "run", -0.05)
    program = constant_runs.write_program(tmp_path / "stool.txt")
    out = tmp_path / "new"
    command(
        "generate", run, "--count", 2, "--out", out, "--resolution", 32, "--program", program, "--latent", "independent"
    )
    for entry in lines(out):
        assert entry["method"] == "independent"
        sizes = np.array(entry["cuboids"])[:, 12:]
        np.testing.assert_allclose(sizes / sizes.max(), execute(read_program(out / entry["structure"])).size / 0.5)
        scene = trimesh.load_scene(out / entry["mesh"])
        names = entry["part_names"]
        assert len({*names}) == len(names) == len(entry["part_ids"])
        assert {*names} != {*entry["part_ids"]}, "the program's own names"
        assert {f"parts/{name}" for name in names} <= scene.geometry.keys()


def test_an_arm_without_cuboids_makes_whole_shapes_and_takes_no_options_about_them(
    command: Command, tmp_path: Path
) -> None:
    run = stools.write_arm(tmp_path / "run", 0.05, trains_on="cube")
    told = json.loads(command("generate", run, "--count", 2, "--out", tmp_path / "new", "--resolution", 16))
    assert (told["method"], told["shapes"], told["empty"]) == ("isotropic", 2, 2)
    assert "rooted" not in told, "that is said of cuboids"
    assert [entry["mesh"] for entry in lines(tmp_path / "new")] == [None, None]
    complaint = command.complaint("generate", run, "--out", tmp_path / "x", "--latent", "dependent")
    assert "without cuboids" in complaint


def test_nothing_is_written_where_something_is_wrong(command: Command, run: Path, tmp_path: Path) -> None:
    out = tmp_path / "new"
    assert "wanted 1 to" in command.complaint("generate", run, "--out", out, "--count", 0)
    assert "seed -1" in command.complaint("generate", run, "--out", out, "--seed", -1)
    assert "temperature -1" in command.complaint("generate", run, "--out", out, "--temperature", -1)
    assert "wanted 8 to 1,024 cells" in command.complaint("generate", run, "--out", out, "--resolution", 4)
    assert "is there already" in command.complaint("generate", run, "--out", tmp_path)
    assert "make it first" in command.complaint("generate", run, "--out", tmp_path / "no" / "new")
    assert "wanted one of them" in command.complaint(
        "generate", run, "--out", out, "--program", tmp_path / "p.txt", "--programs", tmp_path
    )
    assert "p.txt" in command.complaint("generate", run, "--out", out, "--program", tmp_path / "p.txt")
    assert "train_programs" in command.complaint("generate", run, "--out", out, "--programs", tmp_path)
    alone = stools.write_arm(tmp_path / "alone" / "run", -0.05)
    assert "are looked for in" in command.complaint("generate", alone, "--out", out)
    (run.parent.parent.parent / "programs" / "stool" / "generator.json").write_text("{", encoding="utf-8")
    assert "is damaged" in command.complaint("generate", run, "--out", out)
    assert not list(tmp_path.glob("*new*"))
    assert not list(tmp_path.glob(".partial*"))


def test_meshes_are_let_go_as_they_are_written(
    command: Command, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counted, not timed: shapes are made at once, and those alive are counted as each is written."""
    alive: weakref.WeakSet[GeneratedShape] = weakref.WeakSet()
    most, model = [0], read_shape(run)

    def make(_: Run, how: object, rng: object, order: Order) -> GeneratedShape:
        shape = replace(model, method=order.method, shape_id=order.shape_id)
        alive.add(shape)
        return shape

    def counted(path: Path, _: object) -> None:
        most[0] = max(most[0], len(alive))
        path.touch()

    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    monkeypatch.setattr("cagesdf.shape_generation.surfaces.make_shape", make)
    monkeypatch.setattr("cagesdf.io.exports.write_export", counted)
    monkeypatch.setattr(generating, "ThreadPoolExecutor", lambda workers: Instant())
    monkeypatch.setattr(generating, "_sheet", lambda path, shapes: path.touch())
    monkeypatch.setattr(generating, "SHOWN", 3)
    told = json.loads(command("generate", run, "--count", 30, "--out", tmp_path / "new", "--resolution", 8))
    assert told["shapes"] == 30
    assert len(lines(tmp_path / "new")) == 30
    assert most[0] <= 3 + generating.AHEAD * 2 + 2, "the sheet's, those made ahead, the last and this one"


def test_where_no_draw_is_valid_the_reasons_are_told_and_nothing_is_written(
    command: Command, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cagesdf.cage_generation.proportions.THINNEST", 100.0)
    complaint = command.complaint("generate", run, "--count", 2, "--out", tmp_path / "new")
    assert f"no draw gave a valid shape ({2 * ROUNDS} times: cuboid shrunk to nothing)" in complaint
    assert not list(tmp_path.glob("*new*"))
    assert not list(tmp_path.glob(".partial*"))
