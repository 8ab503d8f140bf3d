"""Tables: eight structures with legs, trestles or pedestals, aprons, shelves and drawers."""

from functools import partial

import numpy as np
from numpy import ndarray

from cagesdf.geometry.meshes import Mesh
from cagesdf.synthesis import members, slabs, vessels
from cagesdf.synthesis.chairs import FORWARD, JOINT, column, disc, leg, rail, sunk, wire
from cagesdf.synthesis.layout import Draft, Style, around, bar, box, four, group, one, pair, row, strut
from cagesdf.synthesis.programs import assemble
from cagesdf.synthesis.recipe import Category, Family, Proportions
from cagesdf.synthesis.surfaces import laid, rounded_rectangle, superellipse


def top(size: ndarray, style: Style, power: float = 7.0) -> Mesh:
    """A top: rectangular, or round as far as the legs below allow (a superellipse's power)."""
    if style.kinds["outline"] == "round":
        outline = superellipse(size[0] / 2, size[2] / 2, power, 64)
    else:
        outline = rounded_rectangle(size[0] / 2, size[2] / 2, 0.012 + 1.5 * style.factors["edge"], 64)
    return slabs.slab(size, outline, style.kinds["edge"], style.kinds["top"], style.factors)


def claw(size: ndarray, style: Style) -> Mesh:
    """A pedestal's claw: turned, or curved."""
    kind = "turned" if style.kinds["leg"] == "turned" else "sabre"
    return members.member(size, members.LEGS[kind], style.factors)


def apron(size: ndarray, style: Style) -> Mesh:
    """A rail below the top."""
    return members.apron(size, style.kinds["apron"], style.factors)


def shelf(size: ndarray, style: Style) -> Mesh:
    """A slatted shelf."""
    return slabs.grid(size, style.factors)


def drawer(size: ndarray, style: Style) -> Mesh:
    """A drawer's front."""
    return slabs.front(size, style.kinds["leg"], style.factors)


def case(size: ndarray, style: Style) -> Mesh:
    """A cabinet's carcass."""
    return slabs.case(size, style.factors)


def hoop_stretcher(size: ndarray, style: Style) -> Mesh:
    """A ring that lies flat between the legs."""
    return laid(vessels.ring(size[[1, 0, 2]], 0.0))


def arch(size: ndarray, style: Style) -> Mesh:
    """A trestle's foot: a bar along x, arched below."""
    return members.apron(size, "arched", style.factors)


def tie(size: ndarray, style: Style) -> Mesh:
    """A plain rod along x."""
    return laid(wire(size[[1, 0, 2]], style))


def _top(p: Proportions, power: float = 7.0) -> Draft:
    cuboid = box(0.0, p["height"] - p["thick"] / 2, 0.0, p["width"], p["thick"], p["depth"])
    return group("tabletop", one("board", cuboid, partial(top, power=power)))


def _corner(p: Proportions, y: float) -> ndarray:
    out = p["splay"] * (p["height"] - y)
    x, z = p["width"] / 2 - p["inset"] - p["leg"] / 2, p["depth"] / 2 - p["inset"] - p["leg"] / 2
    return np.array([x + out, y, z + 0.7 * out])


def _raised(point: ndarray, by: float) -> ndarray:
    return point + np.array([0.0, by, 0.0])


def _legs(p: Proportions) -> Draft:
    cuboid = strut(_corner(p, 0.0), _corner(p, p["height"] - sunk(p)), p["leg"], p["leg"], FORWARD)
    return four(one("leg", cuboid, leg))


def _under(p: Proportions, height: float) -> float:
    """Height of the middle of a part that hangs below the top, `height` high."""
    return p["height"] - 0.6 * p["thick"] - height / 2


def _side_aprons(p: Proportions) -> Draft:
    end = _corner(p, _under(p, p["apron"]))
    return pair(one("side_apron", bar(end, end * [1, 1, -1], p["apron"], 0.6 * p["leg"]), apron))


def _long_apron(p: Proportions, label: str, side: float) -> Draft:
    end = _corner(p, _under(p, p["apron"])) * [1, 1, side]
    return one(label, bar(end * [-1, 1, 1], end, p["apron"], 0.6 * p["leg"]), apron)


def _leg_table(p: Proportions) -> Draft:
    aprons = _long_apron(p, "front_apron", 1.0), _long_apron(p, "back_apron", -1.0)
    return group("table", _top(p), group("table_base", _legs(p), _side_aprons(p), *aprons))


def _coffee_table(p: Proportions) -> Draft:
    y = 0.32 * p["height"]
    end = _corner(p, y)
    board = box(0.0, y, 0.0, 2 * end[0] + 0.4 * p["leg"], p["shelf"], 2 * end[2] + 0.4 * p["leg"])
    return group("table", _top(p, 3.2), group("table_base", _legs(p)), group("table_shelf", one("shelf", board, shelf)))


def _console(p: Proportions) -> Draft:
    """One drawer, on the left; an apron beside it."""
    corner = _corner(p, _under(p, p["apron"]))
    x, y, z = corner
    left, width = -x + p["leg"] / 2, p["share"] * 2 * x
    chest = box(left + width / 2, y, z, width, 0.86 * p["apron"], 0.9 * p["leg"])
    beside = bar(np.array([left + width, y, z]), corner, p["apron"], 0.6 * p["leg"])
    base = group(
        "table_base", _legs(p), _side_aprons(p), one("front_apron", beside, apron), _long_apron(p, "back_apron", -1.0)
    )
    return group("table", _top(p), base, group("drawers", one("drawer", chest, drawer)))


def _desk(p: Proportions) -> Draft:
    high = p["height"] - JOINT
    x = p["width"] / 2 - p["inset"] - p["cabinet"] / 2
    deep = p["depth"] - 2 * p["inset"]
    chest = box(x, high / 2, 0.0, p["cabinet"], high, deep)
    step = 0.86 * high / 3
    face = box(x, 0.08 * high + step / 2, deep / 2, 0.86 * p["cabinet"], 0.9 * step, 0.075)
    limb = strut(_corner(p, 0.0) * [-1, 1, 1], _corner(p, high) * [-1, 1, 1], p["leg"], p["leg"], FORWARD)
    rear = _corner(p, 0.0) * [-1, 1, -1]
    other = strut(rear, _raised(rear, high), p["leg"], p["leg"], -FORWARD)
    brace = bar(_raised(rear, 0.3 * high), _raised(rear * [1, 1, -1], 0.3 * high), 0.6 * p["leg"], 0.6 * p["leg"])
    modesty = bar(
        _corner(p, _under(p, p["apron"])) * [-1, 1, -1],
        np.array([x, _under(p, p["apron"]), rear[2]]),
        p["apron"],
        0.6 * p["leg"],
    )
    base = group(
        "table_base",
        one("leg", limb, leg),
        one("leg", other, leg),
        one("stretcher", brace, rail),
        one("apron", modesty, apron),
    )
    drawers = row(one("drawer", face, drawer), np.array([0.0, step, 0.0]), 3)
    return group("table", _top(p), base, group("cabinet", one("carcass", chest, case), drawers))


def _trestle_table(p: Proportions) -> Draft:
    x = p["width"] / 2 - p["inset"] - 0.06
    reach = 0.78 * p["depth"]
    high = p["height"] - JOINT
    foot = bar(np.array([x, 0.045, reach / 2]), np.array([x, 0.045, -reach / 2]), 0.09, p["leg"])
    head = bar(np.array([x, high - 0.04, 0.42 * reach]), np.array([x, high - 0.04, -0.42 * reach]), 0.08, p["leg"])
    pillar = box(x, (0.05 + high - 0.04) / 2, 0.0, 0.9 * p["leg"], high - 0.09, 1.7 * p["leg"])
    beam = bar(
        np.array([-x - 0.08, 0.4 * high, 0.0]), np.array([x + 0.08, 0.4 * high, 0.0]), 1.1 * p["leg"], 0.55 * p["leg"]
    )
    base = group(
        "table_base",
        pair(one("trestle_foot", foot, arch)),
        pair(one("trestle_post", pillar, leg)),
        pair(one("trestle_head", head, rail)),
        one("beam", beam, rail),
    )
    return group("table", _top(p), base)


def _cross_table(p: Proportions) -> Draft:
    reach = 0.36 * p["depth"]
    high = p["height"] - JOINT - 0.5 * p["leg"] * np.sin(np.arctan(2 * reach / p["height"]))  # corners are higher
    x = p["width"] / 2 - p["inset"] - p["leg"]
    thick, gap = 0.8 * p["leg"], 0.3 * p["leg"]
    one_way = strut(np.array([x + gap, 0, reach]), np.array([x + gap, high, -reach]), thick, p["leg"], FORWARD)
    other_way = strut(np.array([x - gap, 0, -reach]), np.array([x - gap, high, reach]), thick, p["leg"], -FORWARD)
    low = np.array([x + 0.5 * p["leg"], 0.48 * high, 0.0])
    rod = one("tie_rod", bar(low * [-1, 1, 1], low, p["rod"], p["rod"]), tie)
    base = group(
        "table_base",
        pair(one("cross_leg", one_way, leg)),
        pair(one("counter_leg", other_way, leg)),
        row(rod, np.array([0.0, 0.06, 0.0]), 2),
    )
    return group("table", _top(p), base)


def _pedestal_table(p: Proportions) -> Draft:
    low, high = 0.2 * p["height"], p["height"] - JOINT
    stem = box(0.0, (low + high) / 2, 0.0, p["stem"], high - low, p["stem"])
    reach = 0.36 * min(p["width"], p["depth"])
    limb = strut(np.array([0, 0.0, reach]), np.array([0, 0.34 * p["height"], 0.02]), p["leg"], 1.3 * p["leg"], FORWARD)
    return group(
        "table", _top(p, 2.0), group("table_base", one("column", stem, column), around(one("claw", limb, claw), 3))
    )


def _tripod_table(p: Proportions) -> Draft:
    reach = 0.27 * min(p["width"], p["depth"])
    high = p["height"] - sunk(p)
    foot = np.array([0.0, 0.0, reach + p["splay"] * p["height"]])
    limb = strut(foot, np.array([0.0, high, reach]), p["leg"], p["leg"], FORWARD)
    y = 0.36 * p["height"]
    radius = reach + p["splay"] * (p["height"] - y) + 0.35 * p["leg"]
    ring = box(0.0, y, 0.0, 2 * radius, 0.5 * p["leg"], 2 * radius)
    base = group("table_base", around(one("leg", limb, leg), 3), one("ring_stretcher", ring, hoop_stretcher))
    return group("table", _top(p, 2.0), base)


def _drum_table(p: Proportions) -> Draft:
    foot = box(0.0, 0.5 * p["plinth"], 0.0, 0.6 * p["width"], p["plinth"], 0.6 * p["depth"])
    low, high = 0.6 * p["plinth"], p["height"] - JOINT
    stem = box(0.0, (low + high) / 2, 0.0, p["stem"], high - low, p["stem"])
    board = box(0.0, 0.45 * p["height"], 0.0, 0.62 * p["width"], 0.05, 0.62 * p["depth"])
    shelf_group = group("table_shelf", one("shelf", board, partial(top, power=2.2)))
    base = group("table_base", one("pedestal_foot", foot, disc), one("column", stem, column))
    return group("table", _top(p, 2.2), base, shelf_group)


COMMON = {
    "width": (0.75, 1.4),
    "depth": (0.45, 0.9),
    "height": (0.46, 0.9),
    "thick": (0.05, 0.125),
    "leg": (0.05, 0.11),
    "inset": (0.03, 0.07),
    "splay": (0.0, 0.0),
}
SMALL = {**COMMON, "width": (0.5, 1.0), "depth": (0.48, 0.95)}

TABLES = Category(
    families={
        "legs": Family(_leg_table, {**COMMON, "apron": (0.09, 0.15)}),
        "coffee": Family(
            _coffee_table,
            {**COMMON, "height": (0.38, 0.55), "splay": (0.1, 0.28), "inset": (0.1, 0.15), "shelf": (0.04, 0.06)},
        ),
        "console": Family(_console, {**COMMON, "depth": (0.36, 0.55), "apron": (0.13, 0.2), "share": (0.35, 0.55)}),
        "desk": Family(_desk, {**COMMON, "cabinet": (0.28, 0.42), "apron": (0.12, 0.2)}),
        "trestle": Family(_trestle_table, COMMON),
        "cross": Family(_cross_table, {**COMMON, "rod": (0.0065, 0.008)}),
        "pedestal": Family(_pedestal_table, {**SMALL, "stem": (0.12, 0.2)}),
        "tripod": Family(_tripod_table, {**SMALL, "splay": (0.12, 0.3)}),
        "drum": Family(_drum_table, {**SMALL, "stem": (0.13, 0.22), "plinth": (0.06, 0.11)}),
    },
    kinds={
        "leg": tuple(members.LEGS),
        "top": tuple(slabs.TOPS),
        "edge": tuple(slabs.EDGES),
        "outline": ("square", "round"),
        "apron": ("arched", "waved"),
    },
    factors={
        "edge": (0.006, 0.036),  # radius or width of mouldings
        "board": (0.036, 0.056),  # thickness of tops over their frames
        "block": (0.05, 0.12),  # height of blocks, where legs and rails meet
        "bead": (0.045, 0.12),  # length of beads
        "pitch": (0.07, 0.15),  # distance of slats and waves
        "dish": (0.008, 0.02),  # depth of hollowed tops, height of domed ones
        "tip": (0.024, 0.05),  # diameter of feet
    },
    driven=("tip", "leg"),
    assemble=assemble,
)
