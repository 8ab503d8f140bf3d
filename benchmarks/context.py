"""Gain of a part's code from the other parts: decoders whose parts see each other, know how they relate, or neither.

    python -m benchmarks.context [chair table vase] [--steps 1400] [--seeds 4 5] [--shapes 6] [--parts 3]

Each is trained as the arm `cagesdf` is, on all families but every fourth. Then a shape's code is sought from the points
of all its parts but one, and the decoder is asked for that one: of validation shapes of the trained families, and of
training shapes of the others. Errors are mean |sdf error| in the unit of training, the part's smallest length, clamped
as there: of the training shapes with their own codes, of the parts that the code was sought from, and of the hidden
ones. Prints a Markdown table, means over seeds ± half their spread. `data/` is that of `make repro`.
"""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import torch

from cagesdf.cuboid import Sequence
from cagesdf.inference.codes import OneShape, infer
from cagesdf.inference.shapes import FitSettings, prepare, usual_settings
from cagesdf.io.points import read_points
from cagesdf.io.sequences import read_sequences
from cagesdf.io.shapes import read_shapes
from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import LatentTable
from cagesdf.run import Run
from cagesdf.seeds import item_rng
from cagesdf.synthesis.writing import read_recipes
from cagesdf.training.batches import Batch, MemoryBatches, latent_keys, training_chunks, training_set
from cagesdf.training.checkpoint import Checkpoint
from cagesdf.training.loop import TrainSettings, train
from cagesdf.training.precision import processor
from pipeline import TrainParams, load
from stages.train import free_codes

# Learning distances, as these arms of profiles/ablations.yaml do.
ARM = {"clamp": 0.6, "precision": "float32", "snapshots": ()}
DECODERS = ("PlainTriplaneDecoder", "TriplaneDecoder", "RelationTriplaneDecoder")
HIDDEN_FAMILIES = 4  # every fourth family isn't trained on
COLUMNS = ("trained", "seen parts", "hidden part", "other families: seen parts", "hidden part")


def split(category: str) -> tuple[set[str], set[str]]:
    """Shape ids of the families that are trained on, and of the others."""
    recipes = read_recipes(Path("data/raw") / category)
    names = sorted({recipe.family for recipe in recipes.values()})
    hidden = names[HIDDEN_FAMILIES - 1 :: HIDDEN_FAMILIES]
    others = {shape_id for shape_id, recipe in recipes.items() if recipe.family in hidden}
    return set(recipes) - others, others


def trained(category: str, ids: set[str], params: TrainParams, folder: Path) -> tuple[Run, float]:
    """A run of the shapes with these ids, and its mean error of their points."""
    sequences = read_sequences(Path("data/sequences") / category)
    chunks = read_points(Path("data/points") / category, "part")
    of = np.array([shape_id in ids for shape_id in chunks.shape_ids])
    chunks = chunks.take(np.flatnonzero(of[chunks.shape_id]))
    decoder = make_decoder(params.decoder, **params.model_dump(exclude={"decoder"}))
    rng = item_rng(params.seed, "train")
    chunks = training_chunks(chunks, sequences, params.steps_of, decoder.trains_on, params.reach, rng)
    latents = LatentTable.drawn(latent_keys(chunks, params.latents), params.latent_dim, params.latent_std, params.seed)
    known: dict[str, Sequence] = {shape_id: sequences[shape_id] for shape_id, _ in latents.keys}
    batches = MemoryBatches(training_set(chunks, sequences, latents), params.batch_chunks, params.bundle, params.seed)
    settings = TrainSettings(**params.model_dump(include={field.name for field in fields(TrainSettings)}))
    free = free_codes(decoder, latents, known)
    log = train(decoder, latents, free, batches, settings, Checkpoint(folder), lambda step, loss: None)
    shapes = read_shapes(Path("data/shapes") / category)
    structures = {shape_id: shapes.structure(shape_id) for shape_id in known}
    similarities = {shape_id: shapes.similarity(shape_id) for shape_id in known}
    decoder.requires_grad_(False).eval()
    return Run(decoder, latents, known, structures, similarities, params.model_dump(mode="json"), {}), log[-1]["l1"]


def hidden_parts(
    run: Run, category: str, ids: list[str], count: int, settings: FitSettings
) -> Iterator[tuple[float, float]]:
    """Errors of the seen parts and of the hidden one, for `count` parts of each shape."""
    shapes = read_shapes(Path("data/shapes") / category)
    candidates = torch.cat([run.latents.values, run.latents.values.mean(dim=0, keepdim=True)]).detach()
    for shape_id in ids:
        rng = item_rng(0, "context", shape_id)
        groups = prepare(run, shapes.read(shape_id), settings, rng).groups
        parts = groups.part.unique()
        for part in rng.permutation(parts.numpy())[:count].tolist():
            seen, hidden = of_parts(groups, groups.part != part), of_parts(groups, groups.part == part)
            inferred = infer(run.decoder, candidates, seen, run.params["clamp"], settings.inference, 0)
            (codes,) = OneShape(run.decoder, hidden, run.params["clamp"]).codes(inferred.code[None])
            yield inferred.code_error, OneShape(run.decoder, hidden, run.params["clamp"]).mean_error(codes)


def of_parts(groups: Batch, which: torch.Tensor) -> Batch:
    """Some of the groups of a shape; its cage stays whole."""
    return groups.take(which.nonzero()[:, 0])


def row(decoder: str, category: str, options: argparse.Namespace) -> str:
    """A row of the table."""
    base = usual_settings()
    settings = replace(base, inference=replace(base.inference, residual_steps=0))
    ids, others = split(category)
    validation = read_shapes(Path("data/shapes") / category).ids_of("val")
    figures = []
    for seed in options.seeds:
        params = load("arms.cagesdf").model_copy(
            update={**ARM, "decoder": decoder, "seed": seed, "steps": options.steps}
        )
        with tempfile.TemporaryDirectory() as folder:
            run, error = trained(category, ids, params, Path(folder))
        known = [i for i in validation if i in ids][: options.shapes]
        unknown = sorted(others - set(validation))[: options.shapes]
        means = [np.mean([*hidden_parts(run, category, i, options.parts, settings)], axis=0) for i in (known, unknown)]
        figures.append([error, *means[0], *means[1]])
    mean, spread = np.mean(figures, axis=0), np.ptp(figures, axis=0) / 2
    return f"| `{decoder}` | {category} | " + " | ".join(f"{m:.4f} ± {s:.4f}" for m, s in zip(mean, spread)) + " |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("categories", nargs="*", default=["chair", "table", "vase"])
    parser.add_argument("--steps", type=int, default=1400)
    parser.add_argument("--seeds", type=int, nargs="+", default=[4, 5])
    parser.add_argument("--shapes", type=int, default=6)
    parser.add_argument("--parts", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"On {processor()}, float32, one thread, {options.steps} steps.\n")
    print(f"| decoder | category | {' | '.join(COLUMNS)} |\n|---|---|---|---|---|---|---|", flush=True)
    for category in options.categories:
        for decoder in DECODERS:
            print(row(decoder, category, options), flush=True)


if __name__ == "__main__":
    main()
