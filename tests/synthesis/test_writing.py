"""Procedural shapes on disk: what real data sets look like, defects included."""

import json
from pathlib import Path

import numpy as np
import pytest

from cagesdf.cuboid import Cage
from cagesdf.formats.partnet import read_partnet
from cagesdf.geometry.meshes import face_areas, is_closed, signed_volume
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.synthesis.dataset import build, draw, draw_recipes
from cagesdf.synthesis.recipe import Recipe
from cagesdf.synthesis.writing import DEFECTS, with_defect, write_shape, write_splits
from pipeline import artefact, load
from stages import synthesize

ROOT = Path(__file__).parents[2]


def written(folder: Path, recipe: Recipe, defective: float) -> Path:
    (folder / f"{recipe.category}_hier").mkdir(exist_ok=True)
    write_shape(folder, recipe, defective, np.random.default_rng(0))
    return folder / recipe.shape_id


@pytest.mark.parametrize("category", ["chair", "table", "vase"])
def test_the_reader_of_real_data_reads_back_what_was_built(tmp_path: Path, category: str) -> None:
    recipe = draw_recipes(category, 4, 0, np.random.default_rng(2))[3]
    place = written(tmp_path, recipe, 0.0)
    raw = read_partnet(place, recipe.shape_id, "train", tmp_path / f"{category}_hier" / f"{recipe.shape_id}.json")
    assert raw.structure.signature() == draw(recipe).structure.signature()
    for part, ours in zip(raw.parts, build(recipe, recipe), strict=True):
        assert (part.part_id, part.label) == (ours.part_id, ours.label)
        assert part.mesh.vertices == pytest.approx(ours.mesh.vertices, abs=1e-7)
        assert (part.mesh.faces == ours.mesh.faces).all()


def test_boxes_on_disk_are_the_recipes_cuboids_and_ids_are_preorder_places(tmp_path: Path) -> None:
    recipe = draw_recipes("chair", 1, 0, np.random.default_rng(2))[0]
    place = written(tmp_path, recipe, 0.0)
    hierarchy = PartHierarchy.from_json((tmp_path / "chair_hier" / f"{recipe.shape_id}.json").read_text())
    expected = Cage.of(draw(recipe).structure.cuboids())
    assert Cage.of(hierarchy.cuboids()).corners() == pytest.approx(expected.corners())
    assert [node.node_id for node in hierarchy.tree.walk()] == [str(i) for i in range(len(list(hierarchy.tree.walk())))]
    root = json.loads((place / "result_after_merging.json").read_text())[0]
    assert len(root["objs"]) == len(expected) == len(list((place / "objs").iterdir()))
    assert Recipe.from_json((place / "recipe.json").read_text()) == recipe


def test_defects_do_what_they_are_called() -> None:
    mesh = build(*2 * draw_recipes("vase", 1, 0, np.random.default_rng(2)))[0].mesh
    opened, flipped, doubled = (with_defect(mesh, defect, np.random.default_rng(0)) for defect in DEFECTS)
    assert is_closed(mesh)
    assert not is_closed(opened)
    assert 0.9 * len(mesh.faces) < len(opened.faces) < len(mesh.faces)
    assert signed_volume(flipped) == pytest.approx(-signed_volume(mesh))
    assert face_areas(doubled).sum() == pytest.approx(2 * face_areas(mesh).sum())
    assert signed_volume(doubled) == pytest.approx(0, abs=1e-9)
    with pytest.raises(ValueError, match="melted"):
        with_defect(mesh, "melted", np.random.default_rng(0))


def test_the_share_of_defective_parts_is_the_one_asked_for_and_the_recipe_names_them(tmp_path: Path) -> None:
    recipes = draw_recipes("chair", 8, 0, np.random.default_rng(2))
    faults, parts = 0, 0
    for recipe in recipes:
        place = written(tmp_path, recipe, 0.5)
        defects = json.loads((place / "recipe.json").read_text())["defects"]
        raw = read_partnet(place, recipe.shape_id, "train", None)
        for part, ours in zip(raw.parts, build(recipe, recipe)):
            same = np.array_equal(part.mesh.faces, ours.mesh.faces)
            assert same == (part.part_id not in defects)
        faults, parts = faults + len(defects), parts + len(raw.parts)
    assert 0.3 < faults / parts < 0.7


def test_splits_list_each_shape_once(tmp_path: Path) -> None:
    recipes = draw_recipes("table", 3, 2, np.random.default_rng(2))
    write_splits(tmp_path, recipes)
    assert (tmp_path / "train.txt").read_text().split() == ["table_0000", "table_0001", "table_0002"]
    assert (tmp_path / "val.txt").read_text().split() == ["table_0003", "table_0004"]


def test_the_stage_writes_the_same_bytes_for_any_number_of_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    params = load("synthesize", ROOT / "params.yaml").model_copy(update={"train": 3, "val": 1})
    for workers in ("1", "2"):
        monkeypatch.setenv("CAGESDF_WORKERS", workers)
        synthesize.main("vase", tmp_path / workers, params)
    one, two = (artefact.read_manifest(tmp_path / workers) for workers in ("1", "2"))
    assert one == two
    assert one["kind"] == "raw"
