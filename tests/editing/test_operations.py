"""What operations do, in laws: what undoes what, what commutes, what stays as it was."""

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.editing.links import Motion, repeats
from cagesdf.editing.operations import edited
from cagesdf.editing.parts import parameters, part_names
from cagesdf.editing.script import (
    Blend,
    Build,
    Harmonise,
    Mix,
    Move,
    Operation,
    Redo,
    Resize,
    Rotate,
    Scale,
    Set,
    Style,
    Swap,
    Undo,
    parse,
)
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.structure.executor import execute_nodes
from cagesdf.structure.hierarchy import Node, PartHierarchy
from cagesdf.structure.relations import Adjacency, Translation
from cagesdf.structure.relations import Rotation as Turned
from tests.support import programs
from tests.support.mirrored import LATENTS, STYLES, Z_UP, chair, do, is_mirrored, jug, turned


def same(a: State, b: State) -> None:
    np.testing.assert_allclose(a.cage.vectors(), b.cage.vectors(), atol=1e-11)


frames = st.sampled_from(["shape", "cuboid"])
axes = st.sampled_from("xyz")
lengths = st.floats(-0.8, 0.8)
vectors = st.tuples(lengths, lengths, lengths)
factors = st.floats(0.6, 1.6)
OF_PARTS = st.one_of(
    st.builds(Move, part=st.just("handle_1"), by=vectors, frame=frames),
    st.builds(
        Resize,
        part=st.just("handle_1"),
        axis=axes,
        factor=factors,
        frame=frames,
        keep=st.sampled_from(["low", "centre", "high"]),
    ),
    st.builds(Rotate, part=st.just("handle_1"), axis=axes, angle=st.floats(-180, 180), frame=frames),
)


@settings(max_examples=20)
@given(vectors, frames, st.booleans())
def test_moving_there_and_back_changes_nothing(by: tuple, frame: Any, mirror: bool) -> None:
    back = tuple(-way for way in by)
    for state, part in ((chair(), "*"), (chair(), "leg*"), (jug(), "handle_2")):
        there = Move(part=part, by=by, frame=frame, mirror=mirror)
        same(do(state, there, Move(part=part, by=back, frame=frame, mirror=mirror)), state)


@settings(max_examples=20)
@given(axes, factors, st.sampled_from(["low", "centre", "high"]), st.floats(-180, 180))
def test_stretching_and_turning_are_undone_by_their_inverse(axis: Any, factor: float, keep: Any, angle: float) -> None:
    for state, part in ((chair(), "seat"), (jug(), "handle_1")):
        there = Resize(part=part, axis=axis, factor=factor, keep=keep)
        same(do(state, there, Resize(part=part, axis=axis, factor=1 / factor, keep=keep)), state)
        turn = Rotate(part=part, axis=axis, angle=angle)
        same(do(state, turn, Rotate(part=part, axis=axis, angle=-angle)), state)


@settings(max_examples=20)
@given(st.tuples(factors, factors, factors), st.tuples(factors, factors, factors))
def test_scaling_an_upright_cage_commutes_and_composes(first: tuple, second: tuple) -> None:
    state = chair()
    upright = state.with_cage(replace(state.cage, axes=np.tile(np.eye(3), (len(state.cage), 1, 1))))
    both = Scale(factors=tuple(a * b for a, b in zip(first, second)))
    forth = do(upright, Scale(factors=first), Scale(factors=second))
    same(forth, do(upright, Scale(factors=second), Scale(factors=first)))
    same(forth, do(upright, both))


@settings(max_examples=20)
@given(factors, vectors)
def test_scaling_alike_commutes_with_what_is_done_to_parts(factor: float, by: tuple) -> None:
    scale = Scale(factors=(factor, factor, factor))
    further = Move(part="leg*", by=tuple(factor * way for way in by))
    same(do(chair(), Move(part="leg*", by=by), scale), do(chair(), scale, further))
    turn = Rotate(part="arm", axis="y", angle=30)
    same(do(chair(), turn, scale), do(chair(), scale, turn))
    whole = Set(parameter="Chair.Base.y", value=0.6)
    same(do(chair(), whole, scale), do(chair(), scale, whole))


@settings(max_examples=20)
@given(st.lists(OF_PARTS, max_size=4).map(tuple))
def test_a_mirrored_pair_stays_mirrored_whatever_is_done_to_one(script: tuple) -> None:
    state = do(jug(), *script)
    is_mirrored(state, "2", "3")
    assert np.array_equal(state.cage["1"].centre, jug().cage["1"].centre)
    both = parse(f"[{','.join(operation.model_dump_json() for operation in script)}]".replace("handle_1", "handle_2"))
    is_mirrored(do(jug(), *both), "2", "3")


def test_mirrored_parts_of_a_program_follow_in_every_block() -> None:
    state = do(chair(), Move(part="Base/Side/leg", by=(0.3, 0.2, 0.1)), Rotate(part="arm_1", axis="y", angle=20))
    for a, b in (("Base/Side/leg", "Base/cube1/leg"), ("arm", "cube4")):
        assert not np.allclose(Cage.of({a: state.cage[a]}).corners(), Cage.of({a: chair().cage[a]}).corners())
        is_mirrored(state, a, b)
    for untouched in ("seat", "back", "Base/Side/bar"):
        assert np.array_equal(state.cage[untouched].centre, chair().cage[untouched].centre)


def test_a_mirrored_part_is_left_alone_if_the_script_says_so_and_named_parts_do_as_they_are_told() -> None:
    alone = do(jug(), Move(part="handle_1", by=(1, 0, 0), mirror=False))
    assert np.array_equal(alone.cage["3"].centre, jug().cage["3"].centre)
    both = do(jug(), Move(part="handle", by=(1, 0, 0)))
    for part in ("2", "3"):
        np.testing.assert_allclose(both.cage[part].centre - jug().cage[part].centre, [0.1, 0, 0], atol=1e-12)


def raw_corners(state: State, part: str) -> np.ndarray:
    return state.similarity.to_raw(Cage.of({part: state.cage[part]}).corners()[0])


def test_operations_speak_of_the_users_axes_and_unit() -> None:
    state, seat = chair(), "seat"
    before = raw_corners(state, seat)
    moved = raw_corners(do(state, Move(part=seat, by=(0.1, 0.2, 0.3))), seat)
    np.testing.assert_allclose(moved - before, np.tile([0.1, 0.2, 0.3], (8, 1)), atol=1e-12)
    axis_names: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
    ends: tuple[tuple[Literal["low", "high"], Any], ...] = (("low", np.min), ("high", np.max))
    for k, axis in enumerate(axis_names):
        for frame in ("shape", "cuboid"):
            for keep, end in ends:
                wide = raw_corners(do(state, Resize(part=seat, axis=axis, factor=1.5, keep=keep, frame=frame)), seat)
                wanted = np.ones(3)
                wanted[k] = 1.5
                np.testing.assert_allclose(np.ptp(wide, axis=0), np.ptp(before, axis=0) * wanted, atol=1e-12)
                np.testing.assert_allclose(end(wide, axis=0)[k], end(before, axis=0)[k], atol=1e-12)
    # A quarter turn about z takes the user's x to y.
    quarter = raw_corners(do(state, Rotate(part=seat, axis="z", angle=90)), seat)
    np.testing.assert_allclose(np.ptp(quarter, axis=0), np.ptp(before, axis=0)[[1, 0, 2]], atol=1e-12)
    leaning = raw_corners(do(state, Rotate(part=seat, axis="z", angle=10, frame="shape")), seat)
    middle = before.mean(axis=0)
    c, s = np.cos(np.deg2rad(10)), np.sin(np.deg2rad(10))
    wanted = (before - middle) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + middle
    np.testing.assert_allclose(leaning, wanted, atol=1e-12)


def test_a_group_is_turned_and_stretched_as_one_in_the_shapes_frame() -> None:
    state = chair()
    parts = [part for part, name in part_names(state.structure).items() if name.startswith("leg")]
    before = np.array([raw_corners(state, part) for part in parts])
    wide = do(state, Resize(part="leg_*", axis="x", factor=2, frame="shape", keep="low"))
    after = np.array([raw_corners(wide, part) for part in parts])
    low = before[..., 0].min()
    np.testing.assert_allclose(after[..., 0].mean(1), low + 2 * (before[..., 0].mean(1) - low), atol=1e-9)
    half = do(state, Rotate(part="leg_*", axis="z", angle=180, frame="shape"))
    centre = (before.min(axis=(0, 1)) + before.max(axis=(0, 1))) / 2
    for part, corners in zip(parts, before):
        np.testing.assert_allclose(
            raw_corners(half, part).mean(0)[:2], 2 * centre[:2] - corners.mean(0)[:2], atol=1e-12
        )


def gap(nodes: Cage, a: str, b: str) -> float:
    """Between two cuboids, as a lattice of points finds it; 0 or less where they meet."""
    lattice = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 9)] * 3), axis=-1).reshape(-1, 3)
    points = nodes.from_unit(lattice, nodes.part_ids.index(a))
    return float(nodes.signed_distance(points)[:, nodes.part_ids.index(b)].min())


@settings(max_examples=40)
@given(st.sampled_from(sorted(parameters(programs.CHAIR))), st.floats(0.85, 1.15))
def test_what_is_attached_stays_attached_when_the_program_changes(name: str, factor: float) -> None:
    state = chair()
    value = parameters(programs.CHAIR)[name] * factor
    placed = do(state, Set(parameter=name, value=value)).structure.placed_program()
    assert placed is not None
    assert parameters(placed[0])[name] == value
    before, after = execute_nodes(programs.CHAIR), execute_nodes(placed[0])
    for relation in state.structure.relations():
        if isinstance(relation, Adjacency) and gap(before, relation.a, relation.b) <= 1e-9:
            assert gap(after, relation.a, relation.b) <= 1e-9, relation


def test_a_lower_base_takes_all_above_it_along_and_repeated_parts_follow() -> None:
    state = chair()
    low = do(state, Set(parameter="Chair.Base.y", value=0.3))
    drop = 0.9 * (0.45 - 0.3)
    np.testing.assert_allclose(low.cage["seat"].centre - state.cage["seat"].centre, [0, -drop, 0], atol=1e-9)
    for leg in ("Base/Side/leg", "Base/cube1/leg", "Base/Side/cube2", "Base/Side/cube3"):
        assert low.cage[leg].size[1] == pytest.approx(state.cage[leg].size[1] * 0.3 / 0.45)
    np.testing.assert_allclose(low.cage.vectors(), low.structure.cage().vectors(), atol=1e-12)


def test_what_was_moved_by_hand_stays_moved_when_the_program_changes_and_the_rest_to_the_last_bit() -> None:
    state = do(chair(), Move(part="seat", by=(0.5, 0, 0), mirror=False))
    low = do(state, Set(parameter="Chair.Base.y", value=0.3))
    np.testing.assert_allclose(low.cage["seat"].centre - state.cage["seat"].centre, [0, -0.135, 0], atol=1e-9)
    wider = do(state, Set(parameter="Chair.arm.y", value=0.06))
    for part in ("seat", "back", "Base/Side/leg"):
        assert (wider.cage[part].axes == state.cage[part].axes).all()
        assert (wider.cage[part].centre == state.cage[part].centre).all()
        assert (wider.cage[part].size == state.cage[part].size).all()


def test_styles_are_swapped_and_blended_and_leave_the_cage_alone() -> None:
    state = chair()
    swapped = do(state, Swap(style_of="b"))
    assert swapped.cage is state.cage
    assert np.array_equal(swapped.latent, LATENTS["b"])
    for weight, latent in ((0.0, LATENTS["a"]), (1.0, LATENTS["b"]), (0.25, 0.75 * LATENTS["a"] + 0.25 * LATENTS["b"])):
        blended = do(state, Blend(style_of="b", weight=weight))
        assert blended.cage is state.cage
        assert blended.latent.dtype == np.float32
        np.testing.assert_allclose(blended.latent, latent)


def test_undo_and_redo_restore_the_very_states() -> None:
    state = chair()
    script = (Move(part="seat", by=(0.1, 0, 0)), Swap(style_of="b"), Undo(), Undo(), Redo())
    states = [edited(state, script[:i], STYLES) for i in range(len(script) + 1)]
    assert states[4].present is state
    assert states[5].future[0].latent is LATENTS["b"]
    np.testing.assert_array_equal(states[5].present.cage.vectors(), states[1].present.cage.vectors())
    history = states[2]
    assert history.undone().redone().present is history.present
    forgotten = edited(state, (*script[:3], Swap(style_of="b")), STYLES)
    assert not forgotten.future


@pytest.mark.parametrize(
    ("operation", "said"),
    [
        (Undo(), "nothing to take back"),
        (Redo(), "nothing was taken back"),
        (Move(part="log", by=(0, 0, 0)), "wanted one of seat"),
        (Move(part="seat", by=(1e6, 0, 0)), "takes seat"),
        (Move(part="seat", by=(0, 0, 100)), "wanted at most 20"),
        (Resize(part="seat", axis="z", factor=0.01), "leaves seat 0.0045 thin; wanted 0.01 or more"),
        (Swap(style_of="c"), "style_of 'c': none of the 2 styles"),
        (Blend(style_of="c", weight=0.5), "style_of 'c'"),
        (Mix(part="wing", style_of="b"), "part 'wing': no part is called so; wanted one of seat"),
        (Mix(part="seat", style_of="c"), "style_of 'c': none of the 2 styles"),
        (
            Mix.model_validate({"part": "seat", "style_of": "b", "from": "wing"}),
            "part 'wing': no part is called so; wanted one of seat",
        ),
        (Set(parameter="Chair.seet.y", value=1), "did you mean Chair.seat.y"),
        (Set(parameter="Chair.seat.y", value=-1), "positive"),
        (Set(parameter="Chair.seat.y", value=1e6), "away"),
    ],
)
def test_what_can_not_be_done_is_refused_with_its_place(operation: Operation, said: str) -> None:
    script = (Swap(style_of="b"), operation) if not isinstance(operation, Undo) else (operation,)
    with pytest.raises(InputError) as error:
        edited(chair(), script, STYLES)
    assert str(error.value).startswith(f"script: operation {len(script) - 1}: {operation.op}: ")
    assert said in str(error.value)


def test_cuboids_without_a_program_have_no_parameters() -> None:
    with pytest.raises(InputError, match="no program"):
        do(jug(), Set(parameter="jug.x", value=1))


def test_parts_are_called_by_label_numbered_where_several_share_it_or_by_id() -> None:
    names = part_names(chair().structure)
    assert names["seat"] == "seat"
    assert [names["Base/Side/leg"], names["Base/cube1/leg"], names["back"]] == ["leg_1", "leg_2", "back"]
    assert part_names(jug().structure) == {"1": "body", "2": "handle_1", "3": "handle_2"}


def test_parameters_have_a_name_each() -> None:
    named = parameters(programs.CHAIR)
    inner = 6  # lengths of the bboxes of Base and Side
    assert len(named) == len(programs.CHAIR.parameters()) - inner
    assert set(named.values()) == set(programs.CHAIR.parameters())
    assert named["Chair.bbox.y"] == 1.0
    assert named["Chair.back.attach2.z2"] == 0.02
    assert named["Side.leg.squeeze1.v"] == 0.05
    assert named["Side.leg.translate1.span"] == 0.9


def rail(relation: Translation | Turned) -> State:
    """Two bars, the second one made of the first."""
    first = Cuboid(np.array([0.1, 0.2, 0.0]), turned(10), np.array([0.1, 0.5, 0.05]))
    match relation:
        case Translation(offset=offset):
            second = replace(first, centre=first.centre + offset)
        case Turned(pivot=pivot, axis=axis, angle=angle):
            turn = Rotation.from_rotvec(angle * np.array(axis)).as_matrix()
            second = Cuboid(turn @ (first.centre - pivot) + pivot, first.axes @ turn.T, first.size)
    leaves = tuple(Node(name, "bar", (), (), None) for name in ("1", "2"))
    structure = PartHierarchy(Node("0", "rail", leaves, (relation,), None))
    return State.opened(Cage.of({"1": first, "2": second}), structure, LATENTS["b"], Z_UP)


REPEATS = (
    Translation("1", "2", (0.3, 0.0, 0.1)),
    Turned("1", "2", (0.0, 0.1, 0.0), (0.0, 1.0, 0.0), 2 * np.pi / 3),
)


@pytest.mark.parametrize("relation", REPEATS)
@pytest.mark.parametrize("part", ["1", "2"])
def test_repeated_parts_stay_repeated_if_the_script_says_so(relation: Translation | Turned, part: str) -> None:
    changes = (
        Move(part=part, by=(0.3, 0.2, -0.4), frame="cuboid", repeat=True),
        Resize(part=part, axis="y", factor=1.2, keep="low", repeat=True),
        Rotate(part=part, axis="z", angle=15, repeat=True),
    )
    state = do(rail(relation), *changes)
    motion = next(iter(repeats(state)["1"].values()))
    assert isinstance(motion, Motion)
    np.testing.assert_allclose(state.cage["2"].centre, motion(state.cage["1"].centre), atol=1e-12)
    np.testing.assert_allclose(state.cage["2"].size, state.cage["1"].size)
    np.testing.assert_allclose(state.cage["2"].axes, state.cage["1"].axes @ motion.rotation.T, atol=1e-12)
    alone = do(rail(relation), replace_repeat(changes[0]))
    other = "2" if part == "1" else "1"
    np.testing.assert_array_equal(alone.cage[other].centre, rail(relation).cage[other].centre)


def replace_repeat(operation: Move) -> Move:
    return operation.model_copy(update={"repeat": False})


def test_several_parts_are_named_with_a_bar() -> None:
    by = (0.1, 0.0, 0.2)
    together = do(chair(), Move(part="seat|arm_1", by=by, mirror=False))
    same(together, do(chair(), Move(part="seat", by=by, mirror=False), Move(part="arm_1", by=by, mirror=False)))
    with pytest.raises(InputError, match="'wing': no part"):
        do(chair(), Move(part="seat|wing", by=by))


def test_a_style_is_taken_by_its_code() -> None:
    same(do(chair(), Style(code=(2.0, -1.0))), do(chair(), Swap(style_of="b")))
    with pytest.raises(InputError, match="3 numbers"):
        do(chair(), Style(code=(0.0, 0.0, 0.0)))


@pytest.mark.parametrize(
    "operation",
    [
        Move(part="leg", by=(1.0, 0.0, 0.0)),
        Resize(part="seat", axis="x", factor=1.3),
        Rotate(part="seat", axis="z", angle=20.0),
        Scale(factors=(1.2, 0.9, 1.0)),
        Swap(style_of="b"),
    ],
    ids=lambda operation: operation.op,
)
def test_parts_look_as_in_the_cage_that_was_opened_until_it_is_harmonised(
    operation: Operation,
) -> None:
    """By identity: codes that are made once serve for as long as nothing else is seen."""
    opened = chair()
    edited_state = do(opened, operation)
    assert edited_state.seen is opened.seen is opened.cage
    harmonised = do(opened, operation, Harmonise())
    assert harmonised.seen is harmonised.cage
    np.testing.assert_array_equal(harmonised.cage.vectors(), edited_state.cage.vectors())
    np.testing.assert_array_equal(harmonised.latent, edited_state.latent)


def test_a_number_of_the_program_changes_cuboids_and_not_what_is_seen() -> None:
    opened = chair()
    placed = opened.structure.placed_program()
    assert placed is not None
    numbers = parameters(placed[0])
    state = do(opened, Set(parameter="Chair.seat.x", value=numbers["Chair.seat.x"] * 0.9))
    assert state.seen is opened.seen
    assert not np.array_equal(state.cage.vectors(), opened.cage.vectors())


def test_harmonising_is_taken_back_and_done_again_and_later_moves_keep_what_it_saw() -> None:
    opened, move = chair(), Move(part="leg", by=(1.0, 0.0, 0.0))
    assert do(opened, move, Harmonise(), Undo()).seen is opened.seen
    again = do(opened, move, Harmonise(), Undo(), Redo())
    np.testing.assert_array_equal(again.seen.vectors(), do(opened, move).cage.vectors())
    later = do(opened, move, Harmonise(), move)
    np.testing.assert_array_equal(later.seen.vectors(), again.cage.vectors())
    assert not np.array_equal(later.cage.vectors(), later.seen.vectors())


def test_another_structure_is_seen_in_its_own_cuboids() -> None:
    state = do(jug(), Move(part="body", by=(1.0, 0.0, 0.0)), Build(structure=chair().structure.to_json()))
    assert state.seen is state.cage
    assert state.seen.part_ids == chair().cage.part_ids


def test_another_structure_stands_in_its_own_cuboids_and_keeps_the_style() -> None:
    other = rail(REPEATS[0])
    tree = other.structure.with_cuboids(other.cage.cuboids())
    state = do(chair(), Swap(style_of="b"), Build(structure=tree.to_json()))
    np.testing.assert_allclose(state.cage.vectors(), other.cage.vectors(), atol=1e-12)
    np.testing.assert_array_equal(state.latent, LATENTS["b"])
    np.testing.assert_array_equal(state.similarity.to_raw(np.eye(3)), np.eye(3))
    program = chair().structure
    np.testing.assert_allclose(do(jug(), Build(structure=program.to_json())).cage.vectors(), chair().cage.vectors())


def test_what_is_built_has_the_frame_of_its_files() -> None:
    text = chair().structure.to_json()
    frame = Similarity(0.01, Rotation.from_euler("x", -90, degrees=True).as_matrix(), np.array([0.1, -0.2, 0.3]))
    state = do(chair(), Build(structure=text, frame=tuple(frame.to_numbers())))
    assert state.similarity.to_numbers() == frame.to_numbers()
    moved = do(chair(), Build(structure=text, frame=tuple(frame.to_numbers())), Move(part="*", by=(0.0, 0.0, 20.0)))
    np.testing.assert_allclose(moved.cage.centre - state.cage.centre, [[0.0, 0.2, 0.0]] * len(state.cage), atol=1e-12)


@pytest.mark.parametrize(
    "frame",
    [
        [0.0, *np.eye(3).ravel(), 0.0, 0.0, 0.0],
        [-1.0, *np.eye(3).ravel(), 0.0, 0.0, 0.0],
        [1.0, *(2 * np.eye(3)).ravel(), 0.0, 0.0, 0.0],
        [1.0, *np.diag([1.0, 1.0, -1.0]).ravel(), 0.0, 0.0, 0.0],
    ],
)
def test_a_frame_that_is_no_similarity_is_refused(frame: list[float]) -> None:
    with pytest.raises(InputError, match=r"proper rotation|a scale above 0"):
        do(chair(), Build(structure=chair().structure.to_json(), frame=tuple(frame)))


@pytest.mark.parametrize("text", ["{", "[1]", '{"program": 3}', "[" * 100_000, rail(REPEATS[0]).structure.to_json()])
def test_what_is_no_structure_with_cuboids_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="structure"):
        do(chair(), Build(structure=text))
