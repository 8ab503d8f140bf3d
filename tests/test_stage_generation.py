"""The stage of Table 3, on clouds made here: rows of all methods and floors, the same each time."""

import filecmp
from pathlib import Path

import numpy as np
import pytest
import toy

from cagesdf.evaluation.clouds import FRESH, Clouds
from cagesdf.evaluation.table3 import REAL, gather_generation
from cagesdf.io.clouds import write_clouds
from cagesdf.io.features import Features, write_features
from cagesdf.io.generated import GeneratedShape, write_generated
from cagesdf.io.generation import read_generation, read_nearest
from cagesdf.meshes import Mesh, sample_surface
from cagesdf.models.pointnet import make_classifier
from pipeline import GenerationParams, Params, artefact
from pipeline.artefact import ArtefactError
from stages import evaluate_generation

PARAMS = GenerationParams(format=1, points=40, draws=2, seed=11, generators=("cagesdf", "deepsdf"))
NOTHING = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
TRAIN = [toy.box([0, 0, 0], [1, 0.5 + 0.1 * i, 0.3]) for i in range(6)]
OTHERS = [toy.box([0, 0, 0], [1, 0.55 + 0.07 * i, 0.35]) for i in range(10)]


def cloud(mesh: Mesh, seed: int) -> np.ndarray:
    return sample_surface(mesh, 80, np.random.default_rng(seed))[0].astype(np.float32)


def shape(method: str, number: int, mesh: Mesh) -> GeneratedShape:
    """A generated shape; without faces, a failed one."""
    points = cloud(mesh, 50 + number) if len(mesh.faces) else np.zeros((0, 3), np.float32)
    return toy.generated(method, f"new_{number}", mesh, points)


def clouds(meshes: list[Mesh], ids: list[str]) -> Clouds:
    points = np.array([cloud(mesh, i) for i, mesh in enumerate(meshes)], np.float32).reshape(len(meshes), -1, 3)
    return Clouds(tuple(ids), ("",) * len(ids), points if len(meshes) else np.zeros((0, 80, 3), np.float32))


def write_inputs(folder: Path, others: list[Mesh]) -> Path:
    params = Params(format=1)
    ids = ["val_0", *(f"{FRESH}{i}" for i in range(1, len(others)))][: len(others)]
    with artefact.write("clouds", folder / "clouds" / "stool", inputs={}, params=params) as out:
        train = clouds(TRAIN, [f"train_{i}" for i in range(6)])
        write_clouds(out, {"train": train, "reference": clouds(others, ids)})
    with artefact.write("features", folder / "features", inputs={}, params=params) as out:
        write_features(
            out, Features(make_classifier((8, 16), 8, 2, 0), (8, 16), 8, ("stool", "bench"), 60), {"category": 0.5}
        )
    made = {
        "cagesdf": {
            "dependent": [TRAIN[2], TRAIN[4], TRAIN[2], TRAIN[5]],
            "independent": [OTHERS[3], NOTHING, *TRAIN[:2]],
        },
        "deepsdf": {"isotropic": [toy.ball([0, 0, 0], 0.1 * i) for i in range(1, 5)]},
    }
    for arm, methods in made.items():
        with artefact.write("generated", folder / "generated" / "stool" / arm, inputs={}, params=params) as out:
            write_generated(out, [shape(name, i, m) for name, some in methods.items() for i, m in enumerate(some)], {})
    return folder


def run(folder: Path, out: Path) -> Path:
    places = (folder / "generated" / "stool", folder / "clouds" / "stool", folder / "features")
    evaluate_generation.main(*places, out, PARAMS)
    return out


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_inputs(tmp_path_factory.mktemp("inputs"), OTHERS)


@pytest.fixture(scope="module")
def done(inputs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAGESDF_WORKERS", "1")
        return run(inputs, tmp_path_factory.mktemp("one") / "stool")


def test_there_is_a_row_a_method_and_floors_beside_them(done: Path) -> None:
    rows, about = read_generation(done)
    keys = [(row["arm"], row["method"], row["draw"]) for row in rows]
    assert keys == [
        ("cagesdf", "dependent", 0), ("cagesdf", "independent", 0), ("deepsdf", "isotropic", 0),
        (REAL, "drawn", 0), (REAL, "drawn", 1), (REAL, "halves", 0), (REAL, "training", 0),
    ]  # fmt: skip
    assert {key: about["sets"][key] for key in ("train", "validation", "drawn", "shapes_a_draw")} == {
        "train": 6, "validation": 1, "drawn": 9, "shapes_a_draw": 4,
    }  # fmt: skip
    assert about["features"] == {"classes": 2, "category": 0.5}
    found = dict(zip(keys, rows))
    assert found["cagesdf", "independent", 0]["failed"] == 0.25
    assert found[REAL, "training", 0]["gen"] == 0
    assert np.isnan(found[REAL, "halves", 0]["gen"])
    assert found["deepsdf", "isotropic", 0]["fd"] > found["cagesdf", "dependent", 0]["fd"]
    assert found["deepsdf", "isotropic", 0]["told_apart"] == 1
    assert found[REAL, "drawn", 0]["cov"] > 0, "no reference is compared with itself"
    assert gather_generation({"stool": (rows, about)})["orders"]["stool"]["here"]["fd"][-1] == "deepsdf, isotropic"


def test_clouds_of_a_method_without_any_surface_stand_where_figures_are_worst() -> None:
    clouds, failed = evaluate_generation.stacked({"a": np.zeros((0, 3), np.float32), "b": np.zeros((0, 3))}, 60)
    assert clouds.shape == (2, 60, 3)
    assert not clouds.any()
    assert failed.all()
    own = np.ones((80, 3), np.float32)
    clouds, failed = evaluate_generation.stacked({"a": own, "b": own[:0]}, 60)
    assert (clouds.shape, failed.tolist()) == ((2, 80, 3), [False, True])


def test_the_nearest_training_shape_of_each_is_told(done: Path) -> None:
    rows = {(row["arm"], row["method"], int(row["shape_id"][4:])): row for row in read_nearest(done)}
    assert len(rows) == 12
    assert [rows["cagesdf", "dependent", i]["nearest"] for i in range(4)] == [
        "train_2",
        "train_4",
        "train_2",
        "train_5",
    ]
    assert rows["cagesdf", "independent", 1]["nearest"] == ""
    assert np.isinf(rows["cagesdf", "independent", 1]["distance"])


def test_the_same_inputs_give_the_same_bytes_in_any_number_of_processes(
    inputs: Path, done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    again = run(inputs, tmp_path / "stool")
    for path in done.iterdir():
        assert filecmp.cmp(path, again / path.name, shallow=False), path.name


def test_without_references_there_are_no_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    rows, about = read_generation(run(write_inputs(tmp_path, OTHERS[:1]), tmp_path / "out" / "stool"))
    assert rows == []
    assert about["sets"]["validation"] == 1
    assert gather_generation({"stool": (rows, about)})["categories"]["stool"]["methods"] == []


def test_only_the_generators_that_are_run_are_measured_whatever_else_lies_there(inputs: Path, tmp_path: Path) -> None:
    places = (inputs / "generated" / "stool", inputs / "clouds" / "stool", inputs / "features")
    evaluate_generation.main(*places, tmp_path / "out", PARAMS.model_copy(update={"generators": ("deepsdf",)}))
    assert {row["arm"] for row in read_generation(tmp_path / "out")[0]} == {"deepsdf", REAL}


def test_clouds_in_the_place_of_generated_shapes_are_refused(inputs: Path, tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match=r"clouds.cagesdf: no such folder"):
        evaluate_generation.main(
            inputs / "clouds", inputs / "clouds" / "stool", inputs / "features", tmp_path / "out", PARAMS
        )
