"""The stages from shapes to points, on stools: what they write, reject and refuse."""

import filecmp
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagesdf.cuboid import Cage
from cagesdf.deformation.sequences import deform_shape
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import union
from cagesdf.io.cuboids import read_cages
from cagesdf.io.matches import read_matches
from cagesdf.io.points import POINTS, PointsOf, read_points, shard_paths
from cagesdf.io.rejected import read_rejected
from cagesdf.io.sequences import read_sequences, read_transfers
from pipeline import DeformParams, FitParams, MatchParams, SampleParams
from pipeline.artefact import ArtefactError
from stages import deform_sequences, fit_cuboids, match_targets, sample_points
from tests.support import toy

FIT = FitParams(format=1, slack=0.01, min_size=1e-3, margin=1e-6, points=500, max_rejected=0.1, seed=6)
MATCH = MatchParams(format=1, unmatched="drop", scale=(0.8, 1.25), max_rejected=0.5, seed=2)
DEFORM = DeformParams(
    format=1, steps=6, held_out=(2, 3), interpolation="cuboids", transfer="trilinear", max_rejected=0.1
)
SAMPLE = SampleParams(
    format=1, near=400, uniform=100, per_cuboid=64, beta=60.0, part_near=32.0, part_uniform=8.0, shards=2,
    max_rejected=0.5, seed=3,
)  # fmt: skip
SHAPES = [
    toy.stool("a"),
    toy.stool("b", width=1.3, height=0.6),
    toy.stool("c", lean=0.3),
    toy.stool("three", legs=3),
    toy.stool("v", split="val", width=0.7),
]


def run(folder: Path, match: MatchParams = MATCH, sample: SampleParams = SAMPLE) -> Path:
    shapes = toy.write_shapes_artefact(folder / "shapes", SHAPES)
    fit_cuboids.main(shapes, folder / "cuboids", FIT)
    match_targets.main(shapes, folder / "cuboids", folder / "matches", match)
    deform_sequences.main(shapes, folder / "cuboids", folder / "matches", folder / "sequences", DEFORM)
    sample_points.main(shapes, folder / "sequences", folder / "points", sample)
    return folder


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAGESDF_WORKERS", "1")
        return run(tmp_path_factory.mktemp("one"))


def test_every_shape_has_a_cage_in_its_structures_order(done: Path) -> None:
    cages = read_cages(done / "cuboids")
    assert sorted(cages) == [shape.shape_id for shape in SHAPES]
    for shape in SHAPES:
        assert cages[shape.shape_id].part_ids == shape.structure.parts()


def test_validation_shapes_neither_have_nor_are_targets(done: Path) -> None:
    matches = read_matches(done / "matches")
    assert [match.shape_id for match in matches] == ["a", "b", "c"]
    assert {match.target_id for match in matches} <= {"a", "b", "c"}
    assert list(read_sequences(done / "sequences")) == ["a", "b", "c"]


def test_a_shape_without_partner_is_dropped_with_its_reason(done: Path) -> None:
    assert read_rejected(done / "matches") == {"three": "no other training shape of equal structure"}


def test_a_shape_without_partner_is_scaled_where_that_is_wanted(done: Path, tmp_path: Path) -> None:
    scaled = MATCH.model_copy(update={"unmatched": "scale"})
    match_targets.main(done / "shapes", done / "cuboids", tmp_path / "matches", scaled)
    match = {match.shape_id: match for match in read_matches(tmp_path / "matches")}["three"]
    assert match.target_id is None
    assert all(0.8 <= factor <= 1.25 for factor in match.scale)
    assert read_rejected(tmp_path / "matches") == {}


def test_points_are_of_training_steps_and_lie_as_far_as_they_say(done: Path) -> None:
    points, sequences = read_points(done / "points", "shape"), read_sequences(done / "sequences")
    assert set(points.step.tolist()) == {0, 1, 4, 5}
    assert points.shape_ids == ("a", "b", "c")
    for shape in SHAPES[:2]:
        sequence = sequences[shape.shape_id]
        surface = SurfaceDistance(union(deform_shape(shape, sequence.cages[0], sequence.cages[4])))
        own = np.flatnonzero((points.shape_id == points.shape_ids.index(shape.shape_id)) & (points.step == 4))
        xyz = points.xyz[own].reshape(-1, 3).astype(np.float64)
        np.testing.assert_allclose(points.sdf[own].ravel(), surface.signed(xyz), atol=1e-7)
        names = np.array(points.part_ids)[np.repeat(points.part[own], 64)]
        cage = sequence.cages[4]
        np.testing.assert_array_equal(np.array(cage.part_ids)[cage.assign(xyz)[0]], names)
        assert set(names) == set(cage.part_ids)


def test_points_of_parts_are_of_training_steps_and_lie_as_far_from_the_parts_that_their_own_cuboid_moved(
    done: Path,
) -> None:
    points, sequences = read_points(done / "points", "part"), read_sequences(done / "sequences")
    assert set(points.step.tolist()) == {0, 1, 4, 5}
    assert points.shape_ids == ("a", "b", "c")
    shape = SHAPES[1]
    rest, cage = (sequences[shape.shape_id].cages[step] for step in (0, 4))
    for i, part in enumerate(shape.parts):
        moved = part.mesh.with_vertices(cage.from_unit(rest.to_unit(part.mesh.vertices, i), i))
        place = points.shape_ids.index(shape.shape_id), 4, points.part_ids.index(part.part_id)
        rows = np.flatnonzero((np.stack([points.shape_id, points.step, points.part], axis=1) == place).all(axis=1))
        assert len(rows) >= 2
        xyz = points.xyz[rows].reshape(-1, 3).astype(np.float64)
        np.testing.assert_allclose(points.sdf[rows].ravel(), SurfaceDistance(moved).signed(xyz), atol=1e-7)


def test_where_details_keep_their_size_cages_are_the_same_and_points_are_of_warped_parts(
    done: Path, tmp_path: Path
) -> None:
    keep = DEFORM.model_copy(update={"transfer": "keep_details"})
    deform_sequences.main(done / "shapes", done / "cuboids", done / "matches", tmp_path / "sequences", keep)
    sample_points.main(done / "shapes", tmp_path / "sequences", tmp_path / "points", SAMPLE)
    trilinear, sequences = (read_sequences(folder / "sequences") for folder in (done, tmp_path))
    shape, sequence = SHAPES[1], sequences["b"]
    for cage, other in zip(sequence.cages, trilinear["b"].cages, strict=True):
        np.testing.assert_array_equal(cage.vectors(), other.vectors())
    points, meshes = (
        read_points(tmp_path / "points", "part"),
        read_transfers(tmp_path / "sequences", ["b"])["b"].parts(shape, sequence, 4),
    )
    for i, part_id in enumerate(sequence.cages[0].part_ids):
        place = points.shape_ids.index("b"), 4, points.part_ids.index(part_id)
        rows = np.flatnonzero((np.stack([points.shape_id, points.step, points.part], axis=1) == place).all(axis=1))
        xyz = points.xyz[rows].reshape(-1, 3).astype(np.float64)
        np.testing.assert_allclose(points.sdf[rows].ravel(), SurfaceDistance(meshes[i]).signed(xyz), atol=1e-7)


@pytest.mark.parametrize("of", ["shape", "part"])
def test_each_shape_goes_to_one_shard_and_shards_get_as_many(of: PointsOf, done: Path) -> None:
    paths = shard_paths(done / "points", of)
    assert [path.name for path in paths] == [f"{of}-0000.parquet", f"{of}-0001.parquet"]
    held = [set(POINTS.open(path).read(["shape_id"])["shape_id"].to_pylist()) for path in paths]
    assert sorted(held[0] | held[1]) == ["a", "b", "c"]
    assert [len(names) for names in held] == [2, 1]


def test_two_workers_write_the_bytes_that_one_writes(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    again = run(tmp_path)
    for path in sorted(done.rglob("*")):
        if path.is_file():
            assert filecmp.cmp(path, again / path.relative_to(done), shallow=False), path


def test_manifests_name_their_inputs(done: Path) -> None:
    manifest = json.loads((done / "sequences" / "manifest.json").read_text())
    assert sorted(manifest["inputs"]) == ["cuboids", "matches", "shapes"]


def test_an_input_of_another_kind_is_refused_by_name_and_leaves_nothing(done: Path, tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match="holds 'shapes', wanted 'sequences'"):
        sample_points.main(done / "shapes", done / "shapes", tmp_path / "points", SAMPLE)
    assert list(tmp_path.iterdir()) == []


def test_the_share_of_vertices_outside_is_printed(
    done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deform_sequences.main(done / "shapes", done / "cuboids", done / "matches", tmp_path / "sequences", DEFORM)
    assert "% of a part's vertices outside their own cuboid" in capsys.readouterr().out


def test_a_shape_whose_parts_are_not_closed_is_rejected_whole(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    seat = SHAPES[0].parts[0]
    opened = replace(seat, mesh=Mesh(seat.mesh.vertices, seat.mesh.faces[1:]))
    broken = replace(SHAPES[0], parts=(opened, *SHAPES[0].parts[1:]))
    shapes = toy.write_shapes_artefact(tmp_path / "shapes", [broken, *SHAPES[1:]])
    sample_points.main(shapes, done / "sequences", tmp_path / "points", SAMPLE)
    assert "is no closed solid" in read_rejected(tmp_path / "points")["a"]
    for of in sample_points.KINDS:
        assert read_points(tmp_path / "points", of).shape_ids == ("b", "c")


def test_a_cage_that_does_not_bound_its_parts_rejects_the_shape(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    measured = Cage.signed_distance
    wide = SHAPES[1].parts[0].mesh.vertices

    def stretched(cage: Cage, points: np.ndarray) -> np.ndarray:
        return measured(cage, points * 1.1 if points.shape == wide.shape and (points == wide).all() else points)

    monkeypatch.setattr(Cage, "signed_distance", stretched)
    fit_cuboids.main(done / "shapes", tmp_path / "cuboids", FIT.model_copy(update={"max_rejected": 0.5}))
    assert list(read_rejected(tmp_path / "cuboids")) == ["b"]
    assert "b" not in read_cages(tmp_path / "cuboids")
