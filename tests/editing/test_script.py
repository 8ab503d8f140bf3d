"""Scripts: read back as they were written, refused with the place of what is wrong."""

import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, TypeAdapter, ValidationError

from cagesdf.editing.script import (
    KINDS,
    MAX_CHARACTERS,
    MAX_OPERATIONS,
    MAX_PATTERN,
    Blend,
    Build,
    Mix,
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
    refusing,
)
from cagesdf.errors import InputError

ROOT = Path(__file__).parents[2]
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
    st.builds(
        Mix, part=words, style_of=words, weight=st.floats(0, 1), mirror=st.booleans(), **{"from": st.none() | words}
    ),
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
    [mix] = parse('[{"op": "mix", "part": "leg_*", "style_of": "chair_0007", "from": "leg", "weight": 1}]')
    assert mix == Mix.model_validate({"part": "leg_*", "style_of": "chair_0007", "from": "leg"})


def test_the_words_of_saved_scripts_are_still_there() -> None:
    assert set(KINDS) >= {
        "move", "resize", "rotate", "duplicate", "delete", "split", "scale", "set", "swap", "blend", "mix", "style",
        "build", "harmonise", "undo", "redo", "add",
    }  # fmt: skip


@pytest.mark.parametrize("word", KINDS)
def test_the_word_of_an_operation_is_the_name_of_its_class_in_small_letters(word: str) -> None:
    """By its class's name a refusal finds the operation, so that methods of the API speak as scripts do."""
    assert word == KINDS[word].__name__.lower()


def test_every_operation_has_a_row_of_the_documentation_with_its_fields() -> None:
    rows = (ROOT / "docs" / "editing.md").read_text(encoding="utf-8").splitlines()
    for word, kind in KINDS.items():
        row = next((line for line in rows if re.match(rf"\| (`\w+`, )*`{word}`[ ,]", line)), None)
        assert row is not None, f"docs/editing.md: wanted a row for {word}"
        fields = {field.alias or name for name, field in kind.model_fields.items() if name != "op"}
        assert fields <= {*re.findall(r"`(\w+)`", row.split(" | ")[1])}, f"docs/editing.md: wanted all fields of {word}"


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
        ({"op": "mix", "part": "leg", "style_of": "a", "weight": -0.1}, "weight is -0.1; wanted a number from 0 to 1"),
        ({"op": "mix", "part": "leg", "style_of": "a", "weight": float("nan")}, "weight is nan"),
        ({"op": "mix", "part": "leg"}, "style_of is missing; it has part, style_of, from, weight, mirror, repeat"),
        ({"op": "mix", "part": "leg", "style_of": "a", "from": 3}, "from is 3; wanted the name of the other"),
        ({"op": "mix", "part": "leg", "style_of": "a", "source": "leg"}, "source is not known; it has part, style_of"),
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


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "script: is empty; wanted a list"),
        (" \r\n", "script: is empty; wanted a list"),
        ('{"op": "undo"}', "script: got {'op': 'undo'}; wanted a list"),
        ('[["move"]]', "script: operation 0: got ['move']; wanted"),
        ('[{"op": "undo"},]', "script: is no JSON: trailing comma at line 1"),
        ('[{"op": "undo", "op": "redo"}]', "script: operation 0: 'op' is given twice"),
        (
            '[{"op": "undo"}, {"op": "swap", "style_of": "a", "style_of": "b"}]',
            "operation 1: 'style_of' is given twice",
        ),
        ('[{"op": "undo", "op": [[[9]]], "op": "undo"}]', "script: operation 0: 'op' is given twice"),
        ('[{"op": "swap", "style_of": 1' + "9" * 5000 + ', "style_of": "a"}]', "script: "),
        ('[{"op": "swap", "style_of": "\\ud800"}]', "script: "),
        ('[{"op": "swap", "style_of": "\ud800"}]', "script: "),
        ('[{"op": "undo", "' + "x" * 5000 + '\\n": 1}]', "is not known; it has nothing else"),
        ('[{"op": "rotate", "part": "a", "axis": "x", "angle": NaN}]', "rotate: angle is nan; wanted degrees"),
        ('[{"op": "move", "part": "a", "by": [0, 0, 1e999]}]', "move: by.2 is inf; wanted three numbers [x, y, z]"),
        ('[{"op": "resize", "part": "a", "axis": "Y", "factor": 1}]', "resize: axis is 'Y'; wanted x, y or z"),
        ('[{"op": "build", "structure": "{}", "frame": [1, 2]}]', "build: frame is [1, 2]; wanted 13 finite numbers"),
        ('[{"op": "build", "structure": "' + "x" * 200_001 + '"}]', "wanted a structure as JSON text, at most 200,000"),
    ],
    ids=range(17),
)
def test_what_is_wrong_is_said_in_one_line_with_its_place(text: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        parse(text)
    assert said in str(error.value)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 600


@pytest.mark.parametrize("kind", KINDS.values())
def test_every_field_says_what_it_wants(kind: type[BaseModel]) -> None:
    assert all(field.description for name, field in kind.model_fields.items() if name != "op")


def test_an_operation_of_numbers_that_can_not_be_is_refused_in_the_same_words() -> None:
    with pytest.raises(InputError, match=r"^resize: factor is 1000\.0; wanted a number from 0\.01 to 100$"), refusing():
        Resize(part="leg", axis="x", factor=1000.0)
    with pytest.raises(ValidationError), refusing():
        TypeAdapter(int).validate_python("x")


def test_a_frame_may_lie_anywhere_and_have_any_unit() -> None:
    frame = (1.4e-7, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, -7.5e6, 3.1e8, -580.0)
    script = (Build(structure="{}", frame=frame), Move(part="leg", by=(1e9, 0.0, 0.0)))
    assert parse(dump(script)) == script


def test_scripts_are_bounded() -> None:
    with pytest.raises(InputError, match="1,001 operations; wanted a list of at most 1,000"):
        parse(json.dumps([{"op": "undo"}] * (MAX_OPERATIONS + 1)))
    with pytest.raises(InputError, match="at most 1,000,000"):
        parse(" " * (MAX_CHARACTERS + 1))
    assert len(parse(json.dumps([{"op": "undo"}] * MAX_OPERATIONS))) == MAX_OPERATIONS
