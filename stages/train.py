"""Train one arm: a decoder and its latents together (§3.1, §3.5).

python -m stages.train data/points/chair data/shapes/chair data/sequences/chair data/runs/chair/cagesdf \\
    --params arms.cagesdf

Run again after an interruption, it goes on from the last file in checkpoints/.
"""

import os
from dataclasses import asdict, fields
from pathlib import Path

import torch

from cagesdf.io.points import CHUNK, read_points
from cagesdf.io.runs import Run, write_run
from cagesdf.io.sequences import read_sequences
from cagesdf.io.shapes import read_shapes
from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import LatentTable
from cagesdf.training.batches import latent_keys, training_chunks, training_set
from cagesdf.training.checkpoint import Checkpoint, digest_of, loaded_library
from cagesdf.training.loop import TrainSettings, train
from pipeline import TrainParams, artefact, item_rng, progress, run_stage


def main(points: Path, shapes: Path, sequences: Path, out: Path, params: TrainParams) -> None:
    """Read `points/`, `shapes/` and `sequences/`, write a run; say which points were used."""
    device = choose_device()
    inputs = {"points": points, "shapes": shapes, "sequences": sequences}
    with artefact.write("run", out, inputs=inputs, params=params) as folder:
        checkpoint = Checkpoint(Path("checkpoints") / digest(inputs, params, device))
        cages, source, sampled = read_sequences(sequences), read_shapes(shapes), read_points(points)
        rng = item_rng(params.seed, "train", "chunks")
        chunks = training_chunks(sampled, cages, params.steps_of, params.points_of, params.reach, rng)
        print(f"trains on {len(chunks) * CHUNK:,} of {len(sampled) * CHUNK:,} points: {described(params)}")

        keys = latent_keys(chunks, params.latents)
        generator = torch.Generator().manual_seed(params.seed)
        latents = LatentTable.drawn(keys, params.latent_dim, params.latent_std, generator).to(device)
        decoder = make_decoder(
            params.decoder, params.width, params.layers, params.latent_dim, params.mapping, params.octaves, params.seed
        ).to(device)
        settings = TrainSettings(**params.model_dump(include={field.name for field in fields(TrainSettings)}))
        groups = training_set(chunks, cages, latents)
        points_a_step = params.batch_chunks * CHUNK
        with progress((), total=params.steps * points_a_step, label=f"train {out.name}") as bar:
            bar.unit, bar.unit_scale = " points", True

            def report(step: int, loss: float) -> None:
                bar.set_postfix(loss=f"{loss:.5f}", refresh=False)
                bar.update(step * points_a_step - bar.n)

            log = train(decoder, latents, groups, settings, checkpoint, report)
