"""Quality of an edit's surface: the figures of a trial (docs/metrics.md)."""

from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.deformation.matching import touching
from cagesdf.evaluation.surfaces import Truth
from cagesdf.evaluation.trials import STYLED, Trial
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, sample_surface

VERSION = 2  # of the definitions; raised when one changes
NAN = float("nan")
LOST = 100.0  # % of the side: the distance of a surface that isn't there
REACHED = 0.01  # of its length: an end of a cuboid that the true surface reaches is freer by no more
MIRRORED = 1e-3  # canonical units: cuboids whose corners are mirror images to within this make a symmetric cage
FIGURES = ("distance", "distance_detail", "gain", "refit", "overshoot", "symmetry", "moved_mean", "moved_max")
OF_ALL = ("refit", "overshoot")  # figures that all kinds of trials have and are of one thing

Row = dict[str, Any]  # arm, trial_id, kind, shape_id, style_of, FIGURES


def measure(surface: Mesh, trial: Trial, truth: Truth, points: int, rng: np.random.Generator) -> dict[str, float]:
    """FIGURES of a surface in a trial but for those that take another surface, which are NaN.

    `truth` is the trial's. `points` are drawn on each surface. A surface without faces gets the worst values.
    """
    figures = dict.fromkeys(FIGURES, NAN)
    true_points, faces = sample_surface(truth.mesh, points, rng)
    counted = truth.is_detail(true_points) & trial.changed[faces]
    mirror = mirror_plane(trial.cage) if trial.kind == "rest" else None
    if len(surface.faces) == 0:
        lost = {"distance": LOST, "distance_detail": LOST if counted.any() else NAN, "refit": LOST, "overshoot": 0.0}
        return figures | lost | {"symmetry": NAN if mirror is None else LOST}
    asked = SurfaceDistance(surface)
    surface_points, _ = sample_surface(surface, points, rng)
    forth = asked.unsigned(true_points)
    back, faces, nearest = truth.distance.closest(surface_points)
    figures["distance"] = percent((forth.mean() + back.mean()) / 2, truth)
    if counted.any():
        nears = truth.is_detail(nearest) & trial.changed[faces]
        missed = back[nears].mean() if nears.any() else truth.side
        figures["distance_detail"] = percent((forth[counted].mean() + missed) / 2, truth)
    figures["refit"] = 100 * refit(surface, truth.mesh, trial.cage)
    figures["overshoot"] = percent(overshoot(surface, trial.cage), truth)
    if mirror is not None:
        figures["symmetry"] = percent(asked.unsigned(surface_points * [-1, 1, 1] + [2 * mirror, 0, 0]).mean(), truth)
    return figures


def percent(length: float, truth: Truth) -> float:
    """A canonical length in % of the longest side of the true surface."""
    return 100 * float(length) / truth.side


def free_ends(surface: Mesh, cage: Cage) -> Float[ndarray, "p 3 2"]:
    """For each cuboid, axis and end, the share of its length between that end and the part's surface.

    A part's surface are the faces whose centres its cuboid most contains (§3.4). What lies outside of the
    cuboid counts as on its face: that is overshoot. A part without a face leaves its cuboid free from end to end.
    """
    owner, _ = cage.assign(surface.corners().mean(axis=1))
    free = np.ones((len(cage), 3, 2))
    for i in np.unique(owner).tolist():
        points = cage.to_unit(surface.vertices[surface.faces[owner == i].ravel()], i).clip(-0.5, 0.5)
        free[i] = np.stack([points.min(axis=0) + 0.5, 0.5 - points.max(axis=0)], axis=1)
    return free


def refit(surface: Mesh, truth: Mesh, cage: Cage) -> float:
    """Mean of `free_ends` over the ends of cuboids that the true surface reaches: others lie inside other parts."""
    return float(free_ends(surface, cage)[_reached_ends(truth, cage)].mean())


@lru_cache(maxsize=1)  # surfaces of several arms are measured against one truth, one after the other
def _reached_ends(truth: Mesh, cage: Cage) -> Bool[ndarray, "p 3 2"]:
    return free_ends(truth, cage) < REACHED


def overshoot(surface: Mesh, cage: Cage) -> float:
    """The largest distance of a vertex outside all cuboids to the nearest one, canonical."""
    return float(cage.assign(surface.vertices)[1].max(initial=0.0))


def mirror_plane(cage: Cage) -> float | None:
    """Where the cage is its own mirror image: x of the plane, canonical; None if it isn't."""
    corners = cage.corners()
    x = float(corners[..., 0].min() + corners[..., 0].max()) / 2
    images = corners * [-1, 1, 1] + [2 * x, 0, 0]
    for image in images:
        apart = np.linalg.norm(corners[:, :, None] - image, axis=-1).min(axis=2).max(axis=1)
        if apart.min() > MIRRORED:
            return None
    return x


def locality(
    before: Mesh, after: Mesh, rest: Cage, trial: Trial, truth: Truth, points: int, rng: np.random.Generator
) -> dict[str, float]:
    """`moved_mean` and `moved_max`: how far what an edit of one cuboid shouldn't touch has moved.

    That is the surface of cuboids that touch the edited one neither at rest nor afterwards. Distances are from
    points on either of the surfaces `before` and `after` to the other. NaN where there is no such surface.
    """
    part = rest.part_ids.index(trial.part_id)
    far = ~(touching(rest)[part] | touching(trial.cage)[part])
    far[part] = False
    distances = [np.zeros(0)]
    for surface, cage, other in ((before, rest, after), (after, trial.cage, before)):
        if len(before.faces) and len(after.faces):
            sampled, _ = sample_surface(surface, points, rng)
            distances.append(SurfaceDistance(other).unsigned(sampled[far[cage.assign(sampled)[0]]]))
    moved = np.concatenate(distances)
    if len(moved) == 0:
        return {}
    return {"moved_mean": percent(moved.mean(), truth), "moved_max": percent(moved.max(), truth)}


def edit_row(arm: str, trial: Trial, figures: Mapping[str, float]) -> Row:
    """One line of an arm's figures."""
    key = {name: getattr(trial, name) for name in ("trial_id", "kind", "shape_id", "style_of")}
    return {"arm": arm, **key, **figures}


def with_gains(rows: Iterable[Row], references: Iterable[Row]) -> list[Row]:
    """The rows with gains of swaps and mixes: the share of the way from the unchanged shape to the truth they go."""
    distance = {row["trial_id"]: row["distance_detail"] for row in references if row["arm"] == "unchanged"}
    return [
        row | {"gain": 1 - row["distance_detail"] / distance[row["trial_id"]]} if row["kind"] in STYLED else row
        for row in rows
    ]


def definitions(points: int, detail: float, seed: int) -> dict[str, Any]:
    """Meaning of the figures and how they are measured, for the metadata of each file of them."""
    return {
        "version": VERSION,
        "definitions": "docs/metrics.md",
        "points": points,
        "detail": detail,
        "seed": seed,
        "box_warp": "the truth by construction of sequences, local and beyond; a reference for swap, mix and bent",
        "keep_warp": "a reference for swap and mix_keep: parts warped, details keep their size in the files' unit",
    }
