"""A picture of shapes beside their reconstructions: a column each, with cuboids, true surface and reconstruction.

    python -m benchmarks.comparison data FILE chair/chair_0000 table/table_0003 … [--arm cagesdf] [--size 240]

Surfaces are those of `data/meshes`, and the number below each is the distance of `data/scores` in % of the longest
side. Parts that share a label share a colour.
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

ROWS = ("cuboids", "true surface", "reconstruction")
INK = "#444"
COLOURS = 128


def scenes(data: Path, category: str, shape_id: str, arm: str) -> list[Scene]:
    """Scenes of ROWS of one shape, seen alike."""
    shape = read_shapes(data / "shapes" / category).read(shape_id)
    cage = read_run(data / "runs" / category / arm).sequences[shape_id].cages[0]
    kinds = {label: number for number, label in enumerate(dict.fromkeys(part.label for part in shape.parts))}
    colours = {part.part_id: PART_COLOURS[kinds[part.label] % len(PART_COLOURS)] for part in shape.parts}
    truth = join([part.mesh for part in shape.parts])
    made = read_ply(data / "meshes" / category / arm / f"{shape_id}-0.ply")
    boxes = Scene((), (), cage, tuple(colours[part] for part in cage.part_ids))
    return [boxes, Scene((truth,), (CLAY,)), Scene((made,), (CLAY,))]


def distance(data: Path, category: str, shape_id: str, arm: str) -> float:
    """Surface distance of a reconstruction at rest, mean over seeds."""
    table = pq.read_table(data / "scores" / category / "scores.parquet").to_pylist()
    key = arm, shape_id, 0
    return float(
        np.mean([row["surface_distance"] for row in table if (row["arm"], row["shape_id"], row["step"]) == key])
    )


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("file", type=Path)
    parser.add_argument("shapes", nargs="+", help="category/id")
    parser.add_argument("--arm", default="cagesdf")
    parser.add_argument("--size", type=int, default=240)
    options = parser.parse_args()
    names = [tuple(name.split("/", 1)) for name in options.shapes]
    drawn = [scenes(options.data, category, shape_id, options.arm) for category, shape_id in names]
    columns, _ = render_rows(drawn, options.size)
    page = Image.fromarray(side_by_side([column[row] for row in range(len(ROWS)) for column in columns], len(names)))
    font = ImageFont.load_default(size=14)
    picture = Image.new("RGB", (page.width + 24, page.height + 24), "white")
    picture.paste(page, (24, 0))
    for row, title in enumerate(ROWS):
        label = Image.new("RGB", (options.size, 20), "white")
        ImageDraw.Draw(label).text((options.size / 2, 2), title, INK, font, anchor="ma")
        picture.paste(label.rotate(90, expand=True), (2, row * options.size))
    for column, (category, shape_id) in enumerate(names):
        text = f"{distance(options.data, category, shape_id, options.arm):.2f} %"
        middle = 24 + (column + 0.5) * options.size
        ImageDraw.Draw(picture).text((middle, page.height + 2), text, INK, font, anchor="ma")
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(options.file, optimize=True)
    print(f"{options.file}: {options.file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
