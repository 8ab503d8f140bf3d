"""From a shape as its files give it to closed parts in the canonical frame."""

import numpy as np

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.frames import Similarity, canonical_similarity
from cagesdf.meshes import signed_volume
from cagesdf.shape import Part, RawPart, RawShape, Repair, Shape
from cagesdf.solid import METHODS, NotSolidError, make_solid

STAGE = "import_shapes"
SHOWN = 20  # rejected shapes that the summary lists


def import_shape(raw: RawShape, up: str, weld: float, max_faces: int, max_parts: int, min_thickness: float) -> Shape:
    """The shape in the canonical frame with each part closed; parts are repaired here, at rest, and never again.

    `up` is the raw frame's upward axis, "y" or "z"; `weld` and `min_thickness` are canonical
    lengths, see `solid.make_solid`. Raises ShapeRejected for a shape without parts, with more
    than `max_parts` parts or `max_faces` faces, or with a part that can't be made solid;
    InputError if system libraries that a repair needs are missing.
    """
    count, faces = len(raw.parts), sum(len(part.mesh.faces) for part in raw.parts)
    if count == 0:
        raise ShapeRejected(raw.shape_id, STAGE, "it has no parts; wanted at least one mesh")
    if count > max_parts:
        raise ShapeRejected(raw.shape_id, STAGE, f"it has {count} parts, at most {max_parts} wanted; join some of them")
    if faces > max_faces:
        raise ShapeRejected(raw.shape_id, STAGE, f"it has {faces:,} faces, at most {max_faces:,} wanted; simplify it")
    for part in raw.parts:
        if len(part.mesh.faces) == 0:
            raise _rejected(raw, part, "has no faces; remove it, or export it again")
        if not np.isfinite(part.mesh.vertices).all():
            raise _rejected(raw, part, "has vertices that are NaN or infinite; export it again")
    try:
        similarity = canonical_similarity(np.concatenate([part.mesh.vertices for part in raw.parts]), up)
    except InputError as error:
        raise ShapeRejected(raw.shape_id, STAGE, str(error)) from error
    parts = tuple(_import_part(raw, part, similarity, weld, min_thickness) for part in raw.parts)
    return Shape(raw.shape_id, raw.split, parts, raw.structure.transformed(similarity), similarity, raw.alignment)


def _import_part(raw: RawShape, part: RawPart, similarity: Similarity, weld: float, min_thickness: float) -> Part:
    mesh = part.mesh.with_vertices(similarity.to_canonical(part.mesh.vertices))
    try:
        solid, method = make_solid(mesh, weld, min_thickness)
    except NotSolidError as error:
        raise _rejected(raw, part, str(error)) from error
    repair = Repair(method, len(mesh.faces), len(solid.faces), signed_volume(solid))
    return Part(part.part_id, part.label, solid, repair)


def _rejected(raw: RawShape, part: RawPart, reason: str) -> ShapeRejected:
    name = part.part_id + (f" ({part.label})" if part.label not in ("", part.part_id) else "")
    return ShapeRejected(raw.shape_id, STAGE, f"part {name} {reason}")


def summary(shapes: list[Shape], rejected: list[ShapeRejected]) -> str:
    """What became of the shapes: how many passed, were repaired and how, were rejected and why."""
    repaired = sum(shape.status == "repaired" for shape in shapes)
    methods = [part.repair.method for shape in shapes for part in shape.parts]
    counts = ", ".join(f"{methods.count(method)} {method}" for method in METHODS if method in methods)
    lines = [
        f"{len(shapes) + len(rejected)} shapes: {len(shapes) - repaired} passed, {repaired} repaired, "
        f"{len(rejected)} rejected",
        f"{len(methods)} parts, by the last step of the repair they needed: {counts or 'none'}",
        *_alignment_line(shapes),
        *(f"rejected {item.shape_id}: {item.reason}" for item in rejected[:SHOWN]),
    ]
    if len(rejected) > SHOWN:
        lines.append(f"and {len(rejected) - SHOWN} more, in rejected.parquet")
    return "\n".join(lines)


def _alignment_line(shapes: list[Shape]) -> list[str]:
    """How well programs fit their parts before they are fitted; nothing without programs."""
    found = [(part.iou, shape.shape_id, part.part_id) for shape in shapes for part in shape.alignment]
    if not found:
        return []
    programs = sum(bool(shape.alignment) for shape in shapes)
    leftovers = sum(len(part.leftovers) for shape in shapes for part in shape.alignment)
    mean, (worst, shape_id, part_id) = np.mean([item[0] for item in found]), min(found)
    return [
        f"{programs} programs, {len(found)} leaves: mean IoU with their parts {mean:.2f}, "
        f"least {worst:.2f} ({shape_id}, {part_id}); {leftovers} meshes given to the leaf they lie in"
    ]
