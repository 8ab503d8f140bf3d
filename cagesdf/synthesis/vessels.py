"""Bodies, necks, lips, feet, handles and lids of vessels.

A body is hollow: its wall has one thickness everywhere, in absolute units, its floor nearly twice
that. Grooves and rings are as far apart, steps as far and as high, whatever the vessel's size.
Necks and lips are tubes, handles are swept along a curve in the local yz plane with the vessel at
−z. Every function fills [-size/2, size/2]³ of its size.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.geometry.meshes import Mesh
from cagesdf.synthesis.members import Factors
from cagesdf.synthesis.surfaces import Vector, capped, fill, looped, smooth, stack, superellipse, sweep

AROUND = 40  # points of a ring
AROUND_BODY = 80  # points of a fluted ring: a groove has at least four
BULB = 0.2  # half the height of a baluster's
LOBES = (12, 16, 20)  # multiples of four touch the cuboid's four sides


def lobed(size: Vector, factors: Factors) -> Float[ndarray, "n 2"]:
    """A vessel's section: round or oval, with grooves about a pitch apart and `flute` deep.

    Grooves are narrow and the crests between them wide, so that no turned box is smaller.
    """
    angle = np.linspace(0, 2 * np.pi, AROUND_BODY + 1)[:-1]
    count = min(LOBES, key=lambda lobes: abs(lobes - np.pi * (size[0] + size[2]) / 2 / factors["pitch"]))
    groove = factors["flute"] / (size[0] / 2) * (0.5 - 0.5 * np.cos(count * angle)) ** 3
    return (1 - groove)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _ovoid(t: ndarray, foot: float, mouth: float, belly: float, height: float) -> ndarray:
    low = foot + (1 - foot) * np.sin(np.pi / 2 * np.clip(t / belly, 0, 1)) ** 0.9
    high = mouth + (1 - mouth) * np.cos(np.pi / 2 * np.clip((t - belly) / (1 - belly), 0, 1)) ** 0.8
    return np.where(t < belly, low, high)


def _shouldered(t: ndarray, foot: float, mouth: float, belly: float, height: float) -> ndarray:
    top = 1 - min(0.24 - 0.2 * belly, 0.2 * height) / height
    low = foot + (1 - foot) * np.clip(t / top, 0, 1) ** 0.8
    u = np.clip((t - top) / (1 - top), 0, 1)
    return np.where(t < top, low, mouth + (1 - mouth) * np.sqrt(np.clip(1 - u**2.4, 0, 1)))


def _baluster(t: ndarray, foot: float, mouth: float, belly: float, height: float) -> ndarray:
    below, above = np.minimum([0.68 * belly, 0.68 * (1 - belly)], BULB / height)
    bulge = np.exp(-((np.abs(t - belly) / np.where(t < belly, below, above)) ** 4.5))
    line = foot + (mouth - foot) * t
    return line * (1 - bulge) * 0.82 + bulge + 0.18 * line * (1 - bulge)


def _carinated(t: ndarray, foot: float, mouth: float, belly: float, height: float) -> ndarray:
    # The band between the two cones keeps a tilted box from being smaller than the upright one.
    low = foot + (1 - foot) * np.clip(t / (0.55 * belly), 0, 1) ** 0.9
    u = np.clip((t - belly) / (1 - belly) * 2.2 - 1.2, 0, 1)
    return np.where(t < belly, low, mouth + (1 - mouth) * (1 - u) ** 1.2)


BODIES = {"ovoid": _ovoid, "shouldered": _shouldered, "baluster": _baluster, "carinated": _carinated}


def body(size: Vector, kind: str, foot: float, mouth: float, factors: Factors) -> Mesh:
    """A hollow body, open at its top. `foot` and `mouth` are the radii there, in half widths.

    Of the factors, `belly` is the height of the widest place (share of the height), `rib` the
    distance of level grooves, `wall` the thickness.
    """
    half = size / 2
    t = np.linspace(0, 1, int(np.clip(size[1] / 0.018, 28, 44)))
    radius = BODIES[kind](t, foot, mouth, factors["belly"], float(size[1]))
    band = smooth(t, 0.12, 0.3) * (1 - smooth(t, 0.75, 0.95))
    groove = (
        0.45 * factors["flute"] / half[0] * band * (0.5 - 0.5 * np.cos(2 * np.pi * round(size[1] / factors["rib"]) * t))
    )
    radius = radius / radius.max() - groove
    fluted = (smooth(t, 0.1, 0.35) * (1 - smooth(t, 0.7, 0.95)))[:, None, None]
    circle = superellipse(1.0, 1.0, 2.0, AROUND_BODY)
    outline = fluted * lobed(size, factors) + (1 - fluted) * circle
    outer = stack(outline, half[0] * radius, half[2] * radius, size[1] * t)

    wall = min(factors["wall"], 0.25 * half[0], 0.25 * half[2])
    high = np.linspace(size[1], 1.8 * wall, 18)
    room = np.interp(high / size[1], t, radius)
    thick = wall + factors["flute"] * np.interp(high / size[1], t, fluted[:, 0, 0])
    inner_x, inner_z = (np.maximum(side * room - thick, 0.1 * side) for side in half[[0, 2]])
    inner = stack(circle, inner_x, inner_z, high)
    floor = [inner[-1] * [share, 1, share] for share in (0.6, 0.25)]

    rim = radius[0] * np.array([0.3, 0.7, 0.9])
    under = stack(circle, half[0] * rim, half[2] * rim, np.array([0.01, 0.01, 0.0]))
    return fill(capped(np.concatenate([under, outer, inner, floor])), size)


def tube(size: Vector, outer: Float[ndarray, " m"], wall: float) -> Mesh:
    """A standing tube of one thickness, open at both ends; `outer` is its radius, in half widths, upwards."""
    half = size / 2
    t = np.linspace(0, 1, len(outer))
    outer = outer / outer.max()
    wall = min(wall, 0.4 * half[0] * outer.min(), 0.4 * half[2] * outer.min())
    circle = superellipse(1.0, 1.0, 2.0, AROUND)
    soft = np.minimum(1, np.sqrt(np.minimum(t, 1 - t) / 0.06) * 0.5 + 0.5)
    skins = [
        stack(circle, half[0] * outer - wall * (1 - soft), half[2] * outer - wall * (1 - soft), size[1] * t),
        stack(circle, half[0] * outer - wall * soft, half[2] * outer - wall * soft, size[1] * t)[::-1],
    ]
    return fill(looped(np.concatenate(skins)), size)


def neck(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A neck that narrows in the middle by `flare`, or leans in or out, and carries rings half a `rib` apart."""
    t = np.linspace(0, 1, 24)
    narrow = min(factors["flare"] / (size[0] / 2), 0.45)
    outer = {
        "waisted": 1 - narrow * np.sin(np.pi * t),
        "trumpet": 1 - narrow * (1 - t**2.2) * smooth(t, -0.3, 0.25),
        "funnel": 1 - narrow * t**0.8,
    }[kind]
    wave = 0.5 - 0.5 * np.cos(2 * np.pi * round(2 * size[1] / factors["rib"]) * t)
    ring = 0.008 / (size[0] / 2) * wave * smooth(t, 0.1, 0.3) * (1 - smooth(t, 0.7, 0.9))
    return tube(size, outer - ring, factors["wall"])


def lip(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A rim: rolled, flaring or bevelled."""
    t = np.linspace(0, 1, 12)
    wall = min(1.6 * factors["wall"] / (size[0] / 2), 0.15)
    outer = {
        "waisted": 1 - wall * (1 - np.sin(np.pi * t)),
        "trumpet": 1 - 2 * wall * (1 - t) ** 1.6,
        "funnel": 1 - 1.4 * wall * np.abs(t - 0.35),
    }[kind]
    return tube(size, outer, 2 * factors["wall"])


def foot(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A foot ring: spreading, stepped or coved, each as far whatever its width; hollow below."""
    half = size / 2
    t = np.linspace(0, 1, 24)
    y, base = size[1] * t, 0.022
    set_back = min(0.034 / half[0], 0.2)
    outer = {
        "ovoid": 1 - 1.6 * set_back * smooth(y, base, size[1]),
        "shouldered": 1 - set_back * (smooth(y, base, base + 0.006) + smooth(y, 2 * base, 2 * base + 0.006)),
        "baluster": 1 - set_back * (2 * np.sin(np.pi / 2 * np.clip(y / (3 * base), 0, 1)) - t**4),
        "carinated": 1 - 1.7 * set_back * np.sin(0.78 * np.pi * t) ** 0.8,
    }[kind]
    outer[:2] -= [0.02, 0.004]
    hollow = min(0.5 * size[1], 0.03)
    inside = np.array([0.1, 0.4, outer[0] - 1.5 * factors["wall"] / half[0], outer[0] - factors["wall"] / half[0]])
    scale = np.concatenate([inside, outer, outer[-1] * np.array([0.75, 0.4, 0.1])])
    height = np.concatenate([[hollow, hollow, hollow, 0.0], y, np.full(3, 0.85 * size[1])])
    return fill(capped(stack(superellipse(1.0, 1.0, 2.0, AROUND), half[0] * scale, half[2] * scale, height)), size)


def handle(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A handle in the yz plane, both ends at −z: an ear, an angular strap, or a curl that ends in a scroll."""
    _, height, depth = size
    angle = np.linspace(-np.pi / 2, np.pi / 2, 44)
    thick = min(0.4 * factors["wall"] + 0.008, 0.16 * depth, 0.12 * height)
    power = {"ear": 0.95, "strap": 0.42, "curl": 0.8}[kind]
    z = depth * np.abs(np.cos(angle)) ** power
    y = height / 2 * np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** power
    if kind == "curl":
        z = z * (1 - 0.16 * np.exp(-(((y / height + 0.1) / 0.12) ** 2)))
    section = superellipse(size[0] / 2, thick, 3.0 if kind == "strap" else 2.0, 16)
    swell = 0.75 + 0.25 * np.abs(np.sin(angle))
    rings = sweep(np.stack([y, z], axis=1), section, thick * swell, size[0] / 2)
    rings[..., 0] *= (0.7 + 0.3 * np.abs(np.sin(angle)) ** 2)[:, None]
    return fill(capped(rings), size)


def ring(size: Vector, extra: float) -> Mesh:
    """A ring in the yz plane, thicker below and by `extra`: a bowl's handle, or a stretcher laid flat."""
    angle = np.linspace(0, 2 * np.pi, 49)[:-1]
    thick = min(0.45 * size[0] + extra, 0.14 * size[1], 0.14 * size[2])
    y, z = (size[1] / 2 - thick) * np.sin(angle), (size[2] / 2 - thick) * np.cos(angle)
    across = thick * (0.85 - 0.15 * np.sin(angle))
    section = superellipse(size[0] / 2, thick, 2.0, 16)
    normal = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    plane = np.stack([y, z], axis=1)[:, None] + across[:, None, None] * section[None, :, 1:] * normal[:, None]
    x = np.broadcast_to(size[0] / 2 * section[:, 0], plane.shape[:2])
    return fill(looped(np.concatenate([x[..., None], plane], axis=-1)), size)


def lid(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A cover: domed, with a step near its rim, hollow below."""
    half = size / 2
    s = np.linspace(1, 0.03, 24)
    power = {"ovoid": 2.0, "shouldered": 3.2, "baluster": 1.2, "carinated": 1.5}[kind]
    flange = min(0.02 / size[1], 0.3)
    step = 0.006 / size[1] * np.cos(2 * np.pi * (1 - s) * half[0] / (0.5 * factors["rib"])) * (s < 0.85)
    y = flange + (1 - flange) * (1 - s**power) + step
    under = np.linspace(0.05, 1, 10)
    wall = min(factors["wall"], 0.35 * size[1])
    below = size[1] * (flange + (1 - flange) * (1 - under**power)) - wall
    scale = np.concatenate([under * (1 - wall / half[0]), [0.985, 1.0], s * 0.985])
    height = np.concatenate([below.clip(0) * (under < 0.97), [0.0, 0.5 * flange * size[1]], size[1] * y])
    return fill(capped(stack(superellipse(1.0, 1.0, 2.0, AROUND), half[0] * scale, half[2] * scale, height)), size)


def knob(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A finial: a ball, a bud or a button on a stem."""
    t = np.linspace(0, 1, 30)
    bulb = {"ovoid": 0.62, "shouldered": 0.72, "baluster": 0.5, "carinated": 0.66}[kind]
    wide = np.sqrt(np.clip(1 - ((t - bulb) / np.where(t < bulb, 0.34, 1 - bulb)) ** 2, 0, 1))
    stem = 0.42 + 0.2 * (1 - smooth(t, 0.0, 0.25))
    scale = np.where(t < bulb, np.maximum(wide, stem), wide).clip(0.06)
    return fill(
        capped(stack(superellipse(1.0, 1.0, 2.0, 40), size[0] / 2 * scale, size[2] / 2 * scale, size[1] * t)), size
    )


def spout(size: Vector, factors: Factors) -> Mesh:
    """A pouring tube along y: wide at the vessel, narrower and bent forwards at its mouth."""
    t = np.linspace(0, 1, 30)
    radius = 1 - 0.55 * smooth(t, 0.0, 0.8) + 0.12 * smooth(t, 0.85, 1.0)
    half = size / 2
    wall = min(factors["wall"], 0.16 * half[0])
    circle = superellipse(1.0, 1.0, 2.0, 32)
    outer = stack(circle, half[0] * radius, half[2] * radius, size[1] * t)
    inner = stack(circle, half[0] * radius - wall, half[2] * radius - wall, size[1] * t)
    for skin in (outer, inner):
        skin[..., 2] += (half[2] * (0.45 * smooth(t, 0.5, 1.0) - 0.25 * np.sin(np.pi * t)))[:, None]
    return fill(looped(np.concatenate([outer, inner[::-1]])), size)


def bail(size: Vector) -> Mesh:
    """A pail's wire: an arch in the local xy plane, open below."""
    width, height, depth = size
    angle = np.linspace(0, np.pi, 56)
    wire = depth / 2
    path = np.stack([height * np.sin(angle) ** 0.9, (width / 2 - wire) * np.cos(angle)], axis=1)
    rings = sweep(path, superellipse(1.0, 1.0, 2.0, 12), np.full(56, wire), wire)
    return fill(capped(rings[..., [2, 1, 0]]), size)
