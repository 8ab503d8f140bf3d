"""The camera sees all of a shape, handles stay as large, colours tell parts apart, angles lead where they say."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock, Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from viser import ClientHandle

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.editing.parts import parameters
from cagesdf.editing.script import Rotate
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.viewing.angles import angles_of, turns
from cagesdf.viewing.colours import SELECTED, palette, part_colours
from cagesdf.viewing.framing import FILLED, VIEWS, camera_for, world_per_pixel
from cagesdf.viewing.keys import CAMERA_KEYS, KEYS, card
from cagesdf.viewing.opening import named
from cagesdf.viewing.parameters import grouped, plain
from cagesdf.viewing.scene import Stage
from tests.support import programs
from tests.support.attached import box, chair, do, state_of, stool

boxes = st.builds(
    box, st.tuples(*[st.floats(-0.5, 0.5)] * 3), st.tuples(*[st.floats(0.05, 0.9)] * 3), st.floats(-80, 80)
)


@settings(max_examples=50, deadline=None)
@given(st.lists(boxes, min_size=1, max_size=4), st.sampled_from(sorted(VIEWS)), st.floats(0.5, 2.5))
def test_the_camera_sees_all_of_a_cage_and_no_smaller_than_it_must(
    cuboids: list[Cuboid], view: str, aspect: float
) -> None:
    cage, fov = Cage.of({str(i): cuboid for i, cuboid in enumerate(cuboids)}), 1.3
    position, target = camera_for(cage, np.array(VIEWS[view]), fov, aspect)
    towards = (position - target) / np.linalg.norm(position - target)
    right = np.cross([0.0, 1.0, 0.0], towards)
    right /= np.linalg.norm(right)
    x, y, depth = np.stack([right, np.cross(towards, right), -towards]) @ (cage.corners().reshape(-1, 3) - position).T
    assert (depth > 0).all()
    share = np.maximum(np.abs(x) / aspect, np.abs(y)) / (depth * np.tan(fov / 2))
    assert share.max() == pytest.approx(FILLED)


class CameraLikeViser:
    """Takes the point that it looks at along when it moves, as viser's camera does."""

    def __init__(self) -> None:
        self._position, self.look_at = np.array([3.0, 3.0, 3.0]), np.zeros(3)
        self.fov, self.aspect, self.image_height = 1.3, 1.5, 600
        self.on_update = Mock()

    @property
    def position(self) -> np.ndarray:
        return self._position

    @position.setter
    def position(self, value: np.ndarray) -> None:
        self.look_at, self._position = self.look_at + value - self._position, value


@pytest.mark.parametrize("view", sorted(VIEWS))
def test_a_view_looks_at_the_middle_of_the_cage_from_where_it_says(view: str) -> None:
    client, camera = MagicMock(spec=ClientHandle), CameraLikeViser()
    client.camera, client.scene = camera, MagicMock()
    Stage(client, Mock(), Mock(), Mock()).frame(stool().cage, view)
    position, target = camera_for(stool().cage, np.array(VIEWS[view]), camera.fov, camera.aspect)
    np.testing.assert_allclose(camera.position, position)
    np.testing.assert_allclose(camera.look_at, target)


def test_what_is_twice_as_far_is_half_as_large() -> None:
    assert world_per_pixel(2.0, 1.0, 500) == pytest.approx(2 * world_per_pixel(1.0, 1.0, 500))
    assert 500 * world_per_pixel(1.0, np.pi / 2, 500) == pytest.approx(2.0)


def test_parts_that_belong_together_share_a_colour_and_others_do_not() -> None:
    colours = part_colours(stool())
    assert len({colours[f"leg_{i}"] for i in range(4)}) == 1
    assert len(set(colours.values())) == 4
    bare = PartHierarchy.flat(("leg 1", "leg 2", "top", "cube1", "cube2"), ("",) * 5, "")
    cage = {part: box((i, 0, 0), (0.1 + 0.1 * i,) * 3) for i, part in enumerate(bare.parts())}
    found = part_colours(replace(state_of(cage), structure=bare))
    assert found["leg 1"] == found["leg 2"]
    assert len(set(found.values())) == 4


def test_no_two_of_many_colours_are_alike_and_none_is_the_selection_s() -> None:
    colours = np.array([SELECTED, *map(palette, range(40))])
    apart = np.abs(colours[:, None] - colours).sum(axis=2) + 1000 * np.eye(len(colours))
    assert apart.min() > 8
    assert apart[0].min() > 120


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[st.floats(-80, 80)] * 3), st.tuples(*[st.floats(-80, 80)] * 3), st.integers(0, 23))
def test_turns_lead_to_the_angles_that_were_asked_for(
    first: tuple[float, float, float], second: tuple[float, float, float], seed: int
) -> None:
    frame = Rotation.from_euler("zyx", np.random.default_rng(seed).integers(0, 4, 3) * 90.0, degrees=True).as_matrix()
    axes = Rotation.from_euler("xyz", np.array(first) / 4, degrees=True).as_matrix()
    state = state_of({"a": Cuboid(np.zeros(3), axes, np.array([0.1, 0.2, 0.3]))})
    state = replace(state, similarity=Similarity(1.0, frame, np.zeros(3)))
    for axis, angle in turns(state, state.cage["a"], second):
        state = do(state, Rotate(part="a", axis=axis, angle=angle))
    np.testing.assert_allclose(angles_of(state, state.cage["a"]), second, atol=0.01)


def test_a_cuboid_along_the_axes_has_no_angles() -> None:
    assert not angles_of(stool(), stool().cage["seat"]).any()


def test_every_number_of_a_program_has_one_plain_name_under_its_part() -> None:
    state = chair()
    values = parameters(programs.CHAIR)
    groups = grouped(state.structure, values)
    found = [parameter for numbers in groups.values() for parameter in numbers.values()]
    assert sorted(found) == sorted(values)
    assert {"width", "height", "depth"} <= groups["seat"].keys()
    assert groups["seat"]["height"].endswith(".seat.y")
    assert plain("attach2.x1") == "attachment 2: x on itself"
    assert not any("Program" in name or "." in name for numbers in groups.values() for name in numbers)


def test_each_key_does_one_thing_and_stands_in_the_card() -> None:
    keys = [str(key) for action in KEYS.values() for key in action]
    assert len(set(keys)) == len(keys)
    assert all(f"{key}" in card() for key in keys)


def test_no_key_flies_the_camera_too() -> None:
    assert not {key.key for action in KEYS.values() for key in action} & {*CAMERA_KEYS}


def test_runs_are_called_by_what_tells_them_apart(tmp_path: Path) -> None:
    chairs, tables = tmp_path / "runs/chair/cagesdf", tmp_path / "runs/table/cagesdf"
    assert named([chairs]) == {"cagesdf": chairs}
    assert named([chairs, tables]) == {"chair/cagesdf": chairs, "table/cagesdf": tables}
    with pytest.raises(InputError, match="twice"):
        named([chairs, chairs])
