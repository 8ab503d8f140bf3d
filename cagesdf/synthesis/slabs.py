"""Tops, seats, shelves, backs and fronts: flat parts that are nowhere quite flat.

A slab lies in local xz with its top at +y; a panel stands in local xy with its front at +z.
Every function fills [-size/2, size/2]³ of its size.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.geometry.meshes import Mesh
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
FIELD = np.linspace(0, 1, 7)[1:]  # shares of the way from the centre to the rim
TUFTED = np.linspace(0, 1, 19)[1:]  # the same where tufts must show
FRAME = 0.022  # thickness of the frame below a board
OVERHANG = 0.012  # of the board's moulding over its frame
LEAST = 0.008  # a lower frame isn't made


def slab(
    size: Vector, outline: Outline, edge: str, top: str, factors: Factors, field: Float[ndarray, " k"] = FIELD
) -> Mesh:
    """A board with a moulded edge on a frame, hollow below, its top dished, sunk or domed.

    `edge` is one of EDGES, `top` one of TOPS, `field` where the rings of the top lie. Of the factors, `board` is
    the thickness of the board, whatever the slab's: a thicker one has a higher frame, and one hardly thicker
    none. `edge` is the radius or width of the moulding and `dish` how far the top is hollowed or domed.
    """
    half, height = size / 2, size[1]
    drop = TOPS[top](field[::-1], height, factors["dish"])
    rim = height + min(0.0, drop.min())  # a dome rises above it
    hollow = rim - min(factors["board"], 0.8 * rim)
    foot = rim - factors["board"] if rim - factors["board"] > LEAST else 0.0
    inset, rise = EDGES[edge](rim - foot, min(factors["edge"], 0.3 * half[0], 0.3 * half[2]))
    back = inset[0] + OVERHANG
    outside = np.array([[back, 0.0], [back, foot]] if foot else [[inset[0] + 0.002, 0.0]])
    low, high = outside[0, 0] + FRAME, inset[-1] + 0.014
    at = np.concatenate([(low + 0.004) * np.ones_like(field), [low], outside[:, 0], inset])
    at = np.concatenate([at, [high - 0.012], high * np.ones_like(field)])
    y = np.concatenate([np.full_like(field, hollow), [0.0], outside[:, 1], foot + rise, [rim], rim - drop])
    scale = np.concatenate([field, np.ones(len(inset) + len(outside) + 2), field[::-1]])
    # On a narrow plate the moulding stops short of the middle, beyond which the ring would turn inside out.
    x, z = (side - np.minimum(at, 0.9 * side) for side in half[[0, 2]])
    return fill(capped(stack(outline, x * scale, z * scale, y)), size)


def _half_round(height: float, radius: float) -> tuple[ndarray, ndarray]:
    radius = min(radius, 0.49 * height)
    angle = np.linspace(0, np.pi / 2, 6)
    inset, rise = radius * (1 - np.sin(angle)), radius * (1 - np.cos(angle))
    return np.concatenate([inset, inset[::-1]]), np.concatenate([rise, height - rise[::-1]])


def _bevel(height: float, width: float) -> tuple[ndarray, ndarray]:
    slope, lip = min(1.5 * width, 0.6 * height), min(0.4 * width, 0.2 * height)
    rise = np.array([0.0, 0.5 * slope, slope, slope + 0.1 * (height - slope), height - lip, height])
    return np.array([1.8, 0.95, 0.1, 0.0, 0.0, 1.0]) * np.array([width, width, width, 0.0, 0.0, lip]), rise


def _ogee(height: float, width: float) -> tuple[ndarray, ndarray]:
    u = np.linspace(0, 1, 8)
    curve, round_over = min(1.7 * width, 0.62 * height), min(0.6 * width, 0.3 * height)
    inset = np.concatenate([1.5 * width * (1 - smooth(u, 0.0, 1.0)), round_over * np.array([0.0, 0.3, 1.0])])
    return inset, np.concatenate([curve * u, height - round_over * np.array([1.0, 0.3, 0.0])])


def _dished(s: ndarray, height: float, depth: float) -> ndarray:
    return min(depth, 0.35 * height) * (1 - 0.75 * s**3)


def _sunk(s: ndarray, height: float, depth: float) -> ndarray:
    return np.full_like(s, min(depth, 0.35 * height))


def _domed(s: ndarray, height: float, depth: float) -> ndarray:
    # Less than nothing at the centre: the dome rises above the rim and sets the height.
    return min(1.1 * depth, 0.35 * height) * (s**2.5 - 1)


EDGES = {"rounded": _half_round, "bevelled": _bevel, "ogee": _ogee}
TOPS = {"dished": _dished, "sunk": _sunk, "domed": _domed}


def upholstered(size: Vector, outline: Outline, factors: Factors) -> Mesh:
    """A seat whose board is a pad: domed, tufted at the pitch, its edge rounder than wood's."""
    soft = {**factors, "edge": 0.022 + 0.2 * factors["edge"], "board": 0.012 + factors["board"]}
    pad = slab(size, outline, "rounded", "domed", soft, TUFTED)
    return fill(_tufted(pad, size[1] / 2 - 0.6 * soft["edge"], 0.5 * factors["dish"], factors["pitch"]), size)


def _tufted(mesh: Mesh, above: float, depth: float, pitch: float) -> Mesh:
    """A lying pad with its top, from a height on, drawn in at every second corner of a grid of this pitch."""

    def draw_in(x: ndarray, y: ndarray, z: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        wave = 0.5 - 0.5 * np.cos(np.pi * x / pitch) * np.cos(np.pi * z / pitch)
        return x, y - depth * wave * smooth(y, above, y.max()), z

    return warped(mesh, draw_in)


def cushion(size: Vector, factors: Factors) -> Mesh:
    """A pad, domed on both sides, its edge rounded to the same radius everywhere, tufted at the pitch."""
    half = size / 2
    dome = min(factors["dish"], 0.3 * half[1])
    radius = min(0.05, half[1] - dome)
    side = half[1] - dome - radius
    angle = np.linspace(0, np.pi / 2, 7)
    inset, edge = radius * (1 - np.cos(angle)), side + radius * np.sin(angle)
    field = TUFTED[::-1][1:]
    at = np.concatenate([inset, np.full_like(field, radius)])
    scale = np.concatenate([np.ones_like(inset), field])
    y = np.concatenate([edge, half[1] - dome * field**2.5])
    outline = rounded_rectangle(half[0], half[2], 0.04 + factors["edge"], 64)
    x, z = (scale * (half[axis] - np.minimum(at, 0.9 * half[axis])) for axis in (0, 2))
    lower = slice(None, 0, -1) if side == 0 else slice(None, None, -1)
    both = [np.concatenate([values[lower] * sign, values]) for values, sign in ((x, 1), (z, 1), (y, -1))]
    return fill(_tufted(capped(stack(outline, both[0], both[1], both[2])), 0.0, 0.6 * dome, factors["pitch"]), size)


def panel(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A chair's back: `bent`, `pierced`, `slatted` or `cushioned`.

    A plate or pad of one thickness, whatever the cuboid's depth, bowed about the vertical to fill that. Openings and
    tufts follow the pitch, the margins around them and the corners keep their widths.
    """
    width, height, depth = size
    plate = min(factors["plate"] + 0.024 * (kind == "cushioned"), 0.7 * depth)
    flat = np.array([width, plate, height])
    if kind == "cushioned":
        body = stood(cushion(flat, factors))
    else:
        outline = rounded_rectangle(width / 2, height / 2, 0.02 + 0.6 * factors["bend"], 56)
        body = stood(slab(flat, outline, "rounded", "sunk" if kind == "bent" else "domed", factors))
    crest = min(0.045, 0.15 * height) * (kind != "slatted")
    bowed = warped(
        body,
        lambda x, y, z: (
            x,
            y - crest * (2 * x / width) ** 2 * smooth(y / height, -0.3, 0.5),
            z + (depth - plate) * (2 * x / width) ** 2,
        ),
    )
    if kind in ("pierced", "slatted"):
        bowed = pierced(bowed, _openings(width, height, kind, factors["pitch"]))
    return fill(bowed, size)


def _openings(width: float, height: float, kind: str, pitch: float) -> list[Mesh]:
    """Slots the full height, or a lattice of lozenges, a pitch apart."""
    margin = min(0.055, 0.16 * width)
    if kind == "slatted":
        count = max(2, round((width - 2 * margin) / pitch))
        step = (width - 2 * margin) / count
        return [
            _hole(-width / 2 + margin + (i + 0.5) * step, 0.0, 0.33 * step, height / 2 - margin, 4.0)
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
    """A narrow back of a vase's outline, one plate bent to the sitter's spine; pierced at the pitch, or whole.

    The vase's belly and foot are as high, and as far from its ends, whatever the splat's height.
    """
    width, height, depth = size
    plate = min(factors["plate"], 0.7 * depth)
    outline = rounded_rectangle(width / 2, height / 2, 0.02, 56)
    body = stood(slab(np.array([width, plate, height]), outline, "rounded", "domed", factors))

    def shape(x: ndarray, y: ndarray, z: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        up, down = y + height / 2, height / 2 - y
        belly = np.exp(-(((down - min(0.2, 0.4 * height)) / 0.1) ** 2))
        side = 0.6 + 0.4 * belly + 0.28 * (1 - up / min(0.09, 0.2 * height)).clip(0)
        return x * side, y, z - (depth - plate) * np.cos(2 * np.pi * up / height)

    bent = warped(body, shape)
    if kind in ("pierced", "slatted"):
        step = min(1.1 * factors["pitch"], 0.3 * height)
        tops = 0.4 * height - step * np.arange(max(1, int(0.66 * height / step)))
        bent = pierced(bent, [_hole(0.0, top - step / 2, 0.2 * width, 0.36 * step, 2.0) for top in tops])
    return fill(bent, size)


def slat(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A rung of a ladder back or a crest: a bar along x of one thickness, bowed backwards, its top edge curved."""
    half_x, _, half_z = size / 2
    x = np.linspace(-1, 1, int(np.clip(size[0] / 0.014, 24, 64)))
    thick = min(1.3 * factors["plate"], 0.8 * size[2])
    drop = min(0.02, 0.2 * size[1])
    rise = {"bent": np.cos(np.pi / 2 * x), "pierced": 0.5 - 0.5 * np.cos(3 * np.pi * (x + 1) / 2) ** 2}
    top = size[1] - drop * (1 - rise.get(kind, 1 - x**4))
    foot = 0.5 * drop * np.cos(np.pi / 2 * x) ** 2
    section = superellipse(half_z, size[1] / 2, 2.6, 20)
    rings = stack(section, thick / 2 * (0.8 + 0.2 * np.cos(np.pi / 2 * x)), (top - foot) / 2, half_x * x)
    rings[..., 2] += ((top + foot) / 2)[:, None]
    rings[..., 0] += ((size[2] - thick) * x**2)[:, None]
    return fill(capped(rings[..., [1, 2, 0]]), size)


def grid(size: Vector, factors: Factors) -> Mesh:
    """A shelf of slats along x in a frame, a pitch apart."""
    width, _, depth = size
    outline = rounded_rectangle(width / 2, depth / 2, 0.01 + factors["edge"], 56)
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
    base = plate / 2 - min(factors["dish"], 0.35 * plate) - 0.002
    rise = base + t * (depth - plate / 2 - base)
    knob = stood(capped(stack(superellipse(1.0, 1.0, power, 20), waist, waist, rise)))
    return fill(united([board, knob]), size)


def case(size: Vector, factors: Factors) -> Mesh:
    """The carcass of a cabinet: sides set back between a plinth and a cornice, both as high whatever the cabinet."""
    half, height = size / 2, size[1]
    plinth, cornice = 0.03 + factors["board"], 0.8 * factors["board"]
    step, back = 0.012, 0.012 + 0.5 * factors["edge"]
    y = np.array([0.0, 0.2 * step, plinth - step, plinth, *np.linspace(plinth, height - cornice, 24)[1:-1]])
    y = np.concatenate([y, [height - cornice, height - cornice + step, height - 0.2 * step, height]])
    inset = np.concatenate([[0.004, 0.0, 0.0], np.full(len(y) - 6, back), [0.0, 0.0, 0.004]])
    outline = rounded_rectangle(half[0], half[2], 0.6 * factors["edge"], 56)
    rings = stack(outline, half[0] - inset, half[2] - inset, y)
    lid = stack(
        outline, (half[0] - 0.024) * FIELD[::-1], (half[2] - 0.024) * FIELD[::-1], np.full_like(FIELD, height - 0.014)
    )
    floor = lid[::-1] * [1, 0, 1] + [0, 0.014, 0]
    return fill(capped(np.concatenate([floor, rings, lid])), size)


def disc(size: Vector, factors: Factors) -> Mesh:
    """A pedestal's round foot: a moulded edge, rings a bead apart, and a slope up to the column."""
    half, height = size / 2, size[1]
    s = np.linspace(1, 0.02, 30)
    edge = min(0.012 + 0.4 * factors["edge"], 0.4 * height)
    slope = 0.95 * edge + (height - edge) * (1 - s) ** 1.8
    ring = 0.1 * edge * (1 - np.cos(2 * np.pi * (1 - s) * half[0] / (0.6 * factors["bead"]))) * s
    side = np.linspace(0, 1, 6)
    radius = np.concatenate([np.linspace(0.05, 0.86, 9), [0.9], 0.97 + 0.03 * np.sin(np.pi * side), 0.97 * s])
    y = np.concatenate([np.full(9, 0.5 * edge), [0.0], 0.9 * edge * side, slope + ring])
    return fill(capped(stack(superellipse(half[0], half[2], 2.0, 56), half[0] * radius, half[2] * radius, y)), size)
