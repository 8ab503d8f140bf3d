"""Whatever goes wrong in the editor is said there in one line; a defect is called one, and its traceback is kept."""

import logging

import pytest

from cagesdf.editing.script import Resize
from cagesdf.errors import InputError, NotSolidError, ShapeRejected
from cagesdf.viewing.refusals import saying


def said(error: BaseException) -> list[str]:
    lines: list[str] = []
    with saying(lines.append):
        raise error
    return lines


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (InputError("a.obj, line 3:\n no face"), "a.obj, line 3: no face"),
        (ShapeRejected("a", "import_shapes", "it has no parts"), "shape a, import_shapes: it has no parts"),
        (NotSolidError("it has no volume"), "it has no volume"),
    ],
)
def test_what_is_wrong_with_input_is_said_without_a_log(
    error: Exception, text: str, caplog: pytest.LogCaptureFixture
) -> None:
    assert said(error) == [text]
    assert caplog.records == []


@pytest.mark.parametrize(
    "error", [ValueError("shapes (3,) and (4,)"), KeyError("leg"), ZeroDivisionError(), IndexError()]
)
def test_a_defect_is_called_one_and_its_traceback_logged(error: Exception, caplog: pytest.LogCaptureFixture) -> None:
    [text] = said(error)
    assert text.startswith(f"a defect of cagesdf, please report it: {type(error).__name__}: ")
    [record] = caplog.records
    assert record.levelno == logging.ERROR
    assert record.exc_info is not None
    assert record.exc_info[1] is error


def test_too_little_memory_is_no_defect(caplog: pytest.LogCaptureFixture) -> None:
    [text] = said(MemoryError())
    assert "more memory than there is" in text
    assert [record.levelno for record in caplog.records] == [logging.WARNING]


def test_numbers_that_no_operation_has_are_refused_in_our_words() -> None:
    lines: list[str] = []
    with saying(lines.append):
        Resize(part="leg", axis="x", factor=1e9)
    assert lines == ["resize: factor is 1000000000.0; wanted a number from 0.01 to 100"]


def test_the_end_of_the_program_is_not_held_up() -> None:
    with pytest.raises(KeyboardInterrupt):
        said(KeyboardInterrupt())


def test_nothing_is_said_where_nothing_is_wrong() -> None:
    lines: list[str] = []
    with saying(lines.append):
        pass
    assert lines == []
