"""From states to surfaces: after any edits the same bytes as at once, cut so that each face is in its cuboid."""

from pathlib import Path
from typing import Any

import numpy as np
import programs
import pytest
import torch

from cagesdf.cuboid import Sequence
from cagesdf.editing.operations import apply, edited
from cagesdf.editing.script import Blend, Move, Operation, Resize, Rotate, Scale, Set, Swap, Undo
from cagesdf.editing.session import Session, model_of
from cagesdf.editing.state import History
from cagesdf.errors import InputError
from cagesdf.frames import UP_AXES, Similarity
from cagesdf.io.exports import write_model
from cagesdf.io.runs import Run
from cagesdf.meshes import is_closed
from cagesdf.models.arms import make_decoder
from cagesdf.models.latents import LatentTable
from cagesdf.structure.assembly import Assembly

FIGURES: dict[str, Any] = {"width": 12, "layers": 3, "latent_dim": 4, "mapping": [8], "octaves": 1}
EDITS: tuple[Operation, ...] = (
    Move(part="arm_1", by=(0.05, 0.02, 0.0)),
    Rotate(part="back", axis="x", angle=5),
    Swap(style_of="b"),
    Resize(part="leg_*", axis="z", factor=0.9, keep="high"),
    Set(parameter="Chair.seat.y", value=0.08),
    Undo(),
    Blend(style_of="a", weight=0.3),
    Scale(factors=(1.1, 1.0, 0.9)),
)


@pytest.fixture(scope="module")
def session() -> Session:
    """Two chairs in one cage, and a network that was never trained: what it says differs by cuboid and style."""
    decoder: Any = make_decoder("LocalCageDecoder", **FIGURES, seed=1)
    with torch.no_grad():
        decoder.backbone.out.weight.mul_(0.02)
        decoder.backbone.out.bias.fill_(-0.01)
    labels = {"arm": "arm", "cube4": "arm", "Base/Side/leg": "leg", "Base/cube1/leg": "leg"}
    structure = Assembly(programs.CHAIR, Similarity(0.9, np.eye(3), np.zeros(3)), labels)
    names = ("a", "b")
    return Session(
        Run(
            decoder.eval().requires_grad_(False),
            LatentTable.drawn(tuple((name, -1) for name in names), 4, 3.0, seed=2).requires_grad_(False),
            {name: Sequence(name, None, np.zeros(1), (False,), (structure.cage(),)) for name in names},
            dict.fromkeys(names, structure),
            dict.fromkeys(names, Similarity(0.5, UP_AXES["z"], np.array([0.1, 0.2, 0.3]))),
            {**FIGURES, "decoder": "LocalCageDecoder", "points_of": "cage"},
            {},
        )
    )


def test_edits_one_by_one_give_the_bytes_of_the_whole_script_at_once(session: Session, tmp_path: Path) -> None:
    history, live = History.of(session.opened("a")), session.live(32)
    asked = []
    for operation in EDITS:
        history = apply(history, operation, session.styles)
        found = live.surface(history.present)
        asked.append(found.asked)
    state = edited(session.opened("a"), EDITS, session.styles).present
    at_once = session.live(32).surface(state)
    assert max(asked[1], asked[3]) < at_once.asked
    for name, mesh in (("live.glb", found.mesh), ("once.glb", at_once.mesh)):
        write_model(tmp_path / name, model_of(mesh, state))
    assert (tmp_path / "live.glb").read_bytes() == (tmp_path / "once.glb").read_bytes()


def test_a_style_changes_the_surface_and_not_the_cage(session: Session) -> None:
    state = session.opened("a")
    swapped = session.edited(state, (Swap(style_of="b"),)).present
    assert swapped.cage is state.cage
    one, other = (session.live(32).surface(each).mesh for each in (state, swapped))
    assert one.vertices.shape != other.vertices.shape or not np.allclose(one.vertices, other.vertices)


def test_the_surface_is_cut_so_that_each_face_is_in_its_parts_cuboid(session: Session) -> None:
    state = session.edited(session.opened("a"), EDITS).present
    model = model_of(session.live(32).surface(state).mesh, state)
    assert is_closed(model.surface)
    centres = state.similarity.to_canonical(model.surface.corners().mean(axis=1))
    distance = state.cage.signed_distance(centres)
    assert (np.take_along_axis(distance, model.owner[:, None], axis=1) <= 1e-6).all()
    assert sum(map(len, model.faces().values())) == len(model.surface.faces)
    assert {"arm_1", "arm_2", "leg_1", "leg_2", "seat"} <= set(model.cuboids)


def test_a_shape_or_step_that_there_is_not_is_refused_by_name(session: Session) -> None:
    with pytest.raises(InputError, match="no shape 'c' among its 2"):
        session.opened("c")
    with pytest.raises(InputError, match="has the steps 0"):
        session.opened("a", step=3)
