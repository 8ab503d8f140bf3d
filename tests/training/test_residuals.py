"""How well a run fits its shapes: against a loop over points, and without more than it must read."""

from pathlib import Path

import numpy as np
import pytest
import torch

from cagesdf.io.points import CHUNK, PointChunks, PointsOf, shard_path, write_shard
from cagesdf.models.arms import make_decoder
from cagesdf.models.codes import part_codes
from cagesdf.models.decoders import Decoder
from cagesdf.models.latents import SHARED, LatentTable
from cagesdf.training import residuals
from cagesdf.training.batches import Owners, cuboid_distance
from cagesdf.training.residuals import rest_residuals
from tests.support import spheres

DECODERS = {
    name: make_decoder(name, **spheres.SIZES, seed=0) for name in ("TriplaneDecoder", "CageDecoder", "DeepSdfDecoder")
}
CLAMP = 0.3
LATENTS = LatentTable.drawn((("large", SHARED), ("small", SHARED)), 4, 1.0, seed=1)


def shards(folder: Path, of: PointsOf) -> list[PointChunks]:
    """Two shards of the same shapes, with points inside and outside of the cuboids."""
    folder.mkdir()
    pieces = [spheres.chunks((6, 4, 3, 5), reach=0.7, seed=seed) for seed in (0, 1)]
    for i, piece in enumerate(pieces):
        write_shard(shard_path(folder, of, i), [piece], np.random.default_rng(i))
    return pieces


def slow(decoder: Decoder, pieces: list[PointChunks], shape_id: str, reach: float) -> float:
    """The mean over all points of a shape at rest that are within reach of their cuboid, one at a time."""
    errors = []
    for piece in pieces:
        cuboids = Owners.of(piece, spheres.sequences()).cuboids()
        near = cuboid_distance(piece.xyz, cuboids) <= reach
        for chunk in range(len(piece)):
            if piece.shape_ids[piece.shape_id[chunk]] != shape_id or piece.step[chunk]:
                continue
            latent = LATENTS.values[LATENTS.row(shape_id, 0)][None]
            for k in np.flatnonzero(near[chunk]):
                point = torch.from_numpy(piece.xyz[chunk, k])[None, None]
                with torch.no_grad():
                    code = part_codes(decoder, latent[0], spheres.sequences()[shape_id].cages[0])
                    told = decoder(point, code, torch.from_numpy(cuboids[chunk])[None])
                    unit = decoder.unit(torch.from_numpy(cuboids[chunk])[None]).item()
                given, wanted = (np.clip(value / unit, -CLAMP, CLAMP) for value in (told.item(), piece.sdf[chunk, k]))
                errors.append(abs(given - wanted))
    return float(np.mean(errors))


@pytest.mark.parametrize(
    ("name", "of", "counted"),
    [("TriplaneDecoder", "part", np.inf), ("CageDecoder", "shape", 0.02), ("DeepSdfDecoder", "shape", np.inf)],
)
def test_residuals_are_means_over_the_points_that_are_trained_on(
    name: str, of: PointsOf, counted: float, tmp_path: Path
) -> None:
    pieces = shards(tmp_path / "points", of)
    found = rest_residuals(tmp_path / "points", DECODERS[name], LATENTS, spheres.sequences(), 0.02, CLAMP)
    assert list(found) == ["large", "small"]
    for shape_id, value in found.items():
        assert value == pytest.approx(slow(DECODERS[name], pieces, shape_id, counted), rel=1e-5)


def test_no_more_chunks_of_a_shape_are_asked_than_wanted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shards(tmp_path / "points", "shape")
    monkeypatch.setattr(residuals, "CHUNKS", 2)
    decoder, asked = DECODERS["CageDecoder"], []
    with decoder.register_forward_hook(lambda _, given, __: asked.append(given[0].numel() // (3 * CHUNK))):
        rest_residuals(tmp_path / "points", decoder, LATENTS, spheres.sequences(), 0.02, CLAMP)
    assert sum(asked) == 4
