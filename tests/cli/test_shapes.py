"""`cagesdf check`, `cagesdf parts` and `cagesdf sdf` as a user meets them."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from cagesdf.api import sources
from cagesdf.cli import shapes
from cagesdf.errors import InputError
from cagesdf.formats.listing import ShapeSource, find_shape, find_shapes, read_shape
from cagesdf.geometry.meshes import Mesh, join, signed_volume
from cagesdf.importing import import_shape
from cagesdf.shape import RawShape
from tests.support import toy
from tests.support.commands import Command

SHARED = Path(__file__).parents[3] / "shared/data"
BOX = toy.box([0, 0, 0], [2, 2, 2])


def write_ply(path: Path, mesh: Mesh) -> None:
    import trimesh

    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)


def write_shapes(folder: Path) -> None:
    """Three shapes: sound, with a hole, without faces."""
    toy.write_obj(folder / "sound" / "seat.obj", BOX)
    toy.write_obj(folder / "holed" / "seat.obj", Mesh(BOX.vertices, BOX.faces[1:]))
    toy.write_obj(folder / "holed" / "leg.obj", toy.rod([0, -2, 0], [0, 0, 0], 0.3))
    (folder / "bad").mkdir()
    (folder / "bad" / "seat.obj").write_text("v 0 0 0\nf 1 2 3\n")


def test_they_import_as_the_pipeline_does_with_own_data() -> None:
    root = Path(__file__).parents[2]
    base, own = (
        yaml.safe_load((root / name).read_text(encoding="utf-8")) for name in ("params.yaml", "profiles/own.yaml")
    )
    params = base["import_shapes"] | own["import_shapes"]
    assert {name: params[name] for name in sources.IMPORT} == sources.IMPORT


SINGLE = "parts found, 1: the file has a single group"


def test_check_has_a_line_for_every_shape_a_sentence_and_complains_of_the_rejected(
    command: Command, tmp_path: Path
) -> None:
    write_shapes(tmp_path)
    command.on_terminal()
    assert command.complaint("check", tmp_path) == "cagesdf: 1 of 3 shapes rejected"
    lines = command.capsys.readouterr().out.splitlines()
    assert lines[0].startswith("bad: rejected: ")
    assert "seat.obj, line 2" in lines[0]
    assert lines[1:] == [
        "holed: repaired 1 capped of 2 parts",
        f"sound: passed; {SINGLE}",
        "3 shapes: 2 can be used, 1 rejected",
    ]


@pytest.mark.parametrize("terminal", [False, True])
def test_check_gives_programs_one_object(command: Command, tmp_path: Path, terminal: bool) -> None:
    write_shapes(tmp_path)
    if terminal:
        command.on_terminal()
    assert command.complaint("check", tmp_path, *["--json"] * terminal) == "cagesdf: 1 of 3 shapes rejected"
    result = json.loads(command.capsys.readouterr().out)
    assert (result["usable"], result["rejected"], result["notes"]) == (2, 1, [])
    assert [(shape["id"], shape["usable"]) for shape in result["shapes"]] == [
        ("bad", False), ("holed", True), ("sound", True)
    ]  # fmt: skip
    assert result["shapes"][1]["verdict"] == "repaired 1 capped of 2 parts"


def checked(command: Command, *words: object) -> list[str]:
    """Lines for people, without the sentence at the end."""
    command.on_terminal()
    *lines, sentence = command("check", *words).splitlines()
    assert sentence.endswith("can be used, 0 rejected")
    return lines


def test_check_takes_files_and_the_shapes_of_a_folder_that_fit(command: Command, tmp_path: Path) -> None:
    write_shapes(tmp_path / "all")
    write_ply(tmp_path / "one.ply", BOX)
    out = checked(command, tmp_path / "one.ply", tmp_path / "all" / "sound" / "seat.obj")
    assert out == [f"one: passed; {SINGLE}", f"seat: passed; {SINGLE}"]
    assert checked(command, tmp_path / "all", "--include", "[hs]o*") == [
        "holed: repaired 1 capped of 2 parts",
        f"sound: passed; {SINGLE}",
    ]


def test_check_says_what_is_no_shape_and_takes_each_lone_mesh_for_one(command: Command, tmp_path: Path) -> None:
    for name in ("a.ply", "b.stl", "c.off"):
        write_ply(tmp_path / name, BOX)
    lines = checked(command, tmp_path)
    assert lines[0].startswith("not read: c.off; ")
    assert lines[1].startswith("each mesh file is a shape; ")
    assert lines[2:] == [f"a: passed; {SINGLE}", f"b: repaired 1 merged of 1 parts; {SINGLE}"]


def test_parts_writes_a_file_that_an_import_prefers_and_a_picture(command: Command, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    write_ply(tmp_path / "in" / "chair.ply", join([BOX, toy.rod([0, -2, 0], [0, 0, 0], 0.3, 1.0)]))
    told = json.loads(command("parts", tmp_path / "in" / "chair.ply", tmp_path / "out"))
    assert (told["components"], told["parts"]) == (2, 2)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["chair.glb", "chair.parts.json"]
    (tmp_path / "out" / "chair.parts.json").rename(tmp_path / "in" / "chair.parts.json")
    assert checked(command, tmp_path / "in") == ["chair: passed; parts written, 2: a file beside the mesh has them"]
    assert "is there already" in command.complaint("parts", tmp_path / "in" / "chair.ply", tmp_path / "out")


def test_parts_are_changed_by_hand_before_they_are_written(command: Command, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    mesh = tmp_path / "in" / "chair.ply"
    write_ply(mesh, join([BOX, toy.rod([0, -2, 0], [0, 0, 0], 0.3, 1.0)]))
    changes = ["--change", "split part_1 y 0.5", "--change", "merge part_1 part_2", "--change", "rename part_1_2 top"]
    assert json.loads(command("parts", mesh, tmp_path / "out", *changes))["parts"] == 2
    (tmp_path / "out" / "chair.parts.json").rename(tmp_path / "in" / "chair.parts.json")
    [source] = find_shapes(tmp_path / "in", "*")
    shape = import_shape(read_shape(source), **sources.IMPORT)
    assert [part.part_id for part in shape.parts] == ["part_1", "top"]
    volume = signed_volume(shape.parts[1].mesh) / shape.similarity.scale**3
    assert volume == pytest.approx(4 * 0.5, rel=1e-5), "the box above 0.5"
    complaint = command.complaint("parts", mesh, tmp_path / "other", "--change", "split part_9 y 0")
    assert "change 'split part_9 y 0': there is no part 'part_9'; the shape has part_1, part_2" in complaint
    assert not (tmp_path / "other").exists()


def test_check_says_each_shape_as_it_is_done(
    command: Command,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    write_shapes(tmp_path)
    said: list[str] = []
    seen: list[int] = []
    command.on_terminal()
    monkeypatch.setattr("builtins.print", lambda text, end="\n", flush=False: said.append(text) if text else None)
    read = sources.read_shape

    def seeing(source: ShapeSource) -> RawShape:
        seen.append(len(said))
        return read(source)

    monkeypatch.setattr(sources, "read_shape", seeing)
    command.complaint("check", tmp_path)
    assert seen == [0, 1, 2]


@pytest.mark.parametrize("text", [[], ["nothing/here"]])
def test_check_wants_something_that_is_there(command: Command, text: list[str]) -> None:
    assert "wanted" in command.complaint("check", *text)


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the real furniture")
def test_all_real_furniture_is_accounted_for(command: Command) -> None:
    shapes = json.loads(command("check", SHARED / "ikea"))["shapes"]
    assert [shape["id"] for shape in shapes] == sorted(path.name for path in (SHARED / "ikea").iterdir())
    assert sum(shape["usable"] for shape in shapes) >= 34


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the real furniture")
def test_a_partnet_shape_is_one_shape(command: Command) -> None:
    assert checked(command, SHARED / "partnet/3763") == ["3763: repaired 3 capped of 3 parts"]


def test_points_that_are_too_coarse_for_their_place_are_refused(command: Command, tmp_path: Path) -> None:
    place = np.array([500000.25, 5300000.75, 412.0])
    toy.write_obj(tmp_path / "seat.obj", BOX.with_vertices(BOX.vertices + place))
    words = "sdf", tmp_path / "seat.obj", tmp_path / "points.npy", tmp_path / "out.npy"
    np.save(tmp_path / "points.npy", np.array([[0, 0, 0], [0, 1.5, 0]]) + place)
    command(*words)
    np.testing.assert_allclose(np.load(tmp_path / "out.npy"), [-1, 0.5], atol=1e-6)
    np.save(tmp_path / "points.npy", (np.zeros((1, 3)) + place).astype(np.float32))
    assert "got float32, which is 0.5 apart where the shape is" in command.complaint(*words)


@pytest.mark.parametrize(("unit", "kind"), [(1.0, "<f8"), (1e-3, "<f4"), (1e4, ">f8"), (1.0, "<f2")])
def test_distances_are_in_the_files_own_frame_and_unit(
    command: Command,
    tmp_path: Path,
    unit: float,
    kind: str,
) -> None:
    """A box and a second that reaches into it: what is buried doesn't count."""
    place = np.array([3.0, -5, 7]) * unit
    for name, mesh in {"a": BOX, "b": toy.box([1, 0, 0], [2, 1, 1])}.items():
        toy.write_obj(tmp_path / "shape" / f"{name}.obj", mesh.with_vertices(mesh.vertices * unit + place))
    points = (np.array([[0, 0, 0], [0, 1.5, 0], [0.75, 0, 0], [3, 0, 0], [0, 0, -11]]) * unit + place).astype(kind)
    np.save(tmp_path / "points.npy", points)
    report = json.loads(command("sdf", tmp_path / "shape", tmp_path / "points.npy", tmp_path / "out.npy"))
    found = np.load(tmp_path / "out.npy")
    assert found.dtype == np.float32
    if kind != "<f2":  # too coarse for the closed form
        np.testing.assert_allclose(found / unit, [-1, 0.5, -np.hypot(0.25, 0.5), 1, 10], atol=2e-6)
    assert (report["shape"], report["status"], report["points"], report["points_inside"]) == ("shape", "passed", 5, 2)
    assert [part["part"] for part in report["parts"]] == ["a", "b"]
    assert [part["volume"] / unit**3 for part in report["parts"]] == pytest.approx([8, 2])
    assert not list(tmp_path.glob(".*")), "nothing is left beside"


def test_the_report_tells_the_repair(command: Command, tmp_path: Path) -> None:
    toy.write_obj(tmp_path / "seat.obj", Mesh(BOX.vertices, BOX.faces[1:]))
    np.save(tmp_path / "points.npy", np.zeros((0, 3)))
    report = json.loads(command("sdf", tmp_path / "seat.obj", tmp_path / "points.npy", tmp_path / "out.npy"))
    (part,) = report["parts"]
    assert (part["method"], part["faces_before"], part["faces_after"], part["inside"]) == ("capped", 11, 12, 1.0)
    assert report["audit"]["differ"] == 0
    assert np.load(tmp_path / "out.npy").shape == (0,)


def pickled() -> bytes:
    content = io.BytesIO()
    np.save(content, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    return content.getvalue()


def zipped() -> bytes:
    content = io.BytesIO()
    np.savez(content, points=np.zeros((1, 3)))
    return content.getvalue()


def saved(array: object) -> bytes:
    content = io.BytesIO()
    np.save(content, np.asarray(array))
    return content.getvalue()


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (pickled(), "can't be read"),
        (zipped(), "several arrays"),
        (b"0 0 0\n", "can't be read"),
        (b"", "can't be read"),
        (saved(np.zeros((9, 3)))[:-40], "can't be read"),
        (saved(np.zeros((4, 2))), r"float64 of shape \(4, 2\)"),
        (saved(np.zeros(3)), r"of shape \(3,\)"),
        (saved(np.zeros((4, 3), int)), "int64"),
        (saved(np.zeros((4, 3), complex)), "complex128"),
        (saved([[0.0, 0, 0], [0, np.nan, 0]]), "row 1 is"),
        (saved([[0.0, 0, np.inf]]), "row 0 is"),
    ],
)
def test_anything_but_points_is_refused_and_nothing_written(
    command: Command,
    tmp_path: Path,
    content: bytes,
    reason: str,
) -> None:
    toy.write_obj(tmp_path / "seat.obj", BOX)
    (tmp_path / "points.npy").write_bytes(content)
    text = command.complaint("sdf", tmp_path / "seat.obj", tmp_path / "points.npy", tmp_path / "out.npy")
    assert "points.npy: " in text
    assert "wanted" in text
    with pytest.raises(InputError, match=reason):
        shapes._read_points(tmp_path / "points.npy")
    assert {path.name for path in tmp_path.iterdir()} == {"seat.obj", "points.npy"}


def test_too_many_points_are_refused_before_they_are_read(tmp_path: Path) -> None:
    """The header promises more than MAX_POINTS; the file is sparse."""
    head = saved(np.zeros((0, 3))).replace(b"(0, 3), }        ", b"(30000000, 3), } ")
    with (tmp_path / "points.npy").open("wb") as stream:
        stream.write(head)
        stream.truncate(len(head) + 30_000_000 * 24)
    with pytest.raises(InputError, match=r"float64 of shape \(30000000, 3\); wanted .* at most 20,000,000"):
        shapes._read_points(tmp_path / "points.npy")


def test_sdf_refuses_other_places_shapes_and_names(command: Command, tmp_path: Path) -> None:
    write_shapes(tmp_path / "all")
    points, out = tmp_path / "points.npy", tmp_path / "out.npy"
    np.save(points, np.zeros((1, 3)))
    assert "no such file" in command.complaint("sdf", tmp_path / "none", points, out)
    assert "holds 3 shapes, such as bad; name one" in command.complaint("sdf", tmp_path / "all", points, out)
    assert "rejected: " in command.complaint("sdf", tmp_path / "all" / "bad", points, out)
    assert "ends in .npy" in command.complaint("sdf", tmp_path / "all" / "sound", points, tmp_path / "out.txt")
    assert "not that of the points" in command.complaint("sdf", tmp_path / "all" / "sound", points, points)
    assert "no folder" in command.complaint("sdf", tmp_path / "all" / "sound", points, tmp_path / "x" / "out.npy")
    assert "no such file" in command.complaint("sdf", tmp_path / "all" / "sound", tmp_path / "y.npy", out)
    assert not out.exists()


def test_a_folder_of_meshes_is_one_shape_where_one_is_wanted(tmp_path: Path) -> None:
    write_shapes(tmp_path / "all")
    source = find_shape(tmp_path / "all" / "holed")
    assert (source.shape_id, source.path) == ("holed", tmp_path / "all" / "holed")
    (tmp_path / "text.txt").write_text("no mesh")
    for path in ("text.txt", "none"):
        with pytest.raises(InputError, match="wanted one"):
            find_shape(tmp_path / path)
    with pytest.raises(InputError, match="holds 3 shapes, such as bad; name one"):
        find_shape(tmp_path / "all")
