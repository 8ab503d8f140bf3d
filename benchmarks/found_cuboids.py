"""The part model trained on found parts beside the same trained on given ones.

    python -m benchmarks.found_cuboids WORK [--procedural chair …] [--folders FOLDER …] [--include 'Chair_*']
        [--shapes 16] [--steps 1600] [--cells 16]

Shapes: training shapes of `make repro` (`data/shapes`, `data/trials`), and mesh files and folders of part meshes in
FOLDERs whose groups, nodes and files are the parts. Each is taken with its parts as given, and once more with them
joined into one mesh, whose parts are found. Both go the way of the stages with the default parameters (targets: scaled
copies where a shape has no partner), for as many steps, and are measured at 128 cells: source shapes beside their given
parts, and beside the parts that they were trained on, which may have been repaired in another way; cuboids of one shape
with the style of another, by its latent (`swap`) and by its corresponding parts (`mix` of all parts), beside the parts
of the other that both have, warped into them, as gains; edits of single cuboids beside the deformed parts.
Artefacts are left in WORK, where those that are there are used. Prints a Markdown table.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cagesdf.editing.script import Mix
from cagesdf.editing.session import Session, state_field
from cagesdf.editing.styles import corresponding
from cagesdf.errors import ShapeRejected
from cagesdf.evaluation.edits import Row, measure
from cagesdf.evaluation.reconstruction import score
from cagesdf.evaluation.surfaces import Measured, Truth
from cagesdf.evaluation.trials import Trial, local_trials, trial_of
from cagesdf.extraction import extract_surface, field_of
from cagesdf.extraction.field import CageField
from cagesdf.formats.listing import list_shapes, read_shape
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.geometry.solid import union
from cagesdf.importing import import_shape
from cagesdf.io.rejected import write_rejected
from cagesdf.io.runs import read_run
from cagesdf.io.shapes import ShapeFolder, read_shapes, write_shapes
from cagesdf.io.trials import read_trials
from cagesdf.parts.slots import with_slots
from cagesdf.run import Run
from cagesdf.seeds import item_rng
from cagesdf.shape import RawPart, RawShape, Shape
from cagesdf.structure.hierarchy import PartHierarchy
from pipeline import artefact, load
from stages import deform_sequences, fit_cuboids, match_targets, sample_points, train

CELLS = 128
POINTS = 20_000
DETAIL = 0.005
LOCAL = 2  # edits of each of EDITED shapes
EDITED = 8
SWAPPED = "warp"  # swaps beside what deformation sequences teach
COLUMNS = (
    "shapes", "parts", "a shape", "distance, %", "median", "worst", "signed normals", "beside own parts",
    "local edits, %", "swap gain: median, mean", "mix gain",
)  # fmt: skip


def joined(shape_id: str, meshes: list[Mesh]) -> RawShape:
    """The parts of a shape as one mesh in one file."""
    part = RawPart("all", "", join(meshes))
    return RawShape(shape_id, "train", (part,), PartHierarchy.flat(("all",), ("",), ""), whole=True)


def imported(raw: RawShape, parts: str) -> Shape:
    """One shape, by the default parameters."""
    params = load("import_shapes").model_dump(include={"up", "weld", "max_faces", "max_parts", "min_thickness"})
    return import_shape(raw, **params, parts=parts)


def procedural(category: str, count: int) -> Iterator[tuple[Shape, RawShape]]:
    """Training shapes, those of swaps first, with their parts, and as one mesh."""
    source = read_shapes(Path("data/shapes") / category)
    rows = read_trials(Path("data/trials") / category).rows.values()
    swapped = [row[name] for row in rows if row["kind"] == SWAPPED for name in ("shape_id", "style_of")]
    known = source.ids_of("train")
    for shape_id in [i for i in dict.fromkeys([*swapped, *known]) if i in known][:count]:
        shape = source.read(shape_id)
        yield shape, joined(shape_id, [part.mesh for part in shape.parts])


def strangers(folder: Path, include: str, count: int) -> Iterator[tuple[Shape, RawShape]]:
    """Shapes of a folder with the parts of their files, and as one mesh."""
    for source in list_shapes(folder, include).shapes[:count]:
        raw = replace(read_shape(source), split="train")
        try:
            shape = imported(raw, "given")
        except ShapeRejected as error:
            print(f"left out: {error}")
            continue
        yield shape, joined(raw.shape_id, [part.mesh for part in raw.parts])


def write(folder: Path, shapes: list[Shape]) -> None:
    """An artefact of shapes, as `import_shapes` writes it."""
    with artefact.write("shapes", folder, inputs={}, params=load("import_shapes")) as out:
        write_rejected(out, [], len(shapes), 1.0)
        write_shapes(out, shapes)


def prepared(pairs: Callable[[], Iterator[tuple[Shape, RawShape]]], given: Path, found: Path) -> None:
    """Write both kinds of shapes where they aren't there yet."""
    if (given / "shapes").is_dir() and (found / "shapes").is_dir():
        return
    of_files, of_surfaces = [], []
    for shape, raw in pairs():
        try:
            of_surfaces.append(imported(raw, "found"))
        except ShapeRejected as error:
            print(f"left out: {error}")
            continue
        of_files.append(shape)
    write(given / "shapes", of_files)
    write(found / "shapes", with_slots(of_surfaces))


def trained(folder: Path, steps: int, cells: int) -> Run:
    """The run of an artefact of shapes, by the stages that lead to one."""

    def stage(main: Callable[..., None], inputs: list[str], out: str, section: str, **changes: Any) -> None:
        if not (folder / out).is_dir():
            params = load(section).model_copy(update={"max_rejected": 1.0, **changes})
            main(*(folder / name for name in inputs), folder / out, params)

    stage(fit_cuboids.main, ["shapes"], "cuboids", "fit_cuboids")
    stage(match_targets.main, ["shapes", "cuboids"], "matches", "match_targets", unmatched="scale")
    stage(deform_sequences.main, ["shapes", "cuboids", "matches"], "sequences", "deform_sequences")
    stage(sample_points.main, ["shapes", "sequences"], "points", "sample_points")
    changes = {"steps": steps, "cells": cells, "snapshots": (), "precision": "float32"}
    run = f"cagesdf-{steps}-{cells}"
    stage(train.main, ["points", "shapes", "cuboids", "sequences"], run, "arms.cagesdf", **changes)
    return read_run(folder / run)


def reconstruction(run: Run, given: Shape, own: Shape) -> tuple[float, float, float]:
    """Distance and signed normals of a source shape beside its given parts, distance beside those it was trained on."""
    cage = run.sequences[own.shape_id].cages[0]
    mesh = extract_surface(field_of(run.decoder, run.latent(own.shape_id, 0), cage), CELLS)
    surface = Measured(mesh) if len(mesh.faces) else None
    rng = item_rng(0, "found_parts", own.shape_id)
    figures = []
    for shape in (given, own):
        truth = Truth(union([part.mesh for part in shape.parts]), cage, DETAIL)
        figures.append(score(surface, truth, truth.drawn(POINTS, rng), rng))
    return figures[0]["surface_distance"], figures[0]["nc_signed"], figures[1]["surface_distance"]


def swapped(run: Run, trial: Trial) -> CageField:
    """The field of a trial's cuboids with the latent of its style."""
    rest = run.sequences[trial.shape_id].cages[0]
    return field_of(run.decoder, run.latent(trial.style_of, 0), trial.cage, rest)


def mixed(run: Run, trial: Trial) -> CageField:
    """The field of a trial's shape with the codes of the other shape's corresponding parts."""
    session = Session(run)
    mix = Mix(part="*", style_of=trial.style_of)
    return state_field(run, session.edited(session.opened(trial.shape_id), (mix,)).present)


def edited(field: CageField, trial: Trial, seed: int) -> Row:
    """Figures of a trial, whose cuboids are the run's own."""
    surface = extract_surface(field, CELLS // 2)
    truth = Truth(trial.truth, trial.cage, DETAIL)
    figures = measure(surface, trial, truth, POINTS // 4, item_rng(seed, "found_parts", trial.trial_id))
    return {"kind": trial.kind, "trial_id": trial.trial_id, **figures}


def styled(session: Session, shapes: ShapeFolder, shape_id: str, style_of: str) -> Trial:
    """A trial of one shape's cuboids with the parts of another, each warped into the cuboid that corresponds.

    Parts that none corresponds to stay as they are.
    """
    state, other = session.opened(shape_id), session.opened(style_of)
    partners = corresponding(state, other, None)
    own, theirs = ({part.part_id: part.mesh for part in shapes.read(name).parts} for name in (shape_id, style_of))
    meshes = []
    for number, part in enumerate(state.cage.part_ids):
        mesh = own[part]
        if part in partners:
            partner = partners[part]
            unit = other.cage.to_unit(theirs[partner].vertices, other.cage.part_ids.index(partner))
            mesh = theirs[partner].with_vertices(state.cage.from_unit(unit, number))
        meshes.append(mesh)
    return trial_of(SWAPPED, shape_id, state.cage, meshes, style_of=style_of)


def style_gains(run: Run, shapes: ShapeFolder, folder: Path) -> list[tuple[float, float]]:
    """Gains by `swapped` and `mixed` of the pairs of `make_trials` that the run has, each in the run's own cuboids."""
    pairs = []
    if folder.is_dir():
        rows = [row for row in read_trials(folder).rows.values() if row["kind"] == SWAPPED]
        pairs = [
            (row["shape_id"], row["style_of"]) for row in rows if {row["shape_id"], row["style_of"]} <= {*shapes.ids}
        ]
    session, gains = Session(run), []
    for shape_id, style_of in pairs:
        trial = styled(session, shapes, shape_id, style_of)
        unchanged = union([part.mesh for part in shapes.read(shape_id).parts])
        truth = Truth(trial.truth, trial.cage, DETAIL)

        def detail(surface: Mesh, trial: Trial = trial, truth: Truth = truth) -> float:
            rng = item_rng(0, "found_parts", trial.trial_id)
            return measure(surface, trial, truth, POINTS // 4, rng)["distance_detail"]

        swap, mix = (extract_surface(field(run, trial), CELLS // 2) for field in (swapped, mixed))
        gains.append((1 - detail(swap) / detail(unchanged), 1 - detail(mix) / detail(unchanged)))
    return gains


def local_distances(run: Run, shapes: ShapeFolder, ids: list[str]) -> list[float]:
    """Distances of edits of single cuboids beside the shape's own parts, deformed."""
    params = load("make_trials")
    result = []
    for shape_id in ids:
        shape, rest = shapes.read(shape_id), run.sequences[shape_id].cages[0]
        rng = item_rng(params.seed, "local", shape_id)
        trials = local_trials(shape, rest, LOCAL, params.resize, params.move, rng)
        result += [edited(swapped(run, trial), trial, params.seed)["distance"] for trial in trials]
    return result


def rows_of(title: str, given: Path, found: Path, trials: Path, steps: int, cells: int) -> None:
    """Train both and print a row for each, and their ratios."""
    runs = {"given": trained(given, steps, cells), "found": trained(found, steps, cells)}
    ids = sorted(runs["given"].sequences.keys() & runs["found"].sequences.keys())
    truths = read_shapes(given / "shapes")
    means: dict[str, float] = {}
    for kind, run in runs.items():
        shapes = read_shapes((given if kind == "given" else found) / "shapes")
        figures = [reconstruction(run, truths.read(shape_id), shapes.read(shape_id)) for shape_id in ids]
        distances, normals, own = np.array(figures).T
        local = local_distances(run, shapes, ids[:EDITED])
        gains = [*zip(*style_gains(run, shapes, trials))] or [(), ()]
        parts = np.mean([len(run.sequences[shape_id].cages[0]) for shape_id in ids])
        means[kind] = float(distances.mean())
        styles = [f"{np.median(row):.3f}, {np.mean(row):.3f} ({len(row)})" if row else "–" for row in gains]
        print(
            f"| {len(ids)} {title} | {kind} | {parts:.1f} | {distances.mean():.3f} | {np.median(distances):.3f} | "
            f"{distances.max():.3f} | {normals.mean():.3f} | {own.mean():.3f} | {np.mean(local):.3f} | "
            f"{' | '.join(styles)} |",
            flush=True,
        )
        worst = sorted(zip(distances.tolist(), ids), reverse=True)[:4]
        print(f"<!-- worst: {', '.join(f'{name} {value:.3f}' for value, name in worst)} -->", flush=True)
    print(f"<!-- found / given: {means['found'] / means['given']:.2f} -->", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--procedural", nargs="*", default=[])
    parser.add_argument("--folders", type=Path, nargs="*", default=[])
    parser.add_argument("--include", default="*")
    parser.add_argument("--shapes", type=int, default=16)
    parser.add_argument("--steps", type=int, default=1600)
    parser.add_argument("--cells", type=int, default=16)
    options = parser.parse_args()
    torch.set_num_threads(1)
    sets: dict[str, Callable[[], Iterator[tuple[Shape, RawShape]]]] = {
        name: partial(procedural, name, options.shapes) for name in options.procedural
    }
    sets |= {path.name: partial(strangers, path, options.include, options.shapes) for path in options.folders}
    print(f"| {' | '.join(COLUMNS)} |")
    print("|---" * len(COLUMNS) + "|", flush=True)
    for title, pairs in sets.items():
        given, found = (options.work / f"{title}-{kind}" for kind in ("given", "found"))
        prepared(pairs, given, found)
        rows_of(title, given, found, Path("data/trials") / title, options.steps, options.cells)


if __name__ == "__main__":
    main()
