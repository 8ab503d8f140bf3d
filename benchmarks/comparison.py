"""A picture of shapes beside their reconstructions: cuboids, true surface, and what each arm makes of it.

    python -m benchmarks.comparison data FILE chair/chair_0000 table/table_0003 … [--arms cagesdf …] [--size 240]

Surfaces are those of `data/meshes`, and the number below each is its distance of `data/scores` in % of the longest
side. Parts that share a label share a colour. Shapes are rows, or columns where they are more than their pictures.
"""

import argparse
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from PIL import Image, ImageDraw, ImageFont

from cagesdf.geometry.meshes import join
from cagesdf.io.meshes import read_ply
from cagesdf.io.runs import read_run
from cagesdf.io.shapes import read_shapes
from cagesdf.rendering import CLAY, PART_COLOURS, Scene, render_rows, side_by_side

INK = "#444"
COLOURS = 128
MARGIN = 24  # pixels, for names


def scenes(data: Path, category: str, shape_id: str, arms: list[str]) -> list[Scene]:
    """Scenes of one shape: its cuboids, its surface, that of each arm."""
    shape = read_shapes(data / "shapes" / category).read(shape_id)
    cage = read_run(data / "runs" / category / arms[0]).sequences[shape_id].cages[0]
    kinds = {label: number for number, label in enumerate(dict.fromkeys(part.label for part in shape.parts))}
    colours = {part.part_id: PART_COLOURS[kinds[part.label] % len(PART_COLOURS)] for part in shape.parts}
    boxes = Scene((), (), cage, tuple(colours[part] for part in cage.part_ids))
    truth = join([part.mesh for part in shape.parts])
    made = [read_ply(data / "meshes" / category / arm / f"{shape_id}-0.ply") for arm in arms]
    return [boxes, *(Scene((mesh,), (CLAY,)) for mesh in (truth, *made))]


def distances(data: Path, category: str, shape_id: str, arms: list[str]) -> list[str]:
    """Texts below the scenes: the distance of each reconstruction at rest, the mean over seeds."""
    table = pq.read_table(data / "scores" / category / "scores.parquet").to_pylist()
    rows = [row for row in table if (row["shape_id"], row["step"]) == (shape_id, 0)]
    means = [float(np.mean([row["surface_distance"] for row in rows if row["arm"] == arm])) for arm in arms]
    return ["", "", *(f"{mean:.2f} %" for mean in means)]


def picture(pictures: list[list[np.ndarray]], titles: list[str], texts: list[list[str]]) -> Image.Image:
    """Pictures of each shape, in rows under the titles or, where there are more shapes, in columns beside them."""
    down = len(pictures) > len(titles)
    grid = [[*row] for row in zip(*pictures)] if down else pictures
    words = [[*row] for row in zip(*texts)] if down else texts
    size, columns = len(grid[0][0]), len(grid[0])
    left, top = (MARGIN, 0) if down else (0, MARGIN)
    whole = Image.new("RGB", (left + columns * size, top + len(grid) * (size + MARGIN)), "white")
    font, ink = ImageFont.load_default(size=14), ImageDraw.Draw(whole)
    for row, (images, line) in enumerate(zip(grid, words)):
        start = top + row * (size + MARGIN)
        whole.paste(Image.fromarray(side_by_side(images, columns)), (left, start))
        for column, text in enumerate(line):
            ink.text((left + (column + 0.5) * size, start + size + 2), text, INK, font, anchor="ma")
    for number, title in enumerate(titles):
        label = Image.new("RGB", (size, 20), "white")
        ImageDraw.Draw(label).text((size / 2, 2), title, INK, font, anchor="ma")
        at = (2, number * (size + MARGIN)) if down else (number * size, 2)
        whole.paste(label.rotate(90, expand=True) if down else label, at)
    return whole


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("file", type=Path)
    parser.add_argument("shapes", nargs="+", help="category/id")
    parser.add_argument("--arms", nargs="+", default=["cagesdf"])
    parser.add_argument("--size", type=int, default=240)
    options = parser.parse_args()
    names = [(category, shape_id) for category, _, shape_id in (name.partition("/") for name in options.shapes)]
    drawn, _ = render_rows([scenes(options.data, *name, arms=options.arms) for name in names], options.size)
    titles = ["cuboids", "true surface", *(options.arms if len(options.arms) > 1 else ["reconstruction"])]
    whole = picture(drawn, titles, [distances(options.data, *name, arms=options.arms) for name in names])
    whole.quantize(COLOURS, dither=Image.Dither.NONE).save(options.file, optimize=True)
    print(f"{options.file}: {options.file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
