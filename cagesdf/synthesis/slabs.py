"""Tops, seats, shelves, backs and fronts: flat parts that are nowhere quite flat.

A slab lies in local xz with its top at +y; a panel stands in local xy with its front at +z.
Every function fills [-size/2, size/2]³ of its size.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.meshes import Mesh
from cagesdf.synthesis.members import Factors
from cagesdf.synthesis.surfaces import (
    Vector,
    capped,
    fill,
    pierced,
    rounded_rectangle,
    smooth,
    stack,
    stood,
    superellipse,
    united,
    warped,
)

Outline = Float[ndarray, "n 2"]
FIELD = np.linspace(0, 1, 11)[1:]  # shares of the way from the centre to the rim
HOLLOW = 0.02  # depth of undersides
SHEET = 0.014  # thinnest bent or pierced plate


def slab(size: Vector, outline: Outline, edge: str, top: str, factors: Factors) -> Mesh:
    """A plate with a moulded edge, a hollow underside, and a dished, sunk or domed top.

    `edge` is one of EDGES, `top` one of TOPS. Of the factors, `edge` is the radius or width of
    the moulding and `dish` how far the top is hollowed or domed.
    """
    half, height = size / 2, size[1]
    inset, rise = EDGES[edge](height, min(factors["edge"], 0.3 * half[0], 0.3 * half[2]))
    hollow, low, high = min(0.42 * height, HOLLOW), inset[0] + 0.016, inset[-1] + 0.016
    drop = TOPS[top](FIELD[::-1], height, factors["dish"])
    field = np.ones_like(FIELD)
    at = np.concatenate([(low + 0.01) * field, [low, inset[0] + 0.002], inset, [high - 0.014], high * field])
    y = np.concatenate([hollow * field, [0.0, 0.0], rise, [height], height - drop])
    scale = np.concatenate([FIELD, np.ones(len(inset) + 3), FIELD[::-1]])
    # On a narrow plate the moulding stops short of the middle, beyond which the ring would turn inside out.
    x, z = (side - np.minimum(at, 0.9 * side) for side in half[[0, 2]])
    return fill(capped(stack(outline, x * scale, z * scale, y)), size)


def _half_round(height: float, radius: float) -> tuple[ndarray, ndarray]:
    angle = np.linspace(-np.pi / 2, np.pi / 2, 9)
    return radius * (1 - np.cos(angle)), height / 2 * (1 + np.sin(angle))


def _bevel(height: float, width: float) -> tuple[ndarray, ndarray]:
    return np.array([2.2, 1.1, 0.15, 0.0, 0.5]) * width, np.array([0.0, 0.38, 0.72, 0.8, 1.0]) * height


def _ogee(height: float, width: float) -> tuple[ndarray, ndarray]:
    u = np.linspace(0, 1, 9)
    return width * (1.6 - 1.6 * smooth(u, 0.0, 0.75) + 0.6 * u**6), height * u


def _dished(s: ndarray, height: float, depth: float) -> ndarray:
    return min(depth, 0.5 * height) * (1 - 0.75 * s**3)


def _sunk(s: ndarray, height: float, depth: float) -> ndarray:
    return np.full_like(s, min(depth, 0.45 * height))


def _domed(s: ndarray, height: float, depth: float) -> ndarray:
    # Less than nothing at the centre: the dome rises above the rim and sets the height.
    return min(1.6 * depth, 0.5 * height) * (s**2.5 - 1)


EDGES = {"rounded": _half_round, "bevelled": _bevel, "ogee": _ogee}
TOPS = {"dished": _dished, "sunk": _sunk, "domed": _domed}


def cushion(size: Vector, factors: Factors) -> Mesh:
    """A pad, domed on both sides, its seam at half height, tufted at the pitch."""
    half = size / 2
    outline = rounded_rectangle(half[0], half[2], 0.05 + factors["edge"], 72)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 27)
    scale = np.cos(angle).clip(0) ** 0.42
    rings = stack(outline, half[0] * scale, half[2] * scale, half[1] * np.sin(angle))[1:-1]

    def tuft(x: ndarray, y: ndarray, z: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        wave = np.cos(np.pi * x / factors["pitch"]) * np.cos(np.pi * z / factors["pitch"])
        return x, np.where(y > 0, y * (0.87 + 0.13 * wave), y), z

    return fill(warped(capped(rings), tuft), size)


def panel(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A chair's back: `bent`, `pierced`, `slatted` or `cushioned`.

    A plate bowed by `bend` about the vertical, as far as the cuboid is deep enough. Openings and
    tufts follow the pitch.
    """
    if kind == "cushioned":
        return fill(stood(cushion(size[[0, 2, 1]], factors)), size)
    width, height, depth = size
    plate = max(depth - factors["bend"], min(SHEET, 0.5 * depth), 0.3 * depth)
    outline = rounded_rectangle(width / 2, height / 2, 0.03 + 2 * factors["edge"], 72)
    body = stood(
        slab(np.array([width, plate, height]), outline, "rounded", "sunk" if kind == "bent" else "domed", factors)
    )
    if kind != "bent":
        body = pierced(body, _openings(width, height, kind, factors["pitch"]))
    crest = 0.12 * height * (kind != "slatted")
    bowed = warped(
        body,
        lambda x, y, z: (
            x,
            y - crest * (2 * x / width) ** 2 * smooth(y / height, -0.3, 0.5),
            z + (depth - plate) * (2 * x / width) ** 2,
        ),
    )
    return fill(bowed, size)


def _openings(width: float, height: float, kind: str, pitch: float) -> list[Mesh]:
    """Slots the full height, or a lattice of lozenges, a pitch apart."""
    margin = min(0.055, 0.16 * width)
    if kind == "slatted":
        count = max(2, round((width - 2 * margin) / pitch))
        step = (width - 2 * margin) / count
        return [
            _hole(-width / 2 + margin + (i + 0.5) * step, 0.0, 0.3 * step, height / 2 - margin, 4.0)
            for i in range(count)
        ]
    columns = max(2, round((width - 2 * margin) / (1.25 * pitch)))
    rows = max(2, round((height - 2 * margin) / (1.25 * pitch)))
    across, up = (width - 2 * margin) / columns, (height - 2 * margin) / rows
    return [
        _hole(
            (i + 0.5) * across - width / 2 + margin, (j + 0.5) * up - height / 2 + margin, 0.36 * across, 0.36 * up, 1.4
        )
        for i in range(columns)
        for j in range(rows)
        if not (j == rows - 1 and i in (0, columns - 1))
    ]


def _hole(x: float, y: float, half_x: float, half_y: float, power: float) -> Mesh:
    """A prism through a panel, about (x, y)."""
    one = np.ones(2)
    prism = capped(stack(superellipse(half_x, half_y, power, 16), half_x * one, half_y * one, np.array([-0.5, 0.5])))
    return warped(stood(prism), lambda a, b, c: (a + x, b + y, c))


def splat(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A narrow back of a vase's outline, bent to the sitter's spine; pierced at the pitch, or whole."""
    width, height, depth = size
    plate = max(depth - factors["bend"], min(SHEET, 0.5 * depth), 0.3 * depth)
    outline = rounded_rectangle(width / 2, height / 2, 0.02, 72)
    body = stood(slab(np.array([width, plate, height]), outline, "rounded", "domed", factors))
    if kind in ("pierced", "slatted"):
        count = max(1, round(0.55 * height / factors["pitch"]))
        step = 0.62 * height / count
        body = pierced(
            body, [_hole(0.0, (i + 0.5) * step - 0.26 * height, 0.2 * width, 0.36 * step, 2.0) for i in range(count)]
        )

    def shape(x: ndarray, y: ndarray, z: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        u = y / height + 0.5
        side = 0.62 + 0.38 * np.exp(-(((u - 0.62) / 0.2) ** 2)) + 0.25 * np.maximum(0, 0.16 - u) / 0.16
        return x * side, y, z + (depth - plate) * np.cos(2 * np.pi * u)

    return fill(warped(body, shape), size)


def slat(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A rung of a ladder back or a crest: a bar along x, bowed backwards by `bend`, its top edge curved."""
    half_x, _, half_z = size / 2
    x = np.linspace(-1, 1, int(np.clip(size[0] / 0.014, 24, 64)))
    bow = float(np.clip(factors["bend"], 0.0, 0.62 * size[2]))
    rise = {"bent": np.cos(np.pi / 2 * x), "pierced": 0.5 - 0.5 * np.cos(3 * np.pi * (x + 1) / 2) ** 2}
    top = 0.72 + 0.28 * rise.get(kind, 1 - x**4)
    foot = 0.12 * np.cos(np.pi / 2 * x) ** 2
    thick = (half_z - bow / 2) * (0.8 + 0.2 * np.cos(np.pi / 2 * x))
    rings = stack(superellipse(half_z, size[1] / 2, 2.6, 20), thick, size[1] * (top - foot) / 2, half_x * x)
    rings[..., 2] += (size[1] * (top + foot) / 2)[:, None]
    rings[..., 0] += (bow * x**2)[:, None]
    return fill(capped(rings[..., [1, 2, 0]]), size)


def grid(size: Vector, factors: Factors) -> Mesh:
    """A shelf of slats along x in a frame, a pitch apart."""
    width, _, depth = size
    outline = rounded_rectangle(width / 2, depth / 2, 0.01 + factors["edge"], 64)
    margin = min(0.05, 0.14 * depth)
    count = max(2, round((depth - 2 * margin) / factors["pitch"]))
    step = (depth - 2 * margin) / count
    holes = [
        warped(
            _hole(0.0, -depth / 2 + margin + (i + 0.5) * step, width / 2 - margin, 0.3 * step, 5.0),
            lambda x, y, z: (x, z, -y),
        )
        for i in range(count)
    ]
    return fill(pierced(slab(size, outline, "rounded", "sunk", factors), holes), size)


def front(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A drawer's front, its field sunk, with a turned knob that reaches the cuboid's front."""
    width, height, depth = size
    plate = 0.74 * depth  # with a longer knob a tilted box would be smaller
    outline = rounded_rectangle(width / 2, height / 2, factors["edge"], 64)
    board = stood(slab(np.array([width, plate, height]), outline, "bevelled", "sunk", factors))
    t = np.linspace(0, 1, 16)
    radius = min(0.028, 0.2 * height)
    waist = np.where(t < 0.5, 0.5, 0.5 + 0.5 * np.sin(np.pi * np.clip((t - 0.5) * 2, 0, 1) ** 0.8)) * radius
    power = 2.0 if kind in ("turned", "round", "sabre") else 4.5
    base = plate / 2 - min(factors["dish"], 0.45 * plate) - 0.002
    rise = base + t * (depth - plate / 2 - base)
    knob = stood(capped(stack(superellipse(1.0, 1.0, power, 20), waist, waist, rise)))
    return fill(united([board, knob]), size)


def case(size: Vector, factors: Factors) -> Mesh:
    """The carcass of a cabinet: sides set back between a plinth and a cornice."""
    half = size / 2
    t = np.linspace(0, 1, 40)
    back = 0.012 + 0.5 * factors["edge"]
    ends = np.maximum(smooth(-t, -0.1, -0.07), smooth(t, 0.93, 0.96))
    inset = back * (1 - ends) + 0.5 * factors["edge"] * np.maximum(0, 1 - np.minimum(t, 1 - t) / 0.03) ** 2
    outline = rounded_rectangle(half[0], half[2], 0.6 * factors["edge"], 72)
    rings = stack(outline, half[0] - inset, half[2] - inset, size[1] * t)
    lid = stack(
        outline,
        (half[0] - inset[-1] - 0.02) * FIELD[::-1],
        (half[2] - inset[-1] - 0.02) * FIELD[::-1],
        np.full(10, size[1] - 0.014),
    )
    floor = lid[::-1] * [1, 0, 1] + [0, 0.014, 0]
    return fill(capped(np.concatenate([floor, rings, lid])), size)


def disc(size: Vector, factors: Factors) -> Mesh:
    """A pedestal's round foot: a moulded edge and a slope up to the column."""
    half = size / 2
    s = np.linspace(1, 0.02, 22)
    y = size[1] * (0.22 + 0.78 * (1 - s) ** 1.6)
    ring = 0.06 * size[1] * np.cos(2 * np.pi * factors["turnings"] * s)
    edge = np.linspace(0, 1, 6)
    radius = np.concatenate([np.linspace(0.05, 0.86, 9), [0.9], 0.97 + 0.03 * np.sin(np.pi * edge), 0.97 * s])
    height = np.concatenate([np.full(9, 0.16 * size[1]), [0.0], 0.2 * size[1] * edge, y + ring * s])
    return fill(
        capped(stack(superellipse(half[0], half[2], 2.0, 64), half[0] * radius, half[2] * radius, height)), size
    )
