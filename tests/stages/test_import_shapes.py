"""The stage: what it writes and prints, what it refuses, and that workers change nothing."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cagesdf.cli.shapes import parts as write_parts
from cagesdf.errors import InputError
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.io.rejected import read_rejected
from cagesdf.io.shapes import read_shapes
from pipeline import ImportParams, artefact
from stages.import_shapes import main
from tests.support import toy

PARAMS = ImportParams(
    format=1,
    include="*",
    up="y",
    parts="given",
    weld=1e-5,
    max_faces=100_000,
    max_parts=150,
    min_thickness=1e-4,
    max_rejected=0.5,
)


def write_stools(folder: Path, count: int) -> None:
    """Each a little different; every second one has a seat that lacks a face."""
    for i in range(count):
        seat = toy.box([0, 1, 0], [1, 0.1 + 0.01 * i, 1])
        toy.write_obj(folder / f"stool_{i}" / "seat.obj", Mesh(seat.vertices, seat.faces[i % 2 :]))
        toy.write_obj(folder / f"stool_{i}" / "leg.obj", toy.rod([0.1, 0, 0], [0, 1, 0], 0.1))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_one_and_two_workers_write_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_stools(tmp_path / "raw", 5)
    sheet = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1]]), np.array([[0, 1, 2]], dtype=np.int32))
    toy.write_obj(tmp_path / "raw" / "stool_0" / "back.obj", sheet)
    for count in ("1", "2"):
        monkeypatch.setenv("CAGESDF_WORKERS", count)
        main(tmp_path / "raw", tmp_path / count, PARAMS)
    assert contents(tmp_path / "1") == contents(tmp_path / "2")


def test_shapes_and_rejections_are_written_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_stools(tmp_path / "raw", 4)
    (tmp_path / "raw" / "val.txt").write_text("stool_3\n")
    (tmp_path / "raw" / "stool_1" / "leg.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n")
    main(tmp_path / "raw", tmp_path / "out", PARAMS)
    assert artefact.read_manifest(tmp_path / "out")["kind"] == "shapes"
    shapes = read_shapes(tmp_path / "out")
    assert shapes.ids == ("stool_0", "stool_2", "stool_3")
    assert shapes.ids_of("val") == ("stool_3",)
    assert [shape.status for shape in shapes] == ["passed", "passed", "repaired"]
    rejected = read_rejected(tmp_path / "out")
    assert list(rejected) == ["stool_1"]
    assert "leg.obj, line 4" in rejected["stool_1"]
    told = capsys.readouterr().out
    assert "4 shapes: 2 passed, 1 repaired, 1 rejected" in told
    assert "rejected stool_1: " in told


def many_parts(folder: Path) -> None:
    for i in range(200):
        toy.write_obj(folder / f"{i}.obj", toy.box([i, 0, 0], [0.5, 1, 1]))


def nan_part(folder: Path) -> None:
    toy.write_obj(folder / "seat.obj", toy.box([0, 0, 0], [1, 1, 1]))
    (folder / "leg.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")


def empty_part(folder: Path) -> None:
    toy.write_obj(folder / "seat.obj", toy.box([0, 0, 0], [1, 1, 1]))
    (folder / "leg.obj").write_text("")


@pytest.mark.parametrize(
    ("write", "reason"),
    [
        (many_parts, "200 parts"),
        (nan_part, "leg.obj, line 4: corner 1 of the face is at (nan, 0, 0)"),
        (empty_part, "part leg has no faces"),
        (lambda folder: (folder / "objs").mkdir(parents=True), "lacks result_after_merging.json"),
    ],
    ids=["200 parts", "NaN", "empty part", "no tree"],
)
def test_a_bad_shape_is_a_row_of_the_rejected(tmp_path: Path, write, reason: str) -> None:
    write_stools(tmp_path / "raw", 1)
    write(tmp_path / "raw" / "bad")
    main(tmp_path / "raw", tmp_path / "out", PARAMS)
    assert read_shapes(tmp_path / "out").ids == ("stool_0",)
    assert reason in read_rejected(tmp_path / "out")["bad"]


def test_too_many_rejections_stop_the_stage_and_leave_nothing(tmp_path: Path) -> None:
    write_stools(tmp_path / "raw", 1)
    for name in ("bad1", "bad2"):
        (tmp_path / "raw" / name / "objs").mkdir(parents=True)
    with pytest.raises(InputError) as caught:
        main(tmp_path / "raw", tmp_path / "out", PARAMS)
    first, *reasons = str(caught.value).splitlines()
    assert first.startswith("2 of 3 shapes rejected, at most 1 wanted (import_shapes.max_rejected: 0.5): bad1, bad2; ")
    assert "repair or remove them" in first
    assert [reason.split(":")[0] for reason in reasons] == ["  bad1", "  bad2"]
    assert "lacks result_after_merging.json" in reasons[0]
    assert {path.name for path in tmp_path.iterdir()} == {"raw"}


def test_a_missing_folder_and_an_artefact_instead_of_raw_shapes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        main(tmp_path / "none", tmp_path / "out", PARAMS)
    toy.write_shapes_artefact(tmp_path / "shapes", [toy.stool("a")])
    with pytest.raises(InputError, match="no folder"):
        main(tmp_path / "shapes", tmp_path / "out", PARAMS)
    assert {path.name for path in tmp_path.iterdir()} == {"shapes"}


def test_a_clean_shape_needs_no_pymeshlab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    monkeypatch.setitem(__import__("sys").modules, "pymeshlab", None)
    write_stools(tmp_path / "raw", 2)
    main(tmp_path / "raw", tmp_path / "out", PARAMS)
    assert len(read_shapes(tmp_path / "out")) == 2


BROKEN = {
    "index beyond.ply": b"ply\nformat ascii 1.0\nelement vertex 3\nproperty int x\nproperty int y\nproperty int z\n"
    b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n",
    "crossing.obj": b"v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 4\n",
    "cut.stl": b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0",
    "far.obj": b"v 1e300 0 0\nv 0 1e300 0\nv 0 0 1\nf 1 2 3\n",
    "dust.obj": b"v 1e-300 0 0\nv 0 1e-300 0\nv 0 0 0\nf 1 2 3\n",
    "zeros.obj": b"v 0 0 0\0\0\0",
    "empty.ply": b"",
}


def test_a_bad_file_of_any_kind_costs_its_own_shape_and_no_other(tmp_path: Path) -> None:
    write_stools(tmp_path / "raw", 10)
    for i, (name, content) in enumerate(BROKEN.items()):
        folder = tmp_path / "raw" / f"stool_{i}5"
        folder.mkdir()
        (folder / name).write_bytes(content)
    main(tmp_path / "raw", tmp_path / "out", PARAMS)
    assert read_shapes(tmp_path / "out").ids == tuple(f"stool_{i}" for i in range(10))
    rejected = read_rejected(tmp_path / "out")
    assert len(rejected) == len(BROKEN)
    assert "index beyond.ply, face 0" in rejected["stool_05"]


@pytest.mark.parametrize("choice", ["given", "found", "auto"])
def test_parts_that_a_user_wrote_come_before_those_that_are_found(tmp_path: Path, choice: str) -> None:
    """Two boxes are two parts to be found; written down, they are one."""
    boxes = [toy.box([0, 1, 0], [1, 0.1, 1]), toy.rod([0.1, 0, 0], [0, 0.8, 0], 0.1)]
    for name in ("edited", "left"):
        toy.write_obj(tmp_path / "raw" / f"{name}.obj", join(boxes))
    written = parts_of_the_file(tmp_path / "raw" / "edited.obj", tmp_path / "out")
    pieces = [piece for part in written["parts"] for piece in part["pieces"]]
    content = written | {"parts": [{"name": "all", "label": "stool", "pieces": pieces}]}
    (tmp_path / "raw" / "edited.parts.json").write_text(json.dumps(content))
    main(tmp_path / "raw", tmp_path / "shapes", PARAMS.model_copy(update={"parts": choice}))
    edited, left = read_shapes(tmp_path / "shapes")
    assert (edited.origin.parts, [(p.part_id, p.label) for p in edited.parts]) == ("written", [("all", "stool")])
    expected = ("given", 1) if choice == "given" else ("found", 2)
    assert (left.origin.parts, len(left.parts)) == expected
    assert read_rejected(tmp_path / "shapes") == {}


def test_parts_that_were_written_for_another_mesh_cost_their_shape_with_the_reason(tmp_path: Path) -> None:
    toy.write_obj(tmp_path / "raw" / "stool.obj", toy.box([0, 1, 0], [1, 0.1, 1]))
    toy.write_obj(tmp_path / "raw" / "sound.obj", toy.box([0, 1, 0], [1, 0.1, 1]))
    written = parts_of_the_file(tmp_path / "raw" / "stool.obj", tmp_path / "out")
    (tmp_path / "raw" / "stool.parts.json").write_text(json.dumps(written | {"components": 3}))
    main(tmp_path / "raw", tmp_path / "shapes", PARAMS.model_copy(update={"parts": "found"}))
    assert read_shapes(tmp_path / "shapes").ids == ("sound",)
    assert "written for 3 components, the shape has 1" in read_rejected(tmp_path / "shapes")["stool"]


def parts_of_the_file(mesh: Path, out: Path) -> dict[str, Any]:
    """The content of the file that `cagesdf parts` writes for a mesh."""
    write_parts(mesh, out, as_json=True)
    content: dict[str, Any] = json.loads((out / f"{mesh.stem}.parts.json").read_text())
    return content
