"""Text in whichever encoding it was saved: read as it was meant, or refused with the reason."""

import codecs
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cagesdf.errors import InputError, ProgramError
from cagesdf.structure.parsing import read_program
from cagesdf.text import decode, encoding_of, read_text

SAVED = {
    "plain": lambda text: text.encode("utf-8"),
    "mark": lambda text: codecs.BOM_UTF8 + text.encode("utf-8"),
    "twice": lambda text: 2 * codecs.BOM_UTF8 + text.encode("utf-8"),
    "powershell": lambda text: codecs.BOM_UTF16_LE + text.encode("utf-16-le"),
    "big endian": lambda text: codecs.BOM_UTF16_BE + text.encode("utf-16-be"),
    "utf-32": lambda text: codecs.BOM_UTF32_LE + text.encode("utf-32-le"),
}
PROGRAM = "Assembly Program_0 {\r\nbbox = Cuboid(1, 1, 1, True)\r\na = Cuboid(1, 1, 1, True)\r\n}\r\n"


@pytest.mark.parametrize("saved", SAVED)
@given(text=st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\ufeff"), min_size=1))
def test_text_is_read_back_however_it_was_saved(saved: str, text: str) -> None:
    if saved == "plain" and "\0" in text:
        return  # may be UTF-16 without a mark
    if saved == "powershell" and text.startswith("\0"):
        return  # the mark of UTF-32
    assert decode(SAVED[saved](text), "a.txt") == text


UNMARKED = ["utf-16-le", "utf-16-be", "utf-32-le", "utf-32-be"]


@pytest.mark.parametrize("encoding", UNMARKED)
@pytest.mark.parametrize(
    "text", [PROGRAM, "a", "1\n", '{"name": "Stühl"}', "椅子 01\r\n椅子 02\r\n", "Ā_1\nб_2\n", "№1"],
    ids=["program", "letter", "line", "JSON", "Chinese", "Latin and Cyrillic", "sign"],
)  # fmt: skip
def test_wide_letters_are_known_without_a_mark(text: str, encoding: str) -> None:
    assert decode(text.encode(encoding), "a.txt") == text


@given(st.binary(max_size=200))
def test_any_bytes_are_text_or_refused(content: bytes) -> None:
    encoding = encoding_of(content)
    try:
        content.decode(encoding)
    except UnicodeDecodeError:
        with pytest.raises(InputError, match=r"^a\.txt, line "):
            decode(content, "a.txt")
    else:
        text = decode(content, "a.txt")
        assert not text.startswith("\ufeff")
        assert content.endswith(text.encode(encoding))


@pytest.mark.parametrize("content", [b"v 0 0 0\nv 0\0 0 1\n", b"solid a" + bytes(73), b"exported by a b" + bytes(49)])
def test_some_bytes_of_0_make_no_wide_letters(content: bytes) -> None:
    assert encoding_of(content) == "utf-8"


def test_nothing_is_no_text() -> None:
    assert decode(b"", "a.txt") == ""


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"leg \xff", "a.txt, line 1: is no text in UTF-8 (invalid start byte at byte 4); save it as UTF-8"),
        ("Stuhl\r\nfür".encode("latin-1"), "a.txt, line 2: is no text in UTF-8"),
        (codecs.BOM_UTF16_BE + "a\nb\n".encode("utf-16-be") + b"\xdc\0", "a.txt, line 3: is no text in UTF-16-BE"),
        (codecs.BOM_UTF32_LE + b"\0\0\0\1", "UTF-32-LE"),
        (codecs.BOM_UTF16_LE + b"\0\xd8\0\0", "UTF-16-LE"),
        (codecs.BOM_UTF16_LE + b"a", "UTF-16-LE (truncated data"),
    ],
)
def test_what_is_no_text_is_refused_with_its_place(content: bytes, message: str) -> None:
    with pytest.raises(InputError) as error:
        decode(content, "a.txt")
    assert message in str(error.value)


def test_files_are_bounded_and_there(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(b"12345")
    assert read_text(tmp_path / "a.txt", 5) == "12345"
    with pytest.raises(InputError, match=r"5 bytes; wanted at most 4"):
        read_text(tmp_path / "a.txt", 4)
    long = tmp_path / ("b" * 300)
    for path, message in ((tmp_path / "b.txt", "no such file"), (tmp_path, "is a folder"), (long, "can't be read")):
        with pytest.raises(InputError, match=message):
            read_text(path, 1_000_000)


@pytest.mark.parametrize("saved", SAVED)
def test_programs_are_read_in_every_encoding(saved: str, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(SAVED[saved](PROGRAM))
    assert len(read_program(tmp_path / "a.txt").blocks) == 1
    (tmp_path / "b.txt").write_bytes(b"Assembly \xff")
    with pytest.raises(ProgramError, match="no text in UTF-8"):
        read_program(tmp_path / "b.txt")
