"""From states to surfaces: after any edits the same bytes as at once, each part within its cuboid."""

from pathlib import Path

import numpy as np
import pytest

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.editing.operations import apply, edited
from cagesdf.editing.script import (
    Blend,
    Build,
    Mix,
    Move,
    Operation,
    Resize,
    Rotate,
    Scale,
    Set,
    Swap,
    Undo,
    dump,
    parse,
)
from cagesdf.editing.session import Session, export_of
from cagesdf.editing.state import History
from cagesdf.errors import InputError
from cagesdf.geometry.meshes import is_closed
from cagesdf.io.exports import write_export
from cagesdf.structure.hierarchy import PartHierarchy

EDITS: tuple[Operation, ...] = (
    Move(part="arm_1", by=(0.05, 0.02, 0.0)),
    Rotate(part="back", axis="x", angle=5),
    Swap(style_of="b"),
    Resize(part="leg_*", axis="z", factor=0.9, keep="high"),
    Set(parameter="Chair.seat.y", value=0.08),
    Undo(),
    Blend(style_of="a", weight=0.3),
    Scale(factors=(1.1, 1.0, 0.9)),
    Mix(part="leg_*|back", style_of="b", weight=0.7),
)


def test_edits_one_by_one_give_the_bytes_of_the_whole_script_at_once(session: Session, tmp_path: Path) -> None:
    history, live = History.of(session.opened("a")), session.live(32)
    evaluations = []
    for operation in EDITS:
        history = apply(history, operation, session.styles)
        found = live.surface(history.present)
        evaluations.append(found.evaluations)
    state = edited(session.opened("a"), EDITS, session.styles).present
    at_once = session.live(32).surface(state)
    assert max(evaluations[1], evaluations[3]) < at_once.evaluations
    for name, each in (("live.glb", found), ("once.glb", at_once)):
        write_export(tmp_path / name, export_of(each, state))
    assert (tmp_path / "live.glb").read_bytes() == (tmp_path / "once.glb").read_bytes()


def test_a_style_changes_the_surface_and_not_the_cage(session: Session) -> None:
    state = session.opened("a")
    swapped = session.edited(state, (Swap(style_of="b"),)).present
    assert swapped.cage is state.cage
    one, other = (session.live(32).surface(each).mesh for each in (state, swapped))
    assert one.vertices.shape != other.vertices.shape or not np.allclose(one.vertices, other.vertices)


def test_each_part_is_a_closed_mesh_within_its_own_cuboid(session: Session) -> None:
    state = session.edited(session.opened("a"), EDITS).present
    model = export_of(session.live(32).surface(state), state)
    assert is_closed(model.surface)
    assert {"arm_1", "arm_2", "leg_1", "leg_2", "seat"} <= set(model.cuboids)
    cuboids = dict(zip(model.cuboids, state.cage.part_ids))
    for name, mesh in model.parts.items():
        assert is_closed(mesh)
        own = Cage.of({name: state.cage[cuboids[name]]})
        assert own.signed_distance(state.similarity.to_canonical(mesh.vertices)).max() <= 1e-6


def test_a_shape_or_step_that_there_is_not_is_refused_by_name(session: Session) -> None:
    with pytest.raises(InputError, match="no shape 'c' among its 2"):
        session.opened("c")
    with pytest.raises(InputError, match="has the steps 0"):
        session.opened("a", step=3)


TOKENS = (
    "NaN",
    "1e999",
    "-1e308",
    "0",
    "-1",
    "null",
    "true",
    "[]",
    "{}",
    '""',
    "[[[[",
    "9" * 400,
    '"op"',
    "\0",
    '"a|b|*"',
)


def test_a_mutated_script_is_done_or_refused_and_nothing_else(session: Session) -> None:
    """A text with places replaced, removed, repeated: 10,000 of each kind were tried by hand."""
    state = session.opened("a")
    tree = PartHierarchy.flat(tuple("pqr"), ("leg", "leg", "leg_1"), "chair").with_cuboids(
        {part: Cuboid(np.array([0.3 * i, 0, 0]), np.eye(3), np.array([0.1, 0.5, 0.2])) for i, part in enumerate("pqr")}
    )
    builds = [Build(structure=structure.to_json()) for structure in (tree, state.structure)]
    text = dump((*EDITS, builds[0], Move(part="leg_*", by=(0.0, 0.1, 0.0), repeat=True), builds[1]))
    rng = np.random.default_rng(0)
    done: list[History | str] = []
    for _ in range(40):
        mutant = text
        for start in rng.integers(len(text), size=rng.integers(1, 4)).tolist():
            end = start + int(rng.integers(0, 12))
            token = TOKENS[rng.integers(len(TOKENS))] if rng.integers(2) else mutant[start:end] * int(rng.integers(3))
            mutant = mutant[:start] + token + mutant[end:]
        try:
            done.append(session.edited(state, parse(mutant)))
        except InputError as error:
            done.append(str(error))
    assert all(isinstance(outcome, History) or outcome.startswith("script: ") for outcome in done)
    histories = [outcome for outcome in done if isinstance(outcome, History)]
    assert 0 < len(histories) < 30
    for history in histories:
        for each in (*history.past, history.present, *history.future):
            assert each.seen.part_ids == each.cage.part_ids
