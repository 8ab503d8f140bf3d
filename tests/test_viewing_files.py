"""What comes in through the browser is bounded and read by checked readers; what goes out is the command's file."""

from pathlib import Path

import pytest
from untrained import untrained

from cagesdf.editing.session import model_of
from cagesdf.errors import InputError
from cagesdf.io.exports import write_model
from cagesdf.meshes import Mesh
from cagesdf.viewing import files


def test_an_export_is_the_file_that_the_command_writes(tmp_path: Path) -> None:
    session = untrained()
    state = session.opened("a")
    mesh = session.live(48).surface(state).mesh
    for ending in files.FORMATS:
        write_model(tmp_path / f"a.{ending}", model_of(mesh, state))
        assert files.exported(mesh, state, ending) == (tmp_path / f"a.{ending}").read_bytes()
    with pytest.raises(InputError, match="no surface"):
        files.exported(Mesh(mesh.vertices[:0], mesh.faces[:0]), state, "ply")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\xff\xfe\x00", "no text in UTF-8"),
        (b" " * (files.MAX_BYTES + 1), "wanted at most"),
        (b'[{"op": "explode"}]', "wanted"),
        (b"import os", "script"),
    ],
)
def test_a_bad_script_is_refused_in_words(content: bytes, said: str) -> None:
    with pytest.raises(InputError, match=said):
        files.script_of("script.json", content)


def test_a_bad_program_is_refused_in_words() -> None:
    with pytest.raises(InputError):
        files.program_of("chair.txt", b"__import__('os').system('true')")
