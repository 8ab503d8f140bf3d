"""Train one arm: a decoder and its latents together (§3.1, §3.5).

python -m stages.train data/points/chair data/shapes/chair data/sequences/chair data/runs/chair/cagesdf \\
    --params arms.cagesdf

After an interruption the same command goes on from the last file in checkpoints/.
"""

from dataclasses import fields
from pathlib import Path

import torch

from cagesdf.io.points import CHUNK
from cagesdf.io.runs import Run, write_run
from cagesdf.io.sequences import read_sequences
from cagesdf.io.shapes import read_shapes
from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import LatentTable
from cagesdf.training.checkpoint import Checkpoint, digest_of, loaded_library
from cagesdf.training.loop import TrainSettings, train
from cagesdf.training.points import LoadedPoints, TrainingPoints, open_points
from pipeline import TrainParams, artefact, counter, device, item_rng, run_stage
from pipeline.memory import memory

SIZES = {"width", "layers", "latent_dim", "mapping", "octaves"}


def main(points: Path, shapes: Path, sequences: Path, out: Path, params: TrainParams) -> None:
    """Read `points/`, `shapes/` and `sequences/`, write a run; say which points it was trained on."""
    inputs = {"points": points, "shapes": shapes, "sequences": sequences}
    with artefact.write("run", out, inputs=inputs, params=params) as folder:
        source, cages = read_shapes(shapes), read_sequences(sequences)
        rng = item_rng(params.seed, "train")
        data = open_points(points, cages, params.steps_of, params.points_of, params.reach, rng, memory())
        checkpoint = Checkpoint(Path("checkpoints") / digest(inputs, params, data))
        count = {"sampled": data.sampled, "used": data.used}
        print(f"{out.name}: {data.used:,} of {data.sampled:,} points, {described(params)}; {held(data)}")

        keys = data.latent_keys(params.latents)
        latents = LatentTable.drawn(keys, params.latent_dim, params.latent_std, params.seed).to(device())
        decoder = make_decoder(params.decoder, **params.model_dump(include=SIZES), seed=params.seed).to(device())
        settings = TrainSettings(**params.model_dump(include={field.name for field in fields(TrainSettings)}))
        batches = data.batches(latents, params.batch_chunks, params.seed)
        batch = params.batch_chunks * CHUNK
        with counter(settings.steps * batch, "points", f"train {out.name}") as bar:
            log = train(
                decoder,
                latents,
                batches,
                settings,
                checkpoint,
                lambda step, loss: bar(step * batch, loss=f"{loss:.5f}"),
            )

        ids = sorted({shape_id for shape_id, _ in keys})
        run = Run(
            decoder,
            latents,
            {shape_id: cages[shape_id] for shape_id in ids},
            {shape_id: source.structure(shape_id) for shape_id in ids},
            {shape_id: source.similarity(shape_id) for shape_id in ids},
            params.model_dump(mode="json", exclude={"format"}),
            count,
        )
        write_run(folder, run, log)
    checkpoint.remove()


def described(params: TrainParams) -> str:
    """Which points those are, in words."""
    steps = "source shapes" if params.steps_of == "rest" else "all training steps"
    where = f"inside their cuboid or within {params.reach}" if params.points_of == "cage" else "in the whole cube"
    return f"those {where}, of {steps}"


def held(data: TrainingPoints) -> str:
    """Where those are while it trains."""
    return "in memory" if isinstance(data, LoadedPoints) else "streamed, as memory is limited (CAGESDF_MEMORY)"


def digest(inputs: dict[str, Path], params: TrainParams, data: TrainingPoints) -> str:
    """Of all that the weights depend on: parameters, inputs, way of reading, library, torch and device."""
    return digest_of(
        {
            "params": params.model_dump(mode="json"),
            "inputs": {kind: artefact.digest_file(path / artefact.MANIFEST) for kind, path in inputs.items()},
            "points": type(data).__name__,
            "library": loaded_library(),
            "stage": artefact.digest_file(Path(__file__)),
            "torch": torch.__version__,
            "device": device(),
        }
    )


if __name__ == "__main__":
    run_stage(main)
