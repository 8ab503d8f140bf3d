"""From a category's artefacts to what the page shows of it."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from cagesdf.cuboid import Cage
from cagesdf.cuboid import Sequence as Deformation
from cagesdf.deformation.sequences import Transfer
from cagesdf.geometry.meshes import join
from cagesdf.io.cuboids import read_bounding, read_cages
from cagesdf.io.edits import read_edit_surface, read_edits
from cagesdf.io.logs import read_losses
from cagesdf.io.meshes import SurfaceFolder, read_surfaces
from cagesdf.io.rejected import read_rejected
from cagesdf.io.sequences import read_sequences, read_transfers
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.io.trials import TrialFolder, read_trials
from cagesdf.rendering import CLAY, PART_COLOURS, Scene
from cagesdf.report.figures import in_order
from cagesdf.report.generated_shapes import failures, opened, strip
from cagesdf.report.grid import Grid
from cagesdf.report.page import Category
from cagesdf.report.selection import spread
from cagesdf.shape import Shape
from cagesdf.structure.assembly import Assembly


def read_category(
    shapes: Path,
    cuboids: Path,
    sequences: Path,
    trials: Path,
    meshes: Mapping[str, Path],
    runs: Mapping[str, Path],
    edits: Path,
    generated: Mapping[str, Path],
    generation: Path,
    count: int,
    drawn: int,
) -> Category:
    """Gather one category from its artefacts, those of the arms by arm; it is named like `shapes`' folder.

    `count` shapes are compared, evenly spread over those that most arms have reconstructed, and `drawn` are
    shown of each method that generated any. The deformation shown is the one that moves the cuboids most, of those
    whose held-out steps have been reconstructed. Raises InputError for artefacts that can't be read.
    """
    source = read_shapes(shapes)
    status = [shape.status for shape in source]
    deformations = read_sequences(sequences)
    arms = {arm: read_surfaces(meshes[arm]) for arm in in_order(meshes)}
    compared = spread(_by_coverage(arms, list(deformations)), count)
    transfers = read_transfers(sequences, deformations)
    new = opened(generated)
    return Category(
        shapes.name,
        status.count("passed"),
        status.count("repaired"),
        read_rejected(shapes),
        read_bounding(cuboids),
        fitting(source, read_cages(cuboids), compared),
        comparison(source, deformations, transfers, arms, compared),
        deformation(source, deformations[_liveliest(deformations, arms)], transfers, arms)
        if deformations
        else Grid((), (), (), ()),
        swaps(source, read_trials(trials), edits),
        mixes(source, read_trials(trials), edits),
        strip(source, new, generation, drawn),
        failures(new, generation),
        {arm: read_losses(runs[arm]) for arm in in_order(runs)},
    )


def fitting(source: ShapeFolder, cages: Mapping[str, Cage], ids: Sequence[str]) -> Grid:
    """One column a shape: its parts in the cuboids of its program as it was given, if it has one, and as fitted."""
    given, fitted = [], []
    for shape_id in ids:
        shape = source.read(shape_id)
        meshes, colours = tuple(part.mesh for part in shape.parts), part_colours(shape)
        placed = shape.structure.placed_program()
        given.append(Scene(meshes, colours, Assembly(*placed).cage(), colours) if placed else None)
        fitted.append(Scene(meshes, colours, cages[shape_id], colours))
    rows = {"as given": tuple(given), "fitted": tuple(fitted)} if any(given) else {"fitted": tuple(fitted)}
    return Grid(tuple(ids), (False,) * len(ids), tuple(rows), tuple(rows.values()))


def comparison(
    source: ShapeFolder,
    deformations: Mapping[str, Deformation],
    transfers: Mapping[str, Transfer],
    arms: Mapping[str, SurfaceFolder],
    ids: Sequence[str],
) -> Grid:
    """One row a shape: its cuboids, its surface, and what each arm makes of it."""
    rows = []
    for shape_id in ids:
        shape = source.read(shape_id)
        sequence = deformations[shape_id]
        rows.append(
            (
                Scene(cage=sequence.cages[0], cage_colours=part_colours(shape)),
                _true_surface(shape, sequence, transfers[shape_id], 0),
                *(_reconstruction(surfaces, shape_id, 0) for surfaces in arms.values()),
            )
        )
    columns = ("cuboids", "ground truth", *arms)
    return Grid(columns, (False,) * len(columns), tuple(ids), tuple(rows))


def deformation(
    source: ShapeFolder,
    sequence: Deformation,
    transfers: Mapping[str, Transfer],
    arms: Mapping[str, SurfaceFolder],
) -> Grid:
    """One column a step: the cage, the true surface that follows it, and the arms that have any step but the first."""
    shape = source.read(sequence.shape_id)
    colours = part_colours(shape)
    steps = range(len(sequence.t))
    shown = [
        arm for arm, surfaces in arms.items() if any((shape.shape_id, step) in surfaces.rows for step in steps[1:])
    ]
    return Grid(
        tuple(f"t = {t:.1f}" for t in sequence.t),
        sequence.held_out,
        ("cuboids", "ground truth", *shown),
        (
            tuple(Scene(cage=cage, cage_colours=colours) for cage in sequence.cages),
            tuple(_true_surface(shape, sequence, transfers[shape.shape_id], step) for step in steps),
            *(tuple(_reconstruction(arms[arm], shape.shape_id, step) for step in steps) for arm in shown),
        ),
    )


def swaps(source: ShapeFolder, trials: TrialFolder, edits: Path) -> Grid:
    """The swaps of median and of least gain of the first arm that has any: both shapes, each such arm, the truth."""
    rows = [row for row in read_edits(edits / "edits.parquet")[0] if row["kind"] == "swap"]
    arms = in_order({row["arm"] for row in rows})
    if not arms:
        return Grid((), (), (), ())
    first = [row for row in rows if row["arm"] == arms[0] and not math.isnan(row["gain"])]
    ranked = sorted(first, key=lambda row: row["gain"])
    scenes, names = [], []
    for what, row in (("median", ranked[len(ranked) // 2]), ("least", ranked[0])):
        shown = [
            *(join([part.mesh for part in source.read(row[name]).parts]) for name in ("shape_id", "style_of")),
            *(read_edit_surface(edits, arm, row["trial_id"]) for arm in arms),
            trials.read(row["trial_id"]).truth,
        ]
        scenes.append(tuple(Scene((mesh,), (CLAY,)) for mesh in shown))
        names.append(f"{what} gain, {row['gain']:.2f}: {row['shape_id']} in the style of {row['style_of']}")
    columns = ("cuboids of", "style of", *arms, "ground truth")
    return Grid(columns, (False,) * len(columns), tuple(names), tuple(scenes))


def mixes(source: ShapeFolder, trials: TrialFolder, edits: Path) -> Grid:
    """Three mixes of the first arm that has any, evenly spread by gain: with details stretched, and kept."""
    rows = [row for row in read_edits(edits / "edits.parquet")[0] if row["kind"] == "mix"]
    arms = in_order({row["arm"] for row in rows})
    first = [row for row in rows if row["arm"] in arms[:1] and not math.isnan(row["gain"])]
    ranked = sorted(first, key=lambda row: row["gain"])
    scenes, names = [], []
    for row in spread(ranked, 3):
        labels = {part.part_id: part.label or part.part_id for part in source.read(row["shape_id"]).parts}
        keep = row["trial_id"].replace("mix/", "mix_keep/", 1)
        shown = [
            *(join([part.mesh for part in source.read(row[name]).parts]) for name in ("shape_id", "style_of")),
            *(read_edit_surface(edits, row["arm"], trial_id) for trial_id in (row["trial_id"], keep)),
            trials.read(row["trial_id"]).truth,
        ]
        scenes.append(tuple(Scene((mesh,), (CLAY,)) for mesh in shown))
        mixed = labels[trials.rows[row["trial_id"]]["part_id"].split("|")[0]]
        names.append(f"{row['shape_id']}, {mixed} in the style of {row['style_of']}")
    columns = ("shape", "style of", "details stretched", "details kept", "ground truth")
    return Grid(columns, (False,) * len(columns), tuple(names), tuple(scenes)) if names else Grid((), (), (), ())


def part_colours(shape: Shape) -> tuple[str, ...]:
    """A colour a part: one for all parts of a label, or one each where there are no labels."""
    kinds = [part.label or part.part_id for part in shape.parts]
    order = list(dict.fromkeys(kinds))
    return tuple(PART_COLOURS[order.index(kind) % len(PART_COLOURS)] for kind in kinds)


def _by_coverage(arms: Mapping[str, SurfaceFolder], ids: Sequence[str]) -> list[str]:
    """The shapes whose rest shape the largest number of arms has reconstructed."""
    counts = {shape_id: sum((shape_id, 0) in surfaces.rows for surfaces in arms.values()) for shape_id in ids}
    return [shape_id for shape_id, number in counts.items() if number == max(counts.values())]


def _liveliest(deformations: Mapping[str, Deformation], arms: Mapping[str, SurfaceFolder]) -> str:
    """The shape whose corners move farthest, of those with reconstructed held-out steps or of all."""
    done = {
        shape_id
        for surfaces in arms.values()
        for (shape_id, _), row in surfaces.rows.items()
        if row["held_out"] and shape_id in deformations
    }

    def movement(shape_id: str) -> float:
        cages = deformations[shape_id].cages
        return float(np.linalg.norm(cages[-1].corners() - cages[0].corners(), axis=-1).mean())

    return max(sorted(done or deformations), key=movement)


def _true_surface(shape: Shape, sequence: Deformation, transfer: Transfer, step: int) -> Scene:
    return Scene((join(transfer.parts(shape, sequence, step)),), (CLAY,))


def _reconstruction(surfaces: SurfaceFolder, shape_id: str, step: int) -> Scene | None:
    if (shape_id, step) not in surfaces.rows:
        return None
    return Scene((surfaces.read(shape_id, step).mesh,), (CLAY,))
