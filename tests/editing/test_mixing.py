"""Mixing by part, in laws: the codes of mixed parts, who follows, and that the rest stays the same to the last bit."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.deformation.matching import correspond
from cagesdf.editing.operations import apply, edited
from cagesdf.editing.script import (
    Blend,
    Build,
    Duplicate,
    Harmonise,
    Mix,
    Move,
    Operation,
    Resize,
    Style,
    Swap,
    Undo,
    dump,
    parse,
)
from cagesdf.editing.session import Session, state_field
from cagesdf.editing.state import History, State
from cagesdf.editing.styles import Styles, corresponding
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.models.codes import part_codes
from cagesdf.structure.hierarchy import Node, PartHierarchy
from cagesdf.structure.relations import Reflection, Translation
from tests.support.mixed import stool, with_shapes
from tests.support.untrained import untrained


@pytest.fixture(scope="module")
def session() -> Session:
    """Two chairs in one cage, two stools, and a network that was never trained."""
    return with_shapes(untrained(), two=stool({"p": -0.4, "q": 0.4}), three=stool({"u": -0.4, "v": 0.0, "w": 0.4}))


# By name, the parts of the chair that change with one: those that mirror or repeat it, with or without a label.
FOLLOWING = {
    "seat": {"seat"},
    "back": {"back"},
    "arm": {"arm", "cube4"},
    "leg": {f"Base/{side}/{part}" for side in ("Side", "cube1") for part in ("leg", "cube2", "cube3")},
}


def codes(session: Session, state: State) -> dict[str, bytes]:
    field = state_field(session.run, state)
    return {part: code.numpy().tobytes() for part, code in zip(state.cage.part_ids, field.codes)}


def do(session: Session, state: State, *script: Operation) -> State:
    return session.edited(state, script).present


def answers(session: Session, style_of: str, cage: Cage) -> dict[str, bytes]:
    """The codes of a latent in a cage."""
    found = part_codes(session.run.decoder, session.run.latent(style_of, 0), cage)
    return {part: code.numpy().tobytes() for part, code in zip(cage.part_ids, found)}


BEFORE = st.lists(
    st.sampled_from(
        [
            Move(part="arm_1", by=(0.05, 0.0, 0.02)),
            Swap(style_of="b"),
            Mix(part="seat", style_of="b", weight=0.3),
            Mix(part="leg_*", style_of="three"),
            Harmonise(),
        ]
    ),
    max_size=3,
)


@given(BEFORE, st.sampled_from(["seat", "leg_*", "arm|back", "*"]), st.sampled_from(["a", "b", "two", "three"]))
@settings(max_examples=20, deadline=None)
def test_a_weight_of_0_changes_nothing_and_one_of_1_forgets_what_was_there(
    session: Session, before: list[Operation], part: str, style_of: str
) -> None:
    state = do(session, session.opened("a"), *before)
    assert codes(session, do(session, state, Mix(part=part, style_of=style_of, weight=0.0))) == codes(session, state)
    arrived = Mix(part=part, style_of=style_of)
    detour = Mix(part=part, style_of="b", weight=0.6)
    assert codes(session, do(session, state, detour, arrived)) == codes(session, do(session, state, arrived))


@given(BEFORE, st.sampled_from(sorted(FOLLOWING)), st.floats(0.05, 1.0))
@settings(max_examples=20, deadline=None)
def test_codes_of_parts_that_are_not_mixed_stay_the_same_to_the_last_bit(
    session: Session, before: list[Operation], part: str, weight: float
) -> None:
    state = do(session, session.opened("a"), *before)
    mixed = do(session, state, Mix(part=part, style_of="two", weight=weight))
    one, other = codes(session, state), codes(session, mixed)
    assert {name for name in one if one[name] != other[name]} <= FOLLOWING[part]
    assert mixed.cage is state.cage
    assert mixed.latent is state.latent


def test_surfaces_of_parts_that_are_not_mixed_stay_the_same_and_are_not_asked_again(session: Session) -> None:
    state, live = session.opened("a"), session.live(32)
    before = live.surface(state)
    mixed = do(session, state, Mix(part="leg", style_of="b"))
    after, at_once = live.surface(mixed), session.live(32).surface(mixed)
    assert 0 < after.evaluations < at_once.evaluations
    changed = set()
    for part in state.cage.part_ids:
        one, other, again = (found.parts[part] for found in (before, after, at_once))
        assert again.vertices.tobytes() == other.vertices.tobytes()
        if one.vertices.tobytes() != other.vertices.tobytes() or one.faces.tobytes() != other.faces.tobytes():
            changed.add(part)
    assert changed == FOLLOWING["leg"]


@pytest.mark.parametrize("shape_id", ["a", "b", "two", "three"])
def test_all_parts_of_a_shape_in_its_own_cage_are_that_shape(session: Session, shape_id: str) -> None:
    opened = session.opened(shape_id)
    other = do(session, opened, Style(code=(9.0, -7.0, 5.0, 3.0)))
    assert codes(session, other) != codes(session, opened)
    assert codes(session, do(session, other, Mix(part="*", style_of=shape_id))) == codes(session, opened)


def test_all_parts_of_a_shape_with_the_same_cuboids_are_a_swap(session: Session) -> None:
    state, live = session.opened("a"), session.live(32)
    mixed, swapped = (
        live.surface(do(session, state, one)).mesh for one in (Mix(part="*", style_of="b"), Swap(style_of="b"))
    )
    assert mixed.vertices.tobytes() == swapped.vertices.tobytes()
    assert mixed.faces.tobytes() == swapped.faces.tobytes()


def test_a_weight_between_gives_a_code_between(session: Session) -> None:
    state = session.opened("a")
    row = state.cage.part_ids.index("seat")
    ends = [
        state_field(session.run, do(session, state, *script)).codes[row]
        for script in ((), (Mix(part="seat", style_of="b"),))
    ]
    for weight in (0.25, 0.7):
        mixed = do(session, state, Mix(part="seat", style_of="b", weight=weight))
        code = state_field(session.run, mixed).codes[row]
        torch.testing.assert_close(code, (1 - weight) * ends[0] + weight * ends[1])
    # Step by step as at once.
    twice = do(session, state, *[Mix(part="seat", style_of="b", weight=0.5)] * 2)
    torch.testing.assert_close(state_field(session.run, twice).codes[row], 0.25 * ends[0] + 0.75 * ends[1])


@given(st.permutations(["seat", "back", "arm", "leg"]), st.sampled_from(["b", "two", "three"]))
@settings(max_examples=10, deadline=None)
def test_parts_mixed_one_by_one_are_parts_mixed_at_once(session: Session, order: list[str], style_of: str) -> None:
    state = session.opened("a")
    one_by_one = do(session, state, *(Mix(part=part, style_of=style_of) for part in order))
    at_once = do(session, state, Mix(part="seat|back|arm|leg", style_of=style_of))
    assert codes(session, one_by_one) == codes(session, at_once)


def linked_bars(relation: Reflection | Translation) -> State:
    """Two bars of which the second follows from the first, and a third one that is free."""
    bars = {
        name: Cuboid(np.array([x, 0.0, 0.0]), np.eye(3), np.array([0.1, 0.5, 0.1]))
        for name, x in (("1", -0.3), ("2", 0.3), ("3", 0.0))
    }
    leaves = tuple(Node(name, "bar", (), (), None) for name in bars)
    structure = PartHierarchy(Node("0", "rail", leaves, (relation,), None))
    return State.opened(Cage.of(bars), structure, np.zeros(4, np.float32), Similarity(1.0, np.eye(3), np.zeros(3)))


@pytest.mark.parametrize(
    ("relation", "switch"),
    [
        (Reflection("1", "2", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), "mirror"),
        (Translation("1", "2", (0.6, 0.0, 0.0)), "repeat"),
    ],
)
@pytest.mark.parametrize("part", ["1", "2"])
def test_parts_that_mirror_or_repeat_mixed_ones_follow_unless_told_not_to(
    relation: Reflection | Translation, switch: str, part: str
) -> None:
    state = linked_bars(relation)
    other = replace(state, latent=np.ones(4, np.float32))
    styles = Styles({"other": other}, code_dim=6)
    followed = edited(state, (Mix(part=part, style_of="other"),), styles).present.part_styles
    # Each has the code of the part that corresponds to it.
    assert {name: step.part for name, [step] in followed.items()} == {"1": "1", "2": "2"}
    alone = Mix(part=part, style_of="other").model_copy(update={switch: False})
    assert [*edited(state, (alone,), styles).present.part_styles] == [part]


def test_parts_of_equal_structures_correspond_as_in_deformation_sequences(session: Session) -> None:
    one, other = session.opened("a"), session.opened("b")
    wanted = dict(correspond(one.structure, one.cage, other.structure, other.cage))
    assert corresponding(one, other, None) == wanted
    mixed = do(session, one, Mix(part="*", style_of="b"))
    theirs = answers(session, "b", other.cage)
    assert codes(session, mixed) == {part: theirs[partner] for part, partner in wanted.items()}


def test_parts_of_other_structures_correspond_by_label_and_place(session: Session) -> None:
    two, three = session.opened("two"), session.opened("three")
    assert corresponding(two, three, None) == {"p": "u", "q": "w", "top": "top"}
    assert corresponding(three, two, None)["v"] in ("p", "q")
    mixed = do(session, two, Mix(part="leg", style_of="three"))
    theirs, ours = answers(session, "three", three.cage), codes(session, two)
    assert codes(session, mixed) == {"p": theirs["u"], "q": theirs["w"], "top": ours["top"]}


def test_from_says_which_parts_of_the_other_shape_are_taken(session: Session) -> None:
    two, three = session.opened("two"), session.opened("three")
    theirs = answers(session, "three", three.cage)
    for pattern, wanted in (("leg_2", ("v", "v")), ("u|v", ("u", "v")), ("leg", ("u", "w")), ("seat", ("top", "top"))):
        mixed = do(session, two, Mix.model_validate({"part": "leg", "style_of": "three", "from": pattern}))
        assert tuple(codes(session, mixed)[part] for part in "pq") == tuple(theirs[part] for part in wanted)
    # Between equal structures, too, where the part that corresponds is not among them.
    other = do(session, session.opened("a"), Mix.model_validate({"part": "arm", "style_of": "b", "from": "seat"}))
    assert codes(session, other)["arm"] == answers(session, "b", session.opened("b").cage)["seat"]


def test_a_part_without_a_partner_gets_the_networks_answer_for_the_style_in_this_cage(session: Session) -> None:
    state = do(session, session.opened("a"), Resize(part="back", axis="x", factor=1.2))
    assert "back" not in corresponding(state, session.opened("two"), None)
    mixed = do(session, state, Mix(part="back", style_of="two"))
    assert codes(session, mixed)["back"] == answers(session, "two", session.opened("a").cage)["back"]
    # Harmonised, all answers are those of the cage as it is; codes of other shapes' parts stay.
    both = do(session, mixed, Mix(part="leg_1", style_of="two", mirror=False, repeat=False), Harmonise())
    assert codes(session, both)["back"] == answers(session, "two", state.cage)["back"]
    assert codes(session, both)["Base/Side/leg"] in answers(session, "two", session.opened("two").cage).values()


def test_what_corresponds_does_not_depend_on_where_cuboids_were_moved_to(session: Session) -> None:
    state, other = session.opened("two"), session.opened("three")
    moved = do(session, state, Move(part="leg_1", by=(0.9, 0.0, 0.0)))
    assert corresponding(moved, other, None) == corresponding(state, other, None)


def test_mixed_parts_keep_their_style_when_that_of_the_shape_changes(session: Session) -> None:
    state = session.opened("a")
    mix = Mix(part="leg", style_of="two")
    mixed, swapped = do(session, state, mix, Swap(style_of="b")), do(session, state, Swap(style_of="b"))
    own = set(mixed.part_styles)
    one, other, first = (codes(session, each) for each in (mixed, swapped, do(session, state, mix)))
    assert {part: first[part] if part in own else other[part] for part in one} == one


def test_another_structure_has_nothing_mixed_in(session: Session) -> None:
    structure = session.run.structures["two"]
    assert isinstance(structure, PartHierarchy)
    script = (Mix(part="leg", style_of="b"), Build(structure=structure.to_json()))
    assert not do(session, session.opened("a"), *script).part_styles


def test_undo_brings_the_very_bytes_back_without_asking(session: Session) -> None:
    history, live = History.of(session.opened("a")), session.live(32)
    before = live.surface(history.present)
    mixed = apply(history, Mix(part="leg|seat", style_of="b", weight=0.8), session.styles)
    assert live.surface(mixed.present).mesh.vertices.tobytes() != before.mesh.vertices.tobytes()
    undone = apply(mixed, Undo(), session.styles)
    again = live.surface(undone.present)
    assert again.evaluations == 0
    assert again.mesh.vertices.tobytes() == before.mesh.vertices.tobytes()
    assert again.mesh.faces.tobytes() == before.mesh.faces.tobytes()


def test_a_script_with_a_mix_leads_to_the_same_after_it_was_written(session: Session) -> None:
    script = (
        Mix.model_validate({"part": "leg_*", "style_of": "three", "weight": 0.5, "from": "leg_1|leg_3"}),
        Move(part="seat", by=(0.0, 0.02, 0.0)),
        Mix(part="seat", style_of="b", mirror=False, repeat=False),
    )
    text = dump(script)
    assert '"from":"leg_1|leg_3"' in text
    assert parse(text) == script
    one, other = (do(session, session.opened("a"), *each) for each in (script, parse(text)))
    assert codes(session, one) == codes(session, other)


def test_an_arm_whose_parts_have_no_codes_refuses() -> None:
    session = untrained()
    styles = Styles(session.styles.shapes, code_dim=None)
    with pytest.raises(InputError, match=r"operation 0: mix: this arm has one style for the whole shape"):
        edited(session.opened("a"), (Mix(part="seat", style_of="b"),), styles)


RESIDUAL = (0.5, -0.25, 0.0, 1.0, 0.0, 2.0)


def codes_after(session: Session, *script: Operation) -> dict[str, np.ndarray]:
    """By part, the code that a script leads to."""
    state = session.edited(session.opened("a"), script).present
    return dict(zip(state.cage.part_ids, state_field(session.run, state).codes.numpy()))


def style(session: Session, **residuals: tuple[float, ...]) -> Style:
    return Style(code=tuple(session.opened("a").latent.tolist()), residuals=residuals or None)


def test_residuals_are_added_to_the_codes_of_the_parts_that_they_name_alone(session: Session) -> None:
    plain, given = codes_after(session), codes_after(session, *parse(dump([style(session, seat=RESIDUAL)])))
    for part in plain:
        np.testing.assert_array_equal(given[part], plain[part] + np.array(RESIDUAL, np.float32) * (part == "seat"))


def test_a_copy_has_its_original_s_residual_also_once_it_is_harmonised(session: Session) -> None:
    copy = Duplicate(part="seat", by=(0.0, 0.0, 1.0), mirror=False)
    for script in ([copy], [copy, Harmonise()]):
        plain, given = codes_after(session, *script), codes_after(session, style(session, seat=RESIDUAL), *script)
        changed = {part for part in plain if (plain[part] != given[part]).any()}
        assert changed == {"seat", *(plain.keys() - codes_after(session).keys())}


def test_residuals_fade_on_the_way_to_another_style(session: Session) -> None:
    begun = style(session, seat=RESIDUAL)
    for weight in (0.0, 0.5, 1.0):
        blend = Blend(style_of="b", weight=weight)
        left = codes_after(session, begun, blend)["seat"] - codes_after(session, blend)["seat"]
        np.testing.assert_allclose(left, (1 - weight) * np.array(RESIDUAL, np.float32), atol=1e-6)
    np.testing.assert_array_equal(
        codes_after(session, begun, Swap(style_of="b"))["seat"], codes_after(session, Swap(style_of="b"))["seat"]
    )


def test_parts_take_the_style_of_a_code_of_their_own_and_all_others_have_the_shape_s(session: Session) -> None:
    one, two = (tuple(session.opened(name).latent.tolist()) for name in ("a", "b"))
    mixed = Mix(part="back", style_of="b")
    given = codes_after(session, mixed, *parse(dump([Style(code=one, parts={"seat": two})])))
    plain, other = codes_after(session), codes_after(session, Swap(style_of="b"))
    for part in plain:
        np.testing.assert_array_equal(given[part], (other if part == "seat" else plain)[part])
    kept = codes_after(session, mixed, Style(code=one))
    assert (kept["back"] != plain["back"]).any(), "what was mixed stays where nothing is said of parts"
    for part in plain:
        np.testing.assert_array_equal(codes_after(session, mixed, Style(code=one, parts={}))[part], plain[part])


def test_codes_of_parts_of_another_length_are_refused(session: Session) -> None:
    code = tuple(session.opened("a").latent.tolist())
    with pytest.raises(InputError, match="parts: seat: 2 numbers; this run's codes have 4"):
        codes_after(session, Style(code=code, parts={"seat": (1.0, 2.0)}))


def test_residuals_of_another_length_are_refused(session: Session) -> None:
    with pytest.raises(InputError, match="residuals: seat: 2 numbers; wanted 6"):
        codes_after(session, style(session, seat=(1.0, 2.0)))
