"""Parameters: everything is said at once, by path."""

from pathlib import Path

import pytest
import yaml

from pipeline.params import FitParams, ParamsError, TrainParams, check, load

DEFAULTS = Path(__file__).parent.parent / "params.yaml"


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
    assert arm.width == content["train"]["width"]


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
