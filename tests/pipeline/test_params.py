"""Parameters: everything is said at once, by path."""

from pathlib import Path

import pytest
import yaml

from pipeline.params import FitParams, ParamsError, TrainParams, check, load

DEFAULTS = Path(__file__).parents[2] / "params.yaml"


@pytest.fixture
def content() -> dict:
    return yaml.safe_load(DEFAULTS.read_text(encoding="utf-8"))


def written(folder: Path, content: dict) -> Path:
    path = folder / "params.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_one_error_names_every_unknown_missing_and_ill_typed_parameter(tmp_path: Path, content: dict) -> None:
    content["fit_cuboids"]["slak"] = 0.02
    del content["sample_points"]["beta"]
    content["evaluate"]["points"] = "many"
    content["arms"]["cagesdf"] = {"depth": 3}
    with pytest.raises(ParamsError) as caught:
        check(written(tmp_path, content))
    for place in ("fit_cuboids.slak", "sample_points.beta", "evaluate.points", "arms.cagesdf.depth", "'many'"):
        assert place in str(caught.value)


def test_a_mistake_in_train_is_said_once_and_not_for_every_arm(tmp_path: Path, content: dict) -> None:
    del content["train"]["width"]
    with pytest.raises(ParamsError) as caught:
        check(written(tmp_path, content))
    assert str(caught.value).count("width") == 1


def test_an_arm_is_train_with_its_differences(content: dict) -> None:
    arm = load("arms.deepsdf", DEFAULTS)
    assert isinstance(arm, TrainParams)
    assert arm.decoder == "DeepSdfDecoder"
    assert arm.width == content["arms"]["deepsdf"]["width"] != content["train"]["width"]
    assert arm.log_every == content["train"]["log_every"]


def test_the_schema_has_no_defaults(tmp_path: Path, content: dict) -> None:
    for section in content:
        if section not in ("arms", "format"):
            for name in content[section]:
                lacking = {**content, section: {k: v for k, v in content[section].items() if k != name}}
                with pytest.raises(ParamsError, match=rf"{section}\.{name}: field required"):
                    check(written(tmp_path, lacking))


def test_unknown_and_missing_sections_are_named(tmp_path: Path, content: dict) -> None:
    content["fit_cuboid"] = content.pop("fit_cuboids")
    with pytest.raises(ParamsError, match=r"fit_cuboid: unknown section.*fit_cuboids: section missing"):
        check(written(tmp_path, content))


def test_an_arm_that_is_run_but_not_described_is_named(tmp_path: Path, content: dict) -> None:
    content["run"]["arms"].append("cagesdf_2")
    with pytest.raises(ParamsError, match="no arm 'cagesdf_2'"):
        check(written(tmp_path, content))


def test_a_stage_has_the_categories_and_arms_that_are_run_and_they_stand_in_one_place(
    tmp_path: Path, content: dict
) -> None:
    content["run"] |= {"categories": ["chair"], "arms": ["deepsdf", "cagesdf"], "generators": ["deepsdf"]}
    sections = check(written(tmp_path, content))
    for stage in ("evaluate", "evaluate_progress", "evaluate_edits", "report"):
        assert sections[stage].model_dump()["arms"] == ("deepsdf", "cagesdf")
    report, generation = (sections[stage].model_dump() for stage in ("report", "evaluate_generation"))
    assert report["categories"] == ("chair",)
    assert report["generators"] == generation["generators"] == ("deepsdf",)
    content["evaluate"]["arms"] = ["cage"]
    with pytest.raises(ParamsError, match=r"evaluate\.arms: stands under run"):
        check(written(tmp_path, content))


@pytest.mark.parametrize(
    ("section", "changes", "say"),
    [
        ("run", {"arms": ["cagesdf", "cagesdf"], "generators": ["cagesdf"]}, r"run\.arms: names one twice"),
        ("run", {"categories": []}, r"run\.categories: .*at least 1 item"),
        ("run", {"categories": ["../chair"]}, r"run\.categories\.0: .*pattern"),
        ("run", {"generators": ["cage"]}, r"run\.generators: no arm 'cage' in run\.arms"),
        ("deform_sequences", {"held_out": [6]}, r"deform_sequences\.held_out: got \(6,\), wanted steps among 1 to 5"),
        ("deform_sequences", {"held_out": [0]}, r"wanted steps among 1 to 5"),
        ("generate", {"points": 2047}, r"generate\.points: got 2047, wanted at least train_features\.points, 2048"),
        ("make_clouds", {"points": 255}, r"make_clouds\.points: .*evaluate_generation\.points, 256"),
        ("make_clouds", {"seed": 1}, r"make_clouds\.seed: got 1, wanted another than synthesize\.seed"),
    ],
    ids=[
        "an arm twice",
        "no category",
        "a category that is a path",
        "a generator that is not run",
        "a step too late",
        "the rest shape held out",
        "fewer points than features need",
        "fewer points than are compared",
        "one seed",
    ],
)
def test_what_sections_say_against_each_other_is_said_before_any_stage_runs(
    section: str, changes: dict, say: str, tmp_path: Path, content: dict
) -> None:
    content[section] |= changes
    with pytest.raises(ParamsError, match=say):
        check(written(tmp_path, content))


def test_a_missing_file_and_broken_yaml_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ParamsError, match=r"params\.yaml: can't be read"):
        load("train", tmp_path / "params.yaml")
    (tmp_path / "params.yaml").write_text("train: [", encoding="utf-8")
    with pytest.raises(ParamsError, match="is not YAML"):
        load("train", tmp_path / "params.yaml")


def test_parameters_are_frozen() -> None:
    params = load("fit_cuboids", DEFAULTS)
    assert isinstance(params, FitParams)
    with pytest.raises(ValueError, match="frozen"):
        params.slack = 1.0
