"""Runs: self-contained, read back as they were, refused by name where they are not whole."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cagesdf.errors import InputError
from cagesdf.io.runs import read_run, read_snapshot, snapshots_of, write_run, write_snapshot
from cagesdf.models.arms import DECODERS, make_decoder, sizes_of_decoder
from cagesdf.models.codes import part_codes
from cagesdf.models.decoders import CageDecoder
from tests.support.small_runs import PARAMS, make_run, tensors

LOG = [{"step": 1, "loss": 0.5, "l1": 0.4, "latent_norm": 0.1}]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_run(tmp_path, make_run(), LOG)
    return tmp_path


def test_a_run_comes_back_as_it_was(folder: Path) -> None:
    before, after = make_run(), read_run(folder)
    assert not after.decoder.training
    assert not any(parameter.requires_grad for parameter in after.decoder.parameters())
    cage = after.sequences["large"].cages[1]
    cuboid = torch.from_numpy(cage.vectors()).float()
    points = torch.rand(1, 9, 3, generator=torch.Generator().manual_seed(0))
    latent = after.latent("large", 1)
    assert torch.equal(latent, before.latent("large", 1))
    with torch.no_grad():
        one, other = (run.decoder(points, part_codes(run.decoder, latent, cage), cuboid) for run in (after, before))
    assert torch.equal(one, other)
    assert after.params == PARAMS
    assert after.points == before.points
    for shape_id, sequence in before.sequences.items():
        assert after.sequences[shape_id].held_out == sequence.held_out
        for one, other in zip(after.sequences[shape_id].cages, sequence.cages):
            assert one.part_ids == other.part_ids
            assert np.array_equal(one.vectors(), other.vectors())
        assert after.structures[shape_id].to_json() == before.structures[shape_id].to_json()
        assert after.similarities[shape_id].to_numbers() == before.similarities[shape_id].to_numbers()
    assert [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()] == LOG


def test_the_same_run_gives_the_same_bytes_and_nothing_pickled(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    other = tmp_path_factory.mktemp("other")
    write_run(other, make_run(), LOG)
    names = ["arm.json", "cages.parquet", "latents.parquet", "log.jsonl", "shapes.parquet", "weights.safetensors"]
    assert sorted(path.name for path in folder.iterdir()) == names
    assert all((folder / name).read_bytes() == (other / name).read_bytes() for name in names)


def test_a_run_comes_back_as_it_was_after_some_steps(folder: Path) -> None:
    now = tensors(read_run(folder))
    then = {name: tensor + i + 1 for i, (name, tensor) in enumerate(now.items())}
    write_snapshot(folder, 1000, then)
    write_snapshot(folder, 30, now)
    assert snapshots_of(folder) == (30, 1000)
    read = read_snapshot(folder, 1000)
    assert all(torch.equal(tensor, then[name]) for name, tensor in tensors(read).items())
    assert torch.equal(read.latent("small", 0), then["latents"][1])
    assert not any(parameter.requires_grad for parameter in (*read.decoder.parameters(), *read.latents.parameters()))
    assert all(torch.equal(tensor, now[name]) for name, tensor in tensors(read_run(folder)).items())


def test_a_snapshot_that_is_missing_or_of_another_network_is_named(folder: Path) -> None:
    with pytest.raises(InputError, match=r"00000007\.safetensors: no such file"):
        read_snapshot(folder, 7)
    now = tensors(read_run(folder))
    write_snapshot(folder, 7, {name: tensor for name, tensor in now.items() if name != "decoder.out.weight"})
    with pytest.raises(InputError, match=r"00000007\.safetensors: doesn't hold the weights.*decoder\.out"):
        read_snapshot(folder, 7)
    write_snapshot(folder, 7, {**now, "latents": now["latents"][:1]})
    with pytest.raises(InputError, match=r"00000007\.safetensors: doesn't hold the weights.*latents has the size"):
        read_snapshot(folder, 7)


def test_steps_are_all_of_a_shape_or_those_with_a_latent_of_their_own(tmp_path: Path) -> None:
    assert make_run().steps("large") == (0, 1)
    own = make_run((("large", 1), ("small", 0)))
    assert own.steps("large") == (1,)
    with pytest.raises(InputError, match="shape large, step 0"):
        own.latent("large", 0)


@pytest.mark.parametrize(
    "name", ["arm.json", "weights.safetensors", "latents.parquet", "cages.parquet", "shapes.parquet"]
)
def test_a_missing_or_damaged_file_is_named(name: str, folder: Path) -> None:
    whole = (folder / name).read_bytes()
    (folder / name).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=name):
        read_run(folder)
    (folder / name).unlink()
    with pytest.raises(InputError, match=name):
        read_run(folder)


@pytest.mark.parametrize("change", [{"version": 2}, {"kind": "meshes"}])
def test_another_kind_or_version_is_refused_by_name(change: dict, folder: Path) -> None:
    arm = json.loads((folder / "arm.json").read_text())
    (folder / "arm.json").write_text(json.dumps({**arm, **change}))
    with pytest.raises(InputError, match="wanted run version 1"):
        read_run(folder)


def test_a_decoder_that_there_is_not_is_refused_with_the_file_and_those_there_are(folder: Path) -> None:
    arm = json.loads((folder / "arm.json").read_text())
    arm["params"]["decoder"] = "LocalCageDecoder"
    (folder / "arm.json").write_text(json.dumps(arm))
    with pytest.raises(
        InputError,
        match=r"arm\.json.*TriplaneDecoder, OccupancyDecoder, CageDecoder.*got LocalCageDecoder; train again",
    ):
        read_run(folder)


def test_weights_of_another_network_are_refused(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    arm = json.loads((folder / "arm.json").read_text())
    arm["params"]["width"] = 16
    (folder / "arm.json").write_text(json.dumps(arm))
    with pytest.raises(InputError, match=r"weights\.safetensors: doesn't hold the weights.*, wanted \[.*16"):
        read_run(folder)


def test_latents_of_another_length_are_refused(folder: Path) -> None:
    arm = json.loads((folder / "arm.json").read_text())
    arm["params"]["latent_dim"] = 5
    (folder / "arm.json").write_text(json.dumps(arm))
    with pytest.raises(InputError, match=r"latents\.parquet.*5 numbers"):
        read_run(folder)


@pytest.mark.parametrize(
    ("size", "value"),
    [
        ("cells", 1),
        ("cells", 257),
        ("channels", 0),
        ("line_cells", 1),
        ("line_channels", 65),
        ("heads", 65),
        ("heads", 3),
        ("context", "8"),
        ("code_dim", None),
    ],
)
def test_sizes_that_make_no_network_are_refused_by_name(size: str, value: object, folder: Path) -> None:
    arm = json.loads((folder / "arm.json").read_text())
    (folder / "arm.json").write_text(json.dumps({**arm, "params": {**arm["params"], size: value}}))
    with pytest.raises(InputError, match=rf"arm\.json.*{size}"):
        read_run(folder)


@pytest.mark.parametrize("name", ["TriplaneDecoder", "OccupancyDecoder", "CageDecoder", "DeepSdfDecoder"])
def test_a_run_needs_the_sizes_of_its_own_decoder_alone(name: str, tmp_path: Path) -> None:
    params = {size: PARAMS[size] for size in {*sizes_of_decoder(name), "latent_dim", "reach", "clamp"}}
    decoder = make_decoder(name, **{size: params[size] for size in sizes_of_decoder(name)}, seed=1)
    write_run(tmp_path, replace(make_run(), decoder=decoder, params={**params, "decoder": name}), LOG)
    assert type(read_run(tmp_path).decoder) is type(decoder)


class SharpDecoder(CageDecoder):
    """A decoder with a number that isn't whole."""

    def __init__(self, width: int, layers: int, latent_dim: int, mapping: tuple[int, ...], sharpness: float) -> None:
        super().__init__(width, layers, latent_dim, mapping, octaves=0)
        self.sharpness = sharpness


def test_numbers_that_are_not_whole_are_read_if_they_are_finite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(DECODERS, "SharpDecoder", SharpDecoder)
    params = {size: PARAMS[size] for size in ("width", "layers", "latent_dim", "mapping")}
    decoder = make_decoder("SharpDecoder", **params, sharpness=0.25, seed=1)
    others = {"reach": PARAMS["reach"], "clamp": PARAMS["clamp"], "decoder": "SharpDecoder"}
    write_run(tmp_path, replace(make_run(), decoder=decoder, params={**params, **others, "sharpness": 0.25}), LOG)
    path = tmp_path / "arm.json"
    arm = json.loads(path.read_text())
    for value in (0.25, 3, -1e-3):
        path.write_text(json.dumps({**arm, "params": {**arm["params"], "sharpness": value}}))
        read = read_run(tmp_path).decoder
        assert isinstance(read, SharpDecoder)
        assert read.sharpness == value
    for wrong in (float("nan"), float("inf"), "3", None, True, [0.5]):
        path.write_text(json.dumps({**arm, "params": {**arm["params"], "sharpness": wrong}}))
        with pytest.raises(InputError, match=r"wanted a finite number sharpness"):
            read_run(tmp_path)
