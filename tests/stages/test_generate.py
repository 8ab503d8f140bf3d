"""The generate stage: new shapes by each method of an arm, the same bytes each time, nothing dropped in silence."""

from pathlib import Path

import numpy as np
import pytest

from cagesdf.cage_generation.generator import Generated, Generator, Samples, samples_of
from cagesdf.cage_generation.trained import TrainedGenerator
from cagesdf.errors import InputError
from cagesdf.geometry.meshes import is_closed
from cagesdf.io.generated_shapes import read_generated
from cagesdf.io.runs import read_run
from cagesdf.shape_generation.cages import ROUNDS, draw_cages
from cagesdf.shape_generation.static_stability import rooted, stable
from pipeline import GenerateParams, load
from pipeline.artefact import ArtefactError
from stages.generate import main
from tests.support.stools import CAGES, STRUCTURES, write_arm, write_programs

ROOT = Path(__file__).parents[2]


def small(**changes: object) -> GenerateParams:
    params = load("generate", ROOT / "params.yaml")
    return params.model_copy(update={"shapes": 4, "resolution": 32, "points": 100, **changes})


@pytest.fixture
def arms(tmp_path: Path) -> Path:
    write_arm(tmp_path / "runs" / "full", -0.05)
    write_arm(tmp_path / "runs" / "empty", 0.05)
    write_arm(tmp_path / "runs" / "whole", 0.05, trains_on="cube")
    write_programs(tmp_path / "programs")
    return tmp_path


def made(arms: Path, arm: str, name: str = "out", **changes: object) -> Path:
    main(arms / "runs" / arm, arms / "programs", arms / name / arm, small(**changes))
    return arms / name / arm


def test_methods_share_cages_and_each_shape_has_its_surface_in_them(arms: Path, capsys: pytest.CaptureFixture) -> None:
    found = read_generated(made(arms, "full"))
    assert found.methods == ("independent", "dependent")
    assert len(found.rows) == 8
    for (method, shape_id), row in found.rows.items():
        cage, mesh = found.cage(method, shape_id), found.surface(method, shape_id)
        np.testing.assert_array_equal(cage.vectors(), found.cage("independent", shape_id).vectors())
        assert (row["status"], row["closed"], row["components"]) == ("ok", True, 1)
        assert is_closed(mesh)
        assert (len(mesh.vertices), len(mesh.faces)) == (row["vertices"], row["faces"])
        points = found.points(method)[shape_id]
        assert points.shape == (100, 3)
        assert np.abs(cage.signed_distance(points).min(axis=1)).max() < 0.05, "full cuboids are the surface"
        assert (row["rooted"], row["stable"]) == (rooted(cage), stable(cage))
        structure = found.structure(method, shape_id)
        assert structure is not None
        assert structure.signature() == STRUCTURES["stool_0"].signature()
    assert found.about["methods"]["dependent"]["kernels"] == 4
    said = capsys.readouterr().out
    assert "dependent: 4 shapes, 4 with a surface" in said
    assert "of 4 codes in effect" in said


def test_all_arms_and_methods_with_cuboids_draw_the_same_cages_and_other_seeds_others(arms: Path) -> None:
    full, empty = read_generated(made(arms, "full")), read_generated(made(arms, "empty"))
    other = read_generated(made(arms, "full", "other", seed=11))
    for key, row in full.rows.items():
        assert row["cuboids"] == empty.rows[key]["cuboids"] != other.rows[key]["cuboids"]
        assert row["latent"] == empty.rows[key]["latent"] != other.rows[key]["latent"]


def test_shapes_without_surface_are_kept_and_counted(arms: Path, capsys: pytest.CaptureFixture) -> None:
    found = read_generated(made(arms, "empty"))
    assert {row["status"] for row in found.rows.values()} == {"empty"}
    assert len(found.points("dependent")["00000"]) == 0
    assert len(found.surface("dependent", "00000").faces) == 0
    assert "0 with a surface, 0 in one piece, 4 empty, 0 broken" in capsys.readouterr().out


def test_a_surface_that_breaks_its_promises_is_kept_with_the_reason(
    arms: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ValueError("the surface of 7 faces is inside out")

    monkeypatch.setattr("cagesdf.shape_generation.surfaces.extract", broken)
    rows = read_generated(made(arms, "full")).rows.values()
    assert {row["status"] for row in rows} == {"broken: the surface of 7 faces is inside out"}


def test_a_diverged_network_stops_the_stage(arms: Path) -> None:
    write_arm(arms / "runs" / "diverged", float("nan"))
    with pytest.raises(InputError, match="not finite"):
        made(arms, "diverged")
    assert not (arms / "out" / "diverged").exists()


def test_an_arm_without_cuboids_has_one_method_and_no_cages(arms: Path) -> None:
    found = read_generated(made(arms, "whole"))
    assert found.methods == ("isotropic",)
    assert len(found.rows) == 4
    row = found.rows["isotropic", "00001"]
    assert (row["part_ids"], row["structure"], row["rooted"], row["status"]) == ([], "", False, "empty")
    assert found.structure("isotropic", "00001") is None


@pytest.mark.parametrize("arm", ["full", "whole"])
def test_the_same_inputs_give_the_same_bytes_for_any_number_of_workers(
    arm: str, arms: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for workers in ("1", "2"):
        monkeypatch.setenv("CAGESDF_WORKERS", workers)
        made(arms, arm, workers)
    files = sorted(path.name for path in (arms / "1" / arm).iterdir())
    assert files == ["index.parquet", "manifest.json", "points.parquet", "surfaces.parquet"]
    for name in files:
        assert (arms / "1" / arm / name).read_bytes() == (arms / "2" / arm / name).read_bytes(), name


def test_tau_is_the_one_given_and_a_huge_one_makes_the_methods_alike(arms: Path) -> None:
    found = read_generated(made(arms, "full", tau=1e9))
    assert found.about["methods"]["dependent"]["tau"] == 1e9
    for (method, shape_id), row in found.rows.items():
        assert row["latent"] == found.rows["independent", shape_id]["latent"], method
        assert row["effective"] == pytest.approx(4)


def test_temperature_zero_gives_codes_of_training_shapes_and_the_mean_cage(arms: Path) -> None:
    known = {tuple(code) for code in read_run(arms / "runs" / "full").latents.values.tolist()}
    rows = read_generated(made(arms, "full", temperature=0.0)).rows.values()
    assert {tuple(row["latent"]) for row in rows} <= known
    assert len({tuple(row["cuboids"]) for row in rows}) == 1


def test_artefacts_in_the_wrong_order_and_unknown_shapes_are_refused(arms: Path) -> None:
    with pytest.raises(ArtefactError, match="wanted 'run'"):
        main(arms / "programs", arms / "runs" / "full", arms / "out", small())
    with pytest.raises(InputError, match="no shape '9' of method 'dependent'"):
        read_generated(made(arms, "full")).surface("dependent", "9")


class Seldom(Generator):
    """Every third draw is valid."""

    def sample(self, rng: np.random.Generator, count: int, temperature: float) -> Samples:
        kept = Generated(STRUCTURES["stool_0"], CAGES["stool_0"])
        return samples_of([kept if rng.random() < 1 / 3 else "bad luck" for _ in range(count)])


def test_draws_go_on_until_there_are_enough_cages_and_all_of_them_are_counted() -> None:
    samples = draw_cages(TrainedGenerator(Seldom(), STRUCTURES, CAGES), np.random.default_rng(0), 20, 1.0)
    assert len(samples.kept) == 20
    drawn = 20 + samples.failures["bad luck"]
    assert list(samples.numbers) == sorted(set(samples.numbers))
    assert max(samples.numbers) < drawn <= ROUNDS * 20


def test_draws_end_where_nothing_is_valid() -> None:
    class Never(Generator):
        def sample(self, rng: np.random.Generator, count: int, temperature: float) -> Samples:
            return samples_of(["never"] * count)

    samples = draw_cages(TrainedGenerator(Never(), STRUCTURES, CAGES), np.random.default_rng(0), 5, 1.0)
    assert (samples.kept, samples.failures) == ((), {"never": 5 * ROUNDS})
