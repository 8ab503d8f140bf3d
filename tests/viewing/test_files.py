"""What comes in through the browser is bounded and read by checked readers; what goes out is the command's file."""

import io
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from cagesdf.editing.session import export_of
from cagesdf.errors import InputError
from cagesdf.extraction import Extraction
from cagesdf.io.exports import write_boxes, write_export
from cagesdf.viewing import files
from tests.support.untrained import untrained


def test_an_export_is_the_file_that_the_command_writes(tmp_path: Path) -> None:
    session = untrained()
    state = session.opened("a")
    found = session.live(48).surface(state)
    for ending in files.FORMATS:
        write_export(tmp_path / f"a.{ending}", export_of(found, state))
        assert files.exported(found, state, ending) == (tmp_path / f"a.{ending}").read_bytes()
        write_boxes(tmp_path / f"boxes.{ending}", export_of(found, state))
        assert files.exported_boxes(found, state, ending) == (tmp_path / f"boxes.{ending}").read_bytes()
    with pytest.raises(InputError, match="no surface"):
        files.exported(Extraction.nothing(), state, "ply")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        pytest.param(b"\xff\xfe\x00", "no text in UTF-16", id="no UTF-16"),
        pytest.param(b"[\xff]", "no text in UTF-8", id="no UTF-8"),
        pytest.param(b" " * (files.MAX_BYTES + 1), "wanted at most", id="too large"),
        pytest.param(b'[{"op": "explode"}]', "wanted", id="unknown operation"),
        pytest.param(b"import os", "script", id="no script"),
    ],
)
def test_a_bad_script_is_refused_in_words(content: bytes, said: str) -> None:
    with pytest.raises(InputError, match=said):
        files.script_of("script.json", content)


def test_a_bad_script_is_called_as_the_user_calls_it() -> None:
    with pytest.raises(InputError, match=r"^My legs\.json: operation 0: "), files.script_called("My legs.json"):
        files.script_of("My legs.json", b'[{"op": "explode"}]')


def test_a_bad_program_is_refused_in_words() -> None:
    with pytest.raises(InputError):
        files.program_of("chair.txt", b"__import__('os').system('true')")


def zipped(members: Mapping[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return content.getvalue()


def damaged_zip() -> bytes:
    """A zip whose one member has another name in its own header than in the directory."""
    return zipped({"leg.obj": b"v"}).replace(b"leg.obj", b"leg.obx", 1)


def test_meshes_of_a_zip_lie_side_by_side_and_nothing_else_comes_with_them(tmp_path: Path) -> None:
    folder = tmp_path / "into"
    folder.mkdir()
    members = {
        "chair/leg.obj": b"one",
        "../../back.OBJ": b"two",
        "C:\\x\\seat.ply": b"three",
        "/etc/arm.stl": b"four",
        "run.py": b"import os",
        "__MACOSX/._leg.obj": b"",
        "chair/notes.txt": b"-",
    }
    assert files.meshes_of("chair.zip", zipped(members), folder) == folder
    found = {path.relative_to(tmp_path).as_posix(): path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert found == {
        "into/leg.obj": b"one",
        "into/back.OBJ": b"two",
        "into/seat.ply": b"three",
        "into/arm.stl": b"four",
    }


def test_a_member_without_a_name_is_no_mesh(tmp_path: Path) -> None:
    content = zipped({"leg.obj": b"one", "a": b"two"}).replace(b"a\x03\x00", b"\0\x03\x00")
    nameless = content[:-22].replace(b"a", b"\0") + content[-22:]
    files.meshes_of("chair.zip", nameless, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["leg.obj"]


def test_a_mesh_file_is_taken_as_it_is(tmp_path: Path) -> None:
    path = files.meshes_of("../../My chair.GLB", b"glTF", tmp_path)
    assert (path.parent, path.name, path.read_bytes()) == (tmp_path, "My chair.GLB", b"glTF")


# By what is wrong: the file's name, its bytes (made when the test runs: a zip holds the time), what is said.
BAD_MESHES: Mapping[str, tuple[str, Callable[[], bytes], str]] = {
    "no zip": ("chair.zip", lambda: b"PK nothing", "can't be read as a zip"),
    "cut zip": ("chair.zip", lambda: zipped({"leg.obj": b"v" * 1000})[:-40], "can't be read as a zip"),
    "damaged zip": ("chair.zip", damaged_zip, "can't be read as a zip"),
    "zip without meshes": ("chair.zip", lambda: zipped({"notes.txt": b"-"}), "holds no mesh"),
    "damaged LZMA": (
        "chair.zip",
        lambda: zipped({"leg.obj": b"v"}, zipfile.ZIP_LZMA).replace(b"\x09\x04\x05\x00", b"\xff" * 4),
        "as a zip",
    ),
    "long name": ("chair.zip", lambda: zipped({"x" * 300 + ".obj": b"v"}), "wanted at most 200"),
    "name of two lines": ("chair.zip", lambda: zipped({"a\nb.obj": b"v"}), "wanted at most 200"),
    "one name twice": (
        "chair.zip",
        lambda: zipped({"a/leg.obj": b"-", "b/leg.obj": b"-"}),
        "two meshes are called leg.obj",
    ),
    "too large unpacked": (
        "bomb.zip",
        lambda: zipped({"a.obj": bytes(30_000_000), "b.obj": bytes(30_000_000)}),
        "holds too much",
    ),
    "too many": ("many.zip", lambda: zipped({f"{i}.obj": b"-" for i in range(files.MAX_MESHES + 1)}), "holds too much"),
    "no mesh": ("chair.py", lambda: b"import os", "wanted a .obj"),
    "too large": ("chair.obj", lambda: bytes(files.MAX_MESH_BYTES + 1), "wanted at most"),
}


@pytest.mark.parametrize("wrong", BAD_MESHES)
def test_bad_meshes_are_refused_in_words(tmp_path: Path, wrong: str) -> None:
    name, content, said = BAD_MESHES[wrong]
    with pytest.raises(InputError, match=said):
        files.meshes_of(name, content(), tmp_path)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_damaged_zip_is_read_or_refused_and_nothing_else(method: int, tmp_path: Path) -> None:
    sound = zipped({"leg.obj": b"v 0 0 0\n" * 9, "stühle/seat.ply": bytes(range(256))}, method)
    rng = np.random.default_rng(0)
    refusals = []
    for number in range(200):
        content = bytearray(sound)
        for place in rng.integers(len(content), size=rng.integers(1, 4)):
            content[place] = rng.integers(256)
        folder = tmp_path / str(number)
        folder.mkdir()
        try:
            files.meshes_of("chair.zip", bytes(content), folder)
        except InputError as error:
            refusals.append(str(error))
    assert len(refusals) > 50
    assert all(text.startswith("chair.zip: ") for text in refusals)
