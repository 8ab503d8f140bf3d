"""A picture of the distances of one deformed shape's points near a plane."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.io.points import read_shard

THICKNESS = 0.06  # canonical units: points at most half of it from the plane are shown
LIMIT = 0.08  # canonical units: the end of the colour scale
MARGIN = 0.15  # canonical units around the points inside
# Warm inside, cold outside, without a pale middle: the surface is their boundary.
INSIDE, OUTSIDE = ("#5c0a1e", "#c43b3f", "#f6b08c"), ("#a5d0e4", "#3f8fc4", "#0b2f5e")
AXES = "xyz"
INK = "#3b4049"


@dataclass(frozen=True, eq=False)
class Slice:
    """Points near a plane across one canonical axis."""

    shape_id: str
    step: int
    axis: int  # across the plane
    at: float  # of the plane, along that axis
    places: Float[ndarray, "n 2"]  # along the other two axes, canonical
    middle: Float[ndarray, " 2"]  # of the points inside, along these axes
    width: float  # of a square that shows it all, canonical units
    sdf: Float[ndarray, " n"]  # canonical units, negative inside


def middle_slice(shard: Path) -> Slice:
    """Points of the first shape by name in a shard, of its first step, near the plane that shows most of its inside.

    Planes across each axis go through the middle of the points inside. Raises InputError for a shard without points.
    """
    first: tuple[str, int] | None = None
    pieces: list[tuple[ndarray, ndarray]] = []
    for chunks in read_shard(shard):
        names = [(chunks.shape_ids[shape], step) for shape, step in zip(chunks.shape_id.tolist(), chunks.step.tolist())]
        least = min(names)
        if first is None or least < first:
            first, pieces = least, []
        rows = np.flatnonzero([name == first for name in names])
        pieces.append((chunks.xyz[rows].reshape(-1, 3), chunks.sdf[rows].reshape(-1)))
    if first is None:
        raise InputError(f"{shard}: holds no points to draw")
    xyz, sdf = (np.concatenate(column).astype(np.float64) for column in zip(*pieces))
    inside = xyz[sdf < 0] if (sdf < 0).any() else xyz
    middle = (inside.min(axis=0) + inside.max(axis=0)) / 2
    near = np.abs(xyz - middle) <= THICKNESS / 2
    axis = int((near & (sdf < 0)[:, None]).sum(axis=0).argmax())
    others = list(_across(axis))
    width = float(np.ptp(inside, axis=0)[others].max()) + 2 * MARGIN
    shown = near[:, axis] & (np.abs(xyz - middle)[:, others] <= width / 2).all(axis=1)
    return Slice(*first, axis, float(middle[axis]), xyz[shown][:, others], middle[others], width, sdf[shown])


def _across(axis: int) -> tuple[int, int]:
    """The axes to the right and upwards, as one sees the shape: y is up where it can be."""
    return ((2, 1), (0, 2), (0, 1))[axis]


def draw_slice(section: Slice, out: Path) -> None:
    """Write the slice as a PNG: red inside, blue outside."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.colors import LinearSegmentedColormap

    across, up = _across(section.axis)
    colours = LinearSegmentedColormap.from_list("sdf", list(zip((0, 0.25, 0.5, 0.5, 0.75, 1), INSIDE + OUTSIDE)))
    with plt.rc_context({"font.size": 10, "text.color": INK, "axes.edgecolor": "#c3c7ce", "axes.labelcolor": INK}):
        figure, axes = plt.subplots(figsize=(7.4, 6.3), layout="constrained")
        # Points nearest the surface are drawn last, on top of the others.
        order = np.argsort(-np.abs(section.sdf))
        x, y = section.places[order].T
        dots = axes.scatter(
            x, y, _dot(len(order)), section.sdf[order], cmap=colours, vmin=-LIMIT, vmax=LIMIT, linewidths=0
        )
        (left, bottom), half = section.middle, section.width / 2
        axes.set(xlim=(left - half, left + half), ylim=(bottom - half, bottom + half), aspect="equal")
        axes.set(xlabel=f"{AXES[across]}, canonical units", ylabel=f"{AXES[up]}, canonical units")
        axes.tick_params(color="#c3c7ce", labelcolor=INK, length=3)
        axes.set_title(f"{section.shape_id}, step {section.step}", loc="left", fontsize=13, fontweight="bold", pad=10)
        place = f"{AXES[section.axis]} = {section.at:.2f} ± {THICKNESS / 2:g}"
        axes.set_title(f"{len(order):,} points, {place}", loc="right", fontsize=10, pad=10)
        bar = figure.colorbar(dots, ax=axes, extend="both", shrink=0.9, pad=0.02)
        bar.set_label("signed distance, canonical units; negative inside")
        bar.ax.tick_params(color="#c3c7ce", labelcolor=INK, length=3)
        bar.outline.set_visible(False)
        figure.savefig(out, dpi=160, format="png", metadata={"Software": None})
        plt.close(figure)


def _dot(points: int) -> float:
    """Area of a dot in square points, so that many don't cover each other."""
    return float(np.clip(30_000 / max(points, 1), 4, 40))
