"""Train one arm: a decoder and its latents together (§3.1, §3.5).

python -m stages.train data/points/chair data/shapes/chair data/cuboids/chair data/sequences/chair \\
    data/runs/chair/cagesdf --params arms.cagesdf

After an interruption the same command goes on from the last file in checkpoints/. On several GPUs or
machines, `torchrun --nproc-per-node 2 -m stages.train` with the same arguments (docs/training.md).
"""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import torch

from cagesdf.cuboid import Sequence
from cagesdf.errors import InputError
from cagesdf.io.cuboids import read_assemblies
from cagesdf.io.points import CHUNK
from cagesdf.io.residuals import write_residuals
from cagesdf.io.runs import write_run, write_snapshot
from cagesdf.io.sequences import read_sequences
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.models.arms import make_decoder
from cagesdf.models.decoders import Decoder, TrainsOn, check_placement
from cagesdf.models.latents import LatentTable
from cagesdf.run import Run
from cagesdf.seeds import item_rng
from cagesdf.structure.base import Structure
from cagesdf.training.checkpoint import Checkpoint, digest_of
from cagesdf.training.distributed import Ranks, joined_ranks
from cagesdf.training.free_codes import FreeCodes
from cagesdf.training.loop import TrainSettings, train
from cagesdf.training.points import BYTES_A_POINT, LoadedPoints, TrainingPoints, open_points
from cagesdf.training.precision import fitting_precision, processor
from cagesdf.training.residuals import rest_residuals
from pipeline import TrainParams, artefact, counter, device, run_stage
from pipeline.cost import Cost, Counts, Sections
from pipeline.library import used
from pipeline.memory import memory

MEASURED_GROUPS = 16  # at most, of a measured step
MEASURED_WORK = 2e11  # multiplications that a measured training makes, about: a second or some


def trained_points(sections: Sections, arm: str) -> int:
    """Points in all groups of all steps."""
    return sections[f"arms.{arm}"].steps * sections[f"arms.{arm}"].batch_chunks * CHUNK


def measured_trainings(params: TrainParams) -> tuple[TrainParams, TrainParams]:
    """Two trainings to be timed: of one step, and of about a second more, by the size of the network."""
    groups = min(params.batch_chunks, MEASURED_GROUPS)
    a_step = groups * CHUNK * 6 * params.layers * params.width**2
    steps = int(min(max(MEASURED_WORK / a_step, 8), 400))
    few = {"batch_chunks": groups, "steps": 1}
    return params.model_copy(update=few), params.model_copy(update=few | {"steps": 1 + steps})


def held_points(sections: Sections, size: int) -> int:
    """Bytes of the points, where memory holds all of them."""
    points = Counts.of(sections).points * BYTES_A_POINT
    return points if points <= memory() else 0


COST = Cost("points", trained_points, {"snapshots": []}, measured_trainings, grows=False, held=held_points)


def main(points: Path, shapes: Path, cuboids: Path, sequences: Path, out: Path, params: TrainParams) -> None:
    """Read `points/`, `shapes/`, `cuboids/` and `sequences/`, write a run; say which points it was trained on.

    Of several ranks the first writes.
    """
    inputs = {"points": points, "shapes": shapes, "cuboids": cuboids, "sequences": sequences}
    with joined_ranks() as ranks:
        # The manifest, the run and the checkpoint's digest hold what was used. All ranks have the first one's.
        precision = ranks.broadcast(fitting_precision(params.precision, device()))
        params = params.model_copy(update={"precision": precision})
        if ranks.first:
            with artefact.write("run", out, inputs=inputs, params=params) as folder:
                checkpoint = trained(inputs, folder, out.name, params, ranks)
            checkpoint.remove()
        else:
            trained(inputs, None, out.name, params, ranks)
        ranks.barrier()


def trained(inputs: dict[str, Path], folder: Path | None, name: str, params: TrainParams, ranks: Ranks) -> Checkpoint:
    """Train with the other ranks; write the run to `folder` if there is one.

    Returns the checkpoint, which is no longer needed once the run is published.
    """
    source, cages = read_shapes(inputs["shapes"]), read_sequences(inputs["sequences"])
    rng = item_rng(params.seed, "train")
    room = ranks.broadcast(memory() // ranks.size)  # all must read in the same way
    decoder = make_decoder(params.decoder, **params.model_dump(exclude={"decoder"})).to(device())
    check_placement(decoder, params.latent_dim)
    data = open_points(inputs["points"], cages, params.steps_of, decoder.trains_on, params.reach, rng, room)
    checkpoint = Checkpoint(Path("checkpoints") / digest(inputs, params, data, ranks))

    keys = data.latent_keys(params.latents)
    latents = LatentTable.drawn(keys, params.latent_dim, params.latent_std, params.seed).to(device())
    settings = TrainSettings(**params.model_dump(include={field.name for field in fields(TrainSettings)}))
    batches = data.batches(latents, params.batch_chunks, params.bundle, params.seed)
    free = free_codes(decoder, latents, cages)
    if folder is None:
        train(decoder, latents, free, batches, settings, checkpoint, lambda step, loss: None, ranks)
        return checkpoint

    count = {"sampled": data.sampled, "used": data.used}
    print(f"{name}: {data.used:,} of {data.sampled:,} points, {described(params, decoder.trains_on)}; {held(data)}")
    print(f"{name}: products in {params.precision} on {processor() if device() == 'cpu' else device()}")
    batch = params.batch_chunks * CHUNK
    with counter(settings.steps * batch, "points", f"train {name}") as bar:
        log = train(
            decoder,
            latents,
            free,
            batches,
            settings,
            checkpoint,
            lambda step, loss: bar(step * batch, loss=f"{loss:.5f}"),
            ranks,
        )

    ids = sorted({shape_id for shape_id, _ in keys})
    run = Run(
        decoder,
        latents,
        {shape_id: cages[shape_id] for shape_id in ids},
        structures(source, inputs["cuboids"], ids),
        {shape_id: source.similarity(shape_id) for shape_id in ids},
        params.model_dump(mode="json", exclude={"format"}),
        count,
    )
    write_run(folder, run, log)
    errors = rest_residuals(inputs["points"], decoder, latents, cages, params.reach, params.clamp)
    write_residuals(folder, errors)
    for steps, tensors in checkpoint.kept().items():
        write_snapshot(folder, steps, tensors)
    return checkpoint


def free_codes(decoder: Decoder, latents: LatentTable, sequences: Mapping[str, Sequence]) -> FreeCodes | None:
    """Codes that come first, where a network makes the parts' codes."""
    if decoder.code_dim is None:
        return None
    parts = [len(sequences[shape_id].cages[0]) for shape_id, _ in latents.keys]
    return FreeCodes(parts, decoder.code_dim).to(latents.values.device)


def structures(shapes: ShapeFolder, cuboids: Path, ids: list[str]) -> dict[str, Structure]:
    """Structures by shape id: the fitted program with its parts' labels, or else the hierarchy."""
    fitted = read_assemblies(cuboids)
    return {
        shape_id: fitted[shape_id].labelled({part.part_id: part.label for part in shapes.alignment(shape_id)})
        if shape_id in fitted
        else shapes.structure(shape_id)
        for shape_id in ids
    }


def described(params: TrainParams, trains_on: TrainsOn) -> str:
    """Description of the training points, in words."""
    steps = "source shapes" if params.steps_of == "rest" else "all training steps"
    where = {
        "part": "around each part",
        "cage": f"inside their cuboid or within {params.reach}",
        "cube": "in the whole cube",
    }
    return f"those {where[trains_on]}, of {steps}"


def held(data: TrainingPoints) -> str:
    """Place of the points during training, in words."""
    return "in memory" if isinstance(data, LoadedPoints) else "streamed, as memory is limited (CAGESDF_MEMORY)"


def digest(inputs: dict[str, Path], params: TrainParams, data: TrainingPoints, ranks: Ranks) -> str:
    """Digest of all that the weights depend on: parameters, inputs, reader, library, torch, device, ranks."""
    return digest_of(
        {
            "params": params.model_dump(mode="json"),
            "inputs": {kind: artefact.digest_file(path / artefact.MANIFEST) for kind, path in inputs.items()},
            "points": type(data).__name__,
            "library": {name: artefact.digest_file(path) for name, path in used(Path(__file__).absolute()).items()},
            "torch": torch.__version__,
            "device": device(),
            "ranks": ranks.size,
        }
    )


if __name__ == "__main__":
    run_stage(main, InputError)
