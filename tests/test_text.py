"""Text in whichever encoding it was saved: read as it was meant, or refused with the reason."""

import codecs
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cagesdf.errors import InputError, ProgramError
from cagesdf.structure.parsing import read_program
from cagesdf.text import decode, read_text

SAVED = {
    "plain": lambda text: text.encode("utf-8"),
    "mark": lambda text: codecs.BOM_UTF8 + text.encode("utf-8"),
    "twice": lambda text: 2 * codecs.BOM_UTF8 + text.encode("utf-8"),
    "powershell": lambda text: codecs.BOM_UTF16_LE + text.encode("utf-16-le"),
    "big endian": lambda text: codecs.BOM_UTF16_BE + text.encode("utf-16-be"),
    "utf-32": lambda text: codecs.BOM_UTF32_LE + text.encode("utf-32-le"),
}
PROGRAM = "Assembly Program_0 {\r\nbbox = Cuboid(1, 1, 1, True)\r\na = Cuboid(1, 1, 1, True)\r\n}\r\n"


@pytest.mark.parametrize("how", SAVED)
@given(text=st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\ufeff"), min_size=1))
def test_text_is_read_back_however_it_was_saved(how: str, text: str) -> None:
    if how == "plain" and "\0" in text:
        return  # may be UTF-16 without a mark
    assert decode(SAVED[how](text), "a.txt") == text


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_utf16_is_known_without_a_mark(encoding: str) -> None:
    assert decode(PROGRAM.encode(encoding), "a.txt") == PROGRAM


def test_nothing_is_no_text() -> None:
    assert decode(b"", "a.txt") == ""


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"leg \xff", "a.txt: is no text in UTF-8 (invalid start byte at byte 4); save it as UTF-8"),
        ("Stuhl für".encode("latin-1"), "UTF-8"),
        (codecs.BOM_UTF16_LE + b"\0\xd8\0\0", "UTF-16-LE"),
        (codecs.BOM_UTF16_LE + b"a", "UTF-16-LE (truncated data"),
    ],
)
def test_what_is_no_text_is_refused_with_its_place(content: bytes, said: str) -> None:
    with pytest.raises(InputError) as error:
        decode(content, "a.txt")
    assert said in str(error.value)


def test_files_are_bounded_and_there(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(b"12345")
    assert read_text(tmp_path / "a.txt", 5) == "12345"
    with pytest.raises(InputError, match=r"5 bytes; wanted at most 4"):
        read_text(tmp_path / "a.txt", 4)
    for path, said in ((tmp_path / "b.txt", "no such file"), (tmp_path, "is a folder")):
        with pytest.raises(InputError, match=said):
            read_text(path, 1_000_000)


@pytest.mark.parametrize("how", SAVED)
def test_programs_are_read_in_every_encoding(how: str, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(SAVED[how](PROGRAM))
    assert len(read_program(tmp_path / "a.txt").blocks) == 1
    (tmp_path / "b.txt").write_bytes(b"Assembly \xff")
    with pytest.raises(ProgramError, match="no text in UTF-8"):
        read_program(tmp_path / "b.txt")
