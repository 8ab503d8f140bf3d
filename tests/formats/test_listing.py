"""Folders of shapes: which entries are shapes, what is said of the others; lists of ids; names that look like globs."""

import codecs
import errno
import json
import os
import random
import unicodedata
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.formats.listing import Listing, ShapeSource, find_shapes, list_shapes, read_shape
from cagesdf.formats.shapeassembly import list_programs
from cagesdf.formats.splits import read_list
from cagesdf.io.rejected import read_rejected
from cagesdf.io.shapes import read_shapes
from pipeline import ImportParams
from stages.import_shapes import main
from tests.support import toy

BOX = toy.box([0, 0, 0], [1, 1, 1])
PARAMS = ImportParams(
    format=1,
    include="*",
    up="y",
    parts="given",
    weld=1e-5,
    max_faces=100_000,
    max_parts=150,
    min_thickness=1e-4,
    max_rejected=0.0,
)
ENCODINGS = {
    "utf-8": b"",
    "utf-8-sig": b"",
    "utf-16-le": codecs.BOM_UTF16_LE,
    "utf-16-be": codecs.BOM_UTF16_BE,
    "utf-32-le": codecs.BOM_UTF32_LE,
    "utf-32-be": codecs.BOM_UTF32_BE,
}


def write_shapes(folder: Path, *names: str) -> None:
    for name in names:
        toy.write_obj(folder / name / "seat.obj", BOX)


def splits_of(folder: Path) -> dict[str, str]:
    return {source.shape_id: source.split for source in list_shapes(folder, "*")}


def ids(listing: Listing) -> list[str]:
    return [source.shape_id for source in listing]


# Folders


def test_the_listing_takes_folders_and_files_that_fit_and_nothing_else(tmp_path: Path) -> None:
    write_shapes(tmp_path, "chair_b", "chair_a", "desk", ".hidden")
    (tmp_path / "chair_hier").mkdir()
    for name in ("chair_c.obj", "chair_d.glb", "chair_e.json", "chair_f.txt", ".chair.obj", "chair_g.STL", "x.md"):
        (tmp_path / name).touch()
    listing = list_shapes(tmp_path, "chair_*")
    assert ids(listing) == ["chair_a", "chair_b", "chair_c", "chair_d", "chair_g"]
    assert listing.notes == ("no shapes: chair_e.json, chair_f.txt",)
    with pytest.raises(InputError, match="include 'sofa"):
        list_shapes(tmp_path, "sofa*")
    with pytest.raises(InputError, match="no such folder"):
        list_shapes(tmp_path / "none", "*")


def test_each_mesh_file_of_a_format_that_is_read_is_a_shape_and_others_are_named(tmp_path: Path) -> None:
    for name in ("a.obj", "b.OBJ", "c.stl", "d.ply", "e.off", "g.fbx", "h.zip", "i.blend"):
        (tmp_path / name).touch()
    listing = list_shapes(tmp_path, "*")
    assert ids(listing) == ["a", "b", "c", "d"]
    (foreign,) = [note for note in listing.notes if note.startswith("not read: ")]
    assert foreign.startswith("not read: e.off, g.fbx, h.zip, i.blend; export ")
    assert any("each mesh file is a shape" in note for note in listing.notes)


def test_a_part_in_a_format_that_is_not_read_is_named(tmp_path: Path) -> None:
    write_shapes(tmp_path, "a")
    (tmp_path / "a" / "leg.dae").touch()
    (tmp_path / "a" / ".leg.dae").touch()
    (note,) = list_shapes(tmp_path, "*").notes
    assert note.startswith("not read: a/leg.dae; ")


def test_what_systems_leave_and_folders_without_a_mesh_are_no_shapes(tmp_path: Path) -> None:
    write_shapes(tmp_path, "chair1", "__MACOSX/chair1", "__MACOSX")
    for name in (".DS_Store", "Thumbs.db", "desktop.ini", "._chair1", "textures/wood.png", "chair1/._seat.obj"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"\0")
    (tmp_path / "broken link").symlink_to(tmp_path / "nowhere")
    os.mkfifo(tmp_path / "pipe.obj")
    listing = list_shapes(tmp_path, "*")
    assert ids(listing) == ["chair1"]
    assert listing.notes == (
        "no shapes, as no mesh lies in these folders: textures",
        "no shapes: broken link, pipe.obj",
    )
    assert [part.part_id for part in read_shape(listing.shapes[0]).parts] == ["seat"]


def test_names_that_are_no_text_are_no_shapes(tmp_path: Path) -> None:
    write_shapes(tmp_path, "a", "b\nc", os.fsdecode(b"St\xfchl"))
    listing = list_shapes(tmp_path, "*")
    assert ids(listing) == ["a"]
    assert listing.notes == (r"no shapes, as their names are no text: 'St\udcfchl', 'b\nc'; rename them",)


def test_what_is_no_shape_never_stops_the_stage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Not one rejection is allowed here, and of four folders three are none."""
    write_shapes(tmp_path / "raw", "a", "__MACOSX")
    for name in ("textures", "empty"):
        (tmp_path / "raw" / name).mkdir()
    (tmp_path / "raw" / "textures" / "wood.png").touch()
    main(tmp_path / "raw", tmp_path / "out", PARAMS)
    assert read_shapes(tmp_path / "out").ids == ("a",)
    out = capsys.readouterr().out
    assert "no mesh lies in these folders: empty, textures\n" in out
    assert "1 shapes to train on, 0 held out for validation\n" in out


def test_check_and_the_stage_see_the_same_shapes(tmp_path: Path) -> None:
    write_shapes(tmp_path / "all", "a", "b")
    (tmp_path / "all" / "c.stl").touch()
    (tmp_path / "lone").mkdir()
    for name in ("a.obj", "b.ply"):
        (tmp_path / "lone" / name).touch()
    for folder in (tmp_path / "all", tmp_path / "lone"):
        for include in ("*", "a", "[bc]"):
            assert find_shapes(folder, include) == list_shapes(folder, include)


# Names


HOSTILE = ["chair [v2]", "chair*", "chair?", "[a]", "!x", "{a,b}", "$HOME", "`id`", "Stühl", "椅子 01", "-x", "#1"]


def test_hierarchies_and_programs_are_found_by_their_exact_names(tmp_path: Path) -> None:
    names = [*HOSTILE, "chair 2", "chair1", "a", "chair v"]
    write_shapes(tmp_path, *names)
    for name in names:
        for kind, suffix in (("hier", "json"), ("programs", "txt")):
            (tmp_path / f"chair_{kind}").mkdir(exist_ok=True)
            (tmp_path / f"chair_{kind}" / f"{unicodedata.normalize('NFD', name)}.{suffix}").touch()
    for source in list_shapes(tmp_path, "*"):
        assert source.hierarchy is not None
        assert source.program is not None
        assert unicodedata.normalize("NFC", source.hierarchy.stem) == source.shape_id
        assert unicodedata.normalize("NFC", source.program.stem) == source.shape_id
    for name in HOSTILE:
        assert name in ids(list_shapes(tmp_path, name)), "an include that is a name"


def test_a_source_knows_its_hierarchy_and_the_first_of_several(tmp_path: Path) -> None:
    write_shapes(tmp_path, "7", "8")
    for name in ("a_hier/7.json", "b_hier/7.json", "b_hier/8.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert list(list_shapes(tmp_path, "*")) == [
        ShapeSource("7", "train", tmp_path / "7", tmp_path / "a_hier" / "7.json", None),
        ShapeSource("8", "train", tmp_path / "8", tmp_path / "b_hier" / "8.json", None),
    ]


def test_a_shape_that_is_called_like_a_folder_of_hierarchies_or_programs_is_noted(tmp_path: Path) -> None:
    write_shapes(tmp_path, "a", "chair_hier", "chair_programs")
    (tmp_path / "b_hier").mkdir()
    listing = list_shapes(tmp_path, "*")
    assert ids(listing) == ["a"]
    assert listing.notes == (
        "no shapes, as folders of hierarchies or programs end like them: chair_hier, chair_programs; "
        "rename those whose meshes are a shape",
    )
    assert list_shapes(tmp_path, "a").notes == ()


def test_programs_of_which_none_is_a_shapes_are_noted(tmp_path: Path) -> None:
    write_shapes(tmp_path, "a")
    (tmp_path / "x_programs").mkdir()
    (tmp_path / "x_programs" / "A.txt").touch()
    (note,) = list_shapes(tmp_path, "*").notes
    assert note == "none of the 1 programs is called like a shape: A"


def test_lists_and_hidden_files_beside_programs_are_no_programs(tmp_path: Path) -> None:
    (tmp_path / "__MACOSX").mkdir()
    for name, content in {
        "train.txt": b"\xef\xbb\xbfchair 01\r\n", "Val.txt": b"\xff\xfea\0", "__MACOSX/._a.txt": b"\0\5",
        "ids.txt": codecs.BOM_UTF16_LE + "chair_01\r\nstühl\r\n".encode("utf-16-le"),
        "a.txt": b"Assembly x {\n}\n", "b.txt": "Assembly x {\r\n}\r\n".encode("utf-16"), "c.txt": b"\xff",
    }.items():  # fmt: skip
        (tmp_path / name).write_bytes(content)
    assert list_programs([tmp_path]) == [tmp_path / name for name in ("a.txt", "b.txt", "c.txt")]


# Names of entries that have one id, and what the message calls them.
RIVALS = {
    "two formats": (("chair.obj", "chair.ply"), "chair.obj and chair.ply"),
    "a folder beside": (("chair/seat.obj", "chair.stl"), "chair and chair.stl"),
    "PartNet beside": (("chair/objs/o-0.obj", "chair.glb"), "chair and chair.glb"),
    "cases of a suffix": (("chair.OBJ", "chair.obj"), "chair.OBJ and chair.obj"),
    "three": (("chair.glb", "chair.obj", "chair.stl"), "chair.glb, chair.obj and chair.stl"),
    "spellings": (("chai\u0308r.obj", "cha\u00efr.ply"), "chai\u0308r.obj and cha\u00efr.ply"),
    "spellings of a file": (("st\u00fchl.obj", "stu\u0308hl.obj"), r"'stu\u0308hl.obj' and 'st\xfchl.obj'"),
    "spellings of a folder": (("st\u00fchl/a.obj", "stu\u0308hl/a.obj"), r"'stu\u0308hl' and 'st\xfchl'"),
}


def write_entries(folder: Path, *names: str) -> None:
    """A folder or file for each name, as far as the file system takes them for several."""
    for name in names:
        toy.write_obj(folder / name, BOX)


@pytest.mark.parametrize("kind", RIVALS)
def test_entries_of_one_id_cost_their_own_shape_and_no_other(tmp_path: Path, kind: str) -> None:
    names, called = RIVALS[kind]
    write_shapes(tmp_path / "raw", *"abcd")
    (tmp_path / "raw" / "chair.zip").touch()
    write_entries(tmp_path / "raw", *names)
    if len([*(tmp_path / "raw").iterdir()]) < 5 + len(names):
        pytest.skip("the file system takes some names for one")
    (tmp_path / "raw" / "val.txt").write_text("b\nchair\n")
    main(tmp_path / "raw", tmp_path / "out", PARAMS.model_copy(update={"max_rejected": 0.2}))
    assert read_shapes(tmp_path / "out").ids[:4] == tuple("abcd")
    ((shape_id, reason),) = read_rejected(tmp_path / "out").items()
    assert reason == (
        f"{tmp_path}/raw: {called} would have one name, {shape_id!r}; keep one of them or rename the others"
    )


def test_names_that_differ_by_case_or_more_are_shapes_of_their_own(tmp_path: Path) -> None:
    names = ["Chair.ply", "chair.obj", "chair_.obj", "chair.v2.obj", "chair v2.obj"]
    write_entries(tmp_path, *names)
    assert ids(list_shapes(tmp_path, "*")) == ["Chair", "chair", "chair v2", "chair.v2", "chair_"]
    assert not any(source.rivals for source in list_shapes(tmp_path, "*"))


def test_rivals_that_are_not_included_cost_nothing(tmp_path: Path) -> None:
    write_shapes(tmp_path, "a")
    write_entries(tmp_path, "chair.obj", "chair.ply")
    (source,) = list_shapes(tmp_path, "a")
    assert read_shape(source).shape_id == "a"


def test_a_folder_that_can_not_be_opened_is_left_out_and_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_shapes(tmp_path, "a", "locked", "x_hier", "x_programs")
    opened = Path.iterdir

    def iterdir(path: Path) -> Iterator[Path]:
        if path.parent == tmp_path and path.name != "a":
            raise PermissionError(errno.EACCES, "Permission denied")
        return opened(path)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    listing = list_shapes(tmp_path, "*")
    assert ids(listing) == ["a"]
    (note,) = listing.notes
    assert note == "left out, as these folders can't be opened: " + ", ".join(
        f"{name} (Permission denied)" for name in ("locked", "x_hier", "x_programs")
    )


# Lists


@pytest.mark.parametrize(
    ("files", "wanted"),
    [
        ({}, {}),
        ({"val.txt": "b\n"}, {"b": "val"}),
        ({"val.txt": ""}, {}),
        ({"train.txt": "a\nc\n", "val.txt": "b\n"}, {"b": "val", "d": "val"}),
        ({"Train.TXT": "a\nc\n"}, {"b": "val", "d": "val"}),
        ({"train.txt": "a\nb\nc\nd\n", "val.txt": "b\n"}, {"b": "val"}),
        ({"x_hier/train.txt": "a\nb\nc\n"}, {"d": "val"}),
        ({"x_hier/train.txt": "a\nb\n", "y_hier/train.txt": "c\n"}, {"d": "val"}),
        ({"x_hier/train.txt": "a\n", "train.txt": "a\nb\nc\nd\n"}, {}),
        ({"x_hier/train.txt": "a\n", "val.txt": "b\n"}, {"b": "val"}),
    ],
)
def test_lists_say_what_is_held_out(tmp_path: Path, files: dict[str, str], wanted: dict[str, str]) -> None:
    write_shapes(tmp_path, *"abcd")
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert splits_of(tmp_path) == dict.fromkeys("abcd", "train") | wanted


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("marked", [True, False])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_every_encoding_mark_line_end_and_form_is_read_alike(
    tmp_path: Path, encoding: str, marked: bool, end: str, form: Literal["NFC", "NFD"]
) -> None:
    write_shapes(tmp_path, "chair 01", "Stühl", "椅子", "left")
    text = unicodedata.normalize(form, end.join(["chair 01", "", "# held out below", "Stühl", "椅子"]))
    (tmp_path / "train.txt").write_bytes((ENCODINGS[encoding] if marked else b"") + text.encode(encoding))
    assert splits_of(tmp_path) == {"chair 01": "train", "Stühl": "train", "椅子": "train", "left": "val"}


def test_folders_of_a_mac_are_called_as_those_of_others(tmp_path: Path) -> None:
    write_shapes(tmp_path, unicodedata.normalize("NFD", "Stühl"), "b")
    (tmp_path / "val.txt").write_text("Stühl\n", encoding="utf-8")
    assert splits_of(tmp_path) == {"Stühl": "val", "b": "train"}


names = (
    st.text(st.characters(exclude_categories=["Cc", "Cs"], exclude_characters="\ufeff"), min_size=1, max_size=12)
    .map(lambda name: unicodedata.normalize("NFC", name))
    .filter(lambda name: name == name.strip() != "")
)


@given(
    known=st.lists(names, min_size=1, max_size=6, unique=True),
    encoding=st.sampled_from([name for name in ENCODINGS if name != "utf-8"]),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    form=st.sampled_from(["NFC", "NFD"]),
    spaces=st.lists(st.sampled_from(["", " ", "\t", "  "]), min_size=6, max_size=6),
)
def test_what_was_listed_is_what_is_read(
    tmp_path_factory: pytest.TempPathFactory,
    known: list[str],
    encoding: str,
    end: str,
    form: Literal["NFC", "NFD"],
    spaces: list[str],
) -> None:
    """Whatever the ids hold: spaces, brackets, "#", suffixes, any letters."""
    path = tmp_path_factory.mktemp("lists") / "train.txt"
    text = end.join(f"{space}{name}{space}" for name, space in zip(known, spaces)) + end
    path.write_bytes(ENCODINGS[encoding] + unicodedata.normalize(form, text).encode(encoding))
    listed = read_list([path], set(known))
    assert (set(listed.ids), listed.unknown) == (set(known), ())


@pytest.mark.parametrize("line", ["a", "a.obj", "a.OBJ", " a\t", "a # the good one", "a.ply  # comment", "\ufeffa"])
def test_suffixes_space_and_comments_around_an_id_are_left_out(tmp_path: Path, line: str) -> None:
    write_shapes(tmp_path, "a", "b")
    (tmp_path / "val.txt").write_text(f"# comment\n\n{line}\n", encoding="utf-8")
    listing = list_shapes(tmp_path, "*")
    assert splits_of(tmp_path) == {"a": "val", "b": "train"}
    assert listing.notes == ()


def test_the_most_literal_spelling_wins(tmp_path: Path) -> None:
    write_shapes(tmp_path, "a", "a.obj", "#1", "b #2")
    (tmp_path / "val.txt").write_text("a.obj\n#1\nb #2\n")
    assert splits_of(tmp_path) == {"a": "train", "a.obj": "val", "#1": "val", "b #2": "val"}


def test_ids_that_are_no_shape_are_noted_with_their_lines_and_the_nearest_id(tmp_path: Path) -> None:
    write_shapes(tmp_path / "chairs", "chair 01", "chair 02")
    (tmp_path / "chairs" / "train.txt").write_text("chair 01\nchair 02\nChair_01\nstool\nchair 01.off\n")
    listing = list_shapes(tmp_path / "chairs", "*")
    assert {source.split for source in listing} == {"train"}
    assert listing.notes == (
        "chairs/train.txt: no shape is called 'Chair_01' (train.txt line 3: there is 'chair 01'), "
        "'stool' (train.txt line 4), 'chair 01.off' (train.txt line 5)",
    )
    (tmp_path / "chairs" / "train.txt").write_text("".join(f"x{i}\n" for i in range(100)))
    assert list_shapes(tmp_path / "chairs", "*").notes[0].endswith("'x19' (train.txt line 20) and 80 more")


@pytest.mark.parametrize("line", ["a b", "a, b", "a;b"])
def test_several_ids_on_a_line_are_told_apart_from_an_unknown_one(tmp_path: Path, line: str) -> None:
    write_shapes(tmp_path, "a", "b")
    (tmp_path / "train.txt").write_text(f"{line}\n")
    assert f"'{line}' (train.txt line 1: 2 ids, wanted one a line)" in list_shapes(tmp_path, "*").notes[0]


def test_an_id_in_both_lists_is_held_out_and_that_is_said(tmp_path: Path) -> None:
    write_shapes(tmp_path, "a", "b")
    (tmp_path / "train.txt").write_text("a\nb\n")
    (tmp_path / "val.txt").write_text("\nb\n")
    assert splits_of(tmp_path) == {"a": "train", "b": "val"}
    assert list_shapes(tmp_path, "*").notes == (
        "in both lists, so held out for validation: b (train.txt line 2, val.txt line 2)",
    )


@pytest.mark.parametrize("text", ["", "\n", "# nothing\n", "x\ny\n"])
def test_a_train_list_without_a_shape_stops_the_stage_with_the_reason(tmp_path: Path, text: str) -> None:
    write_shapes(tmp_path / "raw", "a", "b")
    (tmp_path / "raw" / "train.txt").write_text(text)
    with pytest.raises(InputError, match=r"all 2 shapes are held out.*raw/train.txt: names no shape that is here"):
        main(tmp_path / "raw", tmp_path / "out", PARAMS)
    assert [path.name for path in tmp_path.iterdir()] == ["raw"]


def test_a_val_list_without_a_shape_is_told_by_the_stage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_shapes(tmp_path / "raw", "a", "b")
    (tmp_path / "raw" / "val.txt").write_text("c\n")
    main(tmp_path / "raw", tmp_path / "out", PARAMS)
    out = capsys.readouterr().out
    assert "raw/val.txt: no shape is called 'c' (val.txt line 1)\n" in out
    assert "raw/val.txt: names no shape that is here, so it holds none out\n" in out


def test_shapes_that_the_train_list_lacks_are_told_if_they_are_asked_for(tmp_path: Path) -> None:
    write_shapes(tmp_path, "a", "b", "x1", "x2")
    (tmp_path / "train.txt").write_text("a\nx1\n")
    (note,) = list_shapes(tmp_path, "x*").notes
    assert note.endswith("1 shapes that it doesn't list are held out for validation: x2")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a\nSt\xfchl\n", "line 2: is no text in UTF-8 .*; save it as UTF-8"),
        (codecs.BOM_UTF16_LE + b"a\0\n", "line 1: is no text in UTF-16-LE"),
        (b" " * (16 * 2**20 + 1), "at most 16,777,216"),
    ],
    ids=["Latin-1", "half a letter", "17 MB"],
)
def test_a_list_that_can_not_be_read_is_refused(tmp_path: Path, content: bytes, said: str) -> None:
    write_shapes(tmp_path, "a")
    (tmp_path / "train.txt").write_bytes(content)
    with pytest.raises(InputError, match=f"train.txt.*{said}"):
        list_shapes(tmp_path, "*")


# Whatever the files hold


def mutated(content: bytes, rng: random.Random) -> bytes:
    """A file after one to four accidents: bytes changed, cut, doubled, or put in."""
    tokens = (b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b'"', b"[", b"{", b"]", b"null", b"-1", b"1e999", b"9" * 400,
              b"NaN", b'"\\ud800"', b'"children"', b'"id"', b"\n", b"#", b"../", b"a")  # fmt: skip
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(content) + 1)
        end = min(len(content), at + rng.randint(0, 12))
        content = rng.choice(
            [
                content[:at] + rng.choice(tokens) + content[end:],
                content[:at] + content[end:],
                content[:end] + content[at:],
                content[:at] + bytes([rng.randrange(256)]) + content[at + 1 :],
            ]
        )
    return content


ODD: tuple[object, ...] = (
    None, True, -1, 0, 1, 2.5, 10**400, float("nan"), float("inf"), "", "o-0", "../../x", "a\0b", "\ud800",
    "root", [], {}, [[]], ["o-0", "o-0"], ["O-0.obj", 7], {"id": 0}, [0] * 12, [1e400] * 12,
    "REF_SYM", "leg" * 99,
)  # fmt: skip


def changed(content: bytes, rng: random.Random) -> bytes:
    """A JSON file in which one to three values are odd ones, are gone, or are copies of others."""
    tree = [json.loads(content)]
    for _ in range(rng.randint(1, 3)):
        places: list[tuple[Any, Any]] = []
        todo: list[Any] = [tree]
        while todo:
            holder = todo.pop()
            keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
            places += [(holder, key) for key in keys]
            todo += [holder[key] for key in keys if isinstance(holder[key], (dict, list))]
        holder, key = rng.choice(places)
        other, name = rng.choice(places)
        match rng.randrange(4):
            case 0 if holder is not tree:
                del holder[key]
            case 1:
                holder[key] = json.loads(json.dumps(other[name]))
            case _:
                holder[key] = json.loads(json.dumps(rng.choice(ODD)))
    return json.dumps(tree[0]).encode()


def write_partnet(folder: Path) -> None:
    for number in range(3):
        toy.write_obj(folder / "1" / "objs" / f"o-{number}.obj", BOX)
    leaves = [{"id": 1 + i, "name": "leg", "objs": [f"o-{i}"]} for i in range(2)]
    tree = [{"id": 0, "name": "chair", "objs": ["o-0", "o-1", "o-2"], "children": leaves}]
    box = [0.0, 0, 0, 1, 1, 1, 1, 0, 0, 0, 1, 0]
    edges = [
        {"part_a": 0, "part_b": 1, "type": "ADJ", "dist": 0.5},
        {"part_a": 0, "part_b": 1, "type": "REF_SYM", "params": [0, 0, 0, 1, 0, 0]},
        {"part_a": 1, "part_b": 0, "type": "ROT_SYM", "params": [0, 0, 0, 0, 1, 0, 3.1]},
    ]
    children = [{"id": 1 + i, "label": "leg", "box": box} for i in range(2)] + [{"id": -1, "label": "other"}]
    (folder / "1" / "result_after_merging.json").write_text(json.dumps(tree))
    (folder / "x_hier").mkdir()
    (folder / "x_hier" / "1.json").write_text(
        json.dumps({"id": 0, "label": "chair", "box": box, "children": children, "edges": edges})
    )


def write_lists(folder: Path) -> None:
    write_shapes(folder, "a", "b c", "d")
    (folder / "train.txt").write_text("a\nb c\n# no\nd.obj\n")


@pytest.mark.parametrize(
    ("write", "name"),
    [
        (write_lists, "train.txt"),
        (write_partnet, "1/result_after_merging.json"),
        (write_partnet, "x_hier/1.json"),
    ],
    ids=["train.txt", "PartNet", "StructureNet"],
)
def test_a_damaged_file_is_read_or_refused_and_nothing_else(
    tmp_path: Path, write: Callable[[Path], None], name: str
) -> None:
    write(tmp_path)
    sound = (tmp_path / name).read_bytes()
    rng = random.Random(name)
    refused = 0
    runs = 150
    for _ in range(runs):
        change = changed if name.endswith(".json") and rng.random() < 0.7 else mutated
        (tmp_path / name).write_bytes(change(sound, rng))
        try:
            for source in list_shapes(tmp_path, "*"):
                raw = read_shape(source)
                raw.structure.to_dict()  # type: ignore[attr-defined]
                json.dumps([raw.shape_id, *raw.structure.labels().items()], ensure_ascii=False).encode()
        except (InputError, ShapeRejected):
            refused += 1
    assert 0 < refused < runs
