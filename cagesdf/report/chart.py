"""Curves as inline SVG, coloured by the page's style sheet."""

import math
from collections.abc import Mapping, Sequence
from html import escape

WIDTH, HEIGHT = 760, 300
LEFT, RIGHT, TOP, BOTTOM = 62, 168, 12, 34  # margins: axis, labels of the curves, none, axis
LABEL_GAP = 17  # between the labels of curves that end at nearly the same height

DRAWABLE = (1e-30, 1e30)  # heights

Curve = Sequence[tuple[int | float, float]]  # (step, loss), (million points, distance)


def log_chart(curves: Mapping[str, Curve], label: str) -> str:
    """An SVG element with one curve per name, its height on a logarithmic axis; `label` is its title.

    Heights that aren't between DRAWABLE are left out: zero, negative, diverged. A single point is no curve, and no
    curve gives an empty text.
    """
    drawable = {name: [(x, y) for x, y in curve if DRAWABLE[0] < y < DRAWABLE[1]] for name, curve in curves.items()}
    drawable = {name: curve for name, curve in drawable.items() if len(curve) > 1}
    if not drawable:
        return ""
    last = max(x for curve in drawable.values() for x, _ in curve) or 1
    heights = [math.log10(y) for curve in drawable.values() for _, y in curve]
    ticks = _decades(min(heights), max(heights))
    low, high = min(math.log10(ticks[0]), *heights), max(math.log10(ticks[-1]), *heights)

    def place(x: int | float, y: float) -> tuple[float, float]:
        share = (math.log10(y) - low) / max(high - low, 1e-9)
        return LEFT + (WIDTH - LEFT - RIGHT) * x / last, HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * share

    parts = [f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(label)}">']
    for tick in ticks:
        _, y = place(0, tick)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    for tick in _multiples(float(last)):
        x, y = place(tick, 10**low)
        parts.append(f'<text class="tick" x="{x:.1f}" y="{y + 20:.1f}" text-anchor="middle">{tick:g}</text>')
    ends = {name: place(*curve[-1]) for name, curve in drawable.items()}
    labels = _apart({name: end[1] for name, end in ends.items()})
    for i, (name, curve) in enumerate(drawable.items()):
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in (place(*point) for point in curve))
        x, y = ends[name]
        parts.append(f'<g class="series s{i % 8}"><polyline points="{line}"/>')
        parts.append(f'<path class="lead" d="M{x:.1f},{y:.1f} L{x + 12:.1f},{labels[name]:.1f}"/>')
        parts.append(f'<text x="{x + 16:.1f}" y="{labels[name] + 4:.1f}">{escape(name)}</text></g>')
    return "".join([*parts, "</svg>"])


def _decades(low: float, high: float) -> list[float]:
    """Round numbers (1, 2 or 5 times a power of ten) around and between two powers of ten."""
    numbers = [m * 10.0**e for e in range(math.floor(low) - 1, math.ceil(high) + 1) for m in (1, 2, 5)]
    inside = [n for n in numbers if low <= math.log10(n) <= high]
    below = [n for n in numbers if math.log10(n) < low][-1:]
    ticks = below + inside
    wide = [n for n in ticks if math.log10(n) % 1 < 1e-9 or math.log10(n) % 1 > 1 - 1e-9]
    return wide if len(ticks) > 7 and len(wide) > 1 else ticks


def _multiples(last: float) -> list[float]:
    """Multiples of a round number from 0 to at most `last`, four to nine of them."""
    size = 10.0 ** math.floor(math.log10(last))
    step = next(size * m for m in (0.1, 0.2, 0.5, 1, 2) if last < 9 * size * m)
    return [step * i for i in range(math.floor(last / step + 1e-9) + 1)]  # 0.6 / 0.1 is less than 6


def _apart(heights: Mapping[str, float]) -> dict[str, float]:
    """The same heights moved down or up until they are LABEL_GAP apart and inside the chart."""
    names = sorted(heights, key=lambda name: heights[name])
    result: dict[str, float] = {}
    lowest = TOP + 4.0
    for name in names:
        result[name] = max(heights[name], lowest)
        lowest = result[name] + LABEL_GAP
    highest = HEIGHT - BOTTOM + 0.0
    for name in reversed(names):
        result[name] = min(result[name], highest)
        highest = result[name] - LABEL_GAP
    return result
