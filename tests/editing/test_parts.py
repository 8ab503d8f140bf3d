"""Names of parts: each is one part's alone, in any collection, and stays it."""

import unicodedata
from collections import Counter

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cagesdf.editing.parts import MAX_NAME, distinct_labels, part_names, select
from cagesdf.errors import InputError
from cagesdf.structure.hierarchy import PartHierarchy

# Few letters, so that names collide; those that readers of files trip over.
texts = st.one_of(
    st.text("ab_1 L", max_size=6),
    st.sampled_from(["leg", "Leg", "LEG", "leg_1", "leg_2", "leg__1", "leg 1", "root", "", " ", "\n", "a/b", "a\\b"]),
    st.sampled_from(
        ["ﬁn", "fin", "ß", "SS", "é", "e\u0301", "\u200d", "\x00", "\ud800", '"', "*", "?", "|", "leg*", "[a]"]
    ),
    st.text(max_size=5),
    st.just("x" * 1000),
)
labelled = st.dictionaries(texts, texts, max_size=12)
# Labels and ids that are names as they are.
plain = st.one_of(
    st.text("ab_1L", min_size=1, max_size=6),
    st.sampled_from(
        ["leg", "Leg", "LEG", "leg_1", "leg_2", "leg__1", "leg 1", "root", "a/b", "é", "e\u0301", "ß", "SS"]
    ),
)
plain_labelled = st.dictionaries(plain, plain, max_size=12)
TROUBLE = {"a": "leg", "b": "leg", "c": "leg_1", "d": "seat"}


def seen(name: str) -> str:
    """A name for a reader that ignores case, composition and the kind of blank."""
    return unicodedata.normalize("NFKC", name).casefold().replace(" ", "_")


def shape(labels: dict[str, str]) -> PartHierarchy:
    return PartHierarchy.flat(tuple(labels), tuple(labels.values()), "thing")


@given(labelled)
@example(TROUBLE)
def test_no_two_parts_share_a_name_not_even_for_careless_readers(labels: dict[str, str]) -> None:
    names = distinct_labels(labels)
    assert [*names] == [*labels]
    assert len({seen(name) for name in names.values()}) == len(labels)


@given(labelled)
@example(TROUBLE)
def test_names_are_one_printable_line_that_no_pattern_could_mean(labels: dict[str, str]) -> None:
    for name in distinct_labels(labels).values():
        assert name
        assert name.isprintable()
        assert name == " ".join(name.split())
        assert not set(name) & set("*?|")
        assert len(name) <= MAX_NAME + 20
        name.encode("utf-8")


@given(plain_labelled)
@example(TROUBLE)
def test_a_label_that_one_part_alone_has_is_its_name(labels: dict[str, str]) -> None:
    names = distinct_labels(labels)
    shared = Counter(map(seen, labels.values()))
    for part, label in labels.items():
        if shared[seen(label)] == 1:
            assert names[part] == label


@given(plain_labelled, plain, plain)
@example(TROUBLE, "e", "leg")
@example(TROUBLE, "e", "leg_3")
def test_one_part_more_renames_no_other_unless_its_label_or_id_is_already_in_use(
    labels: dict[str, str], part: str, label: str
) -> None:
    names = distinct_labels(labels)
    used = {seen(text) for text in (*labels, *labels.values(), *names.values())}
    known = Counter(map(seen, labels.values()))[seen(label)] >= 2
    if seen(part) not in used and (known or seen(label) not in used):
        after = distinct_labels({**labels, part: label})
        assert {other: after[other] for other in labels} == names


@given(labelled)
@example(TROUBLE)
def test_a_name_selects_its_part_and_nothing_else(labels: dict[str, str]) -> None:
    if not labels:
        return
    structure = shape(labels)
    names = part_names(structure)
    for part, name in names.items():
        if name not in labels and name not in labels.values():
            assert select(structure, name) == (part,)
    everything = "|".join(names.values())
    assert set(select(structure, everything)) == set(labels) or everything in {*labels, *labels.values()}


def test_a_label_that_looks_like_a_number_of_others_keeps_its_part() -> None:
    assert distinct_labels(TROUBLE) == {"a": "leg__1", "b": "leg_2", "c": "leg_1", "d": "seat"}
    assert select(shape(TROUBLE), "leg_1") == ("c",)
    assert select(shape(TROUBLE), "leg") == ("a", "b")
    assert select(shape(TROUBLE), "leg_*") == ("a", "b", "c")


def test_a_part_that_is_called_by_label_and_number_keeps_its_number() -> None:
    assert distinct_labels({"leg_2": "leg", "leg_3": "leg"}) == {"leg_2": "leg_2", "leg_3": "leg_3"}
    assert distinct_labels({"x": "leg", "leg_1": "leg"}) == {"x": "leg__1", "leg_1": "leg_1"}
    assert distinct_labels({"x": "leg", "leg_1": "back"}) == {"x": "leg", "leg_1": "back"}


@pytest.mark.parametrize("label", ["a|b", "leg*", "what?", "[seat]", "seat[1]", "*", "[", "[!a]"])
def test_letters_of_patterns_in_labels_mean_themselves_where_the_whole_label_is_said(label: str) -> None:
    structure = shape({"1": label, "2": "seat1", "3": "a", "4": "b"})
    assert select(structure, label)[0] == "1"
    assert select(structure, part_names(structure)["1"]) == ("1",)
    if label[0] in "[s":
        assert select(structure, label) == ("1",)


def test_a_part_may_be_called_root() -> None:
    structure = shape({"root": "root", "root_": "x"})
    assert structure.parts() == ("root", "root_")
    assert structure.root() not in structure.parts()
    assert structure.children(structure.root()) == ("root", "root_")
    assert part_names(structure) == {"root": "root", "root_": "x"}
    again = PartHierarchy.from_json(structure.to_json())
    assert again.parts() == structure.parts()


def test_the_names_of_a_large_shape_are_not_all_listed() -> None:
    with pytest.raises(InputError) as error:
        select(shape({str(i): f"slat {i}" for i in range(150)}), "x" * 10_000)
    assert len(str(error.value)) < 1000
