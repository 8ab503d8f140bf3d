"""Import of shapes: closed parts in the canonical frame, from a shape as its files give it."""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.audit import audit, flags
from cagesdf.errors import InputError, NotSolidError, ShapeRejected
from cagesdf.frames import Similarity, canonical_similarity
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, box_volume, join, signed_volume
from cagesdf.geometry.solid import METHODS, Solid, make_solid, union
from cagesdf.parts.choosing import doubt
from cagesdf.parts.components import last_method
from cagesdf.parts.finding import FoundPart, FoundParts, boxes_volume, find_parts, parts_as_written
from cagesdf.parts.overlapping import overlapping
from cagesdf.parts.relating import relations
from cagesdf.shape import GIVEN, Origin, Part, RawPart, RawShape, Repair, Shape
from cagesdf.structure.hierarchy import PartHierarchy

STAGE = "import_shapes"
BATCH = 1_000_000  # points whose distances are asked for together
LEAST_LOST = 5e-5  # share of a part's surface that `verdict` mentions: it rounds to 0.01 %
SHOWN = 20  # shapes to look at, and rejected ones, that the summary lists


def import_shape(
    raw: RawShape, up: str, weld: float, max_faces: int, max_parts: int, min_thickness: float, parts: str = "given"
) -> Shape:
    """The shape in the canonical frame with each part closed; parts are repaired here, at rest, and never again.

    `up` is the raw frame's upward axis, "y" or "z"; `weld` and `min_thickness` are canonical
    lengths, see `solid.make_solid`. `parts` is "given" by the files, "found" in the surface, or "auto": found if the
    shape came as one file whose groups are no parts. Parts that were written down come before all of them. Raises
    ShapeRejected for a shape without parts, with more than `max_parts` parts or `max_faces` faces, or with a part that
    can't be made solid; InputError if system libraries that a repair needs are missing.
    """
    finds = raw.written is not None or parts == "found" or (parts == "auto" and raw.whole)
    _check(raw, max_faces, len(raw.parts) if finds else max_parts)
    try:
        similarity = canonical_similarity(np.concatenate([part.mesh.vertices for part in raw.parts]), up)
    except InputError as error:
        raise ShapeRejected(raw.shape_id, STAGE, str(error)) from error
    meshes = [part.mesh.with_vertices(similarity.to_canonical(part.mesh.vertices)) for part in raw.parts]
    if not finds:
        return _shape(raw, similarity, meshes, _given(raw, meshes, weld, min_thickness), weld)
    if raw.written is not None or parts == "found":
        origin, closed = _found(raw, meshes, similarity, weld, min_thickness)
    else:
        origin, closed = _chosen(raw, meshes, similarity, weld, max_parts, min_thickness)
    if len(closed) > max_parts:
        reason = f"it has {len(closed)} parts, at most {max_parts} wanted; join some of them"
        raise ShapeRejected(raw.shape_id, STAGE, reason)
    return _shape(raw, similarity, meshes, closed, weld, origin)


def _check(raw: RawShape, max_faces: int, max_parts: int) -> None:
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


def _shape(
    raw: RawShape,
    similarity: Similarity,
    meshes: list[Mesh],
    parts: tuple[Part, ...],
    weld: float,
    origin: Origin = GIVEN,
) -> Shape:
    """The shape of closed parts; `meshes` are those as read, canonical."""
    audited = audit(meshes, union([part.mesh for part in parts]), weld)
    if origin.parts == "given":
        structure, alignment = raw.structure.transformed(similarity), raw.alignment
    else:
        ids, labels = tuple(part.part_id for part in parts), tuple(part.label for part in parts)
        structure, alignment = PartHierarchy.flat(ids, labels, ""), ()
    if structure.is_bare():
        structure = structure.with_relations(relations({part.part_id: part.mesh for part in parts}))
    return Shape(raw.shape_id, raw.split, parts, structure, similarity, alignment, audited, origin)


def _given(raw: RawShape, meshes: list[Mesh], weld: float, min_thickness: float) -> tuple[Part, ...]:
    """The parts as the files have them."""
    return tuple(_import_part(raw, part, mesh, weld, min_thickness) for part, mesh in zip(raw.parts, meshes))


def _found(
    raw: RawShape, meshes: list[Mesh], similarity: Similarity, weld: float, min_thickness: float
) -> tuple[Origin, tuple[Part, ...]]:
    """Parts that were written down, or else those that are found in the surface."""
    try:
        if raw.written is None:
            found, reason = find_parts(join(meshes), weld, min_thickness), "import_shapes.parts is found"
        else:
            found = parts_as_written(join(meshes), raw.written, similarity, weld, min_thickness)
            reason = "a file beside the mesh has them"
        kind = "found" if raw.written is None else "written"
        solids = overlapping([part.mesh for part in found.parts], weld)
        continued = (replace(part, mesh=solid) for part, solid in zip(found.parts, solids))
        parts = tuple(_found_part(found, part, weld, min_thickness) for part in continued)
        return Origin(kind, reason, len(found.components), found.boxes), parts
    except NotSolidError as error:
        raise ShapeRejected(raw.shape_id, STAGE, f"its surface {error}") from error
    except InputError as error:
        if raw.written is None:  # system libraries are missing
            raise
        raise ShapeRejected(raw.shape_id, STAGE, str(error)) from error


def _chosen(
    raw: RawShape, meshes: list[Mesh], similarity: Similarity, weld: float, max_parts: int, min_thickness: float
) -> tuple[Origin, tuple[Part, ...]]:
    """The groups of a file if they are parts, otherwise parts that are found."""
    origin, closed = _found(raw, meshes, similarity, weld, min_thickness)
    if len(meshes) > max_parts:
        return replace(origin, reason=f"the file has {len(meshes)} groups, at most {max_parts} are parts"), closed
    volume = signed_volume(union([part.mesh for part in closed]))
    if reason := doubt(meshes, boxes_volume(meshes) / volume, origin.boxes, weld):
        return replace(origin, reason=reason), closed
    try:
        given = _given(raw, meshes, weld, min_thickness)
    except ShapeRejected as error:
        return replace(origin, reason=error.reason), closed
    return Origin("given", f"cuboids bound the {len(given)} groups of its file well"), given


def _found_part(found: FoundParts, part: FoundPart, weld: float, min_thickness: float) -> Part:
    """A found part; its repair sums up those of its components."""
    solid = make_solid(part.mesh, weld, min_thickness)
    owners = [found.components[i] for i in sorted({fragment.component for fragment in part.fragments})]
    repairs = [*(owner.repair for owner in owners), solid]
    repair = _repair(
        replace(
            solid,
            method=last_method(repairs),
            dropped=sum(one.dropped for one in repairs),
            plates=sum(one.plates for one in repairs),
            lost=max(one.lost for one in repairs),
        ),
        sum(owner.faces for owner in owners),
    )
    return Part(part.name, part.label, solid.mesh, repair)


def _import_part(raw: RawShape, part: RawPart, mesh: Mesh, weld: float, min_thickness: float) -> Part:
    """One part from its mesh, canonical."""
    try:
        solid = make_solid(mesh, weld, min_thickness)
    except NotSolidError as error:
        raise _rejected(raw, part, str(error)) from error
    return Part(part.part_id, part.label, solid.mesh, _repair(solid, len(mesh.faces)))


def _repair(solid: Solid, faces: int) -> Repair:
    """The record of a repair; `faces` are those as read."""
    volume = signed_volume(solid.mesh)
    inside = volume / box_volume(solid.mesh)
    return Repair(solid.method, faces, len(solid.mesh.faces), volume, inside, solid.dropped, solid.plates, solid.lost)


def _rejected(raw: RawShape, part: RawPart, reason: str) -> ShapeRejected:
    name = part.part_id + (f" ({part.label})" if part.label not in ("", part.part_id) else "")
    return ShapeRejected(raw.shape_id, STAGE, f"part {name} {reason}")


def signed_distances(shape: Shape, points: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
    """Distances to the surface of all parts together, negative inside; points and distances in the raw frame."""
    surface = SurfaceDistance(union([part.mesh for part in shape.parts]))
    pieces = np.split(points, range(BATCH, len(points), BATCH))
    distances = [surface.signed(shape.similarity.to_canonical(piece)) for piece in pieces]
    return np.concatenate(distances) / shape.similarity.scale


def summary(shapes: list[Shape], rejected: list[ShapeRejected]) -> str:
    """Summary of an import: numbers of shapes that passed, were repaired and how, were rejected and why."""
    repaired = sum(shape.status == "repaired" for shape in shapes)
    methods = [part.repair.method for shape in shapes for part in shape.parts]
    counts = ", ".join(f"{methods.count(method)} {method}" for method in METHODS if method in methods)
    lines = [
        f"{len(shapes) + len(rejected)} shapes: {len(shapes) - repaired} passed, {repaired} repaired, "
        f"{len(rejected)} rejected",
        f"{len(methods)} parts, by the last step of the repair they needed: {counts or 'none'}",
        *_origin_lines(shapes),
        *_alignment_line(shapes),
    ]
    flagged = [f"look at {shape.shape_id}: {'; '.join(flags(shape))}" for shape in shapes if flags(shape)]
    lines += _first(flagged, "shapes.parquet")
    lines += _first([f"rejected {item.shape_id}: {item.reason}" for item in rejected], "rejected.parquet")
    return "\n".join(lines)


def verdict(shape: Shape) -> str:
    """The result of one shape in a line: passed, or repaired and how, and why it should be looked at."""
    counts = Counter(part.repair.method for part in shape.parts if part.repair.method != "none")
    repairs = [f"{counts[method]} {method}" for method in METHODS if counts[method]]
    repaired = f" {', '.join(repairs)} of {len(shape.parts)} parts" if repairs else ""
    origin = shape.origin
    whose = [] if origin == GIVEN else [f"parts {origin.parts}, {len(shape.parts)}: {origin.reason}"]
    lost = max(part.repair.lost for part in shape.parts)
    loss = [f"at most {lost:.2%} of a part's surface lost"] if lost >= LEAST_LOST else []
    return "; ".join([f"{shape.status}{repaired}", *whose, *loss, *flags(shape)])


def repair_report(shape: Shape) -> dict[str, Any]:
    """Repairs of a shape's parts and reasons to look at it, for JSON; volumes in cubic raw units."""
    unit = shape.similarity.scale**3
    parts = [
        {"part": part.part_id, "label": part.label, **vars(part.repair), "volume": part.repair.volume / unit}
        for part in shape.parts
    ]
    audited = {"clear": shape.audit.clear, "differ": shape.audit.differ, "inside": shape.audit.inside}
    return {"shape": shape.shape_id, "status": shape.status, "flags": flags(shape), "audit": audited, "parts": parts}


def _origin_lines(shapes: list[Shape]) -> list[str]:
    """Origins of the shapes' parts; empty if all have those of their files."""
    kinds = Counter(shape.origin.parts for shape in shapes)
    if all(shape.origin == GIVEN for shape in shapes):
        return []
    counts = ", ".join(f"{kinds[kind]} {kind}" for kind in ("given", "found", "written") if kinds[kind])
    lines = [f"parts of {shape.shape_id} {shape.origin.parts}: {shape.origin.reason}" for shape in shapes]
    return [f"parts: {counts}", *_first(lines, "origins.parquet")]


def _first(lines: list[str], table: str) -> list[str]:
    return lines if len(lines) <= SHOWN else [*lines[:SHOWN], f"and {len(lines) - SHOWN} more, in {table}"]


def _alignment_line(shapes: list[Shape]) -> list[str]:
    """Quality of the programs' alignment with their parts before fitting; empty without programs."""
    overlaps = [(part.iou, shape.shape_id, part.part_id) for shape in shapes for part in shape.alignment]
    if not overlaps:
        return []
    programs = sum(bool(shape.alignment) for shape in shapes)
    leftovers = sum(len(part.leftovers) for shape in shapes for part in shape.alignment)
    mean, (worst, shape_id, part_id) = np.mean([item[0] for item in overlaps]), min(overlaps)
    return [
        f"{programs} programs, {len(overlaps)} leaves: mean IoU with their parts {mean:.2f}, "
        f"least {worst:.2f} ({shape_id}, {part_id}); {leftovers} meshes given to the leaf they lie in"
    ]
