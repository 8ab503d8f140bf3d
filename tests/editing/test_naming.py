"""Parts of new programs are called as the training parts that they are most like, unique, copies numbered."""

from dataclasses import replace

import numpy as np
import pytest

from cagesdf.demo import DEMO
from cagesdf.editing.links import linked, mirrors, repeats
from cagesdf.editing.naming import KnownParts, group_names, relative_boxes
from cagesdf.editing.parts import part_names, select
from cagesdf.editing.session import Session
from cagesdf.editing.state import State
from cagesdf.io.cage_generators import read_generator
from cagesdf.io.runs import read_run
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.stored import read_structure

NOTHING = KnownParts.of(())


@pytest.fixture(scope="module")
def demo() -> dict[str, State]:
    return dict(Session(read_run(DEMO / "run")).styles.shapes)


def bare(state: State) -> Assembly:
    """The structure without labels."""
    assert isinstance(state.structure, Assembly)
    return replace(state.structure, names={})


def test_labels_that_are_taken_away_come_back_from_the_other_shapes(demo: dict[str, State]) -> None:
    right = total = 0
    for shape_id, state in demo.items():
        if state.structure.placed_program() is None:
            continue
        others = KnownParts.of(other for name, other in demo.items() if name != shape_id)
        labels = others.labelled(bare(state), state.cage).labels()
        truth = state.structure.labels()
        right += sum(labels[part] == truth[part] for part in truth)
        total += len(truth)
    assert total > 200
    assert right / total > 0.9


def test_parts_that_mirror_or_repeat_each_other_share_a_label_and_all_names_differ(demo: dict[str, State]) -> None:
    known = KnownParts.of(demo.values())
    kept = read_generator(DEMO / "programs").generator.sample(np.random.default_rng(0), 12, 1.0).kept
    assert kept
    for generated in kept:
        structure = known.labelled(generated.structure, generated.cage)
        labels, names = structure.labels(), part_names(structure)
        assert set(labels.values()) <= set(known.labels)
        assert len(set(names.values())) == len(names) == len(generated.cage)
        state = State.opened(generated.cage, structure, np.zeros(1, np.float32), next(iter(demo.values())).similarity)
        for part in labels:
            assert {labels[other] for other in linked([part], [mirrors(state), repeats(state)])} == {labels[part]}
        again = read_structure(structure.to_json())
        assert part_names(again) == names, "names are kept where the structure is"
        assert again.signature() == generated.structure.signature()
        assert all(select(structure, name) == (part,) for part, name in names.items())


def test_without_labels_parts_are_called_by_their_groups(demo: dict[str, State]) -> None:
    state = demo["chair_0000"]
    structure = NOTHING.labelled(bare(state), state.cage)
    names = part_names(structure)
    assert len(set(names.values())) == len(names)
    assert all("group" in name or name.startswith("part") for name in names.values())
    in_groups = {part.rpartition("/")[0] for part in names if "/" in part}
    assert {name.split(" / ")[0] for name in names.values() if " / " in name} == {
        f"group {number}" for number in range(1, len(in_groups) + 1)
    }


def test_labels_that_are_there_stay(demo: dict[str, State]) -> None:
    state = demo["chair_0000"]
    assert NOTHING.labelled(state.structure, state.cage) is state.structure


def test_boxes_are_relative_to_the_whole(demo: dict[str, State]) -> None:
    cage = demo["chair_0000"].cage
    moved = replace(cage, centre=3 * cage.centre + 1, size=3 * cage.size)
    np.testing.assert_allclose(relative_boxes(moved), relative_boxes(cage), atol=1e-12)
    boxes = relative_boxes(cage)
    assert (boxes[:, :3] - boxes[:, 3:] / 2).min() == pytest.approx(-0.5)
    assert (boxes[:, :3] + boxes[:, 3:] / 2).max() == pytest.approx(0.5)


def test_groups_are_called_by_what_is_in_them_and_no_two_alike(demo: dict[str, State]) -> None:
    for state in demo.values():
        groups = group_names(state.structure)
        assert len(set(groups.values())) == len(groups)
        labels = state.structure.labels()
        for node, text in groups.items():
            inside = {labels[part] for part in labels if part.startswith(f"{node}/")}
            assert not inside or all(label in text for label in inside)
    chair = demo["chair_0000"]
    numbered = group_names(NOTHING.labelled(bare(chair), chair.cage))
    assert set(numbered.values()) == {f"group {number}" for number in range(1, len(numbered) + 1)}


def test_a_document_reads_back_as_the_labelled_structure_where_it_stands(demo: dict[str, State]) -> None:
    known = KnownParts.of(demo.values())
    generated = read_generator(DEMO / "programs").generator.sample(np.random.default_rng(1), 1, 1.0).kept[0]
    read = read_structure(known.document(generated.structure, generated.cage))
    assert read.labels() == known.labelled(generated.structure, generated.cage).labels()
    assert read.cage().part_ids == generated.cage.part_ids
    assert np.allclose(read.cage().corners(), generated.cage.corners(), atol=1e-6)
