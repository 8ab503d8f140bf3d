"""Scripts: read back as they were written, refused with the place of what is wrong."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cagesdf.editing.script import (
    KINDS,
    MAX_CHARACTERS,
    MAX_OPERATIONS,
    MAX_PATTERN,
    Blend,
    Move,
    Redo,
    Resize,
    Rotate,
    Scale,
    Set,
    Swap,
    Undo,
    dump,
    parse,
)
from cagesdf.errors import InputError

numbers = st.floats(-1e6, 1e6, allow_nan=False)
factors = st.floats(0.01, 100, allow_nan=False)
words = st.text(min_size=1, max_size=200)
axes = st.sampled_from("xyz")
frames = st.sampled_from(["shape", "cuboid"])
OPERATIONS = st.one_of(
    st.builds(Move, part=words, by=st.tuples(numbers, numbers, numbers), frame=frames, mirror=st.booleans()),
    st.builds(
        Resize,
        part=words,
        axis=axes,
        factor=factors,
        keep=st.sampled_from(["low", "centre", "high"]),
        frame=frames,
        mirror=st.booleans(),
    ),
    st.builds(Rotate, part=words, axis=axes, angle=numbers, frame=frames, mirror=st.booleans()),
    st.builds(Scale, factors=st.tuples(factors, factors, factors)),
    st.builds(Set, parameter=words, value=numbers),
    st.builds(Swap, style_of=words),
    st.builds(Blend, style_of=words, weight=st.floats(0, 1)),
    st.builds(Undo),
    st.builds(Redo),
)


@given(st.lists(OPERATIONS, max_size=5).map(tuple))
def test_a_script_is_read_back_as_it_was_written(script: tuple) -> None:
    assert parse(dump(script)) == script
    assert dump(parse(dump(script))) == dump(script)


def test_the_example_of_the_documentation_is_read() -> None:
    script = parse('[{"op":"resize","part":"leg_*","axis":"y","factor":1.3},{"op":"swap","style_of":"chair_0007"}]')
    assert script == (Resize(part="leg_*", axis="y", factor=1.3), Swap(style_of="chair_0007"))


def test_every_kind_of_operation_has_its_word() -> None:
    assert set(KINDS) == {"move", "resize", "rotate", "scale", "set", "swap", "blend", "style", "build", "undo", "redo"}


GOOD = {"op": "move", "part": "leg", "by": [0, 1, 2]}


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ({}, "one of move, resize"),
        (5, "got 5"),
        (None, "got None"),
        ([], "got []"),
        ({"op": "moove"}, "'moove'"),
        ({"op": ["move"]}, "one of move, resize"),
        ({"op": "move", "part": "leg"}, "by is missing"),
        ({**GOOD, "frme": "cuboid"}, "frme is not known; it has part, by, frame, mirror"),
        ({**GOOD, "frame": "world"}, "'world'"),
        ({**GOOD, "by": [0, 1]}, "by.2 is missing"),
        ({**GOOD, "by": [0, 1, 2, 3]}, "by"),
        ({**GOOD, "by": [0, 1, "2"]}, "'2'"),
        ({**GOOD, "by": [0, 1, True]}, "True"),
        ({**GOOD, "by": [0, 1, float("nan")]}, "nan"),
        ({**GOOD, "by": [0, 1, 1e300]}, "1e+300"),
        ({**GOOD, "mirror": "no"}, "'no'"),
        ({**GOOD, "part": ""}, "part"),
        ({**GOOD, "part": "x" * (MAX_PATTERN + 1)}, "part"),
        ({"op": "resize", "part": "leg", "axis": "w", "factor": 2}, "'w'"),
        ({"op": "resize", "part": "leg", "axis": "x", "factor": 0}, "factor"),
        ({"op": "resize", "part": "leg", "axis": "x", "factor": -1}, "factor"),
        ({"op": "scale", "factors": 2}, "factors"),
        ({"op": "blend", "style_of": "a", "weight": 1.5}, "weight"),
        ({"op": "undo", "times": 2}, "it has nothing else"),
    ],
)
def test_a_bad_entry_is_refused_with_its_place_and_what_was_wanted(bad: object, said: str) -> None:
    with pytest.raises(InputError) as error:
        parse(json.dumps([GOOD, GOOD, bad, GOOD]))
    assert str(error.value).startswith("script: operation 2: ")
    assert said in str(error.value)
    assert len(str(error.value)) < 600


@pytest.mark.parametrize("text", ["", "{", "5", "{}", "null", "[" * 100_000, '[{"op": "undo"}', "\x00"])
def test_what_is_no_list_of_operations_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="script: "):
        parse(text)


@given(st.recursive(st.none() | st.booleans() | numbers | words, lambda x: st.lists(x) | st.dictionaries(words, x)))
def test_no_json_whatever_crashes_it(value: object) -> None:
    try:
        parse(json.dumps([value, {"op": value}, {"op": "move", "by": value}]))
    except InputError:
        return
    pytest.fail("that is no script")


def test_scripts_are_bounded() -> None:
    with pytest.raises(InputError, match="1,001 operations; wanted a list of at most 1,000"):
        parse(json.dumps([{"op": "undo"}] * (MAX_OPERATIONS + 1)))
    with pytest.raises(InputError, match="at most 1,000,000"):
        parse(" " * (MAX_CHARACTERS + 1))
    assert len(parse(json.dumps([{"op": "undo"}] * MAX_OPERATIONS))) == MAX_OPERATIONS
