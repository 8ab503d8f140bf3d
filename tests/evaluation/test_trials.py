"""Edits whose true outcome is known: what is drawn, and that the truths are what they say."""

from dataclasses import replace

import numpy as np
import pytest

from cagesdf.cuboid import Cage, Cuboid, Sequence
from cagesdf.deformation.matching import touching
from cagesdf.deformation.sequences import SMALLEST, deform_shape, deform_vertices, interpolated_cage
from cagesdf.evaluation.trials import bent_trial, beyond_trials, blend, local_trials, refitted, rest_trial
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, is_closed
from cagesdf.geometry.solid import union
from cagesdf.shape import Shape
from tests.support import toy


def bounding_cage(shape: Shape) -> Cage:
    """Upright cuboids around the parts."""
    ends = [(part.mesh.vertices.min(axis=0), part.mesh.vertices.max(axis=0)) for part in shape.parts]
    return Cage.of({part.part_id: Cuboid((a + b) / 2, np.eye(3), b - a) for part, (a, b) in zip(shape.parts, ends)})


STOOL = toy.stool("stool")
REST = bounding_cage(STOOL)
ASIDE = np.array([[0.15, 0, 0], *[[0.0, 0, 0]] * 4])  # the seat, away from its legs
TARGET = replace(REST, centre=REST.centre * [1.4, 1, 1] + ASIDE, size=REST.size * [1.4, 0.7, 1])
CAGES = (REST, interpolated_cage(REST, TARGET, 0.5), TARGET)
SEQUENCE = Sequence("stool", None, np.array([0, 0.5, 1]), (False, True, False), CAGES)


def apart(a: Mesh, b: Mesh) -> float:
    """The largest distance of a vertex of either surface to the other."""
    return max(SurfaceDistance(x).unsigned(y.vertices).max() for x, y in ((a, b), (b, a)))


def test_without_an_edit_the_truth_is_the_shape_itself() -> None:
    trial = rest_trial(STOOL, REST)
    assert (trial.trial_id, trial.style_of, trial.cage) == ("rest/stool", "stool", REST)
    assert is_closed(trial.truth)
    assert trial.changed.all()
    assert apart(trial.truth, union([part.mesh for part in STOOL.parts])) == pytest.approx(0, abs=1e-9)


def test_a_local_edit_changes_one_cuboid_that_some_other_does_not_touch() -> None:
    trials = list(local_trials(STOOL, REST, 12, (0.5, 2.0), (0.05, 0.1), np.random.default_rng(1)))
    assert len({trial.trial_id for trial in trials}) == 12
    for number, trial in enumerate(trials):
        part = REST.part_ids.index(trial.part_id)
        same = np.isclose(trial.cage.vectors(), REST.vectors()).all(axis=1)
        assert np.flatnonzero(~same).tolist() == [part]
        assert (~touching(REST)[part]).sum() > 1
        if number % 2 == 0:
            factor = trial.cage.size[part] / REST.size[part]
            assert np.isclose(factor, 1).sum() == 2
            assert factor.min() > 0.5 - 1e-12
            assert factor.max() < 2 + 1e-12
        else:
            assert 0.05 <= np.linalg.norm(trial.cage.centre[part] - REST.centre[part]) <= 0.1
    again = list(local_trials(STOOL, REST, 12, (0.5, 2.0), (0.05, 0.1), np.random.default_rng(1)))
    assert [trial.part_id for trial in again] == [trial.part_id for trial in trials]


def test_a_shape_whose_cuboids_all_touch_has_no_local_edit() -> None:
    two = Cage.of({"a": Cuboid(np.zeros(3), np.eye(3), np.ones(3)), "b": Cuboid(np.ones(3) / 2, np.eye(3), np.ones(3))})
    assert list(local_trials(STOOL, two, 3, (0.5, 2.0), (0.1, 0.2), np.random.default_rng(1))) == []


def test_the_line_beyond_a_sequence_passes_through_its_ends() -> None:
    trials, left_out = beyond_trials(STOOL, SEQUENCE, (0.0, 1.0))
    assert left_out == 0
    for trial, cage in zip(trials, (REST, TARGET)):
        assert np.allclose(trial.cage.vectors(), cage.vectors(), atol=1e-12)
    assert apart(trials[1].truth, union(deform_shape(STOOL, REST, TARGET))) == pytest.approx(0, abs=1e-9)


def test_a_place_where_a_cuboid_would_turn_inside_out_is_left_out_and_counted() -> None:
    # Heights shrink by 0.3 over the sequence, so that nothing is left at 1 / 0.3.
    trials, left_out = beyond_trials(STOOL, SEQUENCE, (-0.25, 1.25, 3.3, 3.4))
    assert [trial.trial_id for trial in trials] == ["beyond/stool/-0.25", "beyond/stool/1.25", "beyond/stool/3.3"]
    assert left_out == 1
    assert min(trial.cage.size.min() for trial in trials) >= SMALLEST


def test_blending_without_reach_is_the_deformation_of_the_sequences() -> None:
    for i, part in enumerate(STOOL.parts):
        own = deform_vertices(part.mesh.vertices, i, REST, TARGET)
        assert np.allclose(blend(part.mesh.vertices, REST, TARGET, 1e-5), own, atol=1e-6)


def test_blending_is_continuous_where_a_cuboid_ends_and_towards_the_same_cage_moves_nothing() -> None:
    line = np.linspace(REST.centre[1], REST.centre[1] * [1, 0, 1] + [0, 0.62, 0], 10001)  # up a leg, into the seat
    assert REST.assign(line)[1].max() < 0
    steps = np.linalg.norm(np.diff(blend(line, REST, TARGET, 0.1), axis=0), axis=1)
    assert steps.max() < 1e-3
    sharp = np.linalg.norm(np.diff(blend(line, REST, TARGET, 1e-9), axis=0), axis=1)
    assert sharp.max() > 1e-2, "the sequences' deformation jumps there"
    assert np.allclose(blend(line, REST, REST, 0.1), line, atol=1e-12)


def test_cuboids_refitted_to_an_affine_deformation_are_those_it_was_made_with() -> None:
    roomy = replace(REST, size=REST.size * [1.1, 1.2, 1.05], centre=REST.centre + 0.01)
    before = [part.mesh for part in STOOL.parts]
    after = [mesh.with_vertices(TARGET.from_unit(roomy.to_unit(mesh.vertices, i), i)) for i, mesh in enumerate(before)]
    assert np.allclose(refitted(roomy, TARGET, before, after).vectors(), TARGET.vectors(), atol=1e-12)


def test_a_bent_truth_is_no_box_warp_and_its_cuboids_hold_its_parts() -> None:
    trial = bent_trial(STOOL, SEQUENCE, 0.2)
    assert is_closed(trial.truth)
    assert trial.cage.assign(trial.truth.vertices)[1].max() < 1e-6
    assert apart(trial.truth, union(deform_shape(STOOL, REST, trial.cage))) > 0.01


def test_a_bent_trial_towards_its_own_cage_is_the_shape_at_rest() -> None:
    trial = bent_trial(STOOL, replace(SEQUENCE, cages=(REST, REST, REST)), 0.2)
    assert np.allclose(trial.cage.vectors(), REST.vectors(), atol=1e-12)
    assert apart(trial.truth, rest_trial(STOOL, REST).truth) == pytest.approx(0, abs=1e-9)
