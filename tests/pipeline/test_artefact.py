"""Artefacts: whole or not at all, of the right kind, the same bytes again."""

import json
from pathlib import Path

import pytest

from pipeline import artefact
from pipeline.artefact import ArtefactError
from pipeline.params import MatchParams


def params(seed: int = 1, version: int = 1) -> MatchParams:
    return MatchParams(format=version, unmatched="drop", scale=(0.5, 2.0), max_rejected=0.1, seed=seed)


def make(out: Path, text: str = "hello", **inputs: Path) -> Path:
    with artefact.write("cuboids", out, inputs=inputs, params=params()) as folder:
        (folder / "deep").mkdir()
        (folder / "deep" / "file.txt").write_text(text, encoding="utf-8")
    return out


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_an_exception_leaves_neither_output_nor_half_of_one(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="stop"), artefact.write("a", tmp_path / "a", {}, params()) as folder:
        (folder / "file").write_text("half", encoding="utf-8")
        raise RuntimeError("stop")
    assert list(tmp_path.iterdir()) == []


def test_an_exception_leaves_the_output_of_before_as_it_was(tmp_path: Path) -> None:
    before = snapshot(make(tmp_path / "a"))
    with pytest.raises(RuntimeError), artefact.write("a", tmp_path / "a", {}, params()) as folder:
        (folder / "file").write_text("half", encoding="utf-8")
        raise RuntimeError
    assert snapshot(tmp_path / "a") == before
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_writing_twice_gives_the_same_bytes_and_forgets_old_files(tmp_path: Path) -> None:
    first = snapshot(make(tmp_path / "a"))
    (tmp_path / "a" / "stray").write_text("x", encoding="utf-8")
    assert snapshot(make(tmp_path / "a")) == first


def test_the_manifest_says_kind_parameters_inputs_and_files_and_no_place(tmp_path: Path) -> None:
    source = make(tmp_path / "a")
    manifest = artefact.read_manifest(make(tmp_path / "b", cuboids=source))
    assert manifest["kind"] == "cuboids"
    assert manifest["params"]["seed"] == 1
    assert manifest["inputs"] == {"cuboids": artefact.digest_file(source / "manifest.json")}
    assert manifest["files"]["deep/file.txt"]["bytes"] == 5
    assert str(tmp_path) not in json.dumps(manifest)


def test_an_input_of_another_kind_is_refused_by_name_before_anything_is_written(tmp_path: Path) -> None:
    source = make(tmp_path / "a")
    with (
        pytest.raises(ArtefactError, match="holds 'cuboids', wanted 'shapes'"),
        artefact.write("b", tmp_path / "b", {"shapes": source}, params()),
    ):
        pass
    assert not (tmp_path / "b").exists()


def test_an_input_of_another_format_or_with_a_lost_file_is_refused(tmp_path: Path) -> None:
    source = make(tmp_path / "a")
    with (
        pytest.raises(ArtefactError, match=r"format 1, params\.yaml says 2"),
        artefact.write("b", tmp_path / "b", {"cuboids": source}, params(version=2)),
    ):
        pass
    (source / "deep" / "file.txt").unlink()
    with (
        pytest.raises(ArtefactError, match=r"lacks deep/file\.txt"),
        artefact.write("b", tmp_path / "b", {"cuboids": source}, params()),
    ):
        pass


def test_an_input_that_was_cut_short_is_refused_by_name(tmp_path: Path) -> None:
    source = make(tmp_path / "a")
    file = source / "deep" / "file.txt"
    file.write_bytes(file.read_bytes()[:-1])
    with (
        pytest.raises(ArtefactError, match=r"file\.txt: is not as it was written"),
        artefact.write("b", tmp_path / "b", {"cuboids": source}, params()),
    ):
        pass


def test_what_a_killed_stage_left_is_removed(tmp_path: Path) -> None:
    for left in ("a.partial", "a.old"):
        (tmp_path / left).mkdir()
        (tmp_path / left / "manifest.json").write_text("{", encoding="utf-8")
    again, fresh = make(tmp_path / "a"), make(tmp_path / "b")
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a", "b"]
    assert artefact.digest_tree(again) == artefact.digest_tree(fresh)


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"kind": 1}'])
def test_a_damaged_manifest_is_refused_by_name(tmp_path: Path, damage: str) -> None:
    source = make(tmp_path / "a")
    (source / "manifest.json").write_text(damage, encoding="utf-8")
    with pytest.raises(ArtefactError, match=r"manifest\.json"):
        artefact.read_manifest(source)


def test_the_digest_of_a_folder_sees_names_and_bytes(tmp_path: Path) -> None:
    digests = set()
    for name, text in (("a", "x"), ("b", "x"), ("a", "y")):
        folder = tmp_path / f"{name}{text}"
        folder.mkdir()
        (folder / name).write_text(text, encoding="utf-8")
        digests.add(artefact.digest_tree(folder))
    assert len(digests) == 3


def test_a_digest_covers_files_behind_links_and_ends_where_these_go_round(tmp_path: Path) -> None:
    for name in ("data/a", "elsewhere"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "elsewhere" / "seat.obj").write_text("v 0 0 0\n")
    (tmp_path / "data" / "b").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "data" / "a" / "round").symlink_to(tmp_path / "data")
    before = artefact.digest_tree(tmp_path / "data")
    assert before == artefact.digest_tree(tmp_path / "data")
    (tmp_path / "elsewhere" / "seat.obj").write_text("v 1 0 0\n")
    assert artefact.digest_tree(tmp_path / "data") != before
