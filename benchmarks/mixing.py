"""Gains of mixing by part, against both truths: the table of docs/styles.md.

    OMP_NUM_THREADS=1 python -m benchmarks.mixing [data] [--category chair] [--mixes 24] [--resolution 64]

reads the default run's raw files, shapes, sequences and arm `cagesdf`. Two shapes of a family and a label whose parts
differ between their styles are drawn; the first shape takes the second one's style in the parts of that label. The gain
is that of docs/metrics.md, on the detail of these parts: by the recipe's truth and by the box-warp's, for

partner    codes of the corresponding parts of the second shape, in its own cage: what `mix` does
keep       the same, but details keep their size: `mix` with `details: keep`
context    codes that the network has for the second shape's latent in the first one's cage
swap       the whole shape swapped, of which the same parts are measured
box_warp   the second shape's parts deformed into the cuboids, without a network
keep_warp  the same, but details keep their size

and how many parts that were not mixed are the same to the last bit, in codes and surfaces. With `--picture FILE` draws
instead of measuring: three shapes of one structure as they are, then with the parts of one label after the other from
the next shape; a colour says whose style a part has.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from cagesdf.cuboid import Sequence
from cagesdf.editing.script import Mix, Swap
from cagesdf.editing.session import Session, state_field
from cagesdf.editing.state import State
from cagesdf.evaluation.edits import measure
from cagesdf.evaluation.surfaces import Truth
from cagesdf.evaluation.swaps import kept_parts, swap_trials, swaps_of
from cagesdf.evaluation.trials import Trial
from cagesdf.extraction import Extraction
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import union
from cagesdf.io.runs import read_run
from cagesdf.io.sequences import read_sequences
from cagesdf.io.shapes import ShapeFolder, read_shapes
from cagesdf.rendering import PART_COLOURS, Scene, render_rows, side_by_side
from cagesdf.synthesis.recipe import Recipe
from cagesdf.synthesis.writing import read_recipes

POINTS, DETAIL = 3000, 0.005  # as the default run's make_trials
SHOWN = 3  # shapes of the picture


def in_context(state: State) -> State:
    """The mixed parts with the codes that the network has for their styles in this cage."""
    mixed = {
        part: tuple(replace(step, cage=None, part=part) for step in steps) for part, steps in state.part_styles.items()
    }
    return replace(state, part_styles=mixed)


class Mixes:
    """Mixes of one category, drawn and measured."""

    def __init__(self, data: Path, category: str, resolution: int) -> None:
        self.session = Session(read_run(data / "runs" / category / "cagesdf"))
        self.resolution = resolution
        self.shapes: ShapeFolder = read_shapes(data / "shapes" / category)
        self.sequences: Mapping[str, Sequence] = read_sequences(data / "sequences" / category)
        self.recipes: Mapping[str, Recipe] = read_recipes(data / "raw" / category)

    def figures(self, pair: tuple[str, str], rng: np.random.Generator) -> dict[str, dict[str, float]] | None:
        """Gains of one mix by method and truth; None if no label that only some parts have shows the style."""
        shape, styled = (self.shapes.read(shape_id) for shape_id in pair)
        rest, styled_rest = (self.sequences[shape_id].cages[0] for shape_id in pair)
        opened = self.session.opened(pair[0])
        labels = opened.structure.labels()
        words = sorted(set(labels.values()))
        for label in rng.permutation(words).tolist() if len(words) > 1 else []:
            mixed = self.session.edited(opened, (Mix(part=label, style_of=pair[1]),)).present
            swap, warp = swap_trials(shape, rest, styled, styled_rest, self.recipes, mixed.part_styles)
            if swap.changed.any():
                break
        else:
            return None
        live = self.session.live(self.resolution)
        before, after = live.surface(opened), live.surface(mixed)
        keep = self.session.edited(opened, (Mix(part=label, style_of=pair[1], details="keep"),)).present
        surfaces = {
            "unchanged": union([part.mesh for part in shape.parts]),
            "partner": after.mesh,
            "context": live.surface(in_context(mixed)).mesh,
            "swap": live.surface(self.session.edited(opened, (Swap(style_of=pair[1]),)).present).mesh,
            "box_warp": warp.truth,
            "keep": live.surface(keep).mesh,
            "keep_warp": union(list(kept_parts(styled, styled_rest, shape, rest, mixed.part_styles))),
        }
        truths = {"recipe": swap, "warp": warp}
        result = {
            name: {truth: gain(mesh, trial) for truth, trial in truths.items()} for name, mesh in surfaces.items()
        }
        for name in [name for name in result if name != "unchanged"]:
            result[name] = {truth: 1 - result[name][truth] / result["unchanged"][truth] for truth in truths}
        self.check_rest(opened, mixed, before, after)
        return result

    def check_rest(self, opened: State, mixed: State, before: Extraction, after: Extraction) -> None:
        """Parts that were not mixed must be the same to the last bit."""
        codes = [state_field(self.session.run, state).codes for state in (opened, mixed)]
        for i, part in enumerate(opened.cage.part_ids):
            same = torch.equal(codes[0][i], codes[1][i])
            assert same != (part in mixed.part_styles), part
            if same:
                a, b = before.parts[part], after.parts[part]
                assert a.vertices.tobytes() == b.vertices.tobytes(), part
                assert a.faces.tobytes() == b.faces.tobytes(), part


def picture(mixes: Mixes, out: Path, size: int) -> None:
    """Three shapes, a row each: as they are, then with the next one's parts, label by label."""
    session = mixes.session
    opened = {shape_id: session.opened(shape_id) for shape_id in sorted(session.run.sequences)}
    alike: dict[str, list[str]] = {}
    for shape_id, state in opened.items():
        styles = [mixes.recipes[other].style for other in alike.get(state.structure.signature(), [])]
        if mixes.recipes[shape_id].style not in styles:
            alike.setdefault(state.structure.signature(), []).append(shape_id)
    ids = max(alike.values(), key=lambda group: (len(group) >= SHOWN, len(opened[group[0]].cage)))[:SHOWN]
    live = session.live(128)
    rows = []
    for i, shape_id in enumerate(ids):
        after = (i + 1) % len(ids)
        labels = opened[shape_id].structure.labels()
        row = []
        for label in (None, *sorted(set(labels.values()))):
            script = () if label is None else (Mix(part=label, style_of=ids[after]),)
            state = session.edited(opened[shape_id], script).present
            parts = [(part, mesh) for part, mesh in live.surface(state).parts.items() if len(mesh.faces)]
            colours = tuple(PART_COLOURS[after if part in state.part_styles else i] for part, _ in parts)
            row.append(Scene(tuple(mesh for _, mesh in parts), colours))
        rows.append(row)
    images, _ = render_rows(rows, size)
    page = side_by_side([image for row in images for image in row], len(rows[0]))
    Image.fromarray(page).quantize(128).save(out, optimize=True)
    print(f"{out}: {', '.join(ids)}; columns: as they are, {', '.join(sorted(set(labels.values())))}")


def gain(mesh: Mesh, trial: Trial) -> float:
    """The distance on the detail of changed parts, of which gains are made, in % of the longest side."""
    truth = Truth(trial.truth, trial.cage, DETAIL)
    return measure(mesh, trial, truth, POINTS, np.random.default_rng(0))["distance_detail"]


def main(data: Path, category: str, count: int, resolution: int) -> None:
    torch.set_num_threads(1)
    mixes, rng = Mixes(data, category, resolution), np.random.default_rng(0)
    measured: list[dict[str, dict[str, float]]] = []
    for pair in rng.permutation(swaps_of(mixes.recipes, mixes.sequences)).tolist():
        if len(measured) < count and (figures := mixes.figures((pair[0], pair[1]), rng)):
            measured.append(figures)
    print(f"{category}: {len(measured)} mixes; all parts that were not mixed are the same to the last bit\n")
    print("| codes | gain, recipe | nearer | gain, warp | nearer |")
    print("|---|---|---|---|---|")
    for name in ("partner", "keep", "context", "swap", "box_warp", "keep_warp"):
        gains = {truth: np.array([figures[name][truth] for figures in measured]) for truth in ("recipe", "warp")}
        cells = [f"{np.nanmedian(column):.3f} | {int((column > 0).sum())}" for column in gains.values()]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, nargs="?", default=Path("data"))
    parser.add_argument("--category", default="chair")
    parser.add_argument("--mixes", type=int, default=24)
    parser.add_argument("--resolution", type=int, default=64)
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    if arguments.picture:
        torch.set_num_threads(1)
        picture(Mixes(arguments.data, arguments.category, arguments.resolution), arguments.picture, 220)
        raise SystemExit
    main(arguments.data, arguments.category, arguments.mixes, arguments.resolution)
