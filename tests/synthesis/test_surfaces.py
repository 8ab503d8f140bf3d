"""Surfaces of procedural parts: closed, in their cuboid, and unlike each other."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from cagesdf.cage_fitting.boxes import fit_cuboid
from cagesdf.geometry.meshes import Mesh, is_closed, signed_volume
from cagesdf.geometry.solid import as_manifold
from cagesdf.synthesis import members, slabs, vessels
from cagesdf.synthesis.surfaces import capped, fill, looped, rounded_rectangle, stack, superellipse

FURNITURE = {
    "edge": 0.015,
    "board": 0.045,
    "plate": 0.025,
    "block": 0.08,
    "bead": 0.06,
    "pitch": 0.06,
    "bend": 0.06,
    "dish": 0.015,
    "tip": 0.04,
}
VESSEL = {"wall": 0.02, "flute": 0.01, "pitch": 0.1, "rib": 0.2, "flare": 0.03, "belly": 0.5}
LONG, LYING, FLAT, STANDING = (
    np.array(s) for s in ([0.07, 0.5, 0.08], [0.5, 0.07, 0.08], [0.5, 0.07, 0.45], [0.4, 0.45, 0.09])
)
TALL = np.array([0.5, 0.6, 0.45])
MOUTHS = ("waisted", "trumpet", "funnel")


def outline(size: np.ndarray) -> np.ndarray:
    return rounded_rectangle(size[0] / 2, size[2] / 2, 0.03, 64)


def slab(size: np.ndarray, edge: str, top: str) -> Mesh:
    return slabs.slab(size, outline(size), edge, top, FURNITURE)


# name → (size, function of size)
SURFACES: dict[str, tuple[np.ndarray, Callable[[np.ndarray], Mesh]]] = {
    **{f"leg {k}": (LONG, partial(members.member, shaping=p, factors=FURNITURE)) for k, p in members.LEGS.items()},
    **{f"post {k}": (LONG, partial(members.member, shaping=p, factors=FURNITURE)) for k, p in members.POSTS.items()},
    **{f"rail {k}": (LYING, partial(members.rail, shaping=p, factors=FURNITURE)) for k, p in members.RAILS.items()},
    **{f"apron {k}": (LYING, partial(members.apron, kind=k, factors=FURNITURE)) for k in ("arched", "waved")},
    **{f"column {k}": (TALL, partial(members.column, kind=k, factors=FURNITURE)) for k in ("turned", "square")},
    "hoop": (np.array([0.05, 0.25, 0.4]), lambda s: members.hoop(s, FURNITURE)),
    "bow": (np.array([0.45, 0.5, 0.04]), lambda s: members.bow(s, FURNITURE)),
    **{f"slab {e} {t}": (FLAT, partial(slab, edge=e, top=t)) for e in slabs.EDGES for t in slabs.TOPS},
    "cushion": (FLAT, lambda s: slabs.cushion(s, FURNITURE)),
    "upholstered": (FLAT, lambda s: slabs.upholstered(s, outline(s), FURNITURE)),
    "thin slab": (np.array([0.5, 0.03, 0.45]), lambda s: slabs.slab(s, outline(s), "rounded", "sunk", FURNITURE)),
    "thick slab": (np.array([0.5, 0.14, 0.45]), lambda s: slabs.slab(s, outline(s), "ogee", "domed", FURNITURE)),
    **{
        f"panel {k}": (STANDING, partial(slabs.panel, kind=k, factors=FURNITURE))
        for k in ("bent", "pierced", "slatted", "cushioned")
    },
    **{
        f"splat {k}": (np.array([0.2, 0.5, 0.08]), partial(slabs.splat, kind=k, factors=FURNITURE))
        for k in ("bent", "pierced")
    },
    **{f"slat {k}": (LYING, partial(slabs.slat, kind=k, factors=FURNITURE)) for k in ("bent", "pierced", "slatted")},
    "grid": (FLAT, lambda s: slabs.grid(s, FURNITURE)),
    "front": (np.array([0.3, 0.15, 0.08]), lambda s: slabs.front(s, "round", FURNITURE)),
    "case": (TALL, lambda s: slabs.case(s, FURNITURE)),
    "disc": (FLAT, lambda s: slabs.disc(s, FURNITURE)),
    **{f"body {k}": (TALL, partial(vessels.body, kind=k, foot=0.5, mouth=0.4, factors=VESSEL)) for k in vessels.BODIES},
    **{
        f"neck {k}": (TALL / 3, partial(vessels.neck, kind=k, factors=VESSEL)) for k in ("waisted", "trumpet", "funnel")
    },
    **{f"lip {k}": (FLAT / 2, partial(vessels.lip, kind=k, factors=VESSEL)) for k in MOUTHS},
    **{f"foot {k}": (FLAT / 2, partial(vessels.foot, kind=k, factors=VESSEL)) for k in vessels.BODIES},
    **{f"lid {k}": (FLAT, partial(vessels.lid, kind=k, factors=VESSEL)) for k in vessels.BODIES},
    **{f"knob {k}": (TALL / 6, partial(vessels.knob, kind=k, factors=VESSEL)) for k in vessels.BODIES},
    **{
        f"handle {k}": (np.array([0.06, 0.3, 0.2]), partial(vessels.handle, kind=k, factors=VESSEL))
        for k in ("ear", "strap", "curl")
    },
    "ring": (np.array([0.06, 0.2, 0.15]), lambda s: vessels.ring(s, 0.0)),
    "spout": (np.array([0.1, 0.3, 0.14]), lambda s: vessels.spout(s, VESSEL)),
    "bail": (np.array([0.5, 0.3, 0.008]), lambda s: vessels.bail(s)),
}
HANDLES = {
    "panel pierced": 2,
    "panel slatted": 2,
    "splat pierced": 1,
    "grid": 2,
    "ring": 1,
    "spout": 1,
    "neck funnel": 1,
    "lip funnel": 1,
}


@pytest.mark.parametrize("name", SURFACES)
def test_a_surface_is_closed_faces_outwards_and_touches_all_faces_of_its_cuboid(name: str) -> None:
    size, make = SURFACES[name]
    mesh = make(size)
    assert is_closed(mesh)
    assert signed_volume(mesh) > 0
    assert mesh.vertices.max(0) == pytest.approx(size / 2, abs=1e-12)
    assert mesh.vertices.min(0) == pytest.approx(-size / 2, abs=1e-12)


@pytest.mark.parametrize("name", SURFACES)
def test_a_surface_is_one_solid_with_the_handles_it_shows(name: str) -> None:
    size, make = SURFACES[name]
    solid = as_manifold(make(size))
    assert len(solid.decompose()) == 1
    assert solid.genus() >= HANDLES.get(name, 0)
    assert (solid.genus() > 0) == (name in HANDLES or name.startswith(("neck", "lip")))


@pytest.mark.parametrize("name", SURFACES)
def test_a_surface_is_its_own_mirror_image_in_local_x(name: str) -> None:
    """So that mirrored parts need no other surface: both halves hold the same volume."""
    size, make = SURFACES[name]
    solid = as_manifold(make(size))
    right, left = solid.split_by_plane((1.0, 0.0, 0.0), 0.0)
    assert right.volume() == pytest.approx(left.volume(), rel=2e-3)


@pytest.mark.parametrize("name", [name for name in SURFACES if not name.startswith("body")])
def test_the_smallest_box_around_a_surface_is_its_cuboid(name: str) -> None:
    size, make = SURFACES[name]
    box = fit_cuboid(make(size).vertices, slack=0.01, min_size=1e-4)
    assert box.size.prod() == pytest.approx(size.prod(), rel=0.04)


def radii(mesh: Mesh) -> np.ndarray:
    """Mean radius of a member's rings, from below."""
    rings = mesh.vertices[:-2].reshape(-1, members.SIDES, 3)
    return np.linalg.norm(rings[:, :, [0, 2]], axis=2).mean(axis=1)


def crests(mesh: Mesh, low: float, high: float) -> np.ndarray:
    """Heights above a member's lower end at which its radius is largest, between two heights."""
    rings = mesh.vertices[:-2].reshape(-1, members.SIDES, 3)
    y, radius = rings[:, 0, 1] - rings[0, 0, 1], radii(mesh)
    peaks = np.flatnonzero((radius[1:-1] > radius[:-2]) & (radius[1:-1] >= radius[2:])) + 1
    return y[peaks][(y[peaks] > low) & (y[peaks] < high)]


def test_a_longer_turned_leg_has_more_beads_of_the_same_length() -> None:
    counts = []
    for length in (0.36, 0.72):
        mesh = members.member(np.array([0.07, length, 0.08]), members.LEGS["turned"], FURNITURE)
        beads = crests(mesh, 0.0, length - 0.09)
        assert np.diff(beads) == pytest.approx(FURNITURE["bead"], rel=0.35)  # rings are a fifth of a bead apart
        assert np.diff(beads).mean() == pytest.approx(FURNITURE["bead"], rel=0.1)
        counts.append(len(beads))
    assert counts[1] - counts[0] == round(0.36 / FURNITURE["bead"])


@pytest.mark.parametrize("kind", ["tapered", "sabre"])
def test_a_leg_of_any_thickness_and_length_ends_in_a_foot_of_the_same_diameter(kind: str) -> None:
    for width, length in ((0.06, 0.3), (0.06, 0.8), (0.11, 0.3), (0.11, 0.8)):
        mesh = members.member(np.array([width, length, width + 0.01]), members.LEGS[kind], FURNITURE)
        foot = mesh.vertices[: members.SIDES]
        assert np.ptp(foot[:, 0]) == pytest.approx(FURNITURE["tip"], rel=0.02)


def test_blocks_of_legs_are_as_high_on_a_longer_leg() -> None:
    for length in (0.4, 0.8):
        mesh = members.member(np.array([0.07, length, 0.08]), members.LEGS["tapered"], FURNITURE)
        rings = mesh.vertices[:-2].reshape(-1, members.SIDES, 3)
        block = rings[np.ptp(rings[:, :, 0], axis=1) > 0.999 * 0.07, 0, 1]
        assert np.ptp(block) == pytest.approx(FURNITURE["block"], abs=2 * members.STEP)


def test_a_boards_thickness_is_the_same_on_a_high_frame_and_a_low_one() -> None:
    """What a thicker slab adds is frame: seen from above, nothing changes."""
    for height in (0.07, 0.13):
        size = np.array([0.5, height, 0.45])
        board = as_manifold(slabs.slab(size, outline(size), "rounded", "sunk", FURNITURE))
        for side in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)):
            board = board.trim_by_plane(side, -0.1)
        low, high = np.array(board.bounding_box()).reshape(2, 3)[:, 1]
        assert high - low == pytest.approx(FURNITURE["board"] - FURNITURE["dish"], abs=1e-6)


@pytest.mark.parametrize("kind", ["bent", "cushioned"])
def test_a_backs_plate_is_as_thick_in_a_deeper_cuboid_and_more_bowed(kind: str) -> None:
    volumes = [
        signed_volume(slabs.panel(np.array([0.4, 0.45, depth]), kind, FURNITURE)) for depth in (0.07, 0.09, 0.12)
    ]
    assert volumes == pytest.approx([volumes[0]] * 3, rel=0.03)


def test_arms_bend_at_the_same_radius_whatever_their_length() -> None:
    for height, span in ((0.3, 0.4), (0.5, 0.8)):
        path = members.arch(height, span, 0.07)
        assert path[0] == pytest.approx([0, span / 2])
        assert path[-1] == pytest.approx([0, -span / 2])
        straight = (np.abs(np.abs(path[:, 1]) - span / 2) < 1e-9) | (np.abs(path[:, 0] - height) < 1e-9)
        centre = np.array([height - 0.07, span / 2 - 0.07])
        corner = path[~straight & (path[:, 1] > 0)]
        assert len(corner) >= 3
        assert np.linalg.norm(corner - centre, axis=1) == pytest.approx(0.07, rel=0.03)


def test_slots_keep_their_pitch_when_the_cuboid_grows() -> None:
    """A wider back has more slots, not wider ones: style is not affine in the cuboid."""
    narrow, wide = (
        as_manifold(slabs.panel(np.array([w, 0.45, 0.06]), "slatted", FURNITURE)).genus() for w in (0.35, 0.65)
    )
    assert wide - narrow == round(0.3 / FURNITURE["pitch"])


def test_a_vessels_wall_keeps_its_thickness_when_the_cuboid_grows() -> None:
    for scale in (0.7, 1.4):
        size = scale * TALL
        solid = as_manifold(vessels.body(size, "ovoid", 0.5, 0.5, {**VESSEL, "flute": 0.0}))
        at_belly = solid.rotate((90.0, 0.0, 0.0)).slice(0.0)
        rings = sorted(np.abs(polygon[:, 0]).max() for polygon in at_belly.to_polygons())
        assert rings[1] - rings[0] == pytest.approx(VESSEL["wall"], rel=0.15)


def test_outlines_touch_their_rectangle_and_have_evenly_spaced_points() -> None:
    for points in (superellipse(0.6, 0.3, 4.0, 64), rounded_rectangle(0.6, 0.3, 0.05, 64)):
        assert np.abs(points).max(0) == pytest.approx([1, 1])
        steps = np.linalg.norm(np.diff(points * [0.6, 0.3], axis=0), axis=1)
        assert steps.max() / steps.min() < 1.5


def test_capped_rings_are_a_ball_and_looped_rings_a_torus() -> None:
    circle = superellipse(1.0, 1.0, 2.0, 16)
    half, up = np.array([0.5, 1.0, 1.0, 0.5]), np.array([0.0, 0.0, 1.0, 1.0])
    assert as_manifold(capped(stack(circle, half, half, up))).genus() == 0
    assert as_manifold(looped(stack(circle, half, half, up))).genus() == 1


def test_fill_stretches_to_the_cuboid_and_leaves_faces_alone() -> None:
    circle = superellipse(1.0, 1.0, 2.0, 16)
    mesh = capped(stack(circle, np.ones(2), np.ones(2), np.array([3.0, 4.0])))
    filled = fill(mesh, np.array([1.0, 2.0, 3.0]))
    assert np.ptp(filled.vertices, axis=0) == pytest.approx([1, 2, 3])
    assert (filled.faces == mesh.faces).all()
