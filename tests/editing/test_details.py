"""Details that keep their size while cuboids change theirs, in laws; and surfaces that show it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.editing.script import (
    Build,
    Delete,
    Details,
    Duplicate,
    Harmonise,
    Mix,
    Move,
    Operation,
    Resize,
    Rotate,
    Scale,
    Set,
    Split,
    dump,
    parse,
)
from cagesdf.editing.session import Session, state_field
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.extraction import CageField, LiveSurface, extract
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh, is_closed, signed_volume
from cagesdf.models.decoders import Decoder, to_unit
from cagesdf.structure.hierarchy import PartHierarchy
from tests.support.untrained import untrained


@pytest.fixture(scope="module")
def session() -> Session:
    """Two chairs of equal structure and unit, the second one half as deep; a network that was never trained."""
    run = untrained().run
    small = replace(run.sequences["b"], cages=(run.structures["b"].cage(),))
    narrow = replace(small.cages[0], size=small.cages[0].size * [1, 1, 0.5])
    return Session(replace(run, sequences={**run.sequences, "b": replace(small, cages=(narrow,))}))


DETAILS: tuple[Details, ...] = ("keep", "stretch")


def do(session: Session, *script: Operation) -> State:
    return session.edited(session.opened("a"), script).present


def changes(details: Details) -> list[Resize | Scale | Set | Move | Rotate]:
    """One of each kind that may change lengths."""
    return [
        Resize(part="leg_1", axis="z", factor=1.3, details=details),
        Resize(part="*", axis="x", factor=0.8, frame="shape", details=details),
        Scale(factors=(1.1, 1.0, 0.9), details=details),
        Set(parameter="Chair.seat.y", value=0.08, details=details),
        Move(part="seat", by=(0.0, 0.0, 0.05), attach=True, details=details),
        Rotate(part="back", axis="x", angle=5, attach=True, details=details),
    ]


@pytest.mark.parametrize("number", range(len(changes("keep"))))
def test_the_network_is_evaluated_in_the_lengths_of_before_and_in_those_of_now_if_details_stretch(
    session: Session, number: int
) -> None:
    before = session.opened("a")
    kept, stretched = (do(session, changes(word)[number]) for word in DETAILS)
    np.testing.assert_array_equal(kept.evaluated().size, before.cage.size)
    assert (kept.cage.size != before.cage.size).any()
    assert stretched.evaluated() is stretched.cage
    np.testing.assert_array_equal(kept.cage.vectors(), stretched.cage.vectors())
    resized = (kept.cage.size != before.cage.size).any(axis=1)
    assert set(kept.kept) == {part for part, changed in zip(kept.cage.part_ids, resized) if changed}


def test_the_way_to_a_length_does_not_matter_and_there_and_back_is_nothing(session: Session) -> None:
    twice, half = (Resize(part="leg_*", axis="z", factor=factor, details="keep") for factor in (2.0, 0.5))
    once = do(session, Resize(part="leg_*", axis="z", factor=4.0, details="keep"))
    for state, other in ((do(session, twice, twice), once), (do(session, twice, half), session.opened("a"))):
        assert state_field(session.run, state).keys() == state_field(session.run, other).keys()
    assert not do(session, twice, half).kept


@pytest.mark.parametrize("order", [("keep", "stretch"), ("stretch", "keep")])
@pytest.mark.parametrize(("kept", "stretched"), [(0.5, 2.0), (2.0, 0.25)])
def test_a_stretch_takes_kept_details_along_before_or_after(
    session: Session, order: tuple[Details, ...], kept: float, stretched: float
) -> None:
    factors = {"keep": kept, "stretch": stretched}
    script = (Resize(part="seat", axis="x", factor=factors[word], details=word) for word in order)
    state = do(session, *script)
    before = session.opened("a")
    row, _ = before.own_axis("x")
    assert state.cage["seat"].size[row] == kept * stretched * before.cage["seat"].size[row]
    assert state.evaluated()["seat"].size[row] == stretched * before.cage["seat"].size[row]


def test_a_mix_keeps_the_lengths_that_details_have_in_the_other_shapes_file(session: Session) -> None:
    run = session.run
    larger = replace(run.similarities["b"], scale=run.similarities["a"].scale / 1.25)  # the same, were its file larger
    session = Session(replace(run, similarities={**run.similarities, "b": larger}))
    mixed = do(session, Mix(part="seat|back", style_of="b", details="keep"))
    for part in ("seat", "back"):
        lengths = 1.25 * run.sequences["b"].cages[0][part].size
        np.testing.assert_allclose(mixed.evaluated()[part].size, lengths, rtol=1e-12)
    assert set(mixed.kept) == {"seat", "back"}
    half = do(session, Mix(part="seat", style_of="b", details="keep", weight=0.5))
    between = (session.opened("a").cage["seat"].size + mixed.evaluated()["seat"].size) / 2
    np.testing.assert_allclose(half.evaluated()["seat"].size, between, rtol=1e-12)
    assert not do(session, Mix(part="seat", style_of="b", details="keep", weight=0.0)).kept
    assert not do(session, Mix(part="seat", style_of="b", details="keep"), Mix(part="seat", style_of="b")).kept


def test_a_shape_in_its_own_style_has_nothing_to_keep(session: Session) -> None:
    assert not do(session, Mix(part="*", style_of="a", details="keep")).kept


def test_copies_keep_their_details_cuts_share_them_and_what_goes_takes_them_along(session: Session) -> None:
    longer = Resize(part="leg_*", axis="z", factor=2.0, details="keep")
    state = do(session, longer)
    copied = do(session, longer, Duplicate(part="leg_1", by=(0.0, 0.1, 0.0), mirror=False))
    (new,) = set(copied.cage.part_ids) - set(state.cage.part_ids)
    assert copied.kept[new].tobytes() == next(iter(state.kept.values())).tobytes()
    cut = do(session, longer, Split(part="leg_1", axis="z", mirror=False))
    row, _ = cut.own_axis("z")
    for part, lengths in cut.kept.items():
        assert lengths[row] == pytest.approx(cut.cage[part].size[row] / 2)
    gone = do(session, longer, Delete(part="leg_*"))
    assert not gone.kept


def test_networks_that_look_anew_forget_kept_details_but_of_mixed_parts(session: Session) -> None:
    script = (Resize(part="*", axis="z", factor=2.0, details="keep"), Mix(part="seat", style_of="b", details="keep"))
    state = do(session, *script)
    harmonised = do(session, *script, Harmonise())
    assert set(harmonised.kept) == {"seat"} < set(state.kept)
    cuboids = {"top": Cuboid(np.zeros(3), np.eye(3), np.array([1.0, 0.2, 0.5]))}
    stool = PartHierarchy.flat(("top",), ("seat",), "stool").with_cuboids(cuboids)
    assert not do(session, *script, Build(structure=stool.to_json())).kept


def test_details_of_a_file_in_another_unit_are_refused(session: Session) -> None:
    run = session.run
    metres = replace(run.similarities["b"], scale=run.similarities["b"].scale * 1000)
    session = Session(replace(run, similarities={**run.similarities, "b": metres}))
    with pytest.raises(InputError, match=r"operation 0: mix: details of seat would keep .* wanted lengths from"):
        do(session, Mix(part="seat", style_of="b", details="keep"))


def test_scripts_say_it_and_those_of_before_stretch(session: Session) -> None:
    script = tuple(changes("keep"))
    assert parse(dump(script)) == script
    (old,) = parse('[{"op": "resize", "part": "seat", "axis": "x", "factor": 2}]')
    assert isinstance(old, Resize)
    assert old.details == "stretch"
    with pytest.raises(InputError, match="resize: details is 'shrink'; wanted stretch or keep"):
        parse('[{"op": "resize", "part": "seat", "axis": "x", "factor": 2, "details": "shrink"}]')


class Mallet(Decoder):
    """In each cuboid a slim shaft along z that carries a block as wide as the cuboid, a fifth of the length."""

    trains_on = "part"
    trusted = 0.5

    def unit(self, cuboid: torch.Tensor) -> torch.Tensor:
        return cuboid[:, 12:].amin(dim=1)

    def features(self, points: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return to_unit(points, cuboid)

    def condition(self, code: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return cuboid[:, None, 12:]

    def evaluate(self, features: torch.Tensor, condition: torch.Tensor, compute_dtype: torch.dtype) -> torch.Tensor:
        x, y, z = features.unbind(dim=-1)
        across = torch.maximum(x.abs(), y.abs())
        sides = condition.amin(dim=-1)
        shaft = torch.maximum(across - 0.2, z.abs() - 0.5)
        block = torch.maximum(across - 0.5, 0.3 - z)
        return torch.minimum(shaft, torch.maximum(block, z - 0.5)) * sides


def block_height(mesh: Mesh, cuboid: Cuboid) -> float:
    """How far below the upper end what is wide begins."""
    local = (mesh.vertices - cuboid.centre) @ cuboid.axes.T
    wide = np.abs(local[:, 0]) > 0.4 * cuboid.size[0]
    return float(cuboid.size[2] / 2 - local[wide, 2].min())


@pytest.mark.parametrize("factor", [0.6, 1.5, 2.0])
def test_a_block_keeps_its_height_where_it_would_stretch_with_the_cuboid(factor: float) -> None:
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    axes = turn * np.sign(np.linalg.det(turn))
    rest = Cage.of({"mallet": Cuboid(np.array([0.1, 0.0, -0.2]), axes, np.array([0.3, 0.3, 0.6]))})
    moved = replace(rest, size=rest.size * [1, 1, factor])
    codes = torch.zeros(1, 1)
    before, stretched, kept = (
        extract(CageField(Mallet(), codes, *cages), 96) for cages in ((rest,), (moved,), (moved, rest))
    )
    height = block_height(before.parts["mallet"], rest["mallet"])
    assert height == pytest.approx(0.12, abs=0.01)
    assert block_height(stretched.parts["mallet"], moved["mallet"]) == pytest.approx(factor * height, abs=0.01)
    assert abs(block_height(kept.parts["mallet"], moved["mallet"]) - height) < 0.25 * abs(factor - 1) * height
    assert kept.evaluations == before.evaluations
    ends = (kept.parts["mallet"].vertices - moved.centre[0]) @ axes.T
    np.testing.assert_allclose([ends.min(axis=0), ends.max(axis=0)], np.outer([-0.5, 0.5], moved.size[0]), atol=1e-9)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=4, deadline=None)
def test_resized_surfaces_are_closed_and_within_their_cuboids_and_those_that_need_not_be_the_very_same(
    seed: int,
) -> None:
    session, rng = untrained(), np.random.default_rng(seed)
    state = do(session, Delete(part="leg_*|Base/*"))
    lengths = {part: size * np.exp(rng.normal(size=3) / 2) for part, size in zip(state.cage.part_ids, state.cage.size)}
    lengths["seat"] = state.cage["seat"].size
    live = session.live(16)
    before, after = live.surface(state), live.surface(state.evaluated_in(lengths))
    assert after.parts["seat"] is before.parts["seat"]
    for part, mesh in after.parts.items():
        if len(mesh.faces):
            assert is_closed(mesh)
            assert signed_volume(mesh) > 0
            assert Cage.of({part: state.cage[part]}).signed_distance(mesh.vertices).max() < 1e-8


def test_an_edit_that_keeps_details_gives_the_bytes_of_starting_anew(session: Session) -> None:
    live = session.live(24)
    live.surface(session.opened("a"))
    state = do(session, Resize(part="leg_*", axis="z", factor=1.5, keep="high", details="keep"))
    field = state_field(session.run, state)
    once = LiveSurface(24).surface(field)
    again = live.surface(state)
    assert again.evaluations < once.evaluations
    assert again.mesh.vertices.tobytes() == once.mesh.vertices.tobytes()
    stretched = live.surface(do(session, Resize(part="leg_*", axis="z", factor=1.5, keep="high")))
    assert stretched.mesh.vertices.tobytes() != again.mesh.vertices.tobytes()


def test_a_frame_of_its_own_does_not_move_what_is_kept() -> None:
    """Only a similarity's scale counts, not where a file's shape lies."""
    session = untrained()
    run = session.run
    moved = Similarity(run.similarities["b"].scale, np.eye(3), np.array([5.0, 0.0, 0.0]))
    other = Session(replace(run, similarities={**run.similarities, "b": moved}))
    mix = Mix(part="*", style_of="b", details="keep")
    assert not do(session, mix).kept
    assert not do(other, mix).kept
