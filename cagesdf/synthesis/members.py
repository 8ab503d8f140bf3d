"""Legs, posts and rails: long parts along local y, each style a profile of its section.

Every function fills [-size/2, size/2]³ of its size, in the local frame. A rail is a member laid
along local x. Front is local +z: where a leg kicks out, it kicks there.

Details keep their lengths, whatever the member's: blocks, feet and finials are as high, beads as
far apart, feet as thin. The shaft between them takes the rest. So no style is affine in its cuboid.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.geometry.meshes import Mesh
from cagesdf.synthesis.surfaces import (
    Vector,
    capped,
    fill,
    laid,
    rounded_rectangle,
    smooth,
    stack,
    superellipse,
    sweep,
)

SIDES = 20  # points of a section: of fewer, a turned box would be smaller
STEP = 0.011  # between rings
BREAK = 0.007  # half of what a step between two thicknesses takes along a member
SPADE = 0.055  # height of a square leg's foot
FERRULE = 0.045  # of a round leg's
KICK = 0.15  # height at which a sabre leg starts to turn outwards
SHOULDER = 0.055  # of an apron's ends, which aren't cut
Factors = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Profile:
    """Scale, shift and roundness of a member's section along its length."""

    scale: Float[ndarray, " m"]  # of the section, 1 where it touches the cuboid's sides
    shift: Float[ndarray, " m"]  # of its centre along z, in half depths
    roundness: Float[ndarray, " m"]  # 0 the square section, 1 the round


Shaping = Callable[[Vector, ndarray, Factors], Profile]  # size, heights above the lower end, factors → profile


def member(size: Vector, shaping: Shaping, factors: Factors) -> Mesh:
    """A member along y whose section follows a profile."""
    half_x, _, half_z = size / 2
    y = np.linspace(0, size[1], int(np.clip(size[1] / STEP, 20, 60)))
    profile = shaping(size, y, factors)
    square = rounded_rectangle(half_x, half_z, min(factors["edge"], 0.45 * half_x, 0.45 * half_z), SIDES)
    circle = superellipse(half_x, half_z, 2.0, SIDES)
    blend = profile.roundness[:, None, None]
    rings = stack((1 - blend) * square + blend * circle, half_x * profile.scale, half_z * profile.scale, y)
    rings[..., 2] += (half_z * profile.shift)[:, None]
    return fill(capped(rings), size)


def rail(size: Vector, shaping: Shaping, factors: Factors) -> Mesh:
    """A member along x."""
    return fill(laid(member(size[[1, 0, 2]], shaping, factors)), size)


def _still(scale: ndarray, roundness: float) -> Profile:
    return Profile(scale, np.zeros_like(scale), np.full_like(scale, roundness))


def _share(diameter: float, size: Vector) -> float:
    """A diameter as a share of a member's thinner side, if the member is neither too thin nor too thick for it."""
    return float(np.clip(diameter / min(size[0], size[2]), 0.28, 0.88))


def _upper(y: ndarray, size: Vector, length: float) -> ndarray:
    """1 over the uppermost `length`, 0 below."""
    return smooth(y, size[1] - length - BREAK, size[1] - length + BREAK)


def _lower(y: ndarray, length: float) -> ndarray:
    """1 over the lowest `length`, 0 above."""
    return 1 - smooth(y, length - BREAK, length + BREAK)


def _block(size: Vector, factors: Factors) -> float:
    """Length of a block at a member's end."""
    return min(factors["block"], 0.28 * float(size[1]))


def _beads(y: ndarray, count: int, span: float, depth: float) -> ndarray:
    """1 on the crests of `count` beads over a span, `depth` less between them."""
    return 1 - depth * (1 - np.abs(np.sin(np.pi * count * np.clip(y / span, 0, 1))) ** 0.75)


def _groove(size: Vector, factors: Factors) -> float:
    """Depth of the grooves between beads, as a share of the radius: beads are as round as they are long."""
    return float(np.clip(0.7 * factors["bead"] / min(size[0], size[2]), 0.25, 0.55))


def _square(size: Vector, y: ndarray, factors: Factors) -> Profile:
    """A block, a slimmer shaft, a spade foot."""
    shaft = _share(1.35 * factors["tip"], size)
    spade = 0.72 * _lower(y, SPADE) * (0.6 + 0.4 * y / SPADE)
    return _still(shaft + (1 - shaft) * np.maximum(_upper(y, size, _block(size, factors)), spade), 0.0)


def _tapered(size: Vector, y: ndarray, factors: Factors) -> Profile:
    """A block, then an even taper to a foot."""
    low, span = _share(factors["tip"], size), size[1] - _block(size, factors)
    return _still(np.where(y > span, 1.0, low + (0.92 - low) * np.clip(y / span, 0, 1)), 0.0)


def _round(size: Vector, y: ndarray, factors: Factors) -> Profile:
    """A round shaft on a ferrule, widest a few blocks below its upper end."""
    low, wide = _share(factors["tip"], size), size[1] - 2.4 * _block(size, factors)
    below = low + (1 - low) * np.sin(np.pi / 2 * np.clip((y - FERRULE) / (wide - FERRULE), 0, 1)) ** 1.1
    above = 1 - 0.38 * np.clip((y - wide) / (size[1] - wide), 0, 1) ** 2
    return _still(np.where(y < wide, below, above) + 0.14 * low * _lower(y, FERRULE), 1.0)


def _turned(size: Vector, y: ndarray, factors: Factors) -> Profile:
    """Beads that grow from a foot to a square block."""
    low, span = _share(factors["tip"], size), size[1] - _block(size, factors)
    beads = _beads(y, max(1, round(span / factors["bead"])), span, _groove(size, factors))
    envelope = low + (1 - low) * np.clip(y / span, 0, 1) ** 0.7
    block = smooth(y, span, span + 2 * BREAK)
    return Profile((1 - block) * envelope * beads + block, np.zeros_like(y), 1 - block)


def _sabre(size: Vector, y: ndarray, factors: Factors) -> Profile:
    """A knee below the block, the ankle drawn in, the foot kicked out."""
    low, knee, kick = _share(factors["tip"], size), size[1] - _block(size, factors), min(KICK, 0.4 * float(size[1]))
    scale = low + (1 - low) * smooth(y, 0.1 * kick, knee) ** 1.2
    bow = np.sin(np.pi * np.clip(y / knee, 0, 1)) * smooth(y, 0.2 * kick, kick) * (1 - smooth(y, 0.75 * knee, knee))
    return Profile(scale, (1 - scale) * (1 - smooth(y, 0.0, kick) - bow), np.full_like(y, 0.35))


def _finial(size: Vector, y: ndarray, factors: Factors) -> Profile:
    """A round post with rings a few beads apart, and a ball on its end."""
    radius = min(size[0], size[2]) / 2
    neck = size[1] - 2 * radius
    shaft = _share(1.25 * factors["tip"], size)
    rings = max(1, round(neck / (3 * factors["bead"])))
    ring = np.abs(np.cos(np.pi * rings * np.clip(y / neck, 0, 1))) ** 14
    ball = np.sqrt(np.clip(1 - ((y - size[1]) / radius + 1) ** 2, 0, 1))
    return _still(np.where(y < neck, shaft + (0.92 - shaft) * ring, np.maximum(ball, 0.3)), 1.0)


def _pillar(size: Vector, y: ndarray, factors: Factors) -> Profile:
    """A square post, slimmer between a base and a cap."""
    shaft = _share(1.5 * factors["tip"], size)
    ends = np.maximum(_upper(y, size, 0.4 * factors["block"]), _lower(y, factors["block"]))
    return _still(shaft + (1 - shaft) * ends, 0.0)


def _blocked(size: Vector, y: ndarray, factors: Factors) -> Profile:
    """A bar with blocks at its ends and a waist that swells."""
    block = 0.7 * _block(size, factors)
    waist = _share(0.8 * factors["tip"], size) + 0.1 * np.sin(np.pi * (y / size[1]))
    return _still(waist + (1 - waist) * np.maximum(_upper(y, size, block), _lower(y, block)), 0.0)


def _swelled(size: Vector, y: ndarray, factors: Factors) -> Profile:
    """A round rod, thickest in the middle."""
    low = _share(0.7 * factors["tip"], size)
    return _still(low + (1 - low) * np.sin(np.pi * (y / size[1])) ** 1.6, 1.0)


def _beaded(size: Vector, y: ndarray, factors: Factors) -> Profile:
    """A turned rod: beads under a swelling envelope, symmetric, one bead in the middle."""
    low, count = _share(0.8 * factors["tip"], size), 2 * int(size[1] / factors["bead"] / 2) + 1
    envelope = low + (1 - low) * np.sin(np.pi * (y / size[1]))
    return _still(envelope * _beads(y, count, float(size[1]), _groove(size, factors)), 1.0)


def straight(size: Vector, y: ndarray, factors: Factors) -> Profile:
    """A plain round rod."""
    return _still(np.ones_like(y), 1.0)


LEGS: dict[str, Shaping] = {
    "square": _square,
    "tapered": _tapered,
    "round": _round,
    "turned": _turned,
    "sabre": _sabre,
}
POSTS: dict[str, Shaping] = {"pillar": _pillar, "finial": _finial, "swelled": _round}
RAILS: dict[str, Shaping] = {"blocked": _blocked, "swelled": _swelled, "beaded": _beaded}


def column(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A pedestal's column: wide at the foot, a turned or plain shaft, a spreading head."""
    y = np.linspace(0, size[1], 64)
    foot, head = np.minimum([0.11, 0.07], 0.3 * size[1])
    spread = np.maximum((1 - y / foot).clip(0) ** 1.8, 0.9 * (1 - (size[1] - y) / head).clip(0) ** 1.8)
    shaft = _share(1.6 * factors["tip"], size) + 0.12 * np.sin(np.pi * (y / size[1])) ** 2
    if kind == "turned":
        count = max(1, round(size[1] / (1.5 * factors["bead"])))
        shaft = shaft * _beads(y, count, float(size[1]), 0.32)
    power = 2.0 if kind in ("turned", "round", "sabre") else 5.0
    outline = superellipse(size[0] / 2, size[2] / 2, power, 32)
    scale = shaft + (1 - shaft) * spread
    return fill(capped(stack(outline, scale, scale, y)), size)


def apron(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A rail along x whose lower edge is cut out between its shoulders; its face bulges.

    An arch leaves a band of one `block` above it, whatever the height; waves are `pitch` wide and half as deep.
    """
    half_x, _, half_z = size / 2
    x = np.linspace(-half_x, half_x, int(np.clip(size[0] / 0.012, 32, 96)))
    open_half = half_x - min(SHOULDER, 0.3 * half_x)
    inside = np.clip(x / open_half, -1, 1)
    if kind == "arched":
        cut = (1 - np.clip(0.7 * factors["block"] / size[1], 0.3, 0.75)) * (1 - inside**4)
    else:
        waves = max(1, round(2 * open_half / factors["pitch"]))
        cut = np.clip(0.4 * factors["pitch"] / size[1], 0.2, 0.6) * np.sin(np.pi * waves * (inside + 1) / 2) ** 2
    outline = superellipse(half_z, size[1] / 2, 3.2, 20)
    bulge = 0.7 + 0.3 * np.cos(np.pi / 2 * x / half_x)
    rings = stack(outline, half_z * bulge, size[1] * (1 - cut) / 2, x)
    rings[..., 2] += (size[1] * cut / 2)[:, None]
    # Stacked along y with its height in z: turn it to lie along x, height up.
    return fill(capped(rings[..., [1, 2, 0]]), size)


def hoop(size: Vector, factors: Factors) -> Mesh:
    """An arch over local z, bent at the radius `bend`: up the front, along the top, down the back; an arm."""
    _, height, depth = size
    thick = min(0.55 * factors["plate"] + 0.004, 0.2 * height, 0.12 * depth)
    path = arch(height - thick, depth - 2 * thick, factors["bend"])
    section = superellipse(size[0] / 2, thick, 2.5, 16)
    return fill(capped(sweep(path, section, np.full(len(path), thick), size[0] / 2)), size)


def bow(size: Vector, factors: Factors) -> Mesh:
    """A round bar bent up, across and down again in the local xy plane, at five times the radius `bend`."""
    width, height, depth = size
    path = arch(height - depth / 2, width - depth, 5 * factors["bend"])
    rings = sweep(path, superellipse(1.0, 1.0, 2.0, 12), np.full(len(path), depth / 2), depth / 2)
    return fill(capped(rings[..., [2, 1, 0]]), size)


def arch(height: float, span: float, radius: float) -> Float[ndarray, "m 2"]:
    """A path (y, z) from the floor at z = span/2 up, across at y = height, and down; its two corners have a radius."""
    radius = min(radius, 0.95 * height, 0.499 * span)
    angle = np.linspace(0, np.pi / 2, 24)
    side, top = span / 2 - radius, height - radius
    corner = np.stack([top + radius * np.sin(angle), side + radius * np.cos(angle)], axis=1)
    half = np.concatenate([[[0.0, span / 2]], corner])
    return _even(np.concatenate([half, half[::-1] * [1, -1]]), 64)


def _even(path: Float[ndarray, "m 2"], count: int) -> Float[ndarray, "n 2"]:
    """A path resampled at even distances."""
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0, length[-1], count)
    return np.stack([np.interp(at, length, path[:, 0]), np.interp(at, length, path[:, 1])], axis=1)
