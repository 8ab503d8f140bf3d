"""Read foreign shapes, close their parts, bring them into the canonical frame.

python -m stages.import_shapes data/raw/chair data/shapes/chair
"""

from functools import partial
from pathlib import Path

from cagesdf.audit import with_outliers
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.formats.listing import ShapeSource, list_shapes, read_shape
from cagesdf.importing import import_shape, summary
from cagesdf.io.rejected import write_rejected
from cagesdf.io.shapes import write_shapes
from cagesdf.parts.slots import with_slots
from cagesdf.shape import Shape
from pipeline import ImportParams, artefact, parallel_map, run_stage
from pipeline.cost import Cost, shapes

COST = Cost("shapes", shapes)


def main(raw: Path, out: Path, params: ImportParams) -> None:
    """Read a folder of shapes, write `shapes/`, print the entries that are no shape and the result for each shape.

    Raises InputError if there is no shape to train on, or more than the share `max_rejected` of them was rejected.
    """
    listing = list_shapes(raw, params.include)
    sources = listing.shapes
    for note in listing.notes:
        print(note)
    held_out = sum(source.split == "val" for source in sources)
    if held_out == len(sources):
        unused = f"{raw}: all {held_out:,} shapes are held out, none is trained on"
        raise InputError("; ".join([unused, *listing.notes]))
    print(f"{len(sources) - held_out:,} shapes to train on, {held_out:,} held out for validation")
    with artefact.write("shapes", out, inputs={}, params=params, foreign={"raw": raw}) as folder:
        shapes, rejected = parallel_map(
            partial(import_one, params), sources, rejects=ShapeRejected, label="import_shapes", lost=lost
        )
        shapes = with_slots(with_outliers(shapes))
        print(summary(shapes, rejected))
        write_rejected(folder, rejected, len(sources), params.max_rejected)
        write_shapes(folder, shapes)


def import_one(params: ImportParams, source: ShapeSource) -> Shape:
    """One shape. Raises ShapeRejected if it can't be read or made solid."""
    return import_shape(
        read_shape(source),
        params.up,
        params.weld,
        params.max_faces,
        params.max_parts,
        params.min_thickness,
        params.parts,
    )


def lost(source: ShapeSource, reason: str) -> ShapeRejected:
    """The rejection of a shape that kills its worker."""
    return ShapeRejected(source.shape_id, "import_shapes", reason)


if __name__ == "__main__":
    run_stage(main, InputError)
