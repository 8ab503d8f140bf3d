"""Chairs: eight structures with legs or a pedestal, stretchers, arms and backs of many styles."""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy import ndarray

from cagesdf.cuboid import Cuboid
from cagesdf.geometry.meshes import Mesh
from cagesdf.synthesis import members, slabs
from cagesdf.synthesis.layout import Draft, Style, Surface, around, bar, box, four, group, one, pair, row, strut
from cagesdf.synthesis.programs import assemble
from cagesdf.synthesis.recipe import Category, Family, Proportions
from cagesdf.synthesis.surfaces import rounded_rectangle, superellipse

FORWARD = np.array([0.0, 0.0, 1.0])
JOINT = 0.03  # below a seat's or table's upper face: what carries it ends within its board, however thick it is
INSET = 0.03  # of a seat's legs and of its back
RAIL_OF_LEG = {"square": "blocked", "tapered": "blocked", "sabre": "swelled", "round": "swelled", "turned": "beaded"}
POST_OF_LEG = {"square": "pillar", "tapered": "pillar", "sabre": "swelled", "round": "swelled", "turned": "finial"}
STILE_OF_LEG = {**POST_OF_LEG, "turned": "swelled"}


def leg(size: ndarray, style: Style) -> Mesh:
    """A leg of the style's kind."""
    return members.member(size, members.LEGS[style.kinds["leg"]], style.factors)


def post(size: ndarray, style: Style) -> Mesh:
    """A back's post, to match the legs."""
    return members.member(size, members.POSTS[POST_OF_LEG[style.kinds["leg"]]], style.factors)


def stile(size: ndarray, style: Style) -> Mesh:
    """A post that ends below a crest: without a finial."""
    return members.member(size, members.POSTS[STILE_OF_LEG[style.kinds["leg"]]], style.factors)


def rail(size: ndarray, style: Style) -> Mesh:
    """A stretcher, to match the legs."""
    return members.rail(size, members.RAILS[RAIL_OF_LEG[style.kinds["leg"]]], style.factors)


def column(size: ndarray, style: Style) -> Mesh:
    """A pedestal's column."""
    return members.column(size, style.kinds["leg"], style.factors)


def disc(size: ndarray, style: Style) -> Mesh:
    """A pedestal's foot."""
    return slabs.disc(size, style.factors)


def hoop(size: ndarray, style: Style) -> Mesh:
    """An arm bent in one piece."""
    return members.hoop(size, style.factors)


def wire(size: ndarray, style: Style) -> Mesh:
    """A plain rod."""
    return members.member(size, members.straight, style.factors)


def bow(size: ndarray, style: Style) -> Mesh:
    """A bent back: an arch from the seat up and down again, in the xy plane."""
    return members.bow(size, style.factors)


def seat(size: ndarray, style: Style, power: float = 4.5) -> Mesh:
    """A seat: dished, sunk or upholstered; square, or round of a superellipse's power."""
    if style.kinds["outline"] == "round" or power == 2:
        outline = superellipse(size[0] / 2, size[2] / 2, power, 56)
    else:
        outline = rounded_rectangle(size[0] / 2, size[2] / 2, 0.03 + style.factors["edge"], 56)
    if style.kinds["seat"] == "cushioned":
        return slabs.upholstered(size, outline, style.factors)
    return slabs.slab(size, outline, style.kinds["edge"], style.kinds["seat"], style.factors)


def back(size: ndarray, style: Style) -> Mesh:
    """A back between posts."""
    return slabs.panel(size, style.kinds["back"], style.factors)


def splat(size: ndarray, style: Style) -> Mesh:
    """A narrow back."""
    return slabs.splat(size, style.kinds["back"], style.factors)


def slat(size: ndarray, style: Style) -> Mesh:
    """A rung of a ladder back, or a crest."""
    return slabs.slat(size, style.kinds["back"], style.factors)


def _seat(p: Proportions, power: float = 4.5) -> Draft:
    cuboid = box(0.0, p["seat"] - p["thick"] / 2, 0.0, p["width"], p["thick"], p["depth"])
    return group("chair_seat", one("seat_surface", cuboid, partial(seat, power=power)))


def _corner(p: Proportions, y: float) -> ndarray:
    """The axis of the right front leg at a height: splayed outwards towards the floor."""
    out = p["splay"] * (p["seat"] - y)
    inset = INSET + p["leg"] / 2
    return np.array([p["width"] / 2 - inset + out, y, p["depth"] / 2 - inset + 0.7 * out])


def sunk(p: Proportions) -> float:
    """Distance of the legs' ends below a seat's or table's upper face: corners of a splayed leg are higher."""
    return JOINT + 0.7 * p["splay"] * p["leg"]


def _legs(p: Proportions) -> Draft:
    ends = _corner(p, 0.0), _corner(p, p["seat"] - sunk(p))
    return four(one("leg", strut(*ends, p["leg"], p["leg"], FORWARD), leg))


def _sides(p: Proportions, y: float) -> Draft:
    """Stretchers from front to back."""
    front = _corner(p, y)
    return pair(one("side_stretcher", bar(front, front * [1, 1, -1], 0.6 * p["leg"], 0.6 * p["leg"]), rail))


def _cross(p: Proportions, label: str, y: float, z: float) -> Draft:
    """A stretcher from left to right, `z` of the way from the middle to the front."""
    end = _corner(p, y) * [1, 1, z]
    return one(label, bar(end * [-1, 1, 1], end, 0.55 * p["leg"], 0.55 * p["leg"]), rail)


def _on_back(p: Proportions, x: float, above: float) -> ndarray:
    """A point of the reclined back's plane, `above` the seat."""
    length = JOINT + above
    rear = INSET + 0.36 * p["leg"] - p["depth"] / 2
    return np.array([x, p["seat"] - JOINT + length * np.cos(p["recline"]), rear - length * np.sin(p["recline"])])


def _half_back(p: Proportions) -> float:
    """Distance from the middle to a post's axis."""
    return p["width"] / 2 - INSET - 0.36 * p["leg"]


def _posts(p: Proportions, surface: Surface = post) -> Draft:
    x, side = _half_back(p), 0.72 * p["leg"]
    bottom, top = _on_back(p, x, -JOINT), _on_back(p, x, p["back"])
    return pair(one("back_post", strut(bottom, top, side, side, FORWARD), surface))


def _before(p: Proportions, cuboid: Cuboid, by: float) -> Cuboid:
    """A cuboid moved off the back's plane towards the front."""
    return replace(cuboid, centre=cuboid.centre + by * np.array([0.0, np.sin(p["recline"]), np.cos(p["recline"])]))


def _bowed(p: Proportions, cuboid: Cuboid) -> Cuboid:
    """A cuboid on the back's plane moved backwards, so that a bowed surface in it ends at the posts' front."""
    return _before(p, cuboid, 0.3 * p["leg"] - p["deep"] / 2)


def _splat(p: Proportions, high: float, by: float) -> Draft:
    """A narrow back from the seat up: its ends are at the rear of its cuboid, which is `by` before the back's plane."""
    ends = _on_back(p, 0.0, -JOINT), _on_back(p, 0.0, high)
    cuboid = strut(*ends, p["splat"], p["deep"], FORWARD)
    return one("splat", _before(p, cuboid, by + p["deep"] / 2), splat)


def _panel(p: Proportions, low: float, high: float) -> Draft:
    """A back between the posts, from `low` to `high` as shares of its height."""
    ends = _on_back(p, 0.0, low * p["back"]), _on_back(p, 0.0, high * p["back"])
    return one("back_surface", _bowed(p, strut(*ends, 2 * _half_back(p), p["deep"], FORWARD)), back)


def _panel_chair(p: Proportions) -> Draft:
    return group(
        "chair", _seat(p), group("chair_base", _legs(p)), group("chair_back", _posts(p), _panel(p, 0.28, 0.97))
    )


def _splat_chair(p: Proportions) -> Draft:
    x, high = _half_back(p) + 0.5 * p["leg"], 0.97 * p["back"]
    crest = bar(_on_back(p, -x, high), _on_back(p, x, high), 0.09, 0.7 * p["leg"] + 0.01)
    base = group("chair_base", _legs(p), _sides(p, 0.3 * p["seat"]), _cross(p, "cross_stretcher", 0.3 * p["seat"], 0.0))
    return group(
        "chair",
        _seat(p),
        base,
        group("chair_back", _posts(p, stile), one("crest", crest, slat), _splat(p, high, -0.35 * p["leg"])),
    )


def _ladder_chair(p: Proportions) -> Draft:
    x, gap = _half_back(p), p["back"] * 0.8 / 3
    ends = _on_back(p, -x, 0.35 * gap + 0.12), _on_back(p, x, 0.35 * gap + 0.12)
    first = _bowed(p, bar(*ends, p["rung"], p["deep"]))
    up = (_on_back(p, 0.0, 1.0) - _on_back(p, 0.0, 0.0)) * gap
    base = group(
        "chair_base",
        _legs(p),
        _sides(p, 0.42 * p["seat"]),
        _cross(p, "front_stretcher", 0.3 * p["seat"], 1.0),
        _cross(p, "back_stretcher", 0.5 * p["seat"], -1.0),
    )
    return group("chair", _seat(p), base, group("chair_back", _posts(p), row(one("slat", first, slat), up, 3)))


def _arm(p: Proportions) -> Draft:
    low, long = p["seat"] - JOINT, p["depth"] - 2 * INSET
    cuboid = box(_half_back(p), low + p["arm"] / 2, -0.01, 0.8 * p["leg"], p["arm"], long)
    return one("arm", cuboid, hoop)


def _arm_chair(p: Proportions) -> Draft:
    return group(
        "chair",
        _seat(p),
        group("chair_base", _legs(p)),
        group("chair_arm", pair(_arm(p))),
        group("chair_back", _posts(p), _panel(p, 0.16, 0.97)),
    )


def _tablet_chair(p: Proportions) -> Draft:
    arm = _arm(p)
    assert arm.cuboid is not None
    x, y, z = arm.cuboid.centre + np.array([0, p["arm"] / 2 - 0.005, 0.06])
    board = box(x - 0.06, y, z, 0.62 * p["width"], 0.045, 0.8 * p["depth"])
    return group(
        "chair",
        _seat(p),
        group("chair_base", _legs(p), _cross(p, "front_stretcher", 0.35 * p["seat"], 1.0)),
        group("chair_arm", arm, one("tablet", board, tablet)),
        group("chair_back", _posts(p), _panel(p, 0.4, 0.97)),
    )


def tablet(size: ndarray, style: Style) -> Mesh:
    """A writing board with a sunk field."""
    outline = superellipse(size[0] / 2, size[2] / 2, 3.0 if style.kinds["outline"] == "round" else 6.0, 56)
    return slabs.slab(size, outline, style.kinds["edge"], "sunk", style.factors)


def _pedestal_chair(p: Proportions) -> Draft:
    base = p["foot"]
    foot = box(0.0, 0.5 * p["plinth"], 0.0, base, p["plinth"], base)
    low, high = 0.6 * p["plinth"], p["seat"] - JOINT
    stem = box(0.0, (low + high) / 2, 0.0, p["stem"], high - low, p["stem"])
    rear = np.array([0.0, p["seat"] - JOINT, INSET + p["deep"] / 2 - p["depth"] / 2])
    top = rear + (p["back"] + JOINT) * np.array([0, np.cos(p["recline"]), -np.sin(p["recline"])])
    under = p["seat"] - p["thick"]
    knob = np.array([0.36 * p["width"], under - 0.06, 0.1 * p["depth"]])
    lever = bar(np.array([0.0, under - 0.02, 0.0]), knob, 0.03, 0.03)
    shell = strut(rear, top, 0.8 * p["width"], p["deep"], FORWARD)
    return group(
        "chair",
        _seat(p, 2.6),
        group("chair_base", one("pedestal_foot", foot, disc), one("column", stem, column), one("lever", lever, rail)),
        group("chair_back", one("back_surface", shell, back)),
    )


def _three_legged(p: Proportions) -> Draft:
    reach = 0.5 * min(p["width"], p["depth"])
    top = np.array([0.0, p["seat"] - sunk(p), 0.58 * reach])
    bottom = np.array([0.0, 0.0, 0.58 * reach + p["splay"] * p["seat"] * 1.6])
    limb = one("leg", strut(bottom, top, p["leg"], p["leg"], FORWARD), leg)
    return group(
        "chair", _seat(p, 2.0), group("chair_base", around(limb, 3)), group("chair_back", _splat(p, p["back"], INSET))
    )


def _wire_chair(p: Proportions) -> Draft:
    x = _half_back(p)
    frame = strut(_on_back(p, 0.0, -JOINT), _on_back(p, 0.0, p["back"]), 2 * x, 0.5 * p["leg"], FORWARD)
    step = 2 * x / 6
    low, high = _on_back(p, -2 * step, -JOINT), _on_back(p, -2 * step, 0.84 * p["back"])
    thin = p["wire"] * (p["seat"] + p["back"])
    rod = one("spindle", strut(low, high, thin, thin, FORWARD), wire)
    base = group("chair_base", _legs(p), _sides(p, 0.35 * p["seat"]))
    return group(
        "chair", _seat(p), base, group("chair_back", one("bow", frame, bow), row(rod, np.array([step, 0.0, 0.0]), 5))
    )


COMMON = {
    "width": (0.38, 0.7),
    "depth": (0.36, 0.64),
    "seat": (0.3, 0.56),
    "thick": (0.05, 0.14),
    "leg": (0.045, 0.105),
    "back": (0.32, 0.76),
    "recline": (0.08, 0.3),
    "deep": (0.05, 0.12),
}
UPRIGHT = {**COMMON, "splay": (0.0, 0.0)}
SPLAYED = {**COMMON, "splay": (0.08, 0.24)}

CHAIRS = Category(
    families={
        "panel": Family(_panel_chair, SPLAYED),
        "splat": Family(_splat_chair, {**UPRIGHT, "splat": (0.14, 0.22)}),
        "ladder": Family(_ladder_chair, {**UPRIGHT, "back": (0.42, 0.76), "rung": (0.05, 0.1)}),
        "arms": Family(_arm_chair, {**UPRIGHT, "width": (0.48, 0.7), "arm": (0.2, 0.3)}),
        "tablet": Family(_tablet_chair, {**UPRIGHT, "width": (0.48, 0.66), "arm": (0.24, 0.32)}),
        "pedestal": Family(
            _pedestal_chair,
            {**COMMON, "seat": (0.36, 0.58), "foot": (0.34, 0.52), "plinth": (0.05, 0.1), "stem": (0.1, 0.18)},
        ),
        "three_legged": Family(_three_legged, {**SPLAYED, "splat": (0.18, 0.28)}),
        "wire": Family(_wire_chair, {**SPLAYED, "wire": (0.0055, 0.0085)}),
    },
    kinds={
        "leg": tuple(members.LEGS),
        "seat": ("dished", "sunk", "cushioned"),
        "edge": tuple(slabs.EDGES),
        "outline": ("square", "round"),
        "back": ("bent", "pierced", "slatted", "cushioned"),
    },
    factors={
        "edge": (0.006, 0.036),  # radius or width of mouldings
        "board": (0.036, 0.056),  # thickness of seats and tops over their frames
        "plate": (0.021, 0.034),  # of backs, splats and slats
        "block": (0.05, 0.12),  # height of blocks, where legs and rails meet
        "bead": (0.036, 0.11),  # length of beads
        "pitch": (0.055, 0.13),  # distance of openings and tufts
        "bend": (0.03, 0.1),  # radius of bent arms and corners
        "dish": (0.008, 0.02),  # depth of hollowed tops, height of domed ones
        "tip": (0.024, 0.05),  # diameter of feet
    },
    driven=("tip", "leg"),
    assemble=assemble,
)
