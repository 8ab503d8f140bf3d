"""Audit of a shape's sign, by two tests that share nothing with the repair.

Rays through the faces as they were read vote on points, whatever the faces' orientation: a line
from a point out of a solid crosses its surface an odd number of times. And a shape that fills much
more or less of its box than the others of its category has, likely, lost or gained a solid.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, box_volume, face_components, signed_volume, weld
from cagesdf.shape import Audit, Shape

POINTS = 512  # in all boxes of a shape's parts, equally many in each
LEAST = 8  # in a part's box, however many parts there are
LINES = 5  # through each point: two rays each
AGREED = 0.75  # of the rays: with fewer on either side, a point isn't clear
NEAR = 2e-3  # canonical units: points nearer to the surface aren't used; plates and caps lie there
MAX_PAIRS = 20_000_000  # of a face and a point that lie in one strip, a line; with more there is no audit
BATCH = 1_000_000  # of them, at a time
DIFFERING = 0.02  # share of the clear points: a shape with more is to be looked at
LOST = 0.005  # share of a part's area as read that its solid leaves out: the same
OUTLYING = 6.0  # robust z-score: the same
FEWEST = 8  # shapes that make a category


def audit(meshes: list[Mesh], surface: Mesh, tolerance: float) -> Audit:
    """Compare the sign of `surface`, the union of a shape's closed parts, with rays through the parts as read.

    A part's points are spread evenly over its box, the same ones in every run. A point is inside a
    part if AGREED of the rays say so for one of its components (faces that share vertices, after
    welding within `tolerance`), or three, or five; it is inside the shape if it is inside a part, and outside if
    it is, clearly, outside all components of all. Canonical frame.
    """
    spread = _spread(max(LEAST, POINTS // len(meshes)))
    points = np.concatenate([mesh.vertices.min(0) + spread * np.ptp(mesh.vertices, axis=0) for mesh in meshes])
    distances = SurfaceDistance(surface)
    points = points[distances.unsigned(points) > NEAR]
    votes = [_part_vote(mesh, points, tolerance) for mesh in meshes]
    inside = np.any([part > 0 for part in votes], axis=0)
    clear = inside | np.all([part < 0 for part in votes], axis=0)
    differ = clear & (inside != distances.inside(points))
    return Audit(int(clear.sum()), int(differ.sum()), signed_volume(surface) / box_volume(surface))


def _spread(count: int) -> Float[ndarray, "n 3"]:
    """Points that fill the unit cube evenly: multiples of powers of the root of x⁴ = x + 1 (Roberts, 2018)."""
    return (0.5 + np.arange(1, count + 1)[:, None] * 1.2207440846057596 ** -np.arange(1.0, 4.0)) % 1


def _part_vote(mesh: Mesh, points: Float[ndarray, "n 3"], tolerance: float) -> Int[ndarray, " n"]:
    """`vote` of the welded mesh, evaluated only for points in its box."""
    votes = np.full(len(points), -1)
    boxed = ((points >= mesh.vertices.min(0)) & (points <= mesh.vertices.max(0))).all(1)
    if boxed.any():
        votes[boxed] = vote(weld(mesh, tolerance), points[boxed])
    return votes


def vote(mesh: Mesh, points: Float[ndarray, "n 3"]) -> Int[ndarray, " n"]:
    """1 where rays put a point inside the mesh, -1 where they put it outside, 0 where they don't agree.

    A point within an even number of components, as in a cavity, gets 0, and so do all if the
    faces are so large and many that counting would take long.
    """
    components = face_components(mesh)
    odd = []
    for direction in 2 * _spread(LINES) - 1:
        crossed = _crossings(mesh, points, direction / np.linalg.norm(direction))
        if crossed is None:
            return np.zeros(len(points), dtype=np.int64)
        faces, where, above = crossed
        # One number for each component, point and ray.
        rays = (components[faces] * len(points) + where) * 2 + above
        ray, count = np.unique(rays, return_counts=True)
        odd.append(ray[count % 2 == 1] // 2)
    pair, count = np.unique(np.concatenate(odd), return_counts=True)
    share = count / (2 * LINES)
    within = np.bincount(pair[share >= AGREED] % len(points), minlength=len(points))
    unclear = np.bincount(pair[(share < AGREED) & (share > 1 - AGREED)] % len(points), minlength=len(points))
    return np.where(within % 2 == 1, 1, np.where((within == 0) & (unclear == 0), -1, 0))


def _crossings(
    mesh: Mesh, points: Float[ndarray, "n 3"], direction: Float[ndarray, " 3"]
) -> tuple[Int[ndarray, " k"], Int[ndarray, " k"], Int[ndarray, " k"]] | None:
    """Face, point, and whether it is ahead, for each face that the line through a point crosses.

    None if more than MAX_PAIRS pairs would have to be looked at.
    """
    across = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    basis = np.stack([across / np.linalg.norm(across), np.cross(direction, across), direction], axis=1)
    order = np.argsort(points @ basis[:, 0])
    places = points[order] @ basis
    corners = mesh.corners() @ basis
    # Only points in the strip that a face covers can be on it.
    first = np.searchsorted(places[:, 0], corners[:, :, 0].min(1))
    counts = np.searchsorted(places[:, 0], corners[:, :, 0].max(1)) - first
    if counts.sum() > MAX_PAIRS:
        return None
    batches = []
    for faces in np.split(
        np.arange(len(counts)), np.searchsorted(counts.cumsum(), np.arange(BATCH, counts.sum(), BATCH))
    ):
        face = np.repeat(faces, counts[faces])
        point = np.arange(len(face)) - np.repeat(counts[faces].cumsum() - counts[faces] - first[faces], counts[faces])
        to = corners[face] - places[point, None]
        x, y, z = to.transpose(2, 1, 0)
        # Twice the areas that the point spans with the sides: of one sign where the line crosses the face.
        areas = np.roll(x, -1, axis=0) * np.roll(y, 1, axis=0) - np.roll(x, 1, axis=0) * np.roll(y, -1, axis=0)
        hit = (areas > 0).all(0) | (areas < 0).all(0)
        ahead = (areas[:, hit] * z[:, hit]).sum(0) * np.sign(areas[0, hit]) > 0
        batches.append((face[hit], order[point[hit]], ahead.astype(np.int64)))
    face, point, ahead = (np.concatenate(item) for item in zip(*batches))
    return face, point, ahead


def with_outliers(shapes: list[Shape]) -> list[Shape]:
    """The shapes of a category, each with its outlier score: how unusual is the share of its box that it fills.

    The robust z-score of the share's logarithm: distance from the median in units of 1.4826 times the
    median distance, the standard deviation of a normal distribution. Zero with fewer than FEWEST shapes.
    """
    if len(shapes) < FEWEST:
        return shapes
    filled = np.log([shape.audit.inside for shape in shapes])
    away = filled - np.median(filled)
    scores = away / max(1.4826 * float(np.median(np.abs(away))), 1e-3)
    return [replace(shape, audit=replace(shape.audit, outlier=float(score))) for shape, score in zip(shapes, scores)]


def flags(shape: Shape) -> list[str]:
    """Reasons why a shape should be looked at; usually empty."""
    result = []
    audited = shape.audit
    if audited.differ > DIFFERING * audited.clear:
        result.append(f"{audited.differ} of {audited.clear} points are on the other side for rays through its faces")
    if abs(audited.outlier) > OUTLYING:
        result.append(
            f"it fills {audited.inside:.2%} of its box, {'more' if audited.outlier > 0 else 'less'} than others "
            f"(robust z-score {audited.outlier:.1f})"
        )
    result += [
        f"part {part.part_id} lost {part.repair.lost:.2%} of its surface"
        for part in shape.parts
        if part.repair.lost > LOST
    ]
    if plates := sum(part.repair.plates for part in shape.parts):
        result.append(f"{plates} sheet{'s' if plates > 1 else ''} got a thickness")
    return result
