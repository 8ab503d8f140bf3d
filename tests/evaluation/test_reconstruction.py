"""Metrics of reconstruction: zero on itself, known values, slow versions, and the worst case."""

from dataclasses import replace

import numpy as np
import pytest

from cagesdf.cuboid import Cage, Cuboid, Sequence
from cagesdf.deformation.sequences import Trilinear
from cagesdf.evaluation.metrics import OF_KEY, POINT_METRICS
from cagesdf.evaluation.reconstruction import OWN, own_figures, score
from cagesdf.evaluation.surfaces import Measured, Truth
from cagesdf.geometry.meshes import Mesh, sample_surface
from cagesdf.geometry.solid import cage_surface, union
from cagesdf.shape import Shape
from tests.support import toy

POINTS = 4000
LOOSE = Cage.of({"all": Cuboid(np.zeros(3), np.eye(3), np.full(3, 1.2))})


def measured(predicted: Mesh | None, true: Mesh, cage: Cage = LOOSE, points: int = POINTS) -> dict[str, float]:
    rng = np.random.default_rng(0)
    truth = Truth(true, cage, 0.005)
    return score(Measured(predicted) if predicted else None, truth, truth.drawn(points, rng), rng)


def test_every_metric_is_there() -> None:
    ball = toy.ball([0, 0, 0], 0.5)
    assert (
        measured(ball, ball).keys()
        == measured(None, ball).keys()
        == {*OF_KEY, "detail_share"} - {f"{key}_own" for key in OWN}
    )


def test_a_surface_against_itself_is_perfect_but_for_the_sampling_floor() -> None:
    ball = toy.ball([0, 0, 0], 0.5)
    figures = measured(ball, ball)
    for suffix in ("", "_detail"):
        for name in ("surface_distance", "accuracy", "completeness"):
            assert figures[name + suffix] < 1e-9
        for name in ("f1", "f2", "nc", "nc_signed"):
            assert figures[name + suffix] == pytest.approx(1)
        assert 0 < figures["cd_deepsdf" + suffix] < 2 / POINTS
    assert figures["iou"] == figures["closed"] == 1


def test_concentric_spheres_have_the_known_distances() -> None:
    """Radii 0.5 and 0.6, 0.1 apart: 10 % of the longest side; squared in cd_deepsdf alone."""
    figures = measured(toy.ball([0, 0, 0], 0.6, 128), toy.ball([0, 0, 0], 0.5, 128), points=20000)
    for name in ("surface_distance", "accuracy", "completeness"):
        assert figures[name] == pytest.approx(10, rel=0.01)
    assert figures["cd_deepsdf"] == pytest.approx(2 * 0.1**2, rel=0.03)
    assert figures["cd_l1"] == pytest.approx(0.1, rel=0.03)
    assert figures["f1"] == figures["f2"] == 0
    assert figures["nc"] == pytest.approx(1, abs=0.01)
    assert figures["iou"] == pytest.approx((0.5 / 0.6) ** 3, rel=1e-9)


@pytest.mark.parametrize(("shift", "f1", "f2"), [(0.007, 1, 1), (0.015, 2 / 3, 1), (0.03, 2 / 3, 2 / 3)])
def test_a_shifted_cube_has_the_known_f_scores(shift: float, f1: float, f2: float) -> None:
    """Two of six faces are as far apart as the shift; the others nearly cover each other."""
    figures = measured(toy.box([shift, 0, 0], [1, 1, 1]), toy.box([0, 0, 0], [1, 1, 1]), points=20000)
    assert figures["f1"] == pytest.approx(f1, abs=0.03)
    assert figures["f2"] == pytest.approx(f2, abs=0.03)
    assert figures["surface_distance"] == pytest.approx(100 * shift / 3, rel=0.1)
    assert figures["iou"] == pytest.approx((1 - shift) / (1 + shift))


def test_size_cancels_in_percentages_and_f_scores_and_not_in_chamfer() -> None:
    a, b = toy.box([0.02, 0, 0], [1, 0.5, 0.8]), toy.box([0, 0, 0], [1, 0.5, 0.9])
    one = measured(a, b)
    three = measured(a.with_vertices(3 * a.vertices), b.with_vertices(3 * b.vertices))
    for name in ("surface_distance", "f1", "f2", "nc", "iou"):
        assert three[name] == pytest.approx(one[name], rel=1e-6)
    assert three["cd_l1"] == pytest.approx(3 * one["cd_l1"])
    assert three["cd_deepsdf"] == pytest.approx(9 * one["cd_deepsdf"])


def test_exchanging_surfaces_of_equal_size_exchanges_the_directions() -> None:
    a = toy.box([0, 0, 0], [1, 0.5, 0.8])
    b = union([a, toy.box([0, 0.4, 0], [0.6, 0.4, 0.6])])
    forth, back = measured(a, b, points=20000), measured(b, a, points=20000)
    for name in ("surface_distance", "cd_l1", "cd_deepsdf", "f1", "f2", "nc", "iou"):
        assert forth[name] == pytest.approx(back[name], rel=0.1)
    assert forth["accuracy"] == pytest.approx(back["completeness"], rel=0.1)
    assert forth["accuracy"] != pytest.approx(forth["completeness"], rel=0.5)


def test_chamfer_equals_the_one_of_all_pairs() -> None:
    """The same draws, every distance computed."""
    a, b = toy.ball([0.05, 0, 0], 0.5), toy.box([0, 0, 0], [1, 0.8, 0.7])
    rng = np.random.default_rng(0)
    there, here = sample_surface(b, 500, rng)[0], sample_surface(a, 500, rng)[0]
    pairs = np.linalg.norm(there[:, None] - here, axis=2)
    figures = measured(a, b, points=500)
    assert figures["cd_l1"] == pytest.approx((pairs.min(0).mean() + pairs.min(1).mean()) / 2)
    assert figures["cd_deepsdf"] == pytest.approx((pairs.min(0) ** 2).mean() + (pairs.min(1) ** 2).mean())


def test_f_scores_equal_those_of_distances_in_closed_form() -> None:
    """Two spheres, one moved: the distance to a sphere is |radius − distance to its centre|."""
    centre = np.array([0.01, 0, 0])
    a, b = toy.ball(centre, 0.5, 256), toy.ball([0, 0, 0], 0.49, 256)
    rng = np.random.default_rng(0)
    there, here = sample_surface(b, POINTS, rng)[0], sample_surface(a, POINTS, rng)[0]
    recall = np.mean(np.abs(np.linalg.norm(there - centre, axis=1) - 0.5) < 0.01 * 0.98)
    precision = np.mean(np.abs(np.linalg.norm(here, axis=1) - 0.49) < 0.01 * 0.98)
    assert 0.2 < recall < 0.8
    assert measured(a, b)["f1"] == pytest.approx(2 * recall * precision / (recall + precision), abs=0.02)


def test_an_inside_out_surface_has_the_same_unsigned_normals_and_opposite_signed_ones() -> None:
    ball, true = toy.ball([0.02, 0, 0], 0.5), toy.ball([0, 0, 0], 0.5)
    right, wrong = measured(ball, true), measured(replace(ball, faces=ball.faces[:, ::-1].copy()), true)
    assert wrong["nc"] == pytest.approx(right["nc"], abs=0.01)
    assert wrong["nc_signed"] == pytest.approx(-right["nc_signed"], abs=0.01)
    assert right["nc_signed"] > 0.9


def test_a_surface_that_is_not_there_gets_the_worst_values() -> None:
    figures = measured(None, toy.ball([0, 0, 0], 0.5))
    side = 1.0
    for suffix in ("", "_detail"):
        assert figures["surface_distance" + suffix] == pytest.approx(100)
        assert figures["cd_deepsdf" + suffix] == pytest.approx(2 * side**2)
        assert figures["cd_l1" + suffix] == pytest.approx(side)
        assert figures["f1" + suffix] == figures["f2" + suffix] == figures["nc" + suffix] == 0
        assert figures["nc_signed" + suffix] == -1
    assert figures["iou"] == figures["closed"] == 0


def test_a_surface_that_is_not_there_is_worse_than_the_true_one_by_every_metric() -> None:
    ball = toy.ball([0, 0, 0], 0.5)
    lost, perfect = measured(None, ball), measured(ball, ball)
    for key in lost.keys() - {"detail_share"}:
        sign = 1 if OF_KEY[key].higher else -1
        assert sign * lost[key] < sign * perfect[key], key


def test_a_hole_is_seen() -> None:
    ball = toy.ball([0, 0, 0], 0.5)
    figures = measured(replace(ball, faces=ball.faces[1:]), ball)
    assert figures["closed"] == figures["iou"] == 0


def carved() -> tuple[Mesh, Cage]:
    """A box that fills its cuboid, and a ball inside one: only the ball is away from the cage."""
    cage = Cage.of(
        {
            "box": Cuboid(np.array([0, -0.4, 0]), np.eye(3), np.array([1.0, 0.2, 1.0])),
            "ball": Cuboid(np.array([0, 0.3, 0]), np.eye(3), np.full(3, 0.5)),
        }
    )
    return union([toy.box([0, -0.4, 0], [1, 0.2, 1]), toy.ball([0, 0.3, 0], 0.25, 64)]), cage


def test_detail_is_what_leaves_the_cage() -> None:
    """The cage itself is perfect on the box; on the ball, and nearest to it, it is not."""
    true, cage = carved()
    figures = measured(cage_surface(cage), true, cage)
    ball = 4 * np.pi * 0.25**2
    assert figures["detail_share"] == pytest.approx(ball / (ball + 2.8), rel=0.1)
    assert figures["surface_distance_detail"] > 2 * figures["surface_distance"] > 0
    better = measured(true, true, cage)
    assert better["surface_distance_detail"] == pytest.approx(0, abs=1e-9)
    # An error on the box alone doesn't count as one of detail.
    box_moved = union([toy.box([0, -0.45, 0], [1, 0.2, 1]), toy.ball([0, 0.3, 0], 0.25, 64)])
    moved = measured(box_moved, true, cage)
    assert moved["surface_distance"] > 1
    assert moved["surface_distance_detail"] == pytest.approx(0, abs=1e-9)


def test_detail_that_was_not_reconstructed_at_all_counts_as_lost() -> None:
    true, cage = carved()
    figures = measured(toy.box([0, -0.4, 0], [1, 0.2, 1]), true, cage)
    assert figures["accuracy_detail"] == pytest.approx(100)
    assert figures["completeness"] < figures["completeness_detail"] < 100


def test_a_shape_that_fills_its_cage_has_no_figures_of_detail() -> None:
    true = toy.box([0, 0, 0], [1.2, 1.2, 1.2])
    for predicted in (true, None):
        figures = measured(predicted, true)
        assert figures["detail_share"] == 0
        assert all(np.isnan(figures[f"{metric.key}_detail"]) for metric in POINT_METRICS)
        assert not any(np.isnan(figures[metric.key]) for metric in POINT_METRICS)


def stool_in_its_boxes() -> tuple[Shape, Cage]:
    shape = toy.stool("a")
    boxes = {
        part.part_id: Cuboid(
            (part.mesh.vertices.max(0) + part.mesh.vertices.min(0)) / 2, np.eye(3), np.ptp(part.mesh.vertices, axis=0)
        )
        for part in shape.parts
    }
    return shape, Cage.of(boxes)


def test_the_true_surface_of_a_step_follows_its_cage() -> None:
    shape, rest = stool_in_its_boxes()
    wider = replace(rest, centre=rest.centre * [2, 1, 1], size=rest.size * [2, 1, 1])
    sequence = Sequence("a", None, np.array([0.0, 1.0]), (False, True), (rest, wider))
    at_rest, moved = (Truth.of(shape, sequence, step, 0.005, Trilinear()) for step in (0, 1))
    np.testing.assert_allclose(np.ptp(moved.mesh.vertices, axis=0), np.ptp(at_rest.mesh.vertices, axis=0) * [2, 1, 1])


def test_a_surface_is_measured_against_the_truth_it_was_taught() -> None:
    """A long cuboid that moves away takes the vertices of another's along with it, but not of parts by themselves."""
    shape, loose = stool_in_its_boxes()
    loose = replace(loose, size=loose.size + 0.3)
    centre = loose.centre.copy()
    centre[0] += [0, 0.1, 0]
    sequence = Sequence("a", None, np.array([0.0, 1.0]), (False, True), (loose, replace(loose, centre=centre)))

    def both(predicted: Mesh | None, step: int) -> tuple[float, float]:
        truths = [kind(shape, sequence, step, 0.005, Trilinear()) for kind in (Truth.of, Truth.of_own_cuboids)]
        surface = Measured(predicted) if predicted else None
        drawn = [truth.drawn(POINTS, np.random.default_rng(0)) for truth in truths]
        averaged = score(surface, truths[0], drawn[0], np.random.default_rng(0))["surface_distance"]
        by_own = own_figures(surface, truths[1], drawn[1], np.random.default_rng(0))
        assert by_own.keys() == {f"{key}_own" for key in OWN}
        return averaged, by_own["surface_distance_own"]

    own, averaged = (kind(shape, sequence, 1, 0.005, Trilinear()).mesh for kind in (Truth.of_own_cuboids, Truth.of))
    assert both(own, 1)[1] < 1e-9 < 0.01 < both(own, 1)[0]
    assert both(averaged, 1)[0] < 1e-9 < 0.01 < both(averaged, 1)[1]
    assert both(own, 0)[0] == pytest.approx(both(own, 0)[1])
    assert both(None, 1) == pytest.approx((100, 100))
