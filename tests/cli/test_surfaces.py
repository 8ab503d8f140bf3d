"""`cagesdf extract`, `edit`, `swap` and `mix` as a user meets them, and what `inspect` tells for it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

from cagesdf.cuboid import Cuboid, Sequence
from cagesdf.editing.script import parse
from cagesdf.editing.session import Session
from cagesdf.formats.obj import read_obj_groups
from cagesdf.frames import UP_AXES, Similarity
from cagesdf.geometry.meshes import is_closed, signed_volume
from cagesdf.io.meshes import read_ply
from cagesdf.io.runs import read_run, write_run
from cagesdf.models.latents import LatentTable
from cagesdf.run import Run
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.hierarchy import PartHierarchy
from pipeline import artefact
from tests.support import constant_runs, programs
from tests.support.commands import Command
from tests.support.constant_runs import FIGURES, PARAMS, SIZE, write_parts_run, write_trained

LABELS = {"seat": "seat", "Base/Side/leg": "leg", "Base/cube1/leg": "leg"}


def write_chairs(folder: Path, trains_on: str = "cage") -> Path:
    """A run of two chairs with programs, of which the second is larger; its network says that all cuboids are full."""
    kind = {"cage": "CageDecoder", "cube": "DeepSdfDecoder"}[trains_on]
    decoder = constant_runs.constant(kind, -0.05)
    placements = {
        name: Similarity(scale, np.eye(3), np.zeros(3)) for name, scale in (("chair_1", 1.0), ("chair_2", 1.2))
    }
    structures = {name: Assembly(programs.CHAIR, place, LABELS) for name, place in placements.items()}
    run = Run(
        decoder,
        LatentTable(tuple((name, -1) for name in structures), torch.tensor([[0.0, 1.0], [2.0, 3.0]])),
        {
            name: Sequence(name, None, np.zeros(1), (False,), (structure.cage(),))
            for name, structure in structures.items()
        },
        structures,
        dict.fromkeys(structures, Similarity(0.5, UP_AXES["z"], np.array([0.1, 0.2, 0.3]))),
        {**FIGURES, "decoder": kind},
        {"sampled": 1, "used": 1},
    )
    with artefact.write("run", folder, inputs={}, params=PARAMS) as out:
        write_run(out, run, [{"step": 1.0, "loss": 0.5}])
    return folder


@pytest.fixture
def chairs(tmp_path: Path) -> Path:
    return write_chairs(tmp_path / "runs" / "chairs")


def write_script(folder: Path, *operations: dict[str, Any]) -> Path:
    path = folder / "script.json"
    path.write_text(json.dumps(operations), encoding="utf-8")
    return path


def test_a_surface_is_written_in_the_users_frame(command: Command, trained: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.ply"
    told = json.loads(command("extract", trained, "chair_0001", out, "--resolution", "64"))
    mesh = read_ply(out)
    assert is_closed(mesh)
    assert (told["vertices"], told["faces"]) == (len(mesh.vertices), len(mesh.faces))
    assert told["closed"]
    assert told["components"] == 1
    assert told["overshoot"] <= 1e-3
    assert told["evaluations"] > 0
    assert set(told["seconds"]) == {"read", "extract", "place", "write"}
    # canonical = 0.5 · R raw + (0.1, 0.2, 0.3), z up: raw x, y, z are canonical x, -z, y.
    raw = SIZE[[0, 2, 1]] / 0.5
    centre = np.array([-0.1, 0.3, -0.2]) / 0.5
    cell = 2.1 / 64 / 0.5
    np.testing.assert_allclose(mesh.vertices.max(0), centre + raw / 2, atol=cell / 10)
    np.testing.assert_allclose(mesh.vertices.min(0), centre - raw / 2, atol=cell / 10)


@pytest.mark.parametrize("ending", [".obj", ".stl", ".glb", ".PLY"])
def test_every_format_holds_the_same_closed_solid(ending: str, command: Command, trained: Path, tmp_path: Path) -> None:
    out = tmp_path / f"out{ending}"
    command("extract", trained, "chair_0001", out, "--resolution", "32")
    scene = trimesh.load_scene(out, split_objects=True, group_material=False)
    solid = scene.to_mesh()
    solid.merge_vertices()
    assert solid.is_watertight
    command("extract", trained, "chair_0001", tmp_path / "ours.ply", "--resolution", "32")
    assert solid.volume == pytest.approx(signed_volume(read_ply(tmp_path / "ours.ply")), rel=1e-5)


def test_a_step_of_the_sequence_can_be_asked_for(command: Command, trained: Path, tmp_path: Path) -> None:
    for step in (0, 1):
        command("extract", trained, "chair_0001", tmp_path / f"{step}.ply", "--resolution", "32", "--step", step)
    rest, moved = (np.ptp(read_ply(tmp_path / f"{step}.ply").vertices, axis=0) for step in (0, 1))
    np.testing.assert_allclose(moved / rest, 1.2, rtol=0.05)
    complaint = command.complaint("extract", trained, "chair_0001", tmp_path / "x.ply", "--step", 7)
    assert "has the steps 0, 1" in complaint


def test_nothing_is_written_where_something_is_wrong(command: Command, trained: Path, tmp_path: Path) -> None:
    wanted = tmp_path / "out"
    wanted.mkdir()
    out = wanted / "a.ply"
    assert "did you mean chair_0001" in command.complaint("extract", trained, "chair_001", out)
    assert "wanted 8 to 1,024 cells" in command.complaint("extract", trained, "chair_0001", out, "--resolution", "1")
    assert "ends in .ply" in command.complaint("extract", trained, "chair_0001", wanted / "a.step")
    assert "make it first" in command.complaint("extract", trained, "chair_0001", tmp_path / "no" / "a.ply")
    assert "train stage" in command.complaint("extract", tmp_path, "chair_0001", out)
    empty = write_trained(tmp_path / "empty", 0.05)
    assert "no surface at all" in command.complaint("extract", empty, "chair_0001", out)
    assert list(wanted.iterdir()) == []


def test_an_edited_shape_is_written_as_its_cuboids_say(command: Command, chairs: Path, tmp_path: Path) -> None:
    script = write_script(
        tmp_path,
        {"op": "scale", "factors": [1, 1, 1.5]},
        {"op": "move", "part": "seat", "by": [0, 0, 0.05]},
        {"op": "swap", "style_of": "chair_2"},
    )
    out = tmp_path / "out.ply"
    told = json.loads(command("edit", chairs, "chair_1", script, out, "--resolution", "64"))
    assert "edit" in told["seconds"]
    session = Session(read_run(chairs))
    state = session.edited(session.opened("chair_1"), parse(script.read_text(encoding="utf-8"))).present
    corners = state.similarity.to_raw(state.cage.corners().reshape(-1, 3))
    cell = 2.1 / 64 / 0.5
    mesh = read_ply(out)
    np.testing.assert_allclose(mesh.vertices.max(0), corners.max(0), atol=cell)
    np.testing.assert_allclose(mesh.vertices.min(0), corners.min(0), atol=cell)
    assert (mesh.vertices.max(0) <= corners.max(0) + 1e-3 * cell).all()
    np.testing.assert_array_equal(state.latent, [2, 3])


def test_a_swap_is_the_script_that_swaps(command: Command, chairs: Path, tmp_path: Path) -> None:
    swapped, scripted = tmp_path / "swap.glb", tmp_path / "script.glb"
    script = write_script(tmp_path, {"op": "swap", "style_of": "chair_2"})
    command("swap", chairs, "chair_1", "chair_2", swapped, "--resolution", "32")
    command("edit", chairs, "chair_1", script, scripted, "--resolution", "32")
    assert swapped.read_bytes() == scripted.read_bytes()


def test_a_mix_is_the_script_that_mixes(command: Command, tmp_path: Path) -> None:
    run = write_parts_run(tmp_path / "runs" / "parts")
    mixed, scripted, own = (tmp_path / f"{name}.obj" for name in ("mixed", "scripted", "own"))
    mixes = [{"op": "mix", "part": part, "style_of": "b"} for part in ("leg_1", "seat|arm_*")]
    script = write_script(tmp_path, *mixes)
    command("mix", run, "a", "leg_1=b", "seat|arm_*=b", mixed, "--resolution", "32")
    command("edit", run, "a", script, scripted, "--resolution", "32")
    command("extract", run, "a", own, "--resolution", "32")
    assert mixed.read_bytes() == scripted.read_bytes()
    before, after = (dict(read_obj_groups(path)) for path in (own, mixed))
    changed = {name for name in before if before[name].vertices.tobytes() != after[name].vertices.tobytes()}
    assert {"leg_1", "leg_2", "seat", "arm_1", "arm_2"} <= changed
    assert "back" not in changed


def test_a_mix_goes_halfway_takes_the_parts_that_are_named_and_keeps_their_details(
    command: Command, tmp_path: Path
) -> None:
    run = write_parts_run(tmp_path / "runs" / "parts")
    mixed, scripted, whole = (tmp_path / f"{name}.obj" for name in ("mixed", "scripted", "whole"))
    way = {"from": "seat", "weight": 0.5, "details": "keep"}
    script = write_script(tmp_path, {"op": "mix", "part": "leg_1", "style_of": "b", **way})
    options = [text for name, value in way.items() for text in (f"--{name}", str(value))]
    command("mix", run, "a", "leg_1=b", mixed, *options, "--resolution", "32")
    command("edit", run, "a", script, scripted, "--resolution", "32")
    command("mix", run, "a", "leg_1=b", whole, *options[:-2], "--resolution", "32")
    assert mixed.read_bytes() == scripted.read_bytes() != whole.read_bytes()
    out = tmp_path / "out.obj"
    assert "weight" in command.complaint("mix", run, "a", "leg_1=b", out, "--weight", "2")
    assert "wing" in command.complaint("mix", run, "a", "leg_1=b", out, "--from", "wing")
    assert not out.exists()


def test_what_is_wrong_with_a_mix_is_said_and_nothing_is_written(
    command: Command, chairs: Path, tmp_path: Path
) -> None:
    run, out = write_parts_run(tmp_path / "runs" / "parts"), tmp_path / "out.obj"
    for words, said in (
        (["leg_1"], "'leg_1': wanted PART=SHAPE, such as 'leg_*=chair_0007'"),
        (["=b"], "'=b': wanted PART=SHAPE"),
        (["leg_1="], "'leg_1=': wanted PART=SHAPE"),
        (["wing=b"], "part 'wing': no part is called so; wanted one of seat"),
        (["seat=b", "leg_1=c"], "style_of 'c': none of the 2 styles; did you mean a, b?"),
        ([], "PARTS"),
    ):
        assert said in command.complaint("mix", run, "a", *words, out)
    assert "one style for the whole shape" in command.complaint("mix", chairs, "chair_1", "seat=chair_2", out)
    assert not out.exists()


def test_a_mirrored_chair_has_a_mirrored_surface(command: Command, chairs: Path, tmp_path: Path) -> None:
    command("extract", chairs, "chair_1", tmp_path / "out.ply", "--resolution", "48", "--symmetry", "x")
    vertices = read_ply(tmp_path / "out.ply").vertices
    middle = -0.1 / 0.5  # the canonical plane x = 0, in the user's frame
    mirrored = np.column_stack([2 * middle - vertices[:, 0], vertices[:, 1:]])
    order, other = np.lexsort(vertices.T.round(5)), np.lexsort(mirrored.T.round(5))
    np.testing.assert_allclose(vertices[order], mirrored[other], atol=1e-5)


def test_what_is_wrong_with_an_edit_is_said_and_nothing_is_written(
    command: Command, chairs: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.ply"

    def complaint(*operations: dict[str, Any]) -> str:
        return command.complaint("edit", chairs, "chair_1", write_script(tmp_path, *operations), out)

    assert "operation 1: swap: style_of 'chair_3'" in complaint(
        {"op": "scale", "factors": [1, 1, 1]}, {"op": "swap", "style_of": "chair_3"}
    )
    assert "operation 0: move: part 'lag'" in complaint({"op": "move", "part": "lag", "by": [0, 0, 1]})
    assert "no such file" in command.complaint("edit", chairs, "chair_1", tmp_path / "none.json", out)
    (tmp_path / "bad.json").write_bytes(b"\xff")
    assert "UTF-8" in command.complaint("edit", chairs, "chair_1", tmp_path / "bad.json", out)
    assert "did you mean chair_" in command.complaint("swap", chairs, "chair_9", "chair_2", out)
    cube = write_chairs(tmp_path / "runs" / "cube", trains_on="cube")
    assert "without cuboids" in command.complaint("swap", cube, "chair_1", "chair_2", out)
    assert not out.exists()


def test_parts_and_parameters_are_listed_by_the_names_that_scripts_use(command: Command, chairs: Path) -> None:
    text = command("inspect", chairs, "--shape", "chair_1")
    rows = {line.split()[0]: line for line in text.splitlines() if line.strip()}
    assert "Base/Side/leg" in rows["leg_1"]
    assert "leg_2" in rows["leg_1"]
    assert rows["Chair.seat.y"].split()[1] == "0.05"
    assert rows["Side.leg.translate1.span"].split()[1] == "0.9"
    assert "did you mean chair_" in command.complaint("inspect", chairs, "--shape", "chair_0")


def build(structure: Any, *frame: float) -> dict[str, Any]:
    return {"op": "build", "structure": structure.to_json(), "frame": frame}


@pytest.mark.parametrize("ending", [".obj", ".glb", ".ply", ".stl"])
def test_a_shape_far_from_the_origin_is_written_exactly_or_refused(
    ending: str, command: Command, chairs: Path, tmp_path: Path
) -> None:
    structure = read_run(chairs).structures["chair_1"]
    place = np.array([500000.25, 5300000.86, 412.0])
    solids = []
    for name, middle in (("near", np.zeros(3)), ("far", place)):
        frame = Similarity(1.4, np.eye(3), -1.4 * middle).to_numbers()
        script, out = write_script(tmp_path, build(structure, *frame)), tmp_path / f"{name}{ending}"
        words = ("edit", chairs, "chair_1", script, out, "--resolution", "32")
        if ending == ".stl" and name == "far":
            assert "write .obj, .ply or .glb" in command.complaint(*words)
            assert not out.exists()
            return
        told = json.loads(command(*words))
        scene = trimesh.load_scene(out, split_objects=True, group_material=False)
        for mesh in scene.geometry.values():
            mesh.merge_vertices()
            assert mesh.is_watertight
        solid = scene.to_mesh()
        solid.apply_translation(-middle)
        if ending in (".ply", ".stl"):
            assert told["volume"] == pytest.approx(solid.volume, rel=1e-5)
            assert told["faces"] == len(solid.faces)
        solids.append(solid)
    near, far = solids
    assert far.volume == pytest.approx(near.volume, rel=1e-5)
    np.testing.assert_allclose(far.bounds, near.bounds, atol=1e-5)


def test_cuboids_are_written_on_demand_into_a_file_of_their_own(command: Command, chairs: Path, tmp_path: Path) -> None:
    out, cuboids = tmp_path / "out.obj", tmp_path / "boxes.obj"
    command("extract", chairs, "chair_1", out, "--resolution", "32")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.obj", "runs"]
    surface = out.read_bytes()
    command("extract", chairs, "chair_1", out, "--resolution", "32", "--cuboids", cuboids)
    assert out.read_bytes() == surface
    cage = read_run(chairs).sequences["chair_1"].cages[0]
    boxes = trimesh.load_scene(cuboids, split_objects=True, group_material=False)
    assert boxes.to_mesh().volume == pytest.approx(8 * cage.size.prod(axis=1).sum(), rel=1e-5)
    assert "is the surface's file" in command.complaint("extract", chairs, "chair_1", out, "--cuboids", out)
    assert "ends in .ply" in command.complaint("extract", chairs, "chair_1", out, "--cuboids", tmp_path / "a.step")


@pytest.mark.parametrize(
    "labels", [("leg", "leg", "leg_1"), ("a", "A", "a_1"), ("x y", "x_y", "x  y"), ("", " ", "\n")]
)
def test_every_face_is_in_the_file_under_its_own_part(
    labels: tuple[str, ...], command: Command, chairs: Path, tmp_path: Path
) -> None:
    corners = [[-0.4, -0.4, 0.0], [0.4, -0.4, 0.0], [0.0, 0.4, -0.3], [0.0, 0.0, 0.3]]
    boxes = [Cuboid(np.array(centre), np.eye(3), np.array([0.15, 0.3, 0.15])) for centre in corners]
    hierarchy = PartHierarchy.flat(tuple("pqrs"), (*labels, "seat"), "chair").with_cuboids(dict(zip("pqrs", boxes)))
    script = write_script(tmp_path, {"op": "build", "structure": hierarchy.to_json()})
    out = tmp_path / "out.obj"
    told = json.loads(command("edit", chairs, "chair_1", script, out, "--resolution", "64"))
    groups = read_obj_groups(out)
    assert len(groups) == 4
    assert sum(len(mesh.faces) for _, mesh in groups) == told["faces"]
    for (_, mesh), centre in zip(groups, corners):
        np.testing.assert_allclose(mesh.vertices.mean(axis=0), centre, atol=0.05)
    assert groups[3][0] == "seat"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le"])
def test_scripts_are_read_as_other_systems_write_them(
    encoding: str, command: Command, chairs: Path, tmp_path: Path
) -> None:
    (tmp_path / "a.json").write_text('[{"op": "undo"}]\r\n', encoding=encoding)
    complaint = command.complaint("edit", chairs, "chair_1", tmp_path / "a.json", tmp_path / "a.ply")
    assert complaint.endswith("script: operation 0: undo: there is nothing to take back")


def test_threads_change_no_byte_of_a_file(
    command: Command, chairs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads = torch.get_num_threads()
    for workers in ("1", "3"):
        monkeypatch.setenv("CAGESDF_WORKERS", workers)
        command("extract", chairs, "chair_1", tmp_path / f"{workers}.ply", "--resolution", "24")
    assert (tmp_path / "1.ply").read_bytes() == (tmp_path / "3.ply").read_bytes()
    assert torch.get_num_threads() == threads


def test_loose_pieces_are_dropped_from_edits_too_and_the_thinnest_part_is_told(
    command: Command, chairs: Path, tmp_path: Path
) -> None:
    script = write_script(tmp_path, {"op": "move", "part": "seat", "by": [0, 0, 1.5], "mirror": False})
    told = {
        loose: json.loads(
            command("edit", chairs, "chair_1", script, tmp_path / "out.ply", "--resolution", "24", "--loose", loose)
        )
        for loose in ("keep", "drop")
    }
    assert told["keep"]["components"] == told["drop"]["components"] + told["drop"]["dropped"]
    assert told["drop"]["dropped"] > 0
    assert told["keep"]["cells"] > 2
    assert told["keep"]["thickness"] > 0
