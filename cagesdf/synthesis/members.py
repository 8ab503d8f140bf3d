"""Legs, posts and rails: long parts along local y, each style a profile of its section.

Every function fills [-size/2, size/2]³ of its size, in the local frame. A rail is a member laid
along local x. Front is local +z: where a leg kicks out, it kicks there.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.meshes import Mesh
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

SIDES = 20  # points of a section
STEP = 0.014  # between rings
Factors = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Profile:
    """How a section changes along its member."""

    scale: Float[ndarray, " m"]  # of the section, 1 where it touches the cuboid's sides
    shift: Float[ndarray, " m"]  # of its centre along z, in half depths
    roundness: Float[ndarray, " m"]  # 0 the square section, 1 the round


Shaping = Callable[[ndarray, Factors], Profile]  # positions in [0, 1] from the bottom, factors → profile


def member(size: Vector, shaping: Shaping, factors: Factors) -> Mesh:
    """A member along y whose section follows a profile."""
    half_x, _, half_z = size / 2
    t = np.linspace(0, 1, int(np.clip(size[1] / STEP, 20, 64)))
    profile = shaping(t, factors)
    square = rounded_rectangle(half_x, half_z, min(factors["edge"], 0.45 * half_x, 0.45 * half_z), SIDES)
    circle = superellipse(half_x, half_z, 2.0, SIDES)
    blend = profile.roundness[:, None, None]
    rings = stack((1 - blend) * square + blend * circle, half_x * profile.scale, half_z * profile.scale, size[1] * t)
    rings[..., 2] += (half_z * profile.shift)[:, None]
    return fill(capped(rings), size)


def rail(size: Vector, shaping: Shaping, factors: Factors) -> Mesh:
    """A member along x."""
    return fill(laid(member(size[[1, 0, 2]], shaping, factors)), size)


def _still(t: ndarray, scale: ndarray, roundness: float) -> Profile:
    return Profile(scale, np.zeros_like(t), np.full_like(t, roundness))


def _square(t: ndarray, factors: Factors) -> Profile:
    """A block, a slimmer shaft, a spade foot."""
    shaft = 0.5 + 0.3 * factors["taper"]
    scale = shaft + (1 - shaft) * np.maximum(smooth(t, 0.84, 0.88), smooth(-t, -0.13, -0.03) * 0.75)
    return _still(t, scale, 0.0)


def _tapered(t: ndarray, factors: Factors) -> Profile:
    """A block, then an even taper."""
    low = factors["taper"]
    return _still(t, np.where(t > 0.86, 1.0, low + (0.92 - low) * np.clip(t / 0.86, 0, 1)), 0.0)


def _round(t: ndarray, factors: Factors) -> Profile:
    """A round shaft that swells above its middle."""
    low = 0.8 * factors["taper"]
    swell = np.sin(np.pi * np.clip(t, 0, 1) ** 1.5) ** 0.9
    return _still(t, np.maximum(low + (1 - low) * swell, 0.6 * t), 1.0)


def _turned(t: ndarray, factors: Factors) -> Profile:
    """Beads and coves below a square block."""
    u = np.clip(t / 0.82, 0, 1)
    bead = np.abs(np.sin(np.pi * factors["turnings"] * u)) ** 0.75
    envelope = factors["taper"] + (1 - factors["taper"]) * u**0.8
    block = smooth(t, 0.83, 0.86)
    scale = (1 - block) * envelope * (0.48 + 0.52 * bead) + block
    return Profile(scale, np.zeros_like(t), 1 - block)


def _sabre(t: ndarray, factors: Factors) -> Profile:
    """A knee below the block, the ankle drawn in, the foot kicked out."""
    low = 0.75 * factors["taper"]
    scale = low + (1 - low) * smooth(t, 0.02, 0.86) ** 1.2
    bow = np.sin(np.pi * np.clip(t / 0.88, 0, 1) * 1.0)
    kick = (1 - smooth(t, 0.0, 0.3)) - bow * smooth(t, 0.05, 0.3) * (1 - smooth(t, 0.7, 0.9))
    return Profile(scale, (1 - scale) * kick, np.full_like(t, 0.35))


def _finial(t: ndarray, factors: Factors) -> Profile:
    """A round post with a finial and rings between plain lengths."""
    ring = np.cos(np.pi * factors["turnings"] * t) ** 8
    shaft = 0.62 + 0.12 * np.sin(np.pi * t)
    scale = np.maximum(shaft + (0.94 - shaft) * ring, 1.0 * np.exp(-(((t - 0.94) / 0.035) ** 2)))
    neck = np.exp(-(((t - 0.875) / 0.02) ** 2))
    return _still(t, scale * (1 - 0.35 * neck) * np.sqrt(np.clip((1.004 - t) / 0.03, 0, 1)).clip(0.25), 1.0)


def _pillar(t: ndarray, factors: Factors) -> Profile:
    """A square post, slimmer between a base and a cap."""
    shaft = 0.55 + 0.2 * factors["taper"]
    ends = np.maximum(smooth(t, 0.93, 0.96), smooth(-t, -0.1, -0.06))
    return _still(t, shaft + (1 - shaft) * ends, 0.0)


def _blocked(t: ndarray, factors: Factors) -> Profile:
    """A bar with blocks at its ends and a waist that swells."""
    ends = np.maximum(smooth(t, 0.86, 0.9), smooth(-t, -0.14, -0.1))
    waist = 0.5 + 0.2 * np.sin(np.pi * t)
    return _still(t, waist + (1 - waist) * ends, 0.0)


def _swelled(t: ndarray, factors: Factors) -> Profile:
    """A round rod, thickest in the middle."""
    return _still(t, 0.48 + 0.52 * np.sin(np.pi * t) ** 1.6, 1.0)


def _beaded(t: ndarray, factors: Factors) -> Profile:
    """A turned rod: beads under a swelling envelope, symmetric, one bead in the middle."""
    count = 2 * (factors["turnings"] // 2) + 1
    bead = np.abs(np.sin(np.pi * count * t)) ** 0.75
    envelope = 0.62 + 0.38 * np.sin(np.pi * t) ** 2
    return _still(t, envelope * (0.5 + 0.5 * bead), 1.0)


def straight(t: ndarray, factors: Factors) -> Profile:
    """A plain round rod."""
    return _still(t, np.ones_like(t), 1.0)


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
    t = np.linspace(0, 1, 56)
    spread = np.maximum(1 - smooth(t, 0.0, 0.22), 0.9 * smooth(t, 0.84, 1.0))
    shaft = 0.34 + 0.22 * np.sin(np.pi * t) ** 2
    if kind == "turned":
        shaft = shaft * (0.68 + 0.32 * np.abs(np.sin(np.pi * factors["turnings"] * t)) ** 0.75)
    power = 2.0 if kind in ("turned", "round", "sabre") else 5.0
    outline = superellipse(size[0] / 2, size[2] / 2, power, 32)
    scale = np.maximum(shaft, spread)
    return fill(capped(stack(outline, scale, scale, t)), size)


def apron(size: Vector, kind: str, factors: Factors) -> Mesh:
    """A rail along x whose lower edge is cut out: one arch, or waves of the pitch; its face bulges."""
    half_x, _, half_z = size / 2
    x = np.linspace(-1, 1, int(np.clip(size[0] / 0.016, 32, 72)))
    if kind == "arched":
        cut = 0.55 * np.clip(1 - (x / 0.86) ** 4, 0, 1)
    else:
        waves = max(1, round(1.7 * half_x / factors["pitch"]))
        cut = 0.5 * np.sin(np.pi * waves * (x / 0.86 + 1) / 2) ** 2 * (np.abs(x) < 0.86)
    top, bottom = np.full_like(x, 0.5), -0.5 + cut
    outline = superellipse(half_z, size[1] / 2, 3.2, 20)
    depth = 0.7 + 0.3 * np.cos(np.pi / 2 * x)
    rings = stack(outline, half_z * depth, size[1] * (top - bottom) / 2, half_x * x)
    rings[..., 2] += (size[1] * (top + bottom) / 2)[:, None]
    # Stacked along y with its height in z: turn it to lie along x, height up.
    return fill(capped(rings[..., [1, 2, 0]]), size)


def hoop(size: Vector, factors: Factors) -> Mesh:
    """An arch over local z: up the front, along the top, down the back; an arm, or a bail handle."""
    _, height, depth = size
    thick = min(max(0.3 * size[0], 0.018), 0.2 * height, 0.12 * depth)
    angle = np.linspace(0, np.pi, 56)
    power = 2 / (2.2 + 40 * factors["edge"])
    y = height * np.abs(np.sin(angle)) ** power
    z = depth / 2 * np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** power
    section = superellipse(size[0] / 2, thick, 2.5, 16)
    across = thick * (0.75 + 0.25 * np.sin(angle))
    return fill(capped(sweep(_even(np.stack([y, z], axis=1), 56), section, across, size[0] / 2)), size)


def _even(path: Float[ndarray, "m 2"], count: int) -> Float[ndarray, "n 2"]:
    """A path resampled at even distances."""
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0, length[-1], count)
    return np.stack([np.interp(at, length, path[:, 0]), np.interp(at, length, path[:, 1])], axis=1)
