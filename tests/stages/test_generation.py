"""The stage of Table 3, on clouds made here: rows of all methods and floors, the same each time."""

import filecmp
import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.clouds import FRESH, Clouds
from cagesdf.evaluation.shape_sets import Described, drawn
from cagesdf.evaluation.table3 import REAL, gather_generation
from cagesdf.geometry.meshes import Mesh, sample_surface
from cagesdf.io.clouds import write_clouds
from cagesdf.io.features import write_features
from cagesdf.io.generated_shapes import POINTS, read_generated, write_generated
from cagesdf.io.generation_scores import read_generation, read_nearest
from cagesdf.models.features import Features
from cagesdf.models.pointnet import make_classifier
from cagesdf.report import table3
from cagesdf.shape_generation.generated import GeneratedShape
from pipeline import GenerationParams, Params, artefact
from pipeline.artefact import ArtefactError
from stages import evaluate_generation
from tests.support import toy

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


MADE = {
    "cagesdf": {
        "dependent": [TRAIN[2], TRAIN[4], TRAIN[2], TRAIN[5]],
        "independent": [OTHERS[3], NOTHING, *TRAIN[:2]],
    },
    "deepsdf": {"isotropic": [toy.ball([0, 0, 0], 0.1 * i) for i in range(1, 5)]},
}


def write_inputs(folder: Path, others: list[Mesh], made: dict[str, dict[str, list[Mesh]]] = MADE) -> Path:
    params = Params(format=1)
    ids = ["val_0", *(f"{FRESH}{i}" for i in range(1, len(others)))][: len(others)]
    with artefact.write("clouds", folder / "clouds" / "stool", inputs={}, params=params) as out:
        train = clouds(TRAIN, [f"train_{i}" for i in range(6)])
        write_clouds(out, {"train": train, "reference": clouds(others, ids)})
    with artefact.write("features", folder / "features", inputs={}, params=params) as out:
        write_features(
            out, Features(make_classifier((8, 16), 8, 2, 0), (8, 16), 8, ("stool", "bench"), 60), {"category": 0.5}
        )
    for arm, methods in made.items():
        with artefact.write("generated", folder / "generated" / "stool" / arm, inputs={}, params=params) as out:
            shapes = [shape(name, i, mesh) for name, some in methods.items() for i, mesh in enumerate(some)]
            write_generated(out, shapes, {"methods": {name: {} for name in methods}})
    return folder


def run(folder: Path, out: Path) -> Path:
    places = (folder / "generated" / "stool", folder / "clouds" / "stool", folder / "features")
    arms = tuple(sorted(path.name for path in places[0].iterdir()))
    evaluate_generation.main(*places, out, PARAMS.model_copy(update={"generators": arms}))
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


def test_methods_with_few_shapes_have_a_row_and_change_nobody_elses(
    tmp_path: Path, done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    few: dict[str, dict[str, list[Mesh]]] = {
        "none": {"dependent": [], "independent": []},
        "one": {"dependent": [TRAIN[2]], "independent": [NOTHING]},
    }
    rows, about = read_generation(run(write_inputs(tmp_path, OTHERS, MADE | few), tmp_path / "out" / "stool"))
    found = {(row["arm"], row["method"], row["draw"]): row for row in rows}
    before = {(row["arm"], row["method"], row["draw"]): row for row in read_generation(done)[0]}
    assert about["sets"]["shapes_a_draw"] == 4
    for key, row in before.items():
        assert found[key] == pytest.approx(row, nan_ok=True), key
    methods = ("dependent", "independent")
    counts = {key: (found[(*key, 0)]["shapes"], found[(*key, 0)]["failed"]) for key in product(few, methods)}
    assert counts == {
        ("none", "dependent"): (0, 1), ("none", "independent"): (0, 1),
        ("one", "dependent"): (1, 0), ("one", "independent"): (1, 1),
    }  # fmt: skip
    assert np.isfinite(found["one", "dependent", 0]["cov"])
    assert np.isnan(found["one", "dependent", 0]["fd"])
    assert found["none", "dependent", 0]["recognised"] == 0
    [category] = gather_generation({"stool": (rows, about)})["categories"].values()
    entries = {(entry["arm"], entry["method"]): entry for entry in category["methods"]}
    assert {key for key in entries if key[0] in few} == set(product(few, methods))
    table = table3.table(category, {})
    told = {row.name: row.explanation for row in table["arms"]}
    assert "no shapes: no draw was valid" in told["none, dependent"]
    assert "1 shape" in told["one, dependent"]
    assert "none with a surface" not in told["one, dependent"]
    assert "1 shape, none with a surface" in told["one, independent"]
    assert "4 shapes" in told["deepsdf, isotropic"]
    orders = gather_generation({"stool": (rows, about)})["orders"]["stool"]["here"]
    assert set(orders["fd"][-4:]) == {f"{arm}, {method}" for arm, method in product(few, methods)}


def test_a_category_whose_methods_all_failed_has_its_floors_and_their_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    made = {"cagesdf": {"dependent": [], "independent": [TRAIN[0]]}}
    rows, about = read_generation(run(write_inputs(tmp_path, OTHERS, made), tmp_path / "out" / "stool"))
    assert [(row["arm"], row["method"]) for row in rows] == [
        ("cagesdf", "dependent"), ("cagesdf", "independent"),
        (REAL, "drawn"), (REAL, "drawn"), (REAL, "halves"), (REAL, "training"),
    ]  # fmt: skip
    assert about["sets"]["shapes_a_draw"] == 5, "half of the references"
    assert gather_generation({"stool": (rows, about)})["orders"]["stool"]["here"]["cov"][-1] == "cagesdf, dependent"


def test_a_reference_or_two_are_too_few_and_four_are_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    for count, draws in ((3, 0), (4, 2), (5, 2)):
        folder = write_inputs(tmp_path / str(count), OTHERS[:count])
        rows, about = read_generation(run(folder, folder / "out" / "stool"))
        assert sum(row["method"] == "drawn" for row in rows) == draws
        assert about["sets"]["shapes_a_draw"] == count // 2


def test_points_of_another_set_of_shapes_than_the_index_are_refused(inputs: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(inputs / "generated" / "stool" / "cagesdf", tmp_path / "cagesdf")
    rows = POINTS.read(folder / "points.parquet")
    POINTS.write(folder / "points.parquet", rows[::-1])
    one, other = (read_generated(place).points("dependent") for place in (folder, inputs / "generated/stool/cagesdf"))
    assert list(one) == list(other) == [f"new_{i}" for i in range(4)], "in the index's order"
    assert all(np.array_equal(one[name], other[name]) for name in one)
    POINTS.write(folder / "points.parquet", rows[1:])
    with pytest.raises(InputError, match="shape 'new_0' of method 'dependent' is in it or in index"):
        read_generated(folder).points("dependent")


def test_a_set_that_could_not_be_scored_stops_the_stage(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ShapeRejected("new_1", "evaluate_generation", "bad luck")

    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    monkeypatch.setattr(evaluate_generation, "score_one", fail)
    with pytest.raises(ShapeRejected, match="bad luck"):
        run(inputs, tmp_path / "stool")


def test_the_floor_compares_each_draw_with_the_other_references_and_the_other_draws() -> None:
    rng = np.random.default_rng(0)
    train, reference = (
        Described(rng.normal(size=(n, 20, 3)).astype(np.float32), rng.normal(size=(n, 4)), np.zeros(n, bool))
        for n in (7, 11)
    )
    draws = drawn(reference, 3, 3, rng)
    tasks = list(evaluate_generation.tasks_of({}, (train, 0.25), (reference, 0.75), draws, PARAMS))
    assert [task.key for task in tasks] == [(REAL, "training", 0), *((REAL, "drawn", i) for i in range(3))]

    def rows_in(shapes: Described, whole: Described) -> list[int]:
        same = (shapes.points[:, None] == whole.points[None]).all(axis=(2, 3))
        assert (same.sum(axis=1) == 1).all()
        assert (shapes.features == whole.features[same.argmax(axis=1)]).all()
        return same.argmax(axis=1).tolist()

    copies, *floors = tasks
    assert len(set(rows_in(copies.shapes, train))) == 3
    assert (copies.recognised, copies.reference, copies.draws) == (0.25, reference, draws)
    for task, draw in zip(floors, draws):
        chosen, others = rows_in(task.shapes, reference), rows_in(task.reference, reference)
        assert chosen == draw.rows.tolist()
        assert sorted(chosen + others) == list(range(11)), "none is compared with itself"
        assert task.recognised == 0.75
        rest = [other for other in draws if other is not draw]
        assert len(task.draws) == len(rest) == 2
        for moved, other in zip(task.draws, rest):
            assert rows_in(task.reference.of(moved.rows), reference) == other.rows.tolist()
            np.testing.assert_array_equal(moved.within, other.within)


def test_a_failed_shape_is_not_recognised_whatever_the_classifier_takes_its_points_for() -> None:
    sure = Features(make_classifier((8, 16), 8, 1, 0), (8, 16), 8, ("stool",), 60)
    points = np.random.default_rng(0).normal(size=(4, 80, 3)).astype(np.float32)
    shapes, recognised = evaluate_generation.described(sure, "stool", PARAMS, points, np.arange(4) == 1)
    assert recognised == 0.75
    assert (shapes.points.shape, shapes.features.shape) == ((4, 40, 3), (4, 16))
    assert np.isnan(evaluate_generation.described(sure, "vase", PARAMS, points, np.arange(4) == 1)[1])
