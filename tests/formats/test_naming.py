"""Part ids: any name that a file gives works, in every stage."""

import unicodedata
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cagesdf.formats.naming import MAX_NAME, UNNAMED, distinct_names, part_name
from cagesdf.io.cuboids import read_cages
from cagesdf.io.matches import read_matches
from cagesdf.io.sequences import read_sequences
from cagesdf.io.shapes import read_shapes
from pipeline import DeformParams, FitParams, ImportParams, MatchParams
from stages import deform_sequences, fit_cuboids, import_shapes, match_targets
from tests.support import toy
from tests.support.gltf_files import Gltf

names = st.text(st.characters(), max_size=6) | st.sampled_from(["leg", "leg_2", "leg_3", "", " ", "part", "part_2"])
NAMES = (
    "root",
    "root_",
    "",
    "leg",
    "leg",
    "a/b|c",
    "leg [1]",
    "läg 椅",
    "*",
    "\x07",
    "surface/leg",
    "'; --",
    ".",
    "-1",
)


@given(st.lists(names, max_size=12))
def test_ids_are_different_and_the_first_of_a_name_keeps_it(texts: list[str]) -> None:
    ids = distinct_names(texts)
    assert len({*ids}) == len(ids) == len(texts)
    for i, (text, part_id) in enumerate(zip(texts, ids, strict=True)):
        name = part_name(text)
        if name not in map(part_name, texts[:i]):
            assert part_id == name
        assert part_id.startswith(name)
    assert distinct_names(ids) == ids


@given(st.text(st.characters()))
def test_a_name_is_one_printable_line_of_bounded_length(text: str) -> None:
    name = part_name(text)
    assert 0 < len(name) <= MAX_NAME
    assert name.splitlines() == [name]
    assert name == " ".join(name.split())
    assert name.encode("utf-8").decode("utf-8") == name
    assert not {unicodedata.category(letter) for letter in name} & {"Cc", "Cs"}
    assert part_name(name) == name


def test_a_name_of_nothing_is_the_unnamed_ones() -> None:
    assert {part_name(text) for text in ("", " \t", "\0\n", "\udfff")} == {UNNAMED}


def test_a_thousand_parts_of_one_name_are_numbered_from_2() -> None:
    assert distinct_names(["leg"] * 1000) == ["leg", *(f"leg_{i}" for i in range(2, 1001))]


def test_any_name_goes_through_the_stages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names like the root's, patterns, paths, none at all; parts in a row, in three shapes of different sizes."""
    monkeypatch.setenv("CAGESDF_WORKERS", "1")
    for shape, width in (("a", 1.0), ("b", 1.2), ("c", 1.4)):
        file = Gltf()
        nodes = [file.part(toy.box([i, 0, 0], [width, 1 + 0.1 * i, 1]), name) for i, name in enumerate(NAMES)]
        (tmp_path / "raw").mkdir(exist_ok=True)
        (tmp_path / "raw" / f"{shape}.glb").write_bytes(file.show(*nodes).glb())
    wanted = (
        "root", "root_", "part", "leg", "leg_2", "a/b|c", "leg [1]", "läg 椅", "*", "part_2", "surface/leg", "'; --",
        ".", "-1",
    )  # fmt: skip
    raw, shapes, cuboids, matches, sequences = (tmp_path / name for name in ("raw", "shapes", "cuboids", "m", "s"))
    limits: toy.Limits = {"weld": 1e-5, "max_faces": 100_000, "max_parts": 150, "min_thickness": 1e-4}
    import_shapes.main(
        raw, shapes, ImportParams(format=1, include="*", up="y", parts="given", max_rejected=0.0, **limits)
    )
    fit_cuboids.main(
        shapes, cuboids,
        FitParams(format=1, slack=0.01, min_size=1e-3, margin=1e-6, points=50, max_rejected=0.0, seed=6),
    )  # fmt: skip
    match_targets.main(
        shapes, cuboids, matches, MatchParams(format=1, unmatched="drop", scale=(0.8, 1.25), max_rejected=0.0, seed=2)
    )
    deform_sequences.main(
        shapes, cuboids, matches, sequences,
        DeformParams(format=1, steps=3, held_out=(1,), interpolation="cuboids", transfer="trilinear", max_rejected=0.0),
    )  # fmt: skip
    for read in read_shapes(shapes):
        structure = read.structure
        assert tuple(part.part_id for part in read.parts) == structure.parts() == wanted
        assert structure.children(structure.root()) == wanted
        assert structure.root() not in wanted
    assert {cage.part_ids for cage in read_cages(cuboids).values()} == {wanted}
    for match in read_matches(matches):
        assert dict(match.pairs) == {part: part for part in wanted}
    for sequence in read_sequences(sequences).values():
        assert np.isfinite(sequence.cages[-1].vectors()).all()
