"""`cagesdf fit`: shapes of balls, by a network that knows balls; far from it, boxes."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from cagesdf.api.sources import IMPORT
from cagesdf.errors import InputError
from cagesdf.exported import ExportedShape
from cagesdf.geometry.meshes import Mesh, is_closed, signed_volume
from cagesdf.importing import import_shape
from cagesdf.inference import shapes as inference
from cagesdf.io.cuboids import read_cages
from cagesdf.io.fits import LATENT, read_fit_latent, write_fit
from cagesdf.io.meshes import read_ply
from cagesdf.io.residuals import read_residuals, write_residuals
from cagesdf.shape import RawPart, RawShape
from cagesdf.structure.hierarchy import PartHierarchy
from tests.support import toy
from tests.support.balls import RESIDUALS, SETTINGS, Balls, pair, trained, write_pair
from tests.support.commands import Command

ROOT = Path(__file__).parents[2]
UP = {"y": np.eye(3), "z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])}  # from y up to the axis


def raw(meshes: dict[str, Mesh], move: Callable[[np.ndarray], np.ndarray] = lambda vertices: vertices) -> RawShape:
    parts = tuple(RawPart(name, "ball", mesh.with_vertices(move(mesh.vertices))) for name, mesh in meshes.items())
    return RawShape("new", "val", parts, PartHierarchy.flat(tuple(meshes), ("ball",) * len(meshes), "pair"))


KNOWN = inference.Known.of(trained(), RESIDUALS)


def fit(shape: RawShape, up: str = "y") -> inference.Fit:
    run = trained()
    prepared = inference.prepare(run, import_shape(shape, **{**IMPORT, "up": up}), SETTINGS, np.random.default_rng(0))
    return inference.fit_code(run, KNOWN, prepared, SETTINGS.inference, seed=0)


def test_a_shape_like_the_training_shapes_gets_its_code_and_its_surface() -> None:
    found = fit(raw(pair(0.36, 0.36)))
    scale = found.prepared.shape.similarity.scale
    assert found.inferred.code[0] == pytest.approx(0.36 * scale, abs=2e-3)
    assert str(found.verdict) == "like the training shapes"
    surface = inference.fitted_surface(trained(), found, 48)
    assert is_closed(surface.mesh)
    measured = inference.measure(found, surface.mesh, 2000, 0.005, np.random.default_rng(0))
    assert measured["surface_distance"] < 0.3
    told = inference.report(found, surface, measured)
    assert json.loads(json.dumps(told)) == told
    assert told["whose_parts"] == "given: parts as the files have them"
    assert told["residual"] == pytest.approx(found.inferred.error, abs=1e-6)
    assert told["residual_one_code"] == pytest.approx(found.verdict.residual, abs=1e-6)


def test_parts_that_differ_get_residuals_and_the_surface_follows() -> None:
    """The balls' radii differ by a third; one code alone misses both."""
    found = fit(raw(pair(0.30, 0.40)))
    assert found.inferred.error < found.inferred.code_error / 5
    surface = inference.fitted_surface(trained(), found, 48)
    measured = inference.measure(found, surface.mesh, 2000, 0.005, np.random.default_rng(0))
    assert measured["surface_distance"] < 0.3


def test_the_field_of_a_part_is_the_network_with_its_residual() -> None:
    found = fit(raw(pair(0.30, 0.40)))
    cage = found.prepared.fitted.cage
    field = inference.fitted_field(trained(), found)
    for k, residual in enumerate(found.inferred.residual[:, 0].tolist()):
        radius = float(found.inferred.code[0]) + residual
        assert field.values(cage.centre[k : k + 1], k)[0] == pytest.approx(max(-radius, -0.1), abs=1e-5)


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_moved_scaled_and_turned_copy_gives_the_same_result_in_its_own_frame(up: str) -> None:
    """Powers of two are exact, so the results are equal to the last bit, and not only nearly."""
    turn = UP[up]
    one = fit(raw(pair(0.30, 0.40)))
    other = fit(raw(pair(0.30, 0.40), lambda vertices: 4 * vertices @ turn.T), up)
    assert torch.equal(one.inferred.code, other.inferred.code)
    assert torch.equal(one.inferred.residual, other.inferred.residual)
    assert one.verdict == other.verdict
    surfaces = [inference.fitted_surface(trained(), found, 32).mesh for found in (one, other)]
    here, there = (found.prepared.shape.similarity.to_raw(mesh.vertices) for found, mesh in zip((one, other), surfaces))
    np.testing.assert_allclose(4 * here @ turn.T, there, atol=1e-12)


def test_boxes_are_far_from_balls() -> None:
    boxes = {name: toy.box([x, 0, 0], [0.7, 0.7, 0.7]) for name, x in (("a", -0.6), ("b", 0.6))}
    found = fit(raw(boxes))
    assert found.verdict.far
    assert str(found.verdict).startswith("far from the training shapes: no code explains it: its residual is ")


def test_balls_of_another_size_are_far_by_their_code_and_their_proportions() -> None:
    found = fit(raw(pair(0.12, 0.12, apart=0.85)))
    assert found.verdict.residual < KNOWN.residuals["chair_3"]
    reasons = "; ".join(found.verdict.reasons)
    assert "its code lies" in reasons
    assert "y up, it measures" in reasons
    assert "residual" not in reasons


def test_residuals_of_other_shapes_are_refused() -> None:
    with pytest.raises(InputError, match="other shapes"):
        inference.Known.of(trained(), {"chair_1": 0.002})


class Blind(Balls):
    """Balls that were trained without cuboids."""

    trains_on = "cube"


def test_an_arm_without_cuboids_is_refused() -> None:
    shape = import_shape(raw(pair(0.36, 0.36)), **IMPORT)
    with pytest.raises(InputError, match="without cuboids"):
        inference.prepare(replace(trained(), decoder=Blind()), shape, SETTINGS, np.random.default_rng(0))


def test_the_surface_of_a_shape_far_from_the_origin_keeps_its_volume(
    command: Command, run_folder: Path, tmp_path: Path
) -> None:
    source = write_pair(tmp_path / "far", (500000.25, 5300000.75, 412.0))
    told = json.loads(command("fit", run_folder, source, tmp_path / "out", "--resolution", "32"))
    mesh = read_ply(tmp_path / "out" / "surface.ply")
    assert is_closed(mesh)
    assert (told["vertices"], told["faces"]) == (len(mesh.vertices), len(mesh.faces))
    true = sum(signed_volume(part) for part in pair(0.36, 0.36).values()) * 2.5**3
    assert signed_volume(mesh) == pytest.approx(true, rel=0.03)


def test_the_command_writes_what_it_says(command: Command, run_folder: Path, tmp_path: Path) -> None:
    source = write_pair(tmp_path / "new")
    told = json.loads(command("fit", run_folder, source, tmp_path / "out", "--resolution", "32"))
    again = json.loads(command("fit", run_folder, source, tmp_path / "again", "--resolution", "32"))
    assert (told["shape_id"], told["far"], told["parts"]) == ("new", False, 2)
    dropped = json.loads(
        command("fit", run_folder, source, tmp_path / "dropped", "--resolution", "32", "--loose", "drop")
    )
    assert dropped["components"] + dropped["dropped"] == told["components"]
    names = ["cuboids.parquet", "latent.safetensors", "programs.parquet", "report.json", "surface.ply"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == names
    for name in names:
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()
    assert told.pop("seconds").keys() == again.pop("seconds").keys()
    assert {"out": str(tmp_path / "out"), **json.loads((tmp_path / "out/report.json").read_text())} == told
    mesh = read_ply(tmp_path / "out/surface.ply")
    assert len(mesh.faces) == told["faces"]
    np.testing.assert_allclose(mesh.vertices.min(axis=0), np.array([-0.96, -0.36, -0.36]) * 2.5 + [7, -3, 5], atol=0.1)
    assert read_cages(tmp_path / "out")["new"].part_ids == ("a", "b")
    latent, residual = read_fit_latent(tmp_path / "out")
    assert latent.shape == (2,)
    assert residual.shape == (2, 2)
    assert not list(tmp_path.glob(".*")), "nothing is left beside"


def test_codes_read_back_as_they_were_and_damaged_ones_are_named(tmp_path: Path) -> None:
    found = fit(raw(pair(0.30, 0.40)))
    surface = inference.fitted_surface(trained(), found, 16).mesh
    model = ExportedShape.of(surface, {}, {})
    write_fit(tmp_path, found.prepared.fitted, found.inferred.code, found.inferred.residual, model, {"shape_id": "new"})
    latent, residual = read_fit_latent(tmp_path)
    assert torch.equal(latent, found.inferred.code)
    assert torch.equal(residual, found.inferred.residual)
    whole = (tmp_path / LATENT).read_bytes()
    (tmp_path / LATENT).write_bytes(whole[:-8])
    with pytest.raises(InputError, match=LATENT):
        read_fit_latent(tmp_path)
    (tmp_path / LATENT).unlink()
    with pytest.raises(InputError, match=LATENT):
        read_fit_latent(tmp_path)


def test_bad_sources_and_places_are_complaints(command: Command, run_folder: Path, tmp_path: Path) -> None:
    source = write_pair(tmp_path / "all/new")
    write_pair(tmp_path / "all/other")
    (tmp_path / "broken.obj").write_text("v 0 0\n")
    out = tmp_path / "out"
    assert "holds 2 shapes" in command.complaint("fit", run_folder, tmp_path / "all", out)
    assert "no such file" in command.complaint("fit", run_folder, tmp_path / "none", out)
    assert "rejected: " in command.complaint("fit", run_folder, tmp_path / "broken.obj", out)
    assert "is there already" in command.complaint("fit", run_folder, source, tmp_path)
    assert "there is no folder" in command.complaint("fit", run_folder, source, tmp_path / "no/out")
    assert "resolution 4" in command.complaint("fit", run_folder, source, out, "--resolution", "4")
    assert "seed -1" in command.complaint("fit", run_folder, source, out, "--seed", "-1")
    (run_folder / "residuals.parquet").unlink()
    assert "residuals.parquet" in command.complaint("fit", run_folder, source, out)
    assert not out.exists()


def test_the_commands_numbers_are_those_of_the_default_run() -> None:
    """A shape is prepared as those were that the network was trained on."""
    params = yaml.safe_load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    for name, own in (("fit_cuboids", inference.CUBOIDS), ("sample_points", inference.SAMPLES)):
        assert own == {key: params[name][key] for key in own}
    assert {key: params["evaluate"][key] for key in inference.MEASURE} == inference.MEASURE


def test_residuals_read_back_and_are_sorted(tmp_path: Path) -> None:
    write_residuals(tmp_path, {"b": 0.25, "a": 0.5})
    assert list(read_residuals(tmp_path).items()) == [("a", 0.5), ("b", 0.25)]
