"""Figures of edits: 0 and 1 where they must be, and worse the further an edit is from its truth."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.evaluation.edits import (
    FIGURES,
    edit_row,
    locality,
    measure,
    mirror_plane,
    overshoot,
    refit,
    with_gains,
)
from cagesdf.evaluation.surfaces import Truth
from cagesdf.evaluation.trials import Trial, trial_of
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.geometry.solid import cage_surface, union
from tests.support import toy

EMPTY = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
# A bench of three blocks, none touching the last but one.
BENCH = Cage.of(
    {
        "left": Cuboid(np.array([-0.6, 0, 0]), np.eye(3), np.array([0.4, 0.4, 0.4])),
        "right": Cuboid(np.array([0.6, 0, 0]), np.eye(3), np.array([0.4, 0.4, 0.4])),
        "top": Cuboid(np.array([0.0, 0.8, 0]), np.eye(3), np.array([0.6, 0.4, 0.4])),
    }
)


def shifted(cage: Cage, *offsets: list[float]) -> Cage:
    """The cage with its cuboids moved: all alike, or each by its own offset."""
    return replace(cage, centre=cage.centre + np.array(offsets))


def balls(cage: Cage) -> list[Mesh]:
    """Ellipsoids that fill the cuboids."""
    ball = toy.ball([0, 0, 0], 0.5)
    return [ball.with_vertices(cage.from_unit(ball.vertices, i)) for i in range(len(cage))]


def measured(surface: Mesh, trial: Trial) -> dict[str, float]:
    truth = Truth(trial.truth, trial.cage, 0.005)
    return measure(surface, trial, truth, 3000, np.random.default_rng(3))


REST = trial_of("rest", "bench", BENCH, balls(BENCH))


def test_the_truth_itself_is_perfect() -> None:
    figures = measured(REST.truth, REST)
    assert tuple(figures) == FIGURES
    for name in ("distance", "distance_detail", "refit", "overshoot"):
        assert figures[name] == pytest.approx(0, abs=1e-6), name
    assert figures["symmetry"] == pytest.approx(0, abs=0.05), "a ball of triangles is nearly its mirror image"
    assert math.isnan(figures["gain"])
    assert math.isnan(figures["moved_mean"])


def test_no_surface_gets_the_worst_of_all_but_overshoot() -> None:
    figures = measured(EMPTY, REST)
    assert {figures[name] for name in ("distance", "distance_detail", "refit", "symmetry")} == {100.0}
    assert figures["overshoot"] == 0


def test_distances_are_in_percent_of_the_longest_side() -> None:
    side = np.ptp(REST.truth.vertices, axis=0).max()
    moved = REST.truth.with_vertices(REST.truth.vertices + np.array([0, 0.01, 0]))
    assert 0.2 < measured(moved, REST)["distance"] / (100 * 0.01 / side) < 1


def test_only_parts_whose_style_changed_count_as_detail() -> None:
    wrong = [*balls(BENCH)[:2], toy.box(BENCH.centre[2], BENCH.size[2])]
    owner = BENCH.assign(REST.truth.corners().mean(axis=1))[0]
    upper, lower = (replace(REST, kind="swap", changed=mask) for mask in (owner == 2, owner != 2))
    surface = union(wrong)
    assert measured(surface, upper)["distance_detail"] > 1
    assert measured(surface, lower)["distance_detail"] == pytest.approx(0, abs=1e-6)
    nothing = replace(REST, changed=np.zeros(len(owner), dtype=bool))
    assert math.isnan(measured(surface, nothing)["distance_detail"])


def test_a_swap_gains_all_at_the_truth_and_nothing_where_nothing_changed() -> None:
    trial = replace(REST, kind="swap")
    surfaces = {"unchanged": cage_surface(BENCH), "same": cage_surface(BENCH), "truth": trial.truth, "lost": EMPTY}
    rows = [edit_row(arm, trial, measured(surface, trial)) for arm, surface in surfaces.items()]
    gains = {row["arm"]: row["gain"] for row in with_gains(rows, rows)}
    assert gains["truth"] == pytest.approx(1, abs=1e-6)
    assert gains["same"] == gains["unchanged"] == 0
    assert gains["lost"] < 0
    rest = [edit_row("a", REST, measured(REST.truth, REST))]
    assert math.isnan(with_gains(rest, rows)[0]["gain"])


def test_a_mesh_that_fills_its_cuboids_leaves_nothing_free_and_a_thinner_one_what_it_lacks() -> None:
    full = join(balls(BENCH))
    assert refit(full, full, BENCH) == pytest.approx(0, abs=1e-12)
    thin = replace(BENCH, size=BENCH.size * [1, 0.8, 1])
    # Of six ends of each cuboid two are free by a tenth.
    assert refit(join(balls(thin)), full, BENCH) == pytest.approx(0.1 / 3)
    assert refit(join(balls(BENCH)[:2]), full, BENCH) == pytest.approx(1 / 3)


def test_ends_that_lie_inside_other_parts_are_not_asked_for() -> None:
    leg = Cage.of({"seat": Cuboid(np.zeros(3), np.eye(3), np.array([1.0, 0.2, 1.0])),
                   "leg": Cuboid(np.array([0, -0.45, 0]), np.eye(3), np.array([0.1, 0.9, 0.1]))})  # fmt: skip
    surface = cage_surface(leg)
    assert refit(surface, surface, leg) == pytest.approx(0, abs=1e-9)


def test_overshoot_is_the_farthest_vertex_outside_all_cuboids() -> None:
    surface = cage_surface(BENCH)
    assert overshoot(surface, BENCH) == pytest.approx(0, abs=1e-9)
    assert overshoot(surface.with_vertices(surface.vertices + np.array([0, 0.07, 0])), BENCH) == pytest.approx(0.07)


@pytest.mark.parametrize("x", [0.0, 0.3])
def test_a_cage_is_mirrored_at_its_middle_or_not_at_all(x: float) -> None:
    moved = shifted(BENCH, [x, 0, 0])
    assert mirror_plane(moved) == pytest.approx(x)
    # Both ends where they were, the block between them off the middle.
    assert mirror_plane(shifted(moved, [0, 0, 0], [0, 0, 0], [0.1, 0, 0])) is None


def test_asymmetry_is_that_of_the_surface_in_a_symmetric_cage() -> None:
    lopsided = [*balls(BENCH)[:1], toy.box(BENCH.centre[1], BENCH.size[1]), balls(BENCH)[2]]
    assert measured(union(lopsided), REST)["symmetry"] > 1
    assert math.isnan(measured(union(lopsided), replace(REST, kind="local"))["symmetry"])


def local(cage: Cage, part_id: str) -> tuple[Trial, Truth]:
    trial = trial_of("local", "bench", cage, balls(cage), part_id)
    return trial, Truth(trial.truth, cage, 0.005)


def moved(before: Mesh, after: Mesh, trial: Trial, truth: Truth) -> dict[str, float]:
    return locality(before, after, BENCH, trial, truth, 2000, np.random.default_rng(1))


def test_the_identity_moves_nothing() -> None:
    trial, truth = local(BENCH, "top")
    assert moved(REST.truth, REST.truth, trial, truth) == pytest.approx({"moved_mean": 0, "moved_max": 0}, abs=1e-12)


def test_what_an_edit_should_not_touch_is_all_that_counts() -> None:
    edited = shifted(BENCH, [0, 0, 0], [0, 0, 0], [0, 0.1, 0])
    trial, truth = local(edited, "top")
    assert moved(REST.truth, trial.truth, trial, truth)["moved_max"] == pytest.approx(0, abs=1e-9)
    dragged = union(balls(shifted(BENCH, [0, 0, 0], [0.02, 0, 0], [0, 0.1, 0])))
    figures = moved(REST.truth, dragged, trial, truth)
    assert figures["moved_max"] == pytest.approx(2 / truth.side, rel=0.05)
    assert 0 < figures["moved_mean"] < figures["moved_max"] / 2, "one of the two others stayed"


def test_neighbours_before_or_afterwards_do_not_count() -> None:
    edited = replace(BENCH, size=BENCH.size * [[1, 1, 1], [1, 1, 1], [2, 3.2, 1]])
    trial, truth = local(edited, "top")
    assert moved(REST.truth, trial.truth, trial, truth) == {}, "it reaches both others now"
    assert moved(EMPTY, REST.truth, *local(BENCH, "top")) == {}
