"""The classifier whose features shapes are compared in: laws of the network, of its training, of its file."""

import filecmp
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save
from torch.nn.functional import cross_entropy

from cagesdf.errors import InputError
from cagesdf.io.features import FILE, KEY, read_accuracy, read_features, write_features
from cagesdf.models.pointnet import make_classifier
from cagesdf.synthesis.dataset import CATEGORIES
from cagesdf.synthesis.recipe import Recipe
from cagesdf.training.features import ClassifierSettings, add_gradients, classify, train_classifier
from pipeline import FeaturesParams, artefact
from stages import train_features
from tests.support.classifier import features

SETTINGS = ClassifierSettings(steps=80, batch=16, batch_points=32, learning_rate=1e-2, seed=0)
PARAMS = FeaturesParams(
    format=1, weights="", train=9, val=3, points=64, widths=(16, 32), hidden=16, steps=4, batch=12, batch_points=32,
    learning_rate=1e-3, seed=10,
)  # fmt: skip


def spheres_and_boxes(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Surfaces of spheres and of cubes of about one size, and which are cubes."""
    points, boxes = rng.normal(size=(count, 64, 3)), np.arange(count) % 2
    scale = np.where(
        boxes[:, None, None], np.abs(points).max(axis=-1, keepdims=True), np.linalg.norm(points, axis=-1, keepdims=True)
    )
    return (points / scale).astype(np.float32), boxes


def test_the_order_of_points_and_their_repetition_change_nothing() -> None:
    model = make_classifier((8, 16), 8, 3, seed=1)
    points = torch.randn(2, 20, 3, generator=torch.Generator().manual_seed(0))
    features = model.features(points)
    assert features.shape == (2, 16)
    order = torch.randperm(20, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(model.features(points[:, order]), features)
    torch.testing.assert_close(model.features(torch.cat([points, points[:, :5]], dim=1)), features)
    assert (model.features(torch.cat([points, 3 * points], dim=1)) >= features - 1e-6).all()


def test_a_seed_gives_the_same_network_and_leaves_torchs_generator_as_it_was() -> None:
    torch.manual_seed(5)
    before = torch.get_rng_state()
    first, again, other = (make_classifier((8, 16), 8, 3, seed=seed).state_dict() for seed in (1, 1, 2))
    assert torch.equal(torch.get_rng_state(), before)
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["point.0.weight"], other["point.0.weight"])


def test_the_gradient_in_slices_is_that_of_the_batch() -> None:
    model = make_classifier((8, 16), 8, 2, seed=1)
    points, boxes = spheres_and_boxes(21, np.random.default_rng(0))
    seen, wanted = torch.from_numpy(points), torch.from_numpy(boxes)
    loss = cross_entropy(model(seen), wanted)
    expected = torch.autograd.grad(loss, list(model.parameters()))
    with ThreadPoolExecutor(2) as pool:
        assert add_gradients(model, seen, wanted, pool) == pytest.approx(loss.item(), rel=1e-5)
    for parameter, gradient in zip(model.parameters(), expected):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-4, atol=1e-6)


def trained(threads: int) -> tuple[dict[str, torch.Tensor], list[float], float]:
    model, losses = make_classifier((16, 32), 16, 2, seed=1), []
    points, boxes = spheres_and_boxes(40, np.random.default_rng(0))
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        train_classifier(
            model, torch.from_numpy(points), torch.from_numpy(boxes), SETTINGS, lambda step, loss: losses.append(loss)
        )
    finally:
        torch.set_num_threads(before)
    new, wanted = spheres_and_boxes(40, np.random.default_rng(1))
    return model.state_dict(), losses, float((classify(model, new)[1] == wanted).mean())


def test_it_learns_to_tell_new_shapes_apart_with_the_same_bits_on_any_number_of_threads() -> None:
    weights, losses, right = trained(1)
    assert len(losses) == SETTINGS.steps
    assert losses[-1] < 0.7 * losses[0]
    assert right > 0.9
    again, *_ = trained(3)
    assert all(torch.equal(weights[name], again[name]) for name in weights)


def test_features_of_many_shapes_are_those_of_each_alone() -> None:
    model = make_classifier((8, 16), 8, 2, seed=1)
    points, _ = spheres_and_boxes(11, np.random.default_rng(2))
    features, classes = classify(model, points)
    assert (features.shape, features.dtype, classes.shape) == ((11, 16), np.float64, (11,))
    for i in range(11):
        alone, best = classify(model, points[i : i + 1])
        np.testing.assert_allclose(alone[0], features[i], rtol=1e-5, atol=1e-6)
        assert best[0] == classes[i]


def test_a_classifier_is_read_as_it_was_written(tmp_path: Path) -> None:
    write_features(tmp_path, features(), {"category": 0.5})
    found = read_features(tmp_path / FILE)
    assert (found.widths, found.hidden, found.classes, found.points) == ((8, 16), 8, ("chair/arms", "vase/urn"), 32)
    assert found.categories == {"chair", "vase"}
    assert found.category(1) == "vase"
    points = torch.zeros(1, 5, 3)
    assert torch.equal(found.model(points), features().model(points))
    assert read_accuracy(tmp_path) == {"category": 0.5}
    assert found.taken(np.ones((1, 40, 3), np.float32)).shape == (1, 32, 3)
    with pytest.raises(InputError, match="at least 32 points, got 31"):
        found.taken(np.ones((1, 31, 3), np.float32))


def spoiled(change: str, folder: Path) -> Path:
    write_features(folder, features(), {})
    path, weights = folder / FILE, features().model.state_dict()
    about = {"kind": "features", "version": 1, "widths": [8, 16], "hidden": 8, "classes": ["a", "b"], "points": 32}
    if change == "cut":
        path.write_bytes(path.read_bytes()[:-9])
    elif change == "not finite":
        weights["head.1.bias"][0] = torch.nan
        path.write_bytes(save(weights, {KEY: json.dumps(about)}))
    elif change == "missing":
        path.unlink()
    elif change == "no metadata":
        path.write_bytes(save(weights))
    else:
        path.write_bytes(save(weights, {KEY: json.dumps(about | json.loads(change))}))
    return path


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("cut", "is damaged, or no safetensors file"),
        ("not finite", "NaN or infinite"),
        ("missing", "no such file"),
        ("no metadata", "is no classifier of this project"),
        ('{"kind": "run"}', "holds run version 1"),
        ('{"version": 2}', "holds features version 2"),
        ('{"hidden": 9}', "doesn't hold the weights that are described"),
        ('{"classes": ["a"]}', "doesn't hold the weights that are described"),
        ('{"points": 0}', "wanted points from 1 to"),
        ('{"widths": "wide"}', "wanted widths to be a list"),
        ('{"widths": []}', "at least one"),
    ],
)
def test_another_file_or_a_damaged_one_is_refused_by_name(change: str, said: str, tmp_path: Path) -> None:
    path = spoiled(change, tmp_path)
    with pytest.raises(InputError, match=said) as error:
        read_features(path)
    assert FILE in str(error.value)


def test_a_missing_accuracy_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"accuracy\.json: no such file"):
        read_accuracy(tmp_path)


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAGESDF_WORKERS", "1")
        out = tmp_path_factory.mktemp("stage") / "features"
        train_features.main(out, PARAMS)
        return out


def test_the_stage_knows_all_families_of_all_categories_and_says_how_well(stage: Path) -> None:
    found, accuracy = read_features(stage / FILE), read_accuracy(stage)
    assert set(found.classes) == {f"{name}/{f}" for name, kit in CATEGORIES.items() for f in kit.families}
    assert accuracy["shapes"] == 3 * 3
    assert 0 <= accuracy["family"] <= accuracy["category"] <= 1


def test_the_stage_gives_the_same_bytes_in_any_number_of_processes(
    stage: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "2")
    train_features.main(tmp_path / "features", PARAMS)
    for path in stage.iterdir():
        assert filecmp.cmp(path, tmp_path / "features" / path.name, shallow=False), path.name


def test_weights_trained_elsewhere_are_taken_as_they_are(
    stage: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    given = PARAMS.model_copy(update={"weights": str(stage / FILE)})
    train_features.main(tmp_path / "taken", given)
    assert filecmp.cmp(stage / FILE, tmp_path / "taken" / FILE, shallow=False)
    assert read_accuracy(tmp_path / "taken") == read_accuracy(stage)
    manifest = json.loads((tmp_path / "taken" / artefact.MANIFEST).read_text(encoding="utf-8"))
    assert manifest["inputs"] == {"weights": artefact.digest_file(stage / FILE)}

    write_features(tmp_path, features(), {})
    train_features.main(tmp_path / "other", PARAMS.model_copy(update={"weights": str(tmp_path / FILE)}))
    assert read_accuracy(tmp_path / "other") == {"shapes": 9, "category": None, "family": None}
    with pytest.raises(InputError, match=r"nowhere\.safetensors: no such file"):
        train_features.main(tmp_path / "none", PARAMS.model_copy(update={"weights": "nowhere.safetensors"}))


def test_a_rejected_shape_takes_its_label_and_cloud_with_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    whole, sampled = train_features.drawn("train", 2, PARAMS), train_features.sampled

    def some(name: str, params: FeaturesParams, recipe: Recipe) -> object:
        if recipe.shape_id == whole.ids[1]:
            raise train_features.lost(recipe, "bad luck")
        return sampled(name, params, recipe)

    monkeypatch.setattr(train_features, "sampled", some)
    part = train_features.drawn("train", 2, PARAMS)
    rest = [0, *range(2, len(whole))]
    assert part.ids == tuple(whole.ids[i] for i in rest)
    assert part.labels == tuple(whole.labels[i] for i in rest)
    np.testing.assert_array_equal(part.points, whole.points[rest])
    assert f"left out: shape {whole.ids[1]}, train_features: bad luck" in capsys.readouterr().out
