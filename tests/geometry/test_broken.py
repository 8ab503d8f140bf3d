"""The corpus of broken shapes: each repaired as well as is promised in docs/repair.md, none lost."""

import numpy as np
import pytest

from cagesdf.audit import flags
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, is_closed
from cagesdf.geometry.solid import METHODS, TIGHT, union
from tests.support import broken, toy
from tests.support.broken import Case

POINTS = 5000
CASES = {case.name: case for case in broken.cases()}
# What is lost with a curved cap can't be known. A flat sheet's plate has its rim exactly; of a flap that a lid lies on,
# a plate's thickness more is solid.
OPENED = {"opened", "opened, turned soup", "huge"}
PLATES = {"sheet alone": 1e-6, "frame alone": 1e-6, "flap in a lid's plane": 2 * TIGHT}


@pytest.mark.parametrize("name", CASES)
def test_a_broken_shape_is_as_near_to_the_clean_one_as_is_promised(name: str) -> None:
    shape, errors = broken.measure(CASES[name], POINTS)
    assert all(is_closed(part.mesh) and part.repair.method in METHODS for part in shape.parts)
    if name in OPENED:
        assert max(errors.sign, errors.sign_near) <= 0.002
        assert errors.mean <= 1e-4
    elif name in PLATES:
        assert max(errors.sign, errors.sign_near) <= 0.002
        assert errors.worst <= PLATES[name]
    else:
        assert errors.sign == errors.sign_near == 0
        assert errors.worst <= 1e-9


@pytest.mark.parametrize("name", sorted(CASES.keys() - {"self-intersecting"} - PLATES.keys()))
def test_rays_through_the_broken_faces_agree_with_the_repaired_sign(name: str) -> None:
    shape = broken.imported(CASES[name])
    assert shape.audit.clear > 200
    assert shape.audit.differ == 0
    assert flags(shape) == []


def test_a_surface_that_runs_into_itself_has_no_faces_inside_afterwards() -> None:
    case = CASES["self-intersecting"]
    (part,) = broken.imported(case).parts
    assert part.repair.method == "untangled"
    truth = SurfaceDistance(union(case.clean))
    assert truth.unsigned(broken.imported(case).similarity.to_raw(part.mesh.corners().mean(1))).max() < 1e-9


def test_a_sheet_is_told_of_and_never_a_hole() -> None:
    shape = broken.imported(CASES["sheet alone"])
    assert flags(shape) == ["1 sheet got a thickness"]
    assert [part.repair.plates for part in shape.parts] == [0, 0, 0, 0, 0, 1]
    inside = broken.imported(CASES["sheet in a solid"])
    assert [part.repair.dropped for part in inside.parts] == [1, 0, 0, 0, 0]


@pytest.mark.parametrize("name", sorted(CASES.keys() - {"clean", "tiny and far away"}))
def test_a_damage_does_damage(name: str) -> None:
    case = CASES[name]
    assert [mesh.faces.tolist() for mesh in case.broken] != [mesh.faces.tolist() for mesh in case.clean]


@pytest.mark.slow
def test_a_million_faces_are_repaired() -> None:
    shape, errors = broken.measure(broken.million(), POINTS)
    assert [part.repair.method for part in shape.parts] == ["oriented", "capped"]
    assert errors.sign == errors.sign_near == 0
    assert errors.worst <= 1e-9


@pytest.mark.slow
def test_thousands_of_loose_faces_end_in_a_row_or_a_shape() -> None:
    """More pieces than are closed one by one."""
    rng = np.random.default_rng(0)
    centres = toy.ball([0, 0, 0], 1, 200).corners()[:6000].mean(1)
    corners = centres[:, None] + rng.normal(0, 0.01, (len(centres), 3, 3))
    mesh = Mesh(corners.reshape(-1, 3), np.arange(3 * len(centres), dtype=np.int32).reshape(-1, 3))
    (part,) = broken.imported(Case("loose", [], [mesh])).parts
    assert part.repair.method == "wrapped"
    assert is_closed(part.mesh)
