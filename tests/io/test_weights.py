"""Foreign weights: whatever a file says of itself, it is read as it was written or refused as input."""

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.torch import save

from cagesdf.errors import InputError
from cagesdf.io.cage_generators import read_generator, write_generator
from cagesdf.io.features import FILE, KEY, read_features, write_features
from cagesdf.io.fits import LATENT, read_fit_latent
from cagesdf.io.residuals import read_residuals, write_residuals
from cagesdf.io.runs import read_run, read_snapshot, write_run, write_snapshot
from cagesdf.io.weights import Sizes, planned, read_header, read_tensors, sizes_of
from tests.support import classifier, generators, small_runs

HUGE: list[object] = [0, -1, 2**31, 2**64, 10**400, 1e308, float("nan"), True, None, "12", {}, [2**62], [[]]]
many = settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run, a snapshot of it and its residuals, a generator, a classifier and a fitted latent."""
    root = tmp_path_factory.mktemp("whole")
    for name in ("run", "programs", "features", "fit"):
        (root / name).mkdir()
    write_run(root / "run", small_runs.make_run(), [])
    write_snapshot(root / "run", 7, small_runs.tensors(read_run(root / "run")))
    write_residuals(root / "run", {"large": 0.1, "small": 0.2})
    write_generator(root / "programs", generators.on_programs(), [], {})
    write_features(root / "features", classifier.features(), {})
    (root / "fit" / LATENT).write_bytes(save({"latent": torch.ones(4), "film": torch.ones(2, 3, 2, 5)}))
    return root


Reader = Callable[[Path], Any]
WEIGHTS: dict[str, Reader] = {
    "run/weights.safetensors": lambda root: read_run(root / "run"),
    "run/snapshots/00000007.safetensors": lambda root: read_snapshot(root / "run", 7),
    "programs/weights.safetensors": lambda root: read_generator(root / "programs"),
    f"features/{FILE}": lambda root: read_features(root / "features" / FILE),
    f"fit/{LATENT}": lambda root: read_fit_latent(root / "fit"),
}
DESCRIPTIONS: dict[str, Reader] = {
    "run/arm.json": lambda root: read_run(root / "run"),
    "programs/generator.json": lambda root: read_generator(root / "programs"),
}
TABLES: dict[str, Reader] = {
    "run/latents.parquet": lambda root: read_run(root / "run"),
    "run/cages.parquet": lambda root: read_run(root / "run"),
    "run/shapes.parquet": lambda root: read_run(root / "run"),
    "run/residuals.parquet": lambda root: read_residuals(root / "run"),
    "programs/known.parquet": lambda root: read_generator(root / "programs"),
}


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    return shutil.copytree(whole, tmp_path / "copy")


def refused_or_read(read: Reader, root: Path) -> None:
    """Whatever else is raised fails the test."""
    with suppress(InputError):
        read(root)


def flipped(content: bytes, places: list[tuple[float, int]], start: int, end: int) -> bytes:
    changed = bytearray(content)
    for place, value in places:
        changed[start + int(place * (end - start))] = value
    return bytes(changed)


places = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=4)


@pytest.mark.parametrize("name", WEIGHTS)
@many
@given(places)
def test_a_header_with_other_bytes_is_refused_as_input_or_says_the_same(name: str, copy: Path, where: list) -> None:
    content = (copy / name).read_bytes()
    end = 8 + int.from_bytes(content[:8], "little")
    try:
        (copy / name).write_bytes(flipped(content, where, 0, end))
        refused_or_read(WEIGHTS[name], copy)
    finally:
        (copy / name).write_bytes(content)


@pytest.mark.parametrize("name", TABLES)
@many
@given(places)
def test_a_table_with_other_bytes_is_refused_as_input_or_read(name: str, copy: Path, where: list) -> None:
    content = (copy / name).read_bytes()
    try:
        (copy / name).write_bytes(flipped(content, where, 0, len(content)))
        refused_or_read(TABLES[name], copy)
    finally:
        (copy / name).write_bytes(content)


def keys_of(content: Any) -> list[tuple[str, ...]]:
    if not isinstance(content, dict):
        return [()]
    return [(), *((key, *rest) for key in content for rest in keys_of(content[key]))]


def changed(content: Any, path: tuple[str, ...], value: Any) -> Any:
    return value if not path else {**content, path[0]: changed(content[path[0]], path[1:], value)}


@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_any_value_in_the_place_of_any_other_in_a_description_is_refused_as_input_or_read(
    name: str, copy: Path
) -> None:
    content = json.loads((copy / name).read_text(encoding="utf-8"))
    for path in keys_of(content):
        for value in HUGE:
            (copy / name).write_text(json.dumps(changed(content, path, value)), encoding="utf-8")
            refused_or_read(DESCRIPTIONS[name], copy)
    for text in ("[" * 100_000, '{"a":' * 100_000, "9" * 10_000, "", "\ufeff{}", "NaN"):
        (copy / name).write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=Path(name).name):
            DESCRIPTIONS[name](copy)


def test_any_value_in_the_place_of_any_other_in_a_classifiers_metadata_is_refused_as_input_or_read(
    tmp_path: Path,
) -> None:
    weights = classifier.features().model.state_dict()
    about = {"kind": "features", "version": 1, "widths": [8, 16], "hidden": 8, "classes": ["a", "b"], "points": 32}
    path = tmp_path / FILE
    for key in about:
        for value in HUGE:
            path.write_bytes(save(weights, {KEY: json.dumps(about | {key: value})}))
            refused_or_read(lambda root: read_features(root / FILE), tmp_path)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("run/arm.json", ("params", {"width": 65_536, "layers": 256, "mapping": [65_536] * 256})),
        ("programs/generator.json", ("width", 65_536)),
    ],
)
def test_a_huge_network_is_refused_before_it_has_any_memory(
    name: str, change: tuple[str, Any], copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def allocated(*_: object, **__: object) -> None:
        raise AssertionError("memory was asked for")

    content = json.loads((copy / name).read_text(encoding="utf-8"))
    key, value = change
    content[key] = {**content[key], **value} if isinstance(value, dict) else value
    (copy / name).write_text(json.dumps(content), encoding="utf-8")
    monkeypatch.setattr(torch.nn.Module, "to_empty", allocated)
    with pytest.raises(InputError, match="doesn't hold the weights that are described"):
        DESCRIPTIONS[name](copy)


def test_a_planned_network_has_sizes_and_no_memory() -> None:
    layer = planned(lambda: torch.nn.Linear(10**6, 10**6))
    assert sizes_of(layer) == {"weight": (10**6, 10**6), "bias": (10**6,)}
    assert all(parameter.device.type == "meta" for parameter in layer.parameters())


@pytest.mark.parametrize(
    ("tensor", "said"),
    [
        (torch.zeros(2, 3, dtype=torch.float16), "F16 of size"),
        (torch.zeros(2, 3, dtype=torch.int64), "I64 of size"),
        (torch.zeros(0, 3), "one number at least"),
        (torch.zeros(3, 2), r"a has the size \[3, 2\], wanted \[2, 3\]"),
        (torch.full((2, 3), torch.inf), "not finite"),
    ],
)
def test_tensors_of_another_kind_or_size_are_refused_by_name(tensor: torch.Tensor, said: str, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    path.write_bytes(save({"a": tensor}))
    with pytest.raises(InputError, match=said) as error:
        read_tensors(path, {"a": (2, 3)})
    assert "w.safetensors" in str(error.value)


def test_a_tensor_too_many_or_too_few_is_refused_and_just_the_right_ones_are_read(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    path.write_bytes(save({"a": torch.ones(2), "b": torch.ones(3)}))
    cases: list[tuple[Sizes, str]] = [
        ({"a": (2,)}, r"b has the size \[3\], wanted none"),
        ({"c": (1,)}, "a has the size"),
    ]
    for sizes, message in cases:
        with pytest.raises(InputError, match=message):
            read_tensors(path, sizes)
    assert read_header(path)[0] == {"a": (2,), "b": (3,)}
    tensors = read_tensors(path, {"b": (3,), "a": (2,)})
    np.testing.assert_array_equal(tensors["b"].numpy(), np.ones(3))


def test_a_pickle_is_no_weights_file(copy: Path) -> None:
    torch.save({"a": torch.ones(2)}, copy / "run" / "weights.safetensors")
    with pytest.raises(InputError, match="no safetensors file"):
        read_run(copy / "run")
