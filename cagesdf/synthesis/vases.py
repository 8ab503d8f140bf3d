"""Vases: eight structures with feet, bodies, necks, lips, handles, lids and spouts."""

from functools import partial

import numpy as np
from numpy import ndarray

from cagesdf.cuboid import Cuboid
from cagesdf.geometry.meshes import Mesh
from cagesdf.synthesis import members, vessels
from cagesdf.synthesis.layout import Draft, Style, around, box, group, one, pair, strut
from cagesdf.synthesis.recipe import Category, Family, Proportions

RIGHT = np.array([1.0, 0.0, 0.0])
FORWARD = np.array([0.0, 0.0, 1.0])


def body(size: ndarray, style: Style, foot: float, mouth: float) -> Mesh:
    """A hollow body; `foot` and `mouth` are its radii there, in half widths, to fit its neighbours."""
    return vessels.body(size, style.kinds["body"], foot, mouth, style.factors)


def neck(size: ndarray, style: Style) -> Mesh:
    """A neck."""
    return vessels.neck(size, style.kinds["neck"], style.factors)


def lip(size: ndarray, style: Style) -> Mesh:
    """A rim."""
    return vessels.lip(size, style.kinds["neck"], style.factors)


def foot(size: ndarray, style: Style) -> Mesh:
    """A foot."""
    return vessels.foot(size, style.kinds["body"], style.factors)


def handle(size: ndarray, style: Style) -> Mesh:
    """A handle with both ends on the vessel."""
    return vessels.handle(size, style.kinds["handle"], style.factors)


def ring(size: ndarray, style: Style) -> Mesh:
    """A ring handle."""
    return vessels.ring(size, 0.2 * style.factors["wall"])


def lid(size: ndarray, style: Style) -> Mesh:
    """A cover."""
    return vessels.lid(size, style.kinds["body"], style.factors)


def knob(size: ndarray, style: Style) -> Mesh:
    """A finial."""
    return vessels.knob(size, style.kinds["body"], style.factors)


def spout(size: ndarray, style: Style) -> Mesh:
    """A pouring tube."""
    return vessels.spout(size, style.factors)


def bail(size: ndarray, style: Style) -> Mesh:
    """A wire handle over the mouth."""
    return vessels.bail(size)


def claw(size: ndarray, style: Style) -> Mesh:
    """A short leg."""
    return members.member(size, members.LEGS["sabre"], {"tip": 0.026, "block": 0.05, "edge": 0.02})


def _round(y: float, height: float, width: float) -> Cuboid:
    return box(0.0, y + height / 2, 0.0, width, height, width)


def _oval(p: Proportions, y: float, height: float, share: float) -> Cuboid:
    """A cuboid on the axis, `share` of the body's width and depth."""
    return box(0.0, y + height / 2, 0.0, share * p["width"], height, share * p["oval"] * p["width"])


def _vessel(p: Proportions, mouth: float) -> tuple[Draft, Draft, float]:
    """Foot, body, and the height of the body's mouth."""
    base = p["foot"]
    start = 0.7 * base
    spread = p["base"]
    return (
        one("foot", _oval(p, 0.0, base, 1.12 * spread), foot),
        one("body", _oval(p, start, p["height"], 1.0), partial(body, foot=0.86 * spread, mouth=mouth)),
        start + p["height"],
    )


def _collar(p: Proportions, at: float) -> tuple[Draft, Draft, float]:
    """A neck that reaches into the body below `at`, the lip on it, and where that ends."""
    sunk = 0.25 * p["neck"]
    end = at - sunk + p["neck"]
    tube = one("neck", _oval(p, at - sunk, p["neck"], p["mouth"]), neck)
    return tube, one("lip", _oval(p, end - 0.6 * p["lip"], p["lip"], 1.16 * p["mouth"]), lip), end + 0.4 * p["lip"]


def _bottle(p: Proportions) -> Draft:
    base, belly, at = _vessel(p, 0.9 * p["mouth"])
    tube, rim, _ = _collar(p, at)
    return group("vase", base, belly, group("opening", tube, rim))


def _side_handle(p: Proportions, low: float, high: float, out_low: float, out_high: float) -> Draft:
    """A handle on the right, its ends at two heights and distances from the axis."""
    cuboid = strut(np.array([out_low, low, 0.0]), np.array([out_high, high, 0.0]), p["strap"], p["reach"], RIGHT)
    moved = cuboid.centre + cuboid.axes[2] * p["reach"] / 2
    return one("handle", Cuboid(moved, cuboid.axes, cuboid.size), handle)


def _grip(p: Proportions, at: float, end: float) -> Draft:
    """A handle from the shoulder to below the lip."""
    return _side_handle(
        p, at - 0.36 * p["height"], end - 0.25 * p["neck"], 0.35 * p["width"], 0.34 * p["mouth"] * p["width"]
    )


def _amphora(p: Proportions) -> Draft:
    base, belly, at = _vessel(p, 0.9 * p["mouth"])
    tube, rim, end = _collar(p, at)
    return group("vase", base, belly, group("opening", tube, rim), group("handles", pair(_grip(p, at, end))))


def _jug(p: Proportions) -> Draft:
    base, belly, at = _vessel(p, 0.9 * p["mouth"])
    tube, rim, end = _collar(p, at)
    return group("vase", base, belly, group("opening", tube, rim), group("handles", _grip(p, at, end)))


def _bowl(p: Proportions) -> Draft:
    base, belly, at = _vessel(p, 0.92)
    edge = one("lip", _oval(p, at - 0.6 * p["lip"], p["lip"], 1.04), lip)
    y = at - 0.3 * p["height"] - 0.5 * p["loop"]
    drop = strut(
        np.array([0.4 * p["width"], y, 0.0]),
        np.array([0.52 * p["width"], y + p["loop"], 0.0]),
        p["strap"],
        0.8 * p["loop"],
        RIGHT,
    )
    placed = Cuboid(drop.centre + drop.axes[2] * 0.3 * p["loop"], drop.axes, drop.size)
    return group("vase", base, belly, group("opening", edge), group("handles", pair(one("ring", placed, ring))))


def _cover(p: Proportions, at: float, share: float) -> Draft:
    dome = one("lid", _oval(p, at - 0.15 * p["cover"], p["cover"], share), lid)
    button = one("knob", _round(at + 0.8 * p["cover"], p["knob"], 0.8 * p["knob"]), knob)
    return group("cover", dome, button)


def _urn(p: Proportions) -> Draft:
    plinth = one("foot", _oval(p, 0.0, p["foot"], 1.3 * p["base"]), foot)
    stem = one("stem", _oval(p, 0.7 * p["foot"], p["stem"], 0.8 * p["base"]), neck)
    start = 0.7 * p["foot"] + 0.85 * p["stem"]
    belly = one("body", _oval(p, start, p["height"], 1.0), partial(body, foot=0.7 * p["base"], mouth=p["mouth"]))
    return group("vase", group("pedestal", plinth, stem), belly, _cover(p, start + p["height"], 1.08 * p["mouth"]))


def _ewer(p: Proportions) -> Draft:
    base, belly, at = _vessel(p, p["mouth"])
    low = np.array([-0.33 * p["width"], at - 0.62 * p["height"], 0.0])
    high = np.array([-0.33 * p["width"] - 0.5 * p["pour"], at - 0.62 * p["height"] + p["pour"], 0.0])
    tube = one("spout", strut(low, high, 0.3 * p["pour"], 0.4 * p["pour"], -RIGHT), spout)
    grip = _side_handle(p, at - 0.72 * p["height"], at - 0.12 * p["height"], 0.36 * p["width"], 0.3 * p["width"])
    return group("vase", base, belly, group("spouts", tube), group("handles", grip), _cover(p, at, 1.08 * p["mouth"]))


def _tripod(p: Proportions) -> Draft:
    start = 0.6 * p["claw"]
    belly = one("body", _oval(p, start, p["height"], 1.0), partial(body, foot=p["base"], mouth=0.9 * p["mouth"]))
    reach = 0.5 * p["base"] * p["width"] * min(1.0, p["oval"])
    limb = strut(
        np.array([0, 0.0, 1.25 * reach]),
        np.array([0, p["claw"] * 1.25, 0.75 * reach]),
        p["strap"],
        1.3 * p["strap"],
        FORWARD,
    )
    tube, rim, _ = _collar(p, start + p["height"])
    return group("vase", group("feet", around(one("claw", limb, claw), 3)), belly, group("opening", tube, rim))


def _pail(p: Proportions) -> Draft:
    base, belly, at = _vessel(p, 0.95)
    edge = one("lip", _oval(p, at - 0.6 * p["lip"], p["lip"], 1.02), lip)
    wire = box(
        0.0, at - 0.5 * p["lip"] + p["arch"] / 2, 0.0, 0.99 * p["width"], p["arch"], p["wire"] * (at + p["arch"])
    )
    return group("vase", base, belly, group("opening", edge), group("handles", one("bail", wire, bail)))


def _gourd(p: Proportions) -> Draft:
    base, belly, at = _vessel(p, 0.55)
    small = p["upper"]
    upper = one(
        "upper_body", _oval(p, at - 0.12 * small, small, 0.68), partial(body, foot=0.72, mouth=0.9 * p["mouth"] / 0.68)
    )
    tube, rim, _ = _collar(p, at + 0.86 * small)
    return group("vase", base, group("bodies", belly, upper), group("opening", tube, rim))


COMMON = {
    "width": (0.38, 0.74),
    "oval": (0.75, 1.0),
    "height": (0.4, 0.85),
    "foot": (0.06, 0.11),
    "base": (0.42, 0.6),
    "mouth": (0.32, 0.5),
    "neck": (0.14, 0.28),
    "lip": (0.035, 0.06),
    "strap": (0.05, 0.085),
    "reach": (0.17, 0.25),
}

VASES = Category(
    families={
        "bottle": Family(_bottle, COMMON),
        "amphora": Family(_amphora, COMMON),
        "jug": Family(_jug, COMMON),
        "bowl": Family(_bowl, {**COMMON, "width": (0.55, 1.0), "height": (0.25, 0.46), "loop": (0.14, 0.2)}),
        "urn": Family(
            _urn,
            {
                **COMMON,
                "height": (0.34, 0.64),
                "mouth": (0.6, 0.8),
                "stem": (0.12, 0.22),
                "cover": (0.1, 0.18),
                "knob": (0.08, 0.12),
            },
        ),
        "ewer": Family(
            _ewer,
            {
                **COMMON,
                "height": (0.36, 0.66),
                "mouth": (0.4, 0.55),
                "pour": (0.3, 0.42),
                "cover": (0.08, 0.14),
                "knob": (0.07, 0.11),
            },
        ),
        "tripod": Family(_tripod, {**COMMON, "claw": (0.16, 0.26)}),
        "pail": Family(_pail, {**COMMON, "height": (0.34, 0.62), "arch": (0.26, 0.42), "wire": (0.0055, 0.0085)}),
        "gourd": Family(_gourd, {**COMMON, "height": (0.32, 0.56), "upper": (0.2, 0.38), "neck": (0.1, 0.18)}),
    },
    kinds={
        "body": tuple(vessels.BODIES),
        "neck": ("waisted", "trumpet", "funnel"),
        "handle": ("ear", "strap", "curl"),
    },
    factors={
        "wall": (0.017, 0.044),  # thickness
        "flute": (0.0, 0.028),  # depth of grooves
        "pitch": (0.08, 0.16),  # distance of upright grooves
        "rib": (0.07, 0.2),  # distance of level grooves
        "flare": (0.012, 0.05),  # how far necks narrow
        "belly": (0.36, 0.66),  # height of the widest place, as a share
    },
    driven=("belly", "height"),
    assemble=None,
)
