"""Shapes as clouds: on the outer surface, in the canonical frame, of shapes that no training saw."""

import filecmp
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagesdf.errors import InputError
from cagesdf.evaluation.clouds import FRESH, Clouds, cloud_of, label_of, recipe_parts
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.solid import union
from cagesdf.importing import import_shape
from cagesdf.io.clouds import CLOUDS, read_clouds, write_clouds
from cagesdf.io.shapes import ShapeFolder, write_shapes
from cagesdf.seeds import item_rng
from cagesdf.shape import RawShape
from cagesdf.synthesis.dataset import CATEGORIES, build, draw, draw_recipes
from cagesdf.synthesis.writing import OBJ_DIGITS
from pipeline import CloudsParams, Params, artefact
from stages import make_clouds
from tests.support import toy

PARAMS = CloudsParams(format=1, drawn=9, points=64, seed=9)


def test_points_lie_on_the_outer_surface_and_none_inside_another_part() -> None:
    parts = [toy.box([0, 0, 0], [1, 1, 1]), toy.ball([0.5, 0, 0], 0.4)]
    points = cloud_of(parts, 2000, np.random.default_rng(0)).astype(np.float64)
    assert np.abs(SurfaceDistance(union(parts)).signed(points)).max() < 1e-6
    for part in parts:
        assert SurfaceDistance(part).signed(points).min() > -1e-6


@pytest.mark.parametrize("category", CATEGORIES)
def test_a_recipe_becomes_what_importing_its_shape_gives(category: str) -> None:
    for recipe in draw_recipes(category, 3, 0, np.random.default_rng(1)):
        written = [
            replace(part, mesh=part.mesh.with_vertices(part.mesh.vertices.round(OBJ_DIGITS)))
            for part in build(recipe, recipe)
        ]
        raw = RawShape(recipe.shape_id, "train", tuple(written), draw(recipe).structure)
        imported = import_shape(raw, "y", 1e-5, 10**6, 100, 1e-4)
        parts = recipe_parts(recipe, recipe)
        assert len(parts) == len(imported.parts)
        for mesh, part in zip(parts, imported.parts):
            assert part.repair.method == "none"
            np.testing.assert_allclose(mesh.vertices, part.mesh.vertices, atol=1e-12)
            np.testing.assert_array_equal(mesh.faces, part.mesh.faces)


def test_clouds_are_read_as_they_were_written(tmp_path: Path) -> None:
    points = np.random.default_rng(2).normal(size=(3, 5, 3)).astype(np.float32)
    sets = {"train": Clouds(("a", "b"), ("x/y", ""), points[:2]), "reference": Clouds(("a",), ("",), points[2:])}
    write_clouds(tmp_path, sets)
    for name, found in read_clouds(tmp_path).items():
        assert (found.ids, found.labels) == (sets[name].ids, sets[name].labels)
        np.testing.assert_array_equal(found.points, sets[name].points)
    write_clouds(tmp_path, {"train": sets["train"], "reference": Clouds((), (), points[:0])})
    assert len(read_clouds(tmp_path)["reference"]) == 0


def test_clouds_of_different_sizes_are_refused(tmp_path: Path) -> None:
    rows = [{"set": "train", "shape_id": str(n), "label": "", "points": [0.0] * n} for n in (3, 6)]
    CLOUDS.write(tmp_path / "clouds.parquet", rows)
    with pytest.raises(InputError, match=r"as many points of three numbers in each row, got \[3, 6\]"):
        read_clouds(tmp_path)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    recipes = draw_recipes("vase", 3, 1, np.random.default_rng(3))
    shapes = []
    for recipe in recipes:
        (folder / "raw" / recipe.shape_id).mkdir(parents=True)
        (folder / "raw" / recipe.shape_id / "recipe.json").write_text(recipe.to_json(), encoding="utf-8")
        raw = RawShape(recipe.shape_id, recipe.split, tuple(build(recipe, recipe)), draw(recipe).structure)
        shapes.append(import_shape(raw, "y", 1e-5, 10**6, 100, 1e-4))
    with artefact.write("shapes", folder / "shapes", inputs={}, params=Params(format=1)) as out:
        write_shapes(out, shapes)
    (folder / "bare").mkdir()
    return folder


def test_references_are_validation_shapes_and_fresh_ones_of_every_family(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    make_clouds.main(inputs / "raw", inputs / "shapes", tmp_path / "one", PARAMS)
    sets = read_clouds(tmp_path / "one")
    assert [len(sets[name]) for name in ("train", "reference")] == [3, 10]
    assert sets["reference"].ids[0] == "vase_0003"
    assert all(shape_id.startswith(FRESH) for shape_id in sets["reference"].ids[1:])
    assert set(sets["reference"].labels[1:]) == {f"vase/{family}" for family in CATEGORIES["vase"].families}
    assert sets["train"].labels == tuple(label_of(r) for r in draw_recipes("vase", 3, 1, np.random.default_rng(3))[:3])
    assert np.linalg.norm(sets["reference"].points, axis=-1).max() <= 1 + 1e-6
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    make_clouds.main(inputs / "raw", inputs / "shapes", tmp_path / "two", PARAMS)
    for name in ("clouds.parquet", artefact.MANIFEST):
        assert filecmp.cmp(tmp_path / "one" / name, tmp_path / "two" / name, shallow=False)


def test_the_drawn_references_are_none_of_the_data_sets_recipes() -> None:
    recipes = {r.shape_id: r for r in draw_recipes("chair", 64, 16, item_rng(1, "synthesize", "chair"))}
    drawn = make_clouds.fresh(recipes, PARAMS.model_copy(update={"drawn": 100}))
    for what in ("proportions", "factors"):
        known = {tuple(sorted(getattr(recipe, what).items())) for recipe in recipes.values()}
        assert not known & {tuple(sorted(getattr(recipe, what).items())) for recipe in drawn}


def test_without_recipes_the_references_are_the_validation_shapes(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    make_clouds.main(inputs / "bare", inputs / "shapes", tmp_path / "own", PARAMS)
    sets = read_clouds(tmp_path / "own")
    assert sets["reference"].ids == ("vase_0003",)
    assert set(sets["train"].labels) == {""}


def test_a_rejected_shape_takes_its_id_label_and_cloud_with_it(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    make_clouds.main(inputs / "raw", inputs / "shapes", tmp_path / "whole", PARAMS)
    bad, sampled = ("vase_0001", FRESH + "vase_0002"), make_clouds.sampled

    def some(source: ShapeFolder, params: CloudsParams, subject: make_clouds.Subject) -> object:
        if subject.shape_id in bad:
            raise make_clouds.lost(subject, "bad luck")
        return sampled(source, params, subject)

    monkeypatch.setattr(make_clouds, "sampled", some)
    make_clouds.main(inputs / "raw", inputs / "shapes", tmp_path / "part", PARAMS)
    whole, part = read_clouds(tmp_path / "whole"), read_clouds(tmp_path / "part")
    for name, count in (("train", 2), ("reference", 9)):
        before = {i: (label, cloud) for i, label, cloud in zip(whole[name].ids, whole[name].labels, whole[name].points)}
        assert len(part[name]) == count
        for shape_id, label, cloud in zip(part[name].ids, part[name].labels, part[name].points):
            assert label == before[shape_id][0]
            np.testing.assert_array_equal(cloud, before[shape_id][1])
        assert not {*bad} & {*part[name].ids}
    said = capsys.readouterr().out
    assert "2 training shapes; 1 validation shapes and 8 drawn ones for reference" in said
    assert f"left out: {bad[0]}, bad luck; left out: {bad[1]}, bad luck" in said


def test_without_any_training_cloud_the_stage_fails(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(source: ShapeFolder, params: CloudsParams, subject: make_clouds.Subject) -> object:
        raise make_clouds.lost(subject, "bad luck")

    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    monkeypatch.setattr(make_clouds, "sampled", none)
    with pytest.raises(InputError, match=r"none of its training shapes became a cloud.*vase_0000, bad luck"):
        make_clouds.main(inputs / "raw", inputs / "shapes", tmp_path / "none", PARAMS)


def test_each_shape_has_random_numbers_of_its_own(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys: list[tuple] = []

    def listening(seed: int, *ids: str | int) -> np.random.Generator:
        keys.append((seed, *ids))
        return item_rng(seed, *ids)

    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    monkeypatch.setattr(make_clouds, "item_rng", listening)
    make_clouds.main(inputs / "raw", inputs / "shapes", tmp_path / "out", PARAMS)
    sets = read_clouds(tmp_path / "out")
    assert len(keys) == len(set(keys)) == 1 + sum(map(len, sets.values())), "one for the recipes, one for each shape"
    assert {key[0] for key in keys} == {PARAMS.seed}
